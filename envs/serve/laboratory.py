"""Machines served on their buses, with access to their true state.

Each bus has a thread of its own, which alone touches the machines on it. Requests of other threads
are carried out by that thread between two frames, see `Laboratory.do`.
"""

import threading
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import can

from ...drive.drive import Drive
from ...drive.model.names import hint
from ..engine.checks import in_range
from ..engine.machine import Machine
from .bus_thread import BusThread
from .buses import open_bus, period
from .description import Description, read
from .machines import check_node_ids, coupling, joint, made

T = TypeVar("T")


class Laboratory:
    """Machines on their buses, each bus served by a thread of its own.

    >>> with Laboratory("machine.toml") as laboratory:
    ...     laboratory.position("feeder.x")     # the true position (m), not the encoder's
    ...     laboratory.inject("feeder.x", "overvoltage")

    Args:
        source: a machine file, or a mapping of the same form, see `description`.
        seed: of faults with a rate.
        report: takes a line about trouble with a bus or a log, or for the user of a master.

    Raises:
        ValueError: names file, row, field and what it may be, or the bus that cannot be opened.
    """

    def __init__(
        self, source: str | Path | Mapping[str, Any] | Description, seed: int = 0,
        report: Callable[[str], None] = lambda line: None,
    ):
        self.description = source if isinstance(source, Description) else read(source)
        self.machines: dict[str, Machine] = {}
        self.drives: dict[str, Drive] = {}  # as "machine.drive"
        self._places: dict[str, dict[str, float]] = {}
        self._threads: dict[str, BusThread] = {}
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
                check_node_ids(own)
                period(bus, self.description.of(bus))
            script = [(own[at[0]], at[1], event) for at, event in events if at[0] in own]
            connect = partial(
                open_bus, bus, self.description.of(bus), own, seed, report, self.description.named
            )
            self._threads[bus.name] = BusThread(bus.name, connect, [*own.values()], script)

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
        """Stop serving and close all buses. Raises the error that had ended a bus, if any."""
        for thread in self._threads.values():
            thread.stop()
        self.check()

    def run(
        self, ended: threading.Event, look: Callable[[], object] = lambda: None, every: float = 0.25
    ) -> None:
        """Serve until `ended` is set, and call `look` about every `every` seconds.

        Raises the error that has ended a bus.
        """
        while not ended.wait(every):
            self.check()
            look()

    def check(self) -> None:
        """Raise the error that has ended the thread of a bus, if there is one."""
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
        """Interface on which each bus is served, by the name of the bus."""
        return {name: thread.where for name, thread in self._threads.items()}

    @property
    def servers(self) -> dict[str, Any]:
        """What answers on each bus that is open: a `Server`, `EtherCatServer` or `LockStep`."""
        return {name: each.bus.server for name, each in self._threads.items() if each.bus}

    # -------------------------------------------------------------- true world

    def do(self, machine: str, function: Callable[[Machine], T]) -> T:
        """Call `function` with a machine, in the thread of its bus, between two frames.

        Raises:
            KeyError: there is no machine of that name.
            TimeoutError: the thread does not answer.
            Exception: whatever `function` raises.
        """
        if machine not in self.machines:
            raise KeyError(f"there is no machine {machine!r}: {hint(machine, self.machines)}")
        return self._thread(machine).do(lambda: function(self.machines[machine]))

    def position(self, drive: str) -> float:
        """Return the true position of a drive's joint (m or rad), whatever its encoder reports."""
        name, of = self._drive(drive)
        return self.do(name, lambda machine: joint(machine, of, "qpos"))

    def velocity(self, drive: str) -> float:
        """Return the true velocity of a drive's joint (m/s or rad/s)."""
        name, of = self._drive(drive)
        return self.do(name, lambda machine: joint(machine, of, "qvel"))

    def state(self, drive: str) -> str:
        """Return the state of a drive's device control, such as ``OPERATION_ENABLED``."""
        name, of = self._drive(drive)
        return self.do(name, lambda _: of.state.name)

    def fault(self, drive: str) -> str:
        """Return the fault of a drive in words; empty without one."""
        name, of = self._drive(drive)
        return self.do(name, lambda _: of.fault)

    def time(self, machine: str) -> float:
        """Return the time of a machine since its last reset (s)."""
        return self.do(machine, lambda it: it.time)

    def inject(self, drive: str, cause: str) -> None:
        """Inject a fault into a drive until `clear`. Raises ValueError for an unknown cause."""
        name, of = self._drive(drive)
        self.do(name, lambda _: of.inject(cause))

    def clear(self, drive: str) -> None:
        """Remove all injected causes; the drive still needs a fault reset."""
        name, of = self._drive(drive)
        self.do(name, lambda _: of.clear_injected())

    def push(self, drive: str, force: float) -> None:
        """Apply a constant force (N) or torque (Nm) to a drive's joint; 0 removes it."""
        name, of = self._drive(drive)

        def act(machine: Machine) -> None:
            machine.data.qfrc_applied[coupling(machine, of).dof] = force

        self.do(name, act)

    def reset(self, machine: str | None = None, **positions: float) -> None:
        """Power a machine off and on: it rests without a reference and with stored parameters.

        Args:
            machine: its name; all machines if not given.
            positions: of joints (m or rad), by drive; those of the machine file if not given.
        """
        names = [*self.machines] if machine is None else [machine]
        if positions and len(names) > 1:
            raise ValueError("positions belong to one machine: name it")
        for name in names:
            self.do(name, partial(self._reset, name, positions))

    def _reset(self, name: str, positions: Mapping[str, float], machine: Machine) -> None:
        thread = self._thread(name)
        if thread.bus is not None:
            thread.bus.power_cycle(machine)
        machine.reset(positions=self._places[name] | dict(positions))
        thread.rewind(machine)

    def advance(self, seconds: float) -> None:
        """Simulate some seconds at once, during which no frame is exchanged.

        Raises ValueError for seconds out of 0..3600.
        """
        in_range("seconds", seconds, 0.0, 3600.0, "s")
        for thread in self._threads.values():
            thread.do(partial(thread.advance, seconds))

    def snapshot(self, machine: str) -> bytes:
        """Return a machine with its drives as bytes, without NMT state and mailboxes."""
        return self.do(machine, lambda it: it.snapshot())

    def restore(self, machine: str, snapshot: bytes) -> None:
        """Restore a `snapshot`. Raises ValueError for other bytes, or those of another machine."""
        self.do(machine, lambda it: it.restore(snapshot))

    def wait_until(self, condition: Callable[[], bool], timeout: float = 10.0) -> None:
        """Wait until a condition, checked every millisecond, is true. Raises TimeoutError."""
        pause = threading.Event()
        for _ in range(max(int(timeout * 1e3), 1)):
            self.check()
            if condition():
                return
            pause.wait(1e-3)
        raise TimeoutError(f"not within {timeout:g} s; {self!r}")

    def _drive(self, name: str) -> tuple[str, Drive]:
        """Return machine and drive of ``machine.drive``, or of a machine with one drive."""
        machine = self.machines.get(name)
        if machine is not None and len(machine.drives) == 1:
            return name, next(iter(machine.drives.values()))
        if name not in self.drives:
            raise ValueError(f"there is no drive {name!r}: {hint(name, self.drives)}")
        return name.rpartition(".")[0], self.drives[name]

    def _thread(self, machine: str) -> BusThread:
        row = next(row for row in self.description.machines if row.name == machine)
        return self._threads[row.bus]
