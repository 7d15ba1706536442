"""Machines served on their buses beside the program that looks at their true state.

Each bus has a thread of its own, which alone touches the machines on it. What another thread wants
to know or do is done by that thread between two frames, see `Laboratory.do`.
"""

import threading
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future
from dataclasses import replace
from functools import partial
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any, Protocol, TypeVar

import can

from ...drive.canopen.frame import Base, Frame
from ...drive.canopen.lockstep import LockStep
from ...drive.canopen.node import NmtCommand, Node
from ...drive.drive import Drive
from ...drive.ethercat.bus import Bus
from ...drive.ethercat.faulty import FaultyBus
from ...drive.ethercat.segment import Segment
from ...drive.ethercat.slave import Slave
from ...drive.machine import Standing
from ...drive.model.model import DriveModel, load
from ...drive.model.names import hint
from ...drive.wire.bad_bus import BadBus
from ...drive.wire.can_link import CanLink, Traced
from ...drive.wire.ethercat import EtherCatServer, Port
from ...drive.wire.ethernet import RawPort, UdpPort
from ...drive.wire.interfaces import opened
from ...drive.wire.log import LogFile
from ...drive.wire.pcapng import Writer
from ...drive.wire.server import WAIT, Server
from ..engine.checks import in_range
from ..engine.machine import Machine
from ..environment.registry import task
from ..plants.catalogue import deliver, of_axis
from ..plants.commissioning import commission_joint
from .description import BusRow, Description, EventRow, MachineRow, model_of, read

T = TypeVar("T")
PERIOD = 1000  # µs between SYNCs, where nothing else is said
PATIENCE = 10.0  # s that a caller waits for the thread of a bus


class Bench(Protocol):
    """A bus, served frame by frame."""

    where: str
    server: Any  # what answers: `Server`, `EtherCatServer` or `LockStep`

    def serve(self) -> None:
        """Wait for a frame (ms at most), answer it, and let the time pass that is due."""

    def ahead(self, seconds: float) -> None:
        """The machines have run ahead by so much."""

    def power_cycle(self, machine: Machine) -> None:
        """What stands between bus and drives begins anew."""

    def close(self) -> None:
        """Give the bus back."""


class _CanRealTime:
    """Nodes that follow the wall clock."""

    def __init__(
        self, row: BusRow, bus: can.BusABC, machines: list[Machine],
        again: Callable[[], can.BusABC], told: Callable[[str], None],
    ):
        self.where = f"{row.interface} {row.channel}".strip()
        log = LogFile(row.log, told) if row.log else None
        self.server = Server(bus, machines, log, reopen=again, tell=told)

    def serve(self) -> None:
        self.server.serve(self.server.adapter.recv(WAIT))

    def ahead(self, seconds: float) -> None:
        self.server.skip(seconds)

    def power_cycle(self, machine: Machine) -> None:
        _restart(self.server.nodes, machine, 0)

    def close(self) -> None:
        self.server.close()


class _CanLockStep:
    """Nodes whose time passes with the master's SYNC."""

    def __init__(self, row: BusRow, bus: can.BusABC, machines: list[Machine]):
        self.where = f"{row.interface} {row.channel}".strip()
        self._bus, self.server = bus, LockStep(machines, row.period_us)
        self._ends = row.clock == "sync_end"
        link = CanLink(bus, wait=WAIT)
        self._link = Traced(link, row.log) if row.log else link

    def serve(self) -> None:
        self.server.serve(self._link, ends=self._ends)

    def ahead(self, seconds: float) -> None:
        pass  # time of the bus is that of its SYNCs

    def power_cycle(self, machine: Machine) -> None:
        _restart(self.server.nodes, machine, self.server.time)

    def close(self) -> None:
        if isinstance(self._link, Traced):
            self._link.close()
        self._bus.shutdown()


