"""Session: the panel without a browser, on a machine in this process."""

import base64
from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from typing import Any, Protocol

from ...drive.advice import refusal, remedy
from ...drive.diagrams import State, limits
from ...drive.master import Refused
from ...drive.model.rows import Object
from ...drive.objects.abort import TEXT, Abort, SdoAbort
from ...drive.trace import reader, unit_of
from ..engine.machine import Machine
from ..masters.port import MachinePort
from .bench import Agent, Bench, Interrupted
from .journal import ACTS, Journal

__all__ = ["Agent", "Interrupted", "Laboratory", "Session"]
EVERY = 8  # cycles between two looks for faults
FIELDS = tuple(
    f"axis.{name}" for name in (
        "torque", "position", "velocity", "following_error", "velocity_command", "torque_command",
        "dc_link", "state",
    )
)


class Laboratory(Protocol):
    """The interface to policies; `training` implements it."""

    shipped_only: bool  # whether only the offered policies may be named

    def fitting(self, axis: str) -> Any:
        """The policies offered for an axis: ``what``, ``names``, ``goal``, ``shown``."""

    def prepare(self, machine: Machine, axis: str, name: str, goal: float) -> None:
        """Prepare a policy on a copy. Raises the errors of the policy or the goal."""

    def agent(self, session: "Session", axis: str, name: str, goal: float) -> Agent:
        """Make a policy that takes over; the goal is in the offered unit."""

    def compare(self, machine: Machine, axis: str, names: list[str], goal: float) -> Sequence[Any]:
        """Compare policies on copies of a machine."""


