"""The buses of a machine file, each served frame by frame."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from typing import Any, Protocol

import can

from ...drive.canopen.frame import Base, Frame
from ...drive.canopen.lockstep import LockStep
from ...drive.canopen.node import NmtCommand, Node
from ...drive.ethercat.bus import Bus
from ...drive.ethercat.faulty import FaultyBus
from ...drive.ethercat.segment import Segment
from ...drive.ethercat.slave import Slave
from ...drive.wire.bad_bus import BadBus
from ...drive.wire.bus import CanLink, Traced
from ...drive.wire.ethercat import EtherCatServer, Port
from ...drive.wire.ethernet import RawPort, UdpPort
from ...drive.wire.interfaces import opened
from ...drive.wire.log import LogFile
from ...drive.wire.pcapng import Writer
from ...drive.wire.server import WAIT, Server
from ..engine.machine import Machine
from ..environment.registry import task
from .description import BusRow, Description, MachineRow

PERIOD = 1000  # µs between SYNCs if neither the file nor a task sets it

Report = Callable[[str], None]


class ServedBus(Protocol):
    """An open bus with the machines on it."""

    where: str
    server: Any  # what answers: `Server`, `EtherCatServer` or `LockStep`

    def serve(self) -> None:
        """Wait for a frame (ms at most), answer it, and let the time pass that is due."""

    def ahead(self, seconds: float) -> None:
        """Catch up with machines that have run ahead by a time (s)."""

    def power_cycle(self, machine: Machine) -> None:
        """Restart the communication of a machine's drives."""

    def close(self) -> None:
        """Release the bus."""


def check_access(description: Description, otherwise: str = "") -> None:
    """Open and close the ports of EtherCAT buses, before anything that takes time.

    Args:
        description: the machines and their buses.
        otherwise: another way, named where the right to raw sockets is missing.

    Raises:
        ValueError: a port cannot be opened; names the row and the remedy.
    """
    for row in description.buses:
        try:
            for port in _ports(row, otherwise):
                port.close()
        except ValueError as error:
            raise ValueError(f"{description.row('bus', row.name)}{error}") from None


def open_bus(
    row: BusRow, rows: Iterable[MachineRow], machines: Mapping[str, Machine], seed: int,
    report: Report, named: Callable[[str], str],
) -> ServedBus:
    """Open a bus.

    Args:
        row: of the bus.
        rows: of the machines on it.
        machines: these machines by name.
        seed: of faults with a rate.
        report: takes a line about trouble with the bus or its log.
        named: see `Description.named`.

    Raises:
        ValueError: it cannot be opened.
    """
    served = [*machines.values()]
    if row.kind == "ethercat":
        return _EtherCat(row, served, seed, report)
    row = replace(row, period_us=period(row, rows))

    def connect() -> Any:
        bus = opened(row.keywords, named)
        return BadBus(bus, row.rates(), seed) if row.faults else bus

    bus = connect()
    try:
        if row.clock == "real":
            return _CanRealTime(row, bus, served, connect, report)
        return _CanLockStep(row, bus, served)
    except BaseException:
        bus.shutdown()
        raise


def period(row: BusRow, machines: Iterable[MachineRow]) -> int:
    """Return the time between two SYNCs (µs): that of the file, else the step of its tasks.

    Raises ValueError for tasks with different steps.
    """
    steps = {round(1e6 * task(m.task).STEP_TIME) for m in machines if m.task}
    if len(steps) > 1 and not row.period_us:
        raise ValueError(
            f"bus.{row.name}: its tasks have steps of {sorted(steps)} µs: give period_us"
        )
    return row.period_us or (steps.pop() if steps else PERIOD)


def _ports(row: BusRow, otherwise: str = "") -> list[Port]:
    """Open the ports of an EtherCAT bus, all or none; a CAN bus has none. Raises ValueError."""
    ports: list[Port] = []
    try:
        if row.kind == "ethercat":
            for name in row.interfaces:
                ports.append(RawPort(name, otherwise))
            if row.udp:
                ports.append(UdpPort(row.udp))
    except BaseException:
        for port in ports:
            port.close()
        raise
    return ports


class _CanRealTime:
    """Nodes that follow the wall clock."""

    def __init__(
        self, row: BusRow, bus: can.BusABC, machines: list[Machine],
        connect: Callable[[], can.BusABC], report: Report,
    ):
        self.where = f"{row.interface} {row.channel}".strip()
        log = LogFile(row.log, report) if row.log else None
        self.server = Server(bus, machines, log, reopen=connect, tell=report)

    def serve(self) -> None:
        self.server.serve(self.server.adapter.recv(WAIT))

    def ahead(self, seconds: float) -> None:
        self.server.skip(seconds)

    def power_cycle(self, machine: Machine) -> None:
        _restart(self.server.nodes, machine, 0)

    def close(self) -> None:
        self.server.close()


class _CanLockStep:
    """Nodes whose time advances with the SYNC of the master."""

    def __init__(self, row: BusRow, bus: can.BusABC, machines: list[Machine]):
        self.where = f"{row.interface} {row.channel}".strip()
        self._bus, self.server = bus, LockStep(machines, row.period_us)
        self._ends = row.clock == "sync_end"
        link = CanLink(bus, wait=WAIT)
        self._link = Traced(link, row.log) if row.log else link

    def serve(self) -> None:
        self.server.serve(self._link, ends=self._ends)

    def ahead(self, seconds: float) -> None:
        pass  # the time of the bus is that of its SYNCs

    def power_cycle(self, machine: Machine) -> None:
        _restart(self.server.nodes, machine, self.server.time)

    def close(self) -> None:
        if isinstance(self._link, Traced):
            self._link.close()
        self._bus.shutdown()


class _EtherCat:
    """Slaves in a line, in the order of their machines."""

    def __init__(self, row: BusRow, machines: list[Machine], seed: int, report: Report):
        ports = _ports(row)
        try:
            slaves = [Slave(drive) for machine in machines for drive in machine.drives.values()]
            segment = Segment(slaves, ring=len(ports) == 2)
            segment.warm_up()
            names = tuple(port.name for port in ports)
            self.where = ", ".join(names)
            bus = (
                FaultyBus(segment, machines, row.clock, faults=[*row.faults], seed=seed)
                if row.faults
                else Bus(segment, machines, row.clock)
            )
            log = Writer(row.log, names) if row.log else None
            self.server = EtherCatServer(bus, ports, log, report)
        except BaseException:
            for port in ports:
                port.close()
            raise
        self.serve = self.server.serve
        self._slave_of = {id(slave.drive): i for i, slave in enumerate(slaves)}

    def ahead(self, seconds: float) -> None:
        self.server.bus.segment.publish(self.server.bus.time)

    def power_cycle(self, machine: Machine) -> None:
        segment, now = self.server.bus.segment, self.server.bus.time
        for drive in machine.drives.values():
            for on in (False, True):
                segment.power(self._slave_of[id(drive)], on, now)

    def close(self) -> None:
        self.server.close()


def _restart(nodes: list[Node], machine: Machine, time: int) -> None:
    """Restart the nodes of a machine as at power-on: they load what is stored and boot up."""
    own = {id(drive) for drive in machine.drives.values()}
    for node in nodes:
        if id(node.drive) in own:
            node.receive(Frame(Base.NMT, bytes([NmtCommand.RESET_NODE, node.node_id])), time)
