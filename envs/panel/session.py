"""Session: the panel without a browser. Commands in, snapshots and traces out.

Whoever owns a session calls it from one thread: `clock.Clock` in real time, a test as fast as it
can. A motion runs to its end inside its call, cycle by cycle through `exchange`; whatever paces
that looks after other requests meanwhile and may end the motion with `Interrupted`.
"""

from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any, Protocol

import numpy as np

from ...drive.advice import refusal, remedy
from ...drive.diagrams import ENABLED, Mode, State, limits
from ...drive.master import Master, Refused, ServoError
from ...drive.objects.abort import SdoAbort
from ..engine.machine import Machine
from ..masters.port import MachinePort
from .control import Control
from .recorder import Recorder

CHANNELS = (
    "position_actual_value", "velocity_actual_value", "torque_actual_value",
    "following_error_actual_value",
)  # fmt: skip
MOVES = 600.0  # s of the machine's time a motion may take
MESSAGES = 50


class Interrupted(Exception):
    """A motion was ended by another command."""


class Agent(Protocol):
    """Commands the machine in the place of a person."""

    name: str

    def step(self) -> None:
        """One step of its own; it lets the cycles pass through the session."""

    def release(self) -> None:
        """Give the machine back."""


class Laboratory(Protocol):
    """What knows policies; `training` has one."""

    @property
    def names(self) -> tuple[str, ...]:
        """That are offered."""

    def prepare(self, machine: Machine, name: str, goal: float) -> None:
        """Do on a copy what takes long. Raises what is wrong with the policy or the goal (m)."""

    def agent(self, session: "Session", name: str, goal: float) -> Agent:
        """A policy that brings the axis to a goal (m)."""

    def compare(self, machine: Machine, names: list[str], goal: float) -> Sequence[Any]:
        """How each policy does it, on copies of a machine."""