class Session(Bench):
    """A machine with its masters, a scope and a commander.

    Args:
        machine: machine with one drive or several.
        title: title of the page.
        cycles: position cycles per exchange with the masters, the scope and the judge, as on a
            field bus. Streamed set-points and a policy act in each cycle.
    """

    machine: Machine

    def __init__(self, machine: Machine, title: str = "", cycles: int = 1):
        self.machine, self.cycles = machine, cycles
        self.journal: Journal | None = None  # of the present exercise
        self.attempted: Callable[[Any], object] = lambda pupil: None  # at the end of an exercise
        self._port = _Port(machine, self)
        self._cycle = self._sampled = self._watched = 0
        super().__init__(self._port, title or type(machine).__name__)
        self.scope = self._scope(machine.cycle_time * cycles)
        if cycles > 1:
            self.sampling = (
                f"One sample in {cycles} position cycles, {{rate}} in a second of machine time."
            )
        self.fresh = machine.snapshot()  # the state in which an exercise begins

    def exchange(self) -> None:
        """Advance by position cycles, with pacing, recording and supervision."""
        single = self.pace()
        self._port.deliver()
        self.pass_cycles(1 if single or self.streams else self.cycles)

    def cycle(self) -> None:
        """Advance by one position cycle, for an agent that commands in each cycle."""
        self.pace()
        self._port.deliver()
        self.pass_cycles(1)

    def pass_cycles(self, cycles: int) -> None:
        """Advance by position cycles and check the result."""
        if self.journal is not None:
            self.journal.passed(cycles)
        self.machine.step(cycles)
        self.time += cycles * self.machine.cycle_time
        self._cycle += cycles
        if self.beside is not None:
            if self.agent is not None:
                self.beside.watch_commands()
            self.beside.follow()
        if self._cycle >= self._sampled + self.cycles:
            self._sampled = self._cycle
            self.scope.sample(self.time)
        if self._cycle >= self._watched + EVERY:
            self._watched = self._cycle
            self._watch_faults()
        if self.pupil is not None:
            self.pupil.look()

    def act(self, what: str, *arguments: Any) -> Any:
        """Act on the machine from outside; every page, master and experiment uses this.

        Args:
            what: key of `journal.ACTS`.
            arguments: arguments of the action, which may raise its own errors.
        """
        if self.journal is not None:
            self.journal.enter(what, *arguments)
        done = ACTS[what](self.machine, *arguments)
        if self.beside is not None and arguments[0] == self.beside.axis:
            self.beside.act(what, *arguments[1:])
        return done

    def examined(self) -> str:
        """The reason why disturbances cannot be changed: an exercise is under way."""
        if self.pupil is None or self.pupil.over:
            return ""
        return "an exercise is under way, and this belongs to it: finish or leave it first"

    # ---------------------------------------------------------------- objects

    def rows(self, axis: str) -> list[Object]:
        """The whole dictionary of the drive."""
        return [slot.row for slot in self.machine.drives[axis].objects.slots.values()]

    def value(self, axis: str, name: str) -> float | None:
        """Return the present value of an object."""
        slot = self.machine.drives[axis].objects.names.get(name)
        return slot.get() if slot is not None else None  # type: ignore[return-value]

    def present(self, axis: str, name: str) -> float | None:
        """Return a quantity of the record, also one that the drive has no object for."""
        return float(self.machine.drives[axis].axis.od[name])

    def texts(self, axis: str, rows: Iterable[Object]) -> list[str]:
        """Return the values of objects as a master reads them, as text."""
        objects, texts = self.machine.drives[axis].objects, []
        for row in rows:
            value: Any = "write only"
            if row.access != "wo":
                value = objects.shown(objects.slots[row.index, row.subindex])
            if isinstance(value, Abort):
                value = f"({TEXT[value]})"
            texts.append(f"{value:g}" if isinstance(value, float) else str(value))
        return texts

    def write(self, axis: str, name: int | str, *arguments: float) -> str:
        """Write an object as a master does; -> the reason of a refusal, or nothing."""
        try:
            self.act("write", axis, name, *arguments)
        except (SdoAbort, TypeError, ValueError) as error:
            return str(error)
        return ""

    def acceleration(self, axis: str) -> float:
        """The size of the drive units at the load, from factors and mechanics."""
        record = self.machine.drives[axis].axis
        return float(record.rad_s2_per_acceleration_unit) / self.machine.joint(axis)[0]

    def powered(self, axis: str) -> bool:
        """Whether the drive is in OPERATION_ENABLED."""
        return int(self.machine.drives[axis].axis.state) == State.OPERATION_ENABLED

    def fault_of(self, axis: str) -> tuple[str, str]:
        """Return the fault of a drive."""
        drive = self.machine.drives[axis]
        record = drive.axis
        return (drive.fault, remedy(record)) if record.fault else ("", "")

    def mapped(self, axis: str, direction: str) -> list[Object]:
        """Return the objects in all valid PDOs."""
        return [slot.row for slot, _ in self.machine.drives[axis].mapped(direction)]

    def fields(self) -> tuple[str, ...]:
        """The fields of the record."""
        return FIELDS

    def channel_reader(self, axis: str, name: str) -> Callable[[], float]:
        """Return a reader of an object or of a field of the record."""
        return reader(self.machine.drives[axis], name)

    def channel_unit(self, axis: str, name: str) -> str:
        """Return the unit of an object or of a field of the record."""
        return unit_of(self.machine.drives[axis], name)

    # ------------------------------------------------------------------ gains

    def gains(self, axis: str, names: Iterable[str]) -> dict[str, int]:
        """Present values of objects or of settings of the maker's tool (drive units)."""
        drive = self.machine.drives[axis]
        return {
            name: int(drive.read(name) if name in drive.objects.names else drive.axis.od[name])
            for name in names
        }

    def commission(self, axis: str, values: Mapping[str, float]) -> str:
        """Write gains to a drive, all or none; -> the reason of a refusal."""
        before = self.gains(axis, values)
        try:
            self.act("commission", axis, dict(values))
        except (SdoAbort, ValueError) as error:
            self.act("commission", axis, before)
            return self._failed(f"{axis}: gains", str(error))
        self.tell("done", f"{axis}: gains set")
        return ""

    # ------------------------------------------------------ snapshots, agents

    def keep(self, name: str) -> None:
        """Save the state of the machine under a name."""
        self.kept[name] = self.machine.snapshot()
        self.tell("done", f"kept as {name!r}")

    def back(self, name: str) -> str:
        """Restore a saved state; -> the reason of a refusal."""
        if name not in self.kept:
            return f"there is no snapshot {name!r}"
        self.release()
        self._lose("back at a snapshot")
        try:
            self.restore(self.kept[name])
        except ValueError as error:
            return self._failed("snapshot", str(error))
        self.tell("done", f"back at {name!r}")
        return ""

    def restore(self, snapshot: bytes) -> None:
        """Restore the machine and align the twin. Raises ValueError for another machine."""
        self.machine.restore(snapshot)
        self._moved()

    def _moved(self) -> None:
        """Note that the machine was placed elsewhere."""
        if self.beside is not None:
            self.beside.align()

    def joint_position(self, axis: str) -> float | None:
        """The position of the joint (m or rad)."""
        number = self.axes.index(axis)
        return float(self.machine.data.qpos[self.machine.couplings[number].qpos])

    def referenced(self, axis: str) -> bool:
        """Whether an axis is homed."""
        return bool(self.machine.drives[axis].axis.homed)

    def save_parameters(self, axis: str) -> bytes:
        """The parameter file as the drive would store it now."""
        return self.machine.drives[axis].parameters.export()

    def load_parameters(self, axis: str, content: bytes) -> str:
        """Load a parameter file and apply it; -> the reason of a refusal."""
        drive = self.machine.drives[axis]
        if drive.energised:
            return "the drive has power: disable it before its parameters change as a whole"
        wrong = self.act("parameters", axis, base64.b64encode(content).decode())
        if not wrong:
            self.tell("done", f"{axis}: parameters loaded")
        return wrong

    def reset(self) -> None:
        """Switch the power off and on again, with the joints where they are."""
        self.release()
        self._lose("switched off and on")
        self._port.forget()
        self._moved()
        positions = {}
        for name, coupling in zip(self.axes, self.machine.couplings, strict=True):
            positions[name] = float(self.machine.data.qpos[coupling.qpos])
        with suppress(ValueError):  # an axis pressed into its end stop begins as in the model
            self.machine.reset(positions=positions)
            return
        self.machine.reset()

    def _lose(self, what: str) -> None:
        if self.pupil is not None:
            self.pupil.lose(f"The machine is {what}: the exercise has lost its state.")

    def hand_over(self, agent: Agent) -> None:
        """Let an agent command from now on.

        Raises Refused while another agent commands or an exercise is under way.
        """
        if why := self.examined():
            raise Refused("hand over", why)
        if self.agent is not None:
            raise Refused("hand over", f"{self.agent.name} has the machine", "take it back first")
        self.agent = agent
        if self.beside is not None:
            self.beside.watch_parameters()
        self.tell("done", f"{agent.name} has taken over")

    def release(self) -> None:
        """Take the machine back from an agent."""
        agent = self.agent
        super().release()
        if agent is not None and self.beside is not None:
            self.beside.watch_commands()
            self.beside.watch_parameters()

    def _status(self, axis: str) -> dict[str, Any]:
        """State, and quantities of the drive that have no object."""
        drive, (_, scale) = self.machine.drives[axis], self.unit(axis)
        record = drive.axis
        target = float(record.target) / float(record.rad_per_position_unit or 1)
        return {
            "state": int(record.state),
            "target": target * self.units(axis).position * scale,
            "homed": bool(record.homed),
            "faults": drive.faults[1:],
            "refused": refusal(record) if int(record.refused_command) else "",
            "limits": limits(int(record.limits)),
            "injected": int(record.injected),
            "rpdo": drive.pack(),
            "tpdo": drive.collect(),
        }


class _Port(MachinePort):
    """The port of the machine; time advances through the session, commands may be delayed."""

    def __init__(self, machine: Machine, session: Session):
        super().__init__(machine)
        self._session = session
        self._late: deque[tuple[float, str, str, float]] = deque()

    @property
    def latency(self) -> float:  # type: ignore[override]
        """The delay of commands (s)."""
        return self._session.delay

    def write(self, axis: str, name: str, value: float) -> None:
        """Set an object, after the delay."""
        if self._session.delay or self._late:
            self._late.append((self._session.time + self._session.delay, axis, name, value))
        else:
            self._session.act("write", axis, name, value)

    def exchange(self) -> None:
        """One cycle of the session."""
        self._session.exchange()

    def deliver(self) -> None:
        """Apply the commands that are due."""
        while self._late and self._late[0][0] <= self._session.time:
            _, axis, name, value = self._late.popleft()
            try:
                self._session.act("write", axis, name, value)
            except (SdoAbort, TypeError) as error:
                self._session.tell("refused", f"{axis}: {error}", axis)

    def forget(self) -> None:
        """Drop all pending commands."""
        self._late.clear()
