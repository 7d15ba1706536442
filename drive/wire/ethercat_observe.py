"""Observes a drive at a network interface: `servogym observe --ethercat`.

The segment is first inspected with frames that change nothing. If it exchanges process data, it
belongs to another master and is left alone. If a drive is enabled or moves in PRE_OP, the segment
is read as it is, because a scan would take the slaves to INIT. Otherwise SOEM scans the segment and
takes the slaves to PRE_OP.
"""

import time
from collections.abc import Callable
from typing import Any

from ..ethercat import sii
from ..ethercat.al import AlState
from ..ethercat.controller.registers import R
from ..ethercat.frame import Command, Datagram
from ..ethercat.mailbox_client import MailboxClient
from ..ethercat.master import EtherCatMaster, RemoteSlave
from ..ethercat.observe import EtherCatLine, SlaveAccess
from ..model.model import DriveModel
from ..objects.abort import SdoAbort
from ..observation import Observer, danger
from .ethernet import RawPort
from .soem import SoemMaster, SoemSlave

ANSWER = 0.2  # s, for a frame
INDEX = 17  # byte of a frame: the index of its first datagram
LONGEST = 2048  # bytes of one
PAUSE = 0.0002  # s, between two looks at a mailbox
POLLS = 5000  # of them: a second and more
ENABLED = 0x01  # of the activation of a sync manager
SOEM_ANSWER = 50_000  # µs, for a frame
BUSY = (AlState.BOOTSTRAP, AlState.SAFE_OPERATIONAL, AlState.OPERATIONAL)


def observe(
    interface: str, position: int = 0, model: "str | DriveModel" = "generic", *,
    read_only: bool = False, tell: Callable[[str], None] = lambda text: None,
) -> dict[str, Any]:
    """Observe a slave and return the result.

    Args:
        interface: such as ``eth0``; needs pysoem and permission for raw sockets.
        position: of the slave on the segment, from 0 on.
        model: its data types are used for objects whose lengths agree.
        read_only: write no object and request no state beyond PRE_OP.
        tell: called with lines of progress.

    Raises:
        ValueError: no such interface or slave, or another master exchanges process data.
        ImportError, ConnectionError: as `SoemMaster`. TimeoutError: the slave falls silent.
    """
    asked = "as asked" if read_only else ""
    with _Wire(interface) as wire:
        master = EtherCatMaster(wire)
        states = _states(master, interface)
        _check(interface, position, len(states))
        for n, state in enumerate(states):
            if state in BUSY:
                raise ValueError(
                    f"--ethercat {interface}: slave {n} is in {state.name}, so a master runs it; "
                    "stop that master first; nothing was sent to the slaves"
                )
        standing, reason = _standing(master, states)
        if reason:
            line = EtherCatLine(standing, position, time.sleep, reason)
            return Observer(line, model, tell=tell).observe()
    soem = SoemMaster(interface)
    try:
        slaves = [ScannedSlave(slave, n) for n, slave in enumerate(soem.scan())]
        _check(interface, position, len(slaves))
        line = EtherCatLine(slaves, position, time.sleep, asked)
        return Observer(line, model, tell=tell).observe()
    finally:
        soem.close()


def _check(interface: str, position: int, count: int) -> None:
    if not 0 <= position < count:
        raise ValueError(f"--ethercat {interface}: {count} slaves answer, none at {position}")


def _states(master: EtherCatMaster, interface: str) -> list[AlState]:
    """Read the states of the slaves without writing."""
    try:
        count = master.send(Datagram(Command.BRD, 0, R.AL_STATUS, bytes(2)))[0].wkc
    except TimeoutError:
        raise ValueError(f"--ethercat {interface}: no slave answers; is the cable in, and is the "
                         "drive on?") from None
    found = [
        master.send(Datagram(Command.APRD, -n & 0xFFFF, R.AL_STATUS, bytes(2)))[0].data[0] & 0x0F
        for n in range(count)
    ]
    return [AlState(n) if n in set(AlState) else AlState.INIT for n in found]