class _EtherCat:
    """Slaves in a line, in the order of their machines."""

    def __init__(
        self, row: BusRow, machines: list[Machine], seed: int, told: Callable[[str], None]
    ):
        ports: list[Port] = []
        try:
            for name in row.interfaces:
                ports.append(RawPort(name))
            if row.udp:
                ports.append(UdpPort(row.udp))
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
            self.server = EtherCatServer(bus, ports, log, told)
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
    """Power-on of the nodes of a machine: what is not stored is lost, then the boot-up message."""
    own = {id(drive) for drive in machine.drives.values()}
    for node in nodes:
        if id(node.drive) in own:
            node.receive(Frame(Base.NMT, bytes([NmtCommand.RESET_NODE, node.node_id])), time)


class Laboratory:
    """Machines on their buses, each bus in a thread of its own.

    >>> with Laboratory("machine.toml") as laboratory:
    ...     laboratory.position("feeder.x")     # the true one (m), not what the encoder says
    ...     laboratory.inject("feeder.x", "overvoltage")

    Args:
        source: a machine file, or a mapping of the same form, see `description`.
        seed: of faults with a rate.
        told: takes a line about trouble with a bus or a log, and what a master should know.

    Raises:
        ValueError: names file, row, field and what it may be, or the bus that cannot be opened.
    """

    def __init__(
        self, source: str | Path | Mapping[str, Any] | Description, seed: int = 0,
        told: Callable[[str], None] = lambda line: None,
    ):
        self.description = source if isinstance(source, Description) else read(source)
        self.machines: dict[str, Machine] = {}
        self.drives: dict[str, Drive] = {}  # as "machine.drive"
        self._places: dict[str, dict[str, float]] = {}
        self._threads: dict[str, _Thread] = {}
        kinds = {bus.name: bus.kind for bus in self.description.buses}
        for row in self.description.machines:
            try:
                machine, places = made(
                    row, kinds[row.bus], self.description.folder, self.description.named
                )
            except (ValueError, TypeError, OSError) as error:
                raise ValueError(f"{self.description.row('machine', row.name)}{error}") from None
            self.machines[row.name], self._places[row.name] = machine, places
            self.drives |= {f"{row.name}.{name}": drive for name, drive in machine.drives.items()}
        events = [(self._drive(event.drive), event) for event in self.description.events]
        for (_, drive), event in events:
            if event.inject not in drive.injectable:
                raise ValueError(
                    f"event at {event.at:g} s: inject = {event.inject!r}: "
                    f"{hint(event.inject, drive.injectable)}"
                )
        for bus in self.description.buses:
            own = {row.name: self.machines[row.name] for row in self.description.of(bus)}
            if bus.kind == "can":
                _refuse_twins(own)
            script = [(own[at[0]], at[1], event) for at, event in events if at[0] in own]
            timed = replace(bus, period_us=_period(bus, self.description.of(bus)))
            make = partial(
                _bench, timed, list(own.values()), seed, told, self.description.named
            )
            self._threads[bus.name] = _Thread(bus.name, make, own, script)

    def __repr__(self) -> str:
        return f"Laboratory({', '.join(self.drives)})"

    # ------------------------------------------------------------------ buses

    def start(self) -> "Laboratory":
        """Open all buses and serve them; returns itself.

        Raises:
            ValueError: a bus that cannot be opened; those that were open are closed again.
        """
        try:
            for name, thread in self._threads.items():
                try:
                    thread.open()
                except (ValueError, OSError, can.CanError) as error:
                    raise ValueError(f"{self.description.row('bus', name)}{error}") from None
        except ValueError:
            self.stop()
            raise
        for thread in self._threads.values():
            thread.start()
        return self

    def stop(self) -> None:
        """Stop serving and close all buses. Raises what ended a bus before, if anything did."""
        for thread in self._threads.values():
            thread.stop()
        self.check()

    def run(
        self, ended: threading.Event, look: Callable[[], object] = lambda: None, every: float = 0.25
    ) -> None:
        """Serve until `ended` is set; `look` is called every so many seconds, about.

        Raises what ended a bus before.
        """
        while not ended.wait(every):
            self.check()
            look()

    def check(self) -> None:
        """Raise what ended the thread of a bus, if anything did."""
        for thread in self._threads.values():
            if thread.error is not None:
                error, thread.error = thread.error, None
                raise error

    def __enter__(self) -> "Laboratory":
        return self.start()

    def __exit__(self, *_: object) -> None:
        self.stop()

    @property
    def where(self) -> dict[str, str]:
        """Interface on which each bus is served, by name of the bus."""
        return {name: thread.where for name, thread in self._threads.items()}

    @property
    def servers(self) -> dict[str, Any]:
        """What answers on each bus that is open: a `Server`, `EtherCatServer` or `LockStep`."""
        return {n: thread.bench.server for n, thread in self._threads.items() if thread.bench}

    # -------------------------------------------------------------- true world

    def do(self, machine: str, function: Callable[[Machine], T]) -> T:
        """Let the thread of a machine's bus call `function` with it, between two frames.

        Raises:
            KeyError: there is no machine of that name.
            TimeoutError: the thread does not answer.
            Exception: whatever `function` raises.
        """
        if machine not in self.machines:
            raise KeyError(f"there is no machine {machine!r}: {hint(machine, self.machines)}")
        return self._thread(machine).do(lambda: function(self.machines[machine]))

    def position(self, drive: str) -> float:
        """Position of a drive's joint (m or rad) in the model, whatever its encoder says."""
        name, of = self._drive(drive)
        return self.do(name, lambda machine: float(_joint(machine, of, "qpos")))

    def velocity(self, drive: str) -> float:
        """Velocity of a drive's joint (m/s or rad/s)."""
        name, of = self._drive(drive)
        return self.do(name, lambda machine: float(_joint(machine, of, "qvel")))

    def state(self, drive: str) -> str:
        """State of a drive's device control, such as ``OPERATION_ENABLED``."""
        name, of = self._drive(drive)
        return self.do(name, lambda _: of.state.name)

    def fault(self, drive: str) -> str:
        """The fault of a drive in words, empty without one."""
        name, of = self._drive(drive)
        return self.do(name, lambda _: of.fault)

    def time(self, machine: str) -> float:
        """Time of a machine since its last reset (s)."""
        return self.do(machine, lambda it: it.time)

    def inject(self, drive: str, cause: str) -> None:
        """Inject a fault into a drive until `clear`. Raises ValueError for an unknown cause."""
        name, of = self._drive(drive)
        self.do(name, lambda _: of.inject(cause))

    def clear(self, drive: str) -> None:
        """Take all injected causes away; the drive still needs a fault reset."""
        name, of = self._drive(drive)
        self.do(name, lambda _: of.clear_injected())

    def push(self, drive: str, force: float) -> None:
        """A constant force (N) or torque (Nm) on a drive's joint from now on; 0 takes it away."""
        name, of = self._drive(drive)

        def act(machine: Machine) -> None:
            coupling = _coupling(machine, of)
            machine.data.qfrc_applied[coupling.dof] = force

        self.do(name, act)

    def reset(self, machine: str | None = None, **positions: float) -> None:
        """Power a machine off and on again: at rest, not referenced, unstored parameters lost.

        Args:
            machine: its name; all machines if not given.
            positions: of joints (m or rad), by drive; else those of the machine file.
        """
        names = [*self.machines] if machine is None else [machine]
        if positions and len(names) > 1:
            raise ValueError("positions are those of one machine: name it")
        for name in names:
            self.do(name, partial(self._reset, name, positions))

    def _reset(self, name: str, positions: Mapping[str, float], machine: Machine) -> None:
        thread = self._thread(name)
        if thread.bench is not None:
            thread.bench.power_cycle(machine)
        machine.reset(positions=self._places[name] | dict(positions))
        thread.rewind(machine)

    def advance(self, seconds: float) -> None:
        """Let the machines run ahead at once, while no frame is exchanged.

        Raises ValueError: seconds are out of 0..3600.
        """
        in_range("seconds", seconds, 0.0, 3600.0, "s")
        for thread in self._threads.values():
            thread.do(partial(thread.advance, seconds))

    def snapshot(self, machine: str) -> bytes:
        """The machine with its drives, as bytes; the NMT state and mailboxes are not in them."""
        return self.do(machine, lambda it: it.snapshot())

    def restore(self, machine: str, snapshot: bytes) -> None:
        """Become what `snapshot` was. Raises ValueError: it is none, or of another machine."""
        self.do(machine, lambda it: it.restore(snapshot))

    def wait_until(self, condition: Callable[[], bool], timeout: float = 10.0) -> None:
        """Wait until a condition holds, asked each millisecond. Raises TimeoutError."""
        pause = threading.Event()
        for _ in range(max(int(timeout * 1e3), 1)):
            self.check()
            if condition():
                return
            pause.wait(1e-3)
        raise TimeoutError(f"not within {timeout:g} s; {self!r}")

    def _drive(self, name: str) -> tuple[str, Drive]:
        """Machine and drive of ``machine.drive``, or of a machine with one drive."""
        machine = self.machines.get(name)
        if machine is not None and len(machine.drives) == 1:
            return name, next(iter(machine.drives.values()))
        if name not in self.drives:
            raise ValueError(f"there is no drive {name!r}: {hint(name, self.drives)}")
        return name.rpartition(".")[0], self.drives[name]

    def _thread(self, machine: str) -> "_Thread":
        row = next(row for row in self.description.machines if row.name == machine)
        return self._threads[row.bus]