class Session:
    """A machine, its masters, a scope, and who commands it.

    Args:
        machine: to be driven, with one drive or several.
        title: what people call it.
    """

    def __init__(self, machine: Machine, title: str = ""):
        self.machine, self.title = machine, title or type(machine).__name__
        self.control = Control()
        self.axes = tuple(machine.drives)
        self.port = _Port(machine, self)
        self.masters = {name: Master(self.port, name) for name in self.axes}
        first = machine.drives[self.axes[0]]
        known = [name for name in CHANNELS if name in first.objects.names]
        self.scope = Recorder(first, machine.cycle_time, known or ["statusword"])
        self.scope_axis = self.axes[0]
        self.time = 0.0  # s that have passed, over resets and snapshots
        self.pace: Callable[[], None] = lambda: None
        self.doing = ""  # the motion under way
        self.messages: list[tuple[int, str, str]] = []  # number, kind, text
        self._number = 0
        self.agent: Agent | None = None
        self.pupil: Any = None  # `lessons.Pupil`: the lesson that is being done
        self.lessons: tuple[Any, ...] = ()  # `lessons.Lesson`: that are offered
        self.laboratory: Laboratory | None = None  # given by who serves
        self.delay = 0.0  # s by which commands come late
        self.kept: dict[str, bytes] = {}  # snapshots of the machine by name

    # ------------------------------------------------------------------- time

    def exchange(self) -> None:
        """One position cycle: paced, stepped, recorded, watched."""
        self.pace()
        self.port.deliver()
        self.machine.step()
        self.time += self.machine.cycle_time
        self.scope.sample(self.time)
        if self.pupil is not None:
            self.pupil.look()

    def advance(self, time: float) -> None:
        """Let so much time pass (s)."""
        end = self.time + time - 1e-9
        while self.time < end:
            if self.agent is not None:
                self.agent.step()
            else:
                self.exchange()

    # --------------------------------------------------------------- messages

    def tell(self, kind: str, text: str) -> None:
        """Leave a message for all who watch; `kind` is info, done or error."""
        self._number += 1
        self.messages = [*self.messages[1 - MESSAGES :], (self._number, kind, text)]

    # ---------------------------------------------------------------- motions

    def run(self, what: str, motion: Callable[[], None]) -> str:
        """Carry out a motion to its end; -> what came of it, empty if all went well."""
        if self.agent is not None:
            return self._failed(what, f"{self.agent.name} has the machine: take it back first")
        self.doing = what
        try:
            motion()
        except Interrupted:
            return f"{what}: ended by another command"
        except (ServoError, SdoAbort) as error:
            return self._failed(what, str(error))
        finally:
            self.doing = ""
        self.tell("done", what)
        return ""

    def _failed(self, what: str, why: str) -> str:
        self.tell("error", why if why.startswith(what) else f"{what}: {why}")
        return why

    def enable(self, axis: str) -> str:
        """Walk to OPERATION_ENABLED."""
        return self.run(f"{axis}: enable", self.masters[axis].enable)

    def disable(self, axis: str) -> str:
        """Take the power off."""
        return self.run(f"{axis}: disable", self.masters[axis].disable)

    def reset_fault(self, axis: str) -> str:
        """Reset the fault."""
        return self.run(f"{axis}: fault reset", self.masters[axis].reset_fault)

    def set_mode(self, axis: str, mode: int) -> str:
        """Select a mode of operation."""
        return self.run(
            f"{axis}: mode {Mode(mode).name.lower()}",
            lambda: self.masters[axis].set_mode(Mode(mode)),
        )

    def home(self, axis: str, method: int | None = None) -> str:
        """Home; the method that is set if none is given."""
        return self.run(
            f"{axis}: home", lambda: self.masters[axis].home(method=method, timeout=MOVES)
        )

    def move(self, axis: str, position: float, *, relative: bool = False) -> str:
        """Move to a position (m or rad), or by so much."""
        master = self.masters[axis]

        def motion() -> None:
            if relative:  # counted from where the axis is, whatever 60F2h says
                master.move_to(master.position + position, immediate=True, timeout=MOVES)
            else:
                master.move_to(position, immediate=True, timeout=MOVES)

        name, scale = self.unit(axis)
        by = "by" if relative else "to"
        return self.run(f"{axis}: move {by} {position * scale:g} {name}", motion)

    def jog(self, axis: str, velocity: float) -> str:
        """Run at a velocity (m/s or rad/s); 0 stops."""
        return self.run(f"{axis}: jog", lambda: self.masters[axis].jog(velocity))

    def halt(self, axis: str) -> str:
        """Stop and stay enabled; what it was doing is dropped."""
        return self.run(f"{axis}: stop", lambda: self._stop(axis))

    def _stop(self, axis: str) -> None:
        master = self.masters[axis]
        if master.mode == Mode.PROFILE_VELOCITY:
            master.write("target_velocity", 0)
        master.halt()
        if master.mode == Mode.PROFILE_POSITION:
            with suppress(Refused):  # behind the stroke, as after homing: halt stays
                master.move_to(master.position, immediate=True)  # in the place of what was halted
        else:
            master.control(ENABLED)

    def quick_stop(self, axis: str | None = None) -> str:
        """Quick stop of an axis, or of all that have power; outranks an agent."""
        self.release()
        for name in (axis,) if axis else self.axes:
            powered = int(self.machine.drives[name].axis.state) == State.OPERATION_ENABLED
            stop = self.masters[name].quick_stop
            if powered and (wrong := self.run(f"{name}: quick stop", stop)):
                return wrong
        return ""

    # ---------------------------------------------------------------- objects

    def write(self, axis: str, name: int | str, *arguments: float) -> str:
        """Write an object as a master does; -> why it is refused, if it is."""
        try:
            self.machine.drives[axis].write(name, *arguments)
        except (SdoAbort, TypeError, ValueError) as error:
            return str(error)
        return ""

    def control_word(self, axis: str, word: int) -> str:
        """Send a controlword as it is."""
        if self.agent is not None:
            return f"{self.agent.name} has the machine: take it back first"
        return self.write(axis, "controlword", word & 0xFFFF)

    def unit(self, axis: str) -> tuple[str, float]:
        """The unit people read positions in, and how many make 1 m or 1 rad."""
        return ("mm", 1e3) if self.port.units(axis).name == "m" else ("°", 180 / np.pi)

    # ------------------------------------------------------ snapshots, agents

    def keep(self, name: str) -> None:
        """Keep the machine as it is under a name."""
        self.kept[name] = self.machine.snapshot()
        self.tell("done", f"kept as {name!r}")

    def back(self, name: str) -> str:
        """Become what was kept; -> why it cannot be."""
        if name not in self.kept:
            return f"there is no snapshot {name!r}"
        self.release()
        try:
            self.machine.restore(self.kept[name])
        except ValueError as error:
            return self._failed("snapshot", str(error))
        self.tell("done", f"back at {name!r}")
        return ""

    def save_parameters(self, axis: str) -> bytes:
        """The parameter file as the drive would store it now."""
        return self.machine.drives[axis].parameters.export()

    def load_parameters(self, axis: str, content: bytes) -> str:
        """Store a parameter file and put it in force; -> why it is refused."""
        drive = self.machine.drives[axis]
        if drive.energised:
            return "the drive has power: disable it before its parameters change as a whole"
        wrong = drive.use_parameters(content)
        if not wrong:
            self.tell("done", f"{axis}: parameters loaded")
        return wrong

    def reset(self) -> None:
        """Power off and on again, the joints where they are."""
        self.release()
        self.port.forget()
        positions = {}
        for name, coupling in zip(self.axes, self.machine.couplings, strict=True):
            positions[name] = float(self.machine.data.qpos[coupling.qpos])
        with suppress(ValueError):  # an axis pressed into its end stop begins where the model says
            self.machine.reset(positions=positions)
            return
        self.machine.reset()

    def hand_over(self, agent: Agent) -> None:
        """Let an agent command from now on. Raises Refused while another one does."""
        if self.agent is not None:
            raise Refused("hand over", f"{self.agent.name} has the machine", "take it back first")
        self.agent = agent
        self.tell("done", f"{agent.name} has taken over")

    def release(self) -> None:
        """Take the machine back from an agent."""
        agent, self.agent = self.agent, None
        if agent is not None:
            agent.release()
            self.tell("done", f"{agent.name} has given the machine back")

    # -------------------------------------------------------------- snapshots

    def shown(self) -> dict[str, Any]:
        """All that the pages show of now, as plain values."""
        return {
            "time": self.time,
            "doing": self.doing,
            "agent": self.agent.name if self.agent else "",
            "holder": self.control.holder,
            "messages": self.messages,
            "kept": [*self.kept],
            "scope": self.scope.state,
            "lesson": self.pupil.present if self.pupil else None,
            "axes": {name: self._axis(name) for name in self.axes},
        }

    def _axis(self, name: str) -> dict[str, Any]:
        drive, units = self.machine.drives[name], self.port.units(name)
        axis, od = drive.axis, drive.axis.od
        _, scale = self.unit(name)
        state = State(int(axis.state))
        return {
            "state": int(state),
            "mode": int(od.modes_of_operation_display),
            "controlword": int(od.controlword),
            "statusword": int(od.statusword),
            "position": int(od.position_actual_value) * units.position * scale,
            "demand": int(od.position_demand_value) * units.position * scale,
            "velocity": int(od.velocity_actual_value) * units.velocity * scale,
            "torque": int(od.torque_actual_value) * 0.1,  # % of the rated torque
            "following_error": int(od.following_error_actual_value) * units.position * scale,
            "target": float(axis.target) / float(axis.rad_per_position_unit or 1)
            * units.position * scale,
            "homed": bool(axis.homed),
            "homing_method": int(od.homing_method),
            "fault": drive.fault,
            "faults": drive.faults[1:],
            "remedy": remedy(axis) if drive.fault else "",
            "refused": refusal(axis) if int(axis.refused_command) else "",
            "limits": limits(int(axis.limits)),
            "inputs": int(od.digital_inputs),
            "injected": int(axis.injected),
            "rpdo": drive.pack(),
            "tpdo": drive.collect(),
        }  # fmt: skip


class _Port(MachinePort):
    """The machine; time passes through the session, and commands may come late."""

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
            super().write(axis, name, value)

    def exchange(self) -> None:
        """One cycle of the session."""
        self._session.exchange()

    def deliver(self) -> None:
        """Hand over what is due."""
        while self._late and self._late[0][0] <= self._session.time:
            _, axis, name, value = self._late.popleft()
            try:
                super().write(axis, name, value)
            except (SdoAbort, TypeError) as error:
                self._session.tell("error", f"{axis}: {error}")

    def forget(self) -> None:
        """Nothing is under way any more."""
        self._late.clear()
