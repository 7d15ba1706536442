"""Delays between the clocks of a segment, from the times at which a frame reached each port.

Source: ESC data sheet, section I (propagation delay measurement). A frame enters a slave at one
port, goes on at the others in the order 0-3-1-2 and comes back at each; half of what the way to a
neighbour and back takes, without the neighbour's own ways, is the delay of the cable.
"""

from collections.abc import Callable, Sequence
from typing import Any

from .controller.record import PORTS
from .controller.registers import R
from .frame import Command, Datagram

OPEN = 2  # of a port in 0110h: loop open, communication established


def measure(send: Callable[..., Any], slaves: Sequence[Any]) -> dict[int, int]:
    """Set 0920h and 0928h of all slaves, the first one being the reference.

    Args:
        send: datagrams out and back.
        slaves: `RemoteSlave`, in the order of their processing units.

    Returns: delay from the reference by position (ns).
    """
    send(Datagram(Command.BWR, 0, R.RECEIVE_TIME, bytes(4)))
    units = [slave.number(R.RECEIVE_TIME_UNIT, 8) for slave in slaves]
    ways = [_way(slave, unit) for slave, unit in zip(slaves, units, strict=True)]
    delays: dict[int, int] = {}
    ahead: list[tuple[int, int]] = []  # slave and part of its way where one is still to be met
    for i, way in enumerate(ways):
        delays[i] = 0
        if ahead:
            parent, part = ahead.pop()
            out, back = ways[parent][part : part + 2]
            cable = (back - out - (way[-1] - way[0])) // 2
            delays[i] = delays[parent] + out - ways[parent][0] + cable
        ahead += [(i, part) for part in reversed(range(len(way) - 1))]
    for i, slave in enumerate(slaves):
        offset = units[0] - units[i] + delays[i]
        slave.write(R.SYSTEM_TIME_OFFSET, offset.to_bytes(8, "little", signed=True))
        slave.write(R.SYSTEM_TIME_DELAY, delays[i].to_bytes(4, "little"))
        slave.write(R.SPEED_COUNTER_START, b"\0\x10")
    return delays


def _way(slave: Any, unit: int) -> list[int]:
    """Times at the open ports, in the order in which the frame came there (ns)."""
    status = slave.number(R.DL_STATUS, 2)
    begin = unit - (1 << 31)  # the registers have 32 bits of the time
    return sorted(
        (slave.number(R.RECEIVE_TIME + 4 * port, 4) - begin) & 0xFFFFFFFF
        for port in range(PORTS)
        if status >> 8 + 2 * port & 3 == OPEN
    )