class _Thread:
    """A bus with its machines: what it does between two frames."""

    def __init__(
        self,
        name: str,
        make: Callable[[], Bench],
        machines: Mapping[str, Machine],
        script: list[tuple[Machine, Drive, EventRow]],
    ):
        self.bench: Bench | None = None
        self.error: BaseException | None = None
        self.where = ""
        self._machines = list(machines.values())
        self._make = make
        self._wanted: SimpleQueue[tuple[Callable[[], Any], Future]] = SimpleQueue()
        self._script = script
        self._due: list[tuple[float, Machine, Callable[[], object]]] = []
        for machine in self._machines:
            self.rewind(machine)
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name=f"bus {name}", daemon=True)

    def rewind(self, machine: Machine) -> None:
        """The script of a machine begins anew."""
        self._due = [row for row in self._due if row[1] is not machine]
        for of, drive, event in self._script:
            if of is machine:
                self._due.append((event.at, of, partial(drive.inject, event.inject)))
                if event.clear_after:
                    end = event.at + event.clear_after
                    self._due.append((end, of, drive.clear_injected))
        self._due.sort(key=lambda row: row[0])

    def open(self) -> None:
        """Open the bus."""
        self.bench = self._make()
        self.where = self.bench.where

    def start(self) -> None:
        self._thread.start()

    def stop(self) -> None:
        """End the thread, then close the bus."""
        self._stopping.set()
        if self._thread.is_alive():
            self._thread.join(PATIENCE)
        bench, self.bench = self.bench, None
        if bench is not None:
            bench.close()

    def do(self, function: Callable[[], T]) -> T:
        """Let the thread call it; without a thread the caller does."""
        if not self._thread.is_alive() or threading.current_thread() is self._thread:
            return function()
        future: Future[T] = Future()
        self._wanted.put((function, future))
        try:
            return future.result(PATIENCE)
        except TimeoutError:
            if future.cancel():
                raise TimeoutError(f"the bus {self._thread.name} does not answer") from None
            raise

    def advance(self, seconds: float) -> None:
        """Let all machines of the bus run ahead."""
        for machine in self._machines:
            machine.step(round(seconds / machine.cycle_time))
        if self.bench is not None:
            self.bench.ahead(seconds)

    def _run(self) -> None:
        assert self.bench is not None
        try:
            while not self._stopping.is_set():
                self.bench.serve()
                self._between()
        except BaseException as error:
            self.error = error
        while not self._wanted.empty():
            self._answer(*self._wanted.get())

    def _between(self) -> None:
        """Events of the script that are due, and what others want."""
        for row in [row for row in self._due if row[0] <= row[1].time]:
            self._due.remove(row)
            row[2]()
        while True:
            try:
                wanted = self._wanted.get_nowait()
            except Empty:
                return
            self._answer(*wanted)

    @staticmethod
    def _answer(function: Callable[[], Any], future: Future) -> None:
        if not future.set_running_or_notify_cancel():
            return
        try:
            future.set_result(function())
        except BaseException as error:
            future.set_exception(error)


