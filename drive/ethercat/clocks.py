"""Delays between the clocks of a segment, from the arrival times of a frame at each port.

Source: ESC data sheet, section I (propagation delay measurement). A frame enters a slave at one
port, leaves at the others in the order 0-3-1-2 and returns at each. The delay of a cable is half
the time to the neighbour and back, less the time spent behind the neighbour. A slave that the frame
enters at a port other than 0 processes it on the way back, after slaves that are further away.
"""

from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

from .controller.record import PORTS
from .controller.registers import R
from .frame import Command, Datagram

OPEN = 2  # of a port in 0110h: loop open, communication established


class FramePath(NamedTuple):
    """The path of a frame through a slave."""

    times: list[int]  # at its open ports, in the order in which it came there (ns)
    before: int  # neighbours that the frame visits before it is processed
    unit: int  # from the first of the times to the processing (ns)


class Branch(NamedTuple):
    """A slave and the branches behind its other open ports."""

    slave: int  # number in the order of processing
    behind: "list[Branch]"


def measure(send: Callable[..., Any], slaves: Sequence[Any]) -> dict[int, int]:
    """Set 0920h and 0928h of all slaves; the first one is the reference.

    Args:
        send: sends datagrams and returns them.
        slaves: `RemoteSlave`, in the order of their processing units.

    Returns: delay from the reference by position (ns); negative if processed before it.

    Raises:
        RuntimeError: the open ports are inconsistent; a link may have broken meanwhile.
    """
    send(Datagram(Command.BWR, 0, R.RECEIVE_TIME, bytes(4)))
    units = [slave.number(R.RECEIVE_TIME_UNIT, 8) for slave in slaves]
    ways = [_way(slave, unit) for slave, unit in zip(slaves, units, strict=True)]
    delays: dict[int, int] = {}
    if slaves:
        trees = (tree for tree, end in _trees(ways, 0, len(ways)) if end == len(ways))
        tree = next(trees, None)
        if tree is None:
            raise RuntimeError("the open ports of the slaves do not fit together: scan again")
        entered = _entered(ways, tree, 0)
        delays = {i: entered[i] + ways[i].unit - ways[0].unit for i in range(len(ways))}
        delays = {i: delay - entered[0] for i, delay in delays.items()}
    for i, slave in enumerate(slaves):
        offset = units[0] - units[i] + delays[i]
        slave.write(R.SYSTEM_TIME_OFFSET, offset.to_bytes(8, "little", signed=True))
        slave.write(R.SYSTEM_TIME_DELAY, (delays[i] & 0xFFFFFFFF).to_bytes(4, "little"))
        slave.write(R.SPEED_COUNTER_START, b"\0\x10")
    return delays


def _trees(ways: Sequence[FramePath], begin: int, limit: int) -> Iterator[tuple[Branch, int]]:
    """The possible branches at the end of a cable, made of the slaves from `begin` up to `limit`.

    Yields a branch and the number of the first slave behind it.
    """
    for before in sorted({way.before for way in ways[begin:limit]}):
        for first, slave in _row(ways, begin, limit - 1, before):
            if ways[slave].before == before:
                rest = len(ways[slave].times) - 1 - before
                for last, end in _row(ways, slave + 1, limit, rest):
                    yield Branch(slave, first + last), end


def _row(
    ways: Sequence[FramePath], begin: int, limit: int, count: int
) -> Iterator[tuple[list[Branch], int]]:
    """Yield all sequences of `count` branches, and the first slave behind each."""
    if count == 0:
        yield [], begin
        return
    for branch, end in _trees(ways, begin, limit):
        for others, last in _row(ways, end, limit, count - 1):
            yield [branch, *others], last


def _entered(ways: Sequence[FramePath], branch: Branch, time: int) -> dict[int, int]:
    """Return the time at which a frame enters each slave of a branch (ns)."""
    times = ways[branch.slave].times
    entered = {branch.slave: time}
    for out, back, child in zip(times, times[1:], branch.behind, strict=False):
        own = ways[child.slave].times
        cable = (back - out - (own[-1] - own[0])) // 2
        entered |= _entered(ways, child, time + out - times[0] + cable)
    return entered


def _way(slave: Any, unit: int) -> FramePath:
    """Read a slave's port times from its registers, which hold 32 bits of the time."""
    status = slave.number(R.DL_STATUS, 2)
    begin = unit - (1 << 31)
    times = {
        port: (slave.number(R.RECEIVE_TIME + 4 * port, 4) - begin) & 0xFFFFFFFF
        for port in range(PORTS)
        if status >> 8 + 2 * port & 3 == OPEN
    }
    row = sorted(times.values())
    before = row.index(times[0]) if 0 in times else len(row) - 1
    return FramePath(row, before, (1 << 31) - row[0])
