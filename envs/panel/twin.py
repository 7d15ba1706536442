"""A twin beside a drive of a bench: it gets the same commands, and the scope shows both.

A difference between them is what the model lacks, or what has changed in the machine since. For
this reason injected faults and disturbances act on the machine only. The twin is not corrected
while it runs: a position that has drifted apart has a cause, too.
"""

import math
from collections.abc import Callable
from typing import Any

from ...drive.diagrams import Mode, Statusword
from ...drive.master import Master, ServoError
from ...drive.model.rows import Object, quantity
from ...drive.objects.abort import SdoAbort
from ...drive.trace import reader
from ..engine.machine import Machine
from ..masters.port import MachinePort

TWIN = "twin"  # prefix of its channels
# the axis stands if it moves less than m or rad within s; a bus reports its position less often
STILL = {"joint": (1e-5, 0.02), "bus": (1e-4, 0.3)}
MOST = 1.0  # s of delay that the twin makes up for
COMMANDS = (  # objects that a policy writes by PDO
    "modes_of_operation", "target_position", "target_velocity", "target_torque", "position_offset",
    "velocity_offset", "torque_offset", "controlword",
)


class ParallelTwin:
    """A twin that receives the same commands as an axis.

    It is first placed in the position, mode and state of the axis, and again whenever the axis has
    been referenced or the machine was moved in another way.

    Args:
        bench: `bench.Bench` with the axis.
        machine: machine of the twin, from `plants.catalogue.of_twin`.
        axis: the axis that it represents.
        drive: drive of that machine; by default the first one.

    Raises:
        ValueError: the bench has no such axis, or the joint turns where the axis slides.
    """

    def __init__(self, bench: Any, machine: Machine, axis: str, drive: str = ""):
        if axis not in bench.axes:
            raise ValueError(f"there is no axis {axis!r}: {', '.join(bench.axes)}")
        self.name = drive or next(iter(machine.drives))
        self.bench, self.machine, self.axis = bench, machine, axis
        self.drive, self._port = machine.drives[self.name], MachinePort(machine)
        self._factors: dict[str, float] = {}  # by quantity: unit of the twin in units of the axis
        ours, theirs = self._port.units(self.name).name, bench.units(axis).name
        if bench.unit(axis)[0] != "units" and ours != theirs:
            raise ValueError(f"the twin's joint is in {ours}, axis {axis} in {theirs}")
        self.due = True  # it waits to be placed where the axis stands
        self._time: float = bench.time
        self._sent: dict[str, float] = {}
        self._refused: set[str] = set()
        self._parameters: dict[str, float | None] = {}  # last values of the axis's drive
        self._mark = -math.inf, math.nan  # time (s), and the position then
        self._attained, self._fault = True, 0

    def align(self) -> None:
        """Place the twin where the axis stands, as soon as it does."""
        self.due = True

    @property
    def state(self) -> str:
        """The state of the twin in words."""
        if self.due:
            return "waits until the axis stands"
        return self.drive.fault or self.drive.state.name.replace("_", " ").lower()

    # -------------------------------------------------------------------- commands

    def repeat(self, *arguments: Any) -> None:
        """Repeat a write that the drive has accepted: name or index, and value."""
        if self.due:
            return  # everything is taken over when it is placed
        *where, value = arguments
        try:
            row = self._row(*where)
            factor = self._factor(row)
            if factor != 1.0 and not math.isclose(factor, 1.0):
                value = value / factor if row.real else round(value / factor)
            self.drive.write(*where, value)
        except (SdoAbort, KeyError, TypeError, ValueError) as error:
            name = where[0] if isinstance(where[0], str) else f"{where[0]:04X}h"
            if name not in self._refused:  # it is reported once
                self._refused.add(name)
                self.bench.tell("info", f"twin: {name}: {error}", self.axis)

    def act(self, what: str, *arguments: Any) -> None:
        """Repeat an action on the machine, one of `journal.ACTS`."""
        if what == "write":
            self.repeat(*arguments)
        elif what == "commission" and not self.due:
            try:
                self.drive.commission(arguments[0])
            except (SdoAbort, ValueError) as error:
                self.bench.tell("info", f"twin: gains: {error}", self.axis)

    def watch_commands(self) -> None:
        """Repeat the commands that a policy has sent to the drive by PDO."""
        for name in COMMANDS:
            value = self._of(name)
            if value is not None and value != self._sent.get(name):
                self._sent[name] = value
                self.repeat(name, value)

    def watch_parameters(self) -> None:
        """Repeat the changes of parameters that a policy has made or undone."""
        for name, before in self._parameters.items():
            value = self._parameters[name] = self._of(name)
            if value is not None and value != before:
                self.repeat(name, value)

    def _row(self, name: int | str, subindex: int = 0) -> Object:
        objects = self.drive.objects
        slot = objects.names[name] if isinstance(name, str) else objects.slots[name, subindex]
        return slot.row

    def _factor(self, row: Object) -> float:
        """A unit of the twin's drive in units of the axis's drive."""
        return self._factors.get(quantity(row.unit), 1.0)

    def _compare_units(self) -> None:
        """Compare the units of both drives, whose factors may be written at any time."""
        ours, theirs = self._port.units(self.name), self.bench.units(self.axis)
        known = self.bench.unit(self.axis)[0] != "units"  # otherwise they count as equal
        rate = self.bench.acceleration(self.axis)
        own = float(self.drive.axis.rad_s2_per_acceleration_unit)
        self._size = theirs.position if known else ours.position
        speed = theirs.velocity if known else ours.velocity
        self._factors = {
            "position": ours.position / self._size, "velocity": ours.velocity / speed,
            "acceleration": own / self.machine.joint(self.name)[0] / rate if rate else 1.0,
        }

    # ------------------------------------------------------------------ time passes

    def follow(self) -> None:
        """Let as much time pass as on the bench."""
        self._watch_reference()
        if self.due:
            self._stand()
        passed = self.bench.time - self._time
        if not 0.0 <= passed <= MOST:
            self._time, passed = self.bench.time, 0.0
        cycles = int(passed / self.machine.cycle_time + 1e-6)
        if cycles:
            self.machine.step(cycles)
            self._time += cycles * self.machine.cycle_time
        fault = int(self.drive.axis.fault)
        if fault != self._fault and not self.due:
            self._fault = fault
            said = f"FAULT {self.drive.fault}" if fault else "the fault is gone"
            self.bench.tell("info", f"twin: {said}", self.axis)

    def _of(self, name: str) -> float | None:
        """The last known value of an object of the axis's drive."""
        return self.bench.value(self.axis, name)

    def _watch_reference(self) -> None:
        """Place the twin again once homing has been attained, which moves the axis's zero."""
        if self._of("modes_of_operation_display") != Mode.HOMING:
            self._attained = True
            return
        attained = bool(int(self._of("statusword") or 0) & Statusword.MODE_12)
        if attained and not self._attained:
            self.due = True
        self._attained = attained

    def _stand(self) -> None:
        """Place the twin where the axis stands, as soon as it does."""
        position, mode = self._of("position_actual_value"), self._of("modes_of_operation_display")
        if position is None or mode is None or self._of("statusword") is None:
            return  # nothing is known of the axis yet
        self.machine.step()  # so that its factors are known
        self._compare_units()
        if not self._stands(position):
            return
        self.due = False
        self._place(position * self._size)
        for name in COMMANDS[1:-1]:
            if (value := self._of(name)) is not None:
                self._sent[name] = value
                self.repeat(name, value)
        try:
            self.drive.write("modes_of_operation", int(mode))
            if self.bench.powered(self.axis):
                Master(self._port, self.name).enable()
        except (ServoError, SdoAbort, ValueError) as error:
            self.bench.tell("info", f"twin: {error}", self.axis)
        if not self.bench.real_time:
            names = (
                row.name for row in self.bench.rows(self.axis)
                if row.access == "rw" and row.index >= 0x2000 and row.name not in COMMANDS
                and row.format and row.name in self.drive.objects.names
            )
            self._parameters = {name: self._of(name) for name in names}
        self._time = self.bench.time
        self.bench.tell("done", "twin: it stands where the axis stands", self.axis)

    def _stands(self, position: float) -> bool:
        joint, now = self.bench.joint_position(self.axis), self.bench.time
        near, time = STILL["bus" if joint is None else "joint"]
        place = position * self._size if joint is None else joint
        since, where = self._mark
        if not abs(place - where) < near:
            self._mark = now, place
        elif now - since >= time:
            self._mark = -math.inf, math.nan
            return True
        return False

    def _place(self, position: float) -> None:
        """Place the joint (m or rad), with the same zero as that of the axis's drive."""
        joint = self.bench.joint_position(self.axis)
        low, high = self.machine.range(self.name)
        self.machine.reset(
            positions={self.name: min(max(position if joint is None else joint, low), high)}
        )
        self.machine.step()
        record: Any = self.drive.axis
        gear, _ = self.machine.joint(self.name)
        counts = round(position * gear / float(record.rad_per_increment))
        record.zero_counts = int(record.counts) - counts
        record.homed = self.bench.referenced(self.axis)
        self.machine.step()

    # -------------------------------------------------------------------- channels

    def channels(self) -> list[str]:
        """Channels that the scope can show, in units of the axis's own drive."""
        rows = (slot.row for slot in self.drive.objects.slots.values())
        return sorted(f"{TWIN}:{row.name}" for row in rows if row.pdo and row.format)

    def reader(self, name: str) -> Callable[[], float]:
        """Return a reader for the value of an object. Raises ValueError for an unknown one."""
        if name not in self.drive.objects.names:
            raise ValueError(f"the twin has no object {name!r}")
        read = reader(self.drive, name)
        row = self._row(name)
        return lambda: math.nan if self.due else read() * self._factor(row)