def _bench(
    row: BusRow, machines: list[Machine], seed: int, told: Callable[[str], None],
    named: Callable[[str], str],
) -> Bench:
    """Open a bus."""
    if row.kind == "ethercat":
        return _EtherCat(row, machines, seed, told)

    def again() -> Any:
        bus = opened(row.keywords, named)
        return BadBus(bus, row.rates(), seed) if row.faults else bus

    bus = again()
    try:
        if row.clock == "real":
            return _CanRealTime(row, bus, machines, again, told)
        return _CanLockStep(row, bus, machines)
    except BaseException:
        bus.shutdown()
        raise


def made(
    row: MachineRow, bus: str, folder: Path, named: Callable[[str], str] = str
) -> tuple[Machine, dict[str, float]]:
    """A machine with all compiled that it needs, and where its joints are at power-on.

    Args:
        row: of the machine.
        bus: ``can`` or ``ethercat``.
        folder: that relative paths start from.
        named: see `Description.named`.
    """

    def model(name: str) -> DriveModel:
        return load(model_of(folder, name), bus)

    if row.task:
        machine, places = _of_task(row, model(str(row.drive)))
    elif row.mjcf:
        assert isinstance(row.drive, dict)
        machine = Machine.from_mjcf(
            folder / row.mjcf, {joint: model(str(name)) for joint, name in row.drive.items()}
        )
        for name in machine.drives:
            commission_joint(machine, name)
        places = {}
    else:
        machine, places = of_axis(row.axis, model(str(row.drive)), row.parameters, named)
    places = places | row.positions
    for name, values in row.write.items():
        if not isinstance(values, dict):
            raise ValueError(f"write: name the drive, as {{ x = {{ {name} = {values!r} }} }}")
        for object_name, value in values.items():
            machine.drives[name].write(object_name, value)
    file = folder / row.parameter_file if row.parameter_file else None
    deliver(machine, bus, places, row.node_id, file, named)
    return machine, places