def _standing(master: EtherCatMaster, states: list[AlState]) -> tuple[list[SlaveAccess], str]:
    """The slaves as another master left them, and why they must stay so ("" if none is at risk)."""
    slaves: list[SlaveAccess] = []
    reason = ""
    for n, state in enumerate(states):
        if state != AlState.PRE_OPERATIONAL:
            continue
        row = Datagram(Command.APRD, -n & 0xFFFF, R.STATION_ADDRESS, bytes(2))
        station = int.from_bytes(master.send(row)[0].data, "little")
        slave = _standing_slave(master, n, station)
        slaves.append(slave)
        if not slave.read(R.SYNC_MANAGER + 6, 1)[0] & ENABLED:
            continue  # its mailbox is closed: nobody can have enabled it
        try:
            found = danger(slave.mailbox.upload, time.sleep)
        except (SdoAbort, TimeoutError, ValueError):
            continue  # no drive, or one without a position
        reason = reason or (f"slave {n} {found}" if found else "")
    if reason and len(slaves) < len(states):
        raise ValueError(f"{reason}, while other slaves are in INIT: disable it first")
    return slaves, reason


def _standing_slave(master: EtherCatMaster, position: int, station: int) -> RemoteSlave:
    """A slave at its present station address; access to its EEPROM returns to the former owner.

    0500h: 1 the device has it, 2 it is taken from it, 0 the master has it (ETG.1000.4).
    """

    def configure(value: int) -> None:
        master.send(Datagram(Command.FPWR, station, R.EEPROM_CONFIGURATION, bytes([value])))

    row = Datagram(Command.FPRD, station, R.EEPROM_CONFIGURATION, bytes(1))
    with_device = master.send(row)[0].data[0] & 1
    if with_device:
        configure(2)
        configure(0)
    try:
        return RemoteSlave(master, position, station)
    finally:
        if with_device:
            configure(1)


class _Wire:
    """Exchanges frames through a raw socket."""

    def __init__(self, interface: str):
        self._port = RawPort(interface)
        self._buffer = memoryview(bytearray(LONGEST))

    def __enter__(self) -> "_Wire":
        return self

    def __exit__(self, *_: object) -> None:
        self._port.close()

    def exchange(self, frame: bytes, now: int = 0) -> bytes | None:
        """Send a frame; -> what comes back."""
        self._port.send(memoryview(frame))
        until = time.monotonic() + ANSWER
        while time.monotonic() < until:
            length = self._port.receive(self._buffer)
            if length > INDEX and self._buffer[INDEX] == frame[INDEX]:
                return bytes(self._buffer[:length])
        return None  # what came was late, of a frame before


class ScannedSlave:
    """A slave that SOEM has taken to PRE_OP, and that answers our own datagrams."""

    def __init__(self, slave: SoemSlave, position: int):
        self.position = position
        self._slave = slave
        self.description = sii.unpack(slave.read_sii())
        box = self.description.mailbox
        self.mailbox = MailboxClient(
            _Registers(slave), 0, (box.out_start, box.out_length), (box.in_start, box.in_length),
            POLLS,
        )

    def read(self, address: int, size: int) -> bytes:
        """Read registers. Raises TimeoutError if the slave does not answer."""
        for _ in range(3):
            if (data := self._slave.fprd(address, size, SOEM_ANSWER)) is not None:
                return data
        raise TimeoutError(f"slave {self.position} does not answer at {address:04X}h")

    def write(self, address: int, data: bytes) -> bool:
        """Write registers; -> whether they were written."""
        return self._slave.fpwr(address, data, SOEM_ANSWER)


class _Registers:
    """Sends datagrams to one slave through SOEM."""

    def __init__(self, slave: SoemSlave):
        self._slave = slave

    def send(self, *datagrams: Datagram) -> list[Datagram]:
        """Read and write registers; a lost datagram returns with working counter 0."""
        return [self._one(row) for row in datagrams]

    def _one(self, row: Datagram) -> Datagram:
        if row.command == Command.FPWR:
            return row._replace(wkc=int(self._slave.fpwr(row.ado, row.data, SOEM_ANSWER)))
        if len(row.data) == 1:
            time.sleep(PAUSE)  # a look at a sync manager
        data = self._slave.fprd(row.ado, len(row.data), SOEM_ANSWER)
        return row if data is None else row._replace(data=data, wkc=1)