def _of_task(row: MachineRow, model: DriveModel) -> tuple[Machine, dict[str, float]]:
    """The machine of an environment as it is without draws, where its first episode begins."""
    env = task(row.task)(model, **{"randomise": {}} | row.parameters)
    machine, delivered = env.machine, env.machine.snapshot()
    env.reset(seed=0)
    pairs = zip(machine.drives.values(), machine.drives, strict=True)
    places = {name: float(_joint(machine, drive, "qpos")) for drive, name in pairs}
    machine.restore(delivered)
    return machine, places


def _period(row: BusRow, machines: Sequence[MachineRow]) -> int:
    """Between two SYNCs (µs): what the file says, else the step of its tasks."""
    steps = {round(1e6 * task(m.task).STEP_TIME) for m in machines if m.task}
    if len(steps) > 1 and not row.period_us:
        raise ValueError(
            f"bus.{row.name}: its tasks have steps of {sorted(steps)} µs: give period_us"
        )
    return row.period_us or (steps.pop() if steps else PERIOD)


def _refuse_twins(machines: Mapping[str, Machine]) -> None:
    """Raises ValueError naming two drives with one node-id."""
    of: dict[int, str] = {}
    for name, machine in machines.items():
        for own, drive in machine.drives.items():
            if other := of.get(drive.node_id):
                raise ValueError(
                    f"node-id {drive.node_id} is that of {other} and {name}.{own}: give each "
                    "machine a node_id of its own"
                )
            of[drive.node_id] = f"{name}.{own}"


def _coupling(machine: Machine, drive: Drive) -> Any:
    """Raises ValueError for a drive whose motor is held."""
    if isinstance(machine, Standing):
        raise ValueError("axis = 'none': its motor is held, no joint moves")
    return machine.couplings[[*machine.drives.values()].index(drive)]


def _joint(machine: Machine, drive: Drive, what: str) -> float:
    coupling = _coupling(machine, drive)
    place = coupling.dof
    if what == "qpos":
        place = machine.model.jnt_qposadr[machine.model.dof_jntid[place]]
    return getattr(machine.data, what)[place]
