"""Bench: drives on a port with a commander, a scope and a log, which every panel has.

`session.Session` is the bench of a machine in this process, `bus.BusBench` that of nodes on a bus.
A motion runs to its end inside its call, exchange by exchange. The function that paces it serves
other requests meanwhile and may end the motion with `Interrupted`. A change of state or mode is
completed before the next motion begins, because that motion needs it; only a stop ends it.
"""

from collections.abc import Callable, Iterable, Mapping
from typing import Any, Protocol

import numpy as np

from ...drive.diagrams import Mode
from ...drive.master import DriveFault, Master, NoPower, Refused, ServoError, Units
from ...drive.master.port import Port
from ...drive.model.model import DriveModel
from ...drive.model.rows import Object, quantity
from ...drive.objects.abort import SdoAbort
from .control import Control
from .log import Event, Log
from .recorder import Recorder
from .set_points import SetPoints
from .twin import TWIN, ParallelTwin

CHANNELS = (
    "position_actual_value", "velocity_actual_value", "torque_actual_value",
    "following_error_actual_value",
)
MOVES = 600.0  # s of the drives' time a motion may take
MESSAGES = 50
HERE = ":"  # between an axis and its channel, if there are several axes
ENDED = "ended by another command"
STREAMED = {  # modes in which the axis goes on until it gets another set-point
    Mode.VELOCITY, Mode.PROFILE_VELOCITY, Mode.PROFILE_TORQUE, Mode.INTERPOLATED_POSITION,
    Mode.CYCLIC_SYNC_POSITION, Mode.CYCLIC_SYNC_VELOCITY, Mode.CYCLIC_SYNC_TORQUE,
}
SHOWN_IN = {"m": ("mm", 1e3), "rad": ("°", 180 / np.pi)}  # by unit of the port
BUTTONS = {"enable()": "Enable", "reset_fault()": "Reset fault", "home()": "Home"}


class Interrupted(Exception):
    """Another command has ended this motion."""


def words(error: ServoError) -> tuple[str, str]:
    """The reason of an error and the next step, for readers who see the state of the drive."""
    step = error.next_step
    for call, button in BUTTONS.items():
        step = step.replace(call, button)
    return error.received or str(error), step


class Agent(Protocol):
    """An agent that commands the machine instead of a person."""

    name: str

    def step(self) -> None:
        """Take one step of the agent, which advances the cycles through the session."""

    def release(self) -> None:
        """Hand the machine back."""


class Bench:
    """The interface of drives to pages and clock, wherever the drives are.

    Args:
        port: the way to the drives.
        title: what people call it.
    """

    machine: Any = None  # `engine.machine.Machine`, if it is in this process
    scope: Recorder
    real_time = False  # time passes by itself and cannot be paced
    commands = True  # False: nothing is ever sent
    seats_first = True  # the first tab that opens the page gets control
    sampling = "One sample in each position cycle, {rate} in a second of machine time."
    absent: Mapping[str, str] = {}  # name of a page or part -> why it is not available here

    def __init__(self, port: Port, title: str):
        self.port, self.title = port, title
        self.control = Control()
        self.axes = tuple(port.models)
        self.set_points = SetPoints(self)
        self.masters = {name: Master(port, name) for name in self.axes}
        self.time = 0.0  # s that have passed; resets and snapshots do not turn it back
        self.pace: Callable[[], bool] = lambda: False  # -> whether a single cycle is due
        self.streams = False  # whether each cycle gets a set-point
        self.doing = ""  # the present motion
        self.carried_through = False  # whether it completes before the next one begins
        self.log = Log()
        self._faults: dict[str, str] = {}
        self.underway: set[str] = set()  # axes that a window has set in motion
        self.agent: Agent | None = None
        self.pupil: Any = None  # `lessons.Pupil`: the present exercise
        self.lessons: tuple[Any, ...] = ()  # `course.exercise.Exercise`: the exercises offered
        self.laboratory: Any = None  # `session.Laboratory`
        self.no_policies = ""  # why there is no laboratory
        self.delay = 0.0  # s by which commands are delayed
        self.kept: dict[str, bytes] = {}  # snapshots of the machine by name
        self.beside: ParallelTwin | None = None  # the twin beside an axis

    def _scope(self, period: float) -> Recorder:
        """Make a scope with the usual channels of the first axis."""
        first = self.axes[0]
        present = [name for name in CHANNELS if name in self.model(first).names]
        names = [self.channel(first, name) for name in present or ["statusword"]]
        return Recorder(self.reader, self.unit_of, period, names)

    # ------------------------------------------------------ what each bench has

    def exchange(self) -> None:
        """Advance by a short time, with pacing, recording and supervision."""
        raise NotImplementedError

    def rows(self, axis: str) -> list[Object]:
        """The object rows of a drive."""
        raise NotImplementedError

    def value(self, axis: str, name: str) -> float | None:
        """The last known value of an object (drive units), without waiting.

        None if it is not known yet, or if the drive does not have the object.
        """
        raise NotImplementedError

    def present(self, axis: str, name: str) -> float | None:
        """A quantity that the header or every page shows (drive units); None if it is unknown."""
        raise NotImplementedError

    def texts(self, axis: str, rows: Iterable[Object]) -> list[str]:
        """Values of objects as readable text, or the reason why an object cannot be read."""
        raise NotImplementedError

    def pulse(self) -> str:
        """How time passes, in a word or two, if the clock cannot tell."""
        return ""

    def write(self, axis: str, name: int | str, *arguments: float) -> str:
        """Write an object as a master does; -> the reason of a refusal, or nothing."""
        raise NotImplementedError

    def powered(self, axis: str) -> bool:
        """Whether a drive is in OPERATION_ENABLED."""
        raise NotImplementedError

    def fault_of(self, axis: str) -> tuple[str, str]:
        """The fault of a drive and its remedy, empty without one."""
        raise NotImplementedError

    def mapped(self, axis: str, direction: str) -> list[Object]:
        """The objects in the process data of one direction, rx or tx."""
        raise NotImplementedError

    def fields(self) -> tuple[str, ...]:
        """Channels of the scope that are not objects."""
        return ()

    def channel_reader(self, axis: str, name: str) -> Callable[[], float]:
        """Return a reader for the value of a channel. Raises ValueError for an unknown channel."""
        raise NotImplementedError

    def channel_unit(self, axis: str, name: str) -> str:
        """The unit of a channel."""
        raise NotImplementedError

    def _status(self, axis: str) -> dict[str, Any]:
        """What the pages show of an axis beside `shown`, in the same units."""
        raise NotImplementedError

    def joint_position(self, axis: str) -> float | None:
        """The position of the joint (m or rad); None if only the drive measures it."""
        return None

    def referenced(self, axis: str) -> bool:
        """Whether an axis is homed; True if this cannot be determined."""
        return True

    # ----------------------------------------------------------------- the drives

    def model(self, axis: str) -> DriveModel:
        """The drive model of an axis."""
        return self.port.models[axis]

    def units(self, axis: str) -> Units:
        """The size of the drive units at the load."""
        return self.port.units(axis)

    def unit(self, axis: str) -> tuple[str, float]:
        """The display unit of positions, and how many of them make one unit of the port."""
        return SHOWN_IN.get(self.port.units(axis).name, ("units", 1.0))

    def acceleration(self, axis: str) -> float:
        """The size of an acceleration unit at the load, m/s² or rad/s²; 0 if it is unknown."""
        return 0.0

    def physical(self, axis: str, row: Object) -> tuple[float, str]:
        """Factor from drive units of an object to a display unit, and that unit; 0 if unknown."""
        (unit, scale), units = self.unit(axis), self.units(axis)
        if unit == "units":
            return 0.0, ""
        return {
            "position": (units.position * scale, unit),
            "velocity": (units.velocity * scale, f"{unit}/s"),
            "acceleration": (self.acceleration(axis) * scale, f"{unit}/s²"),
            "torque": (0.1, "% rated"),
        }.get(quantity(row.unit), (0.0, ""))

    # --------------------------------------------------------------------- channels

    def channel(self, axis: str, name: str) -> str:
        """The scope's name for an object of an axis."""
        return f"{axis}{HERE}{name}" if len(self.axes) > 1 else name

    def channels(self) -> list[str]:
        """All channels that the scope can show."""
        return [
            self.channel(axis, name)
            for axis in self.axes
            for name in (
                *sorted(row.name for row in self.rows(axis) if row.pdo and row.format),
                *self.fields(),
            )
        ] + (self.beside.channels() if self.beside else [])

    def found(self, channel: str) -> tuple[str, str]:
        """Axis and name of a channel; a channel of the twin is in the units of its axis."""
        axis, colon, name = channel.partition(HERE)
        if colon and axis in self.axes:
            return axis, name
        if colon and axis == TWIN and self.beside:
            return self.beside.axis, name
        return self.axes[0], channel

    def reader(self, channel: str) -> Callable[[], float]:
        """Return a reader for the value of a channel. Raises ValueError for an unknown channel."""
        axis, name = self.found(channel)
        if self.beside and channel.startswith(TWIN + HERE):
            return self.beside.reader(name)
        return self.channel_reader(axis, name)

    def unit_of(self, channel: str) -> str:
        """The unit of a channel."""
        return self.channel_unit(*self.found(channel))

    def put_beside(self, machine: Any, axis: str = "", drive: str = "") -> None:
        """Put a twin beside an axis, by default the first one; the scope shows both.

        Raises ValueError as `twin.ParallelTwin`.
        """
        self.beside = ParallelTwin(self, machine, axis or self.axes[0], drive)
        axis, known = self.beside.axis, self.beside.channels()
        names = [
            channel for name in ("position_actual_value", "following_error_actual_value")
            for channel in (self.channel(axis, name), f"{TWIN}{HERE}{name}")
            if f"{TWIN}{HERE}{name}" in known
        ]
        if names:
            self.scope.choose(names)

    def advance(self, time: float) -> None:
        """Advance by this time (s)."""
        end = self.time + time - 1e-9
        while self.time < end:
            if self.agent is not None:
                self.agent.step()
            else:
                self.exchange()

    # ---------------------------------------------------------------- the log

    def tell(
        self, kind: str, text: str, axis: str = "", reason: str = "", remedy: str = ""
    ) -> None:
        """Add an entry to the log; see `log.KINDS`."""
        self.log.enter(kind, text, self.time, axis, self.control.window, reason, remedy)

    @property
    def messages(self) -> list[Event]:
        """The latest events of the log."""
        return self.log.events[-MESSAGES:]

    def _watch_faults(self) -> None:
        """Log a fault that has appeared or disappeared."""
        for axis in self.axes:
            fault, remedy = self.fault_of(axis)
            if fault == self._faults.get(axis, ""):
                continue
            self._faults[axis] = fault
            if fault:
                self.tell("fault", f"{axis}: FAULT {fault}", axis, fault, remedy)
            else:
                self.tell("info", f"{axis}: the fault is gone", axis)

    # ---------------------------------------------------------------- motions

    def run(
        self, what: str, motion: Callable[[], Any], axis: str = "", *, through: bool = False,
        goes_on: bool = False,
    ) -> str:
        """Carry out a motion; -> the reason of a failure, empty if all went well.

        Args:
            what: the motion in words.
            motion: lets time pass until it is done.
            axis: the axis that it moves, which is under way until the motion has ended.
            through: whether the next motion waits for its end.
            goes_on: whether the axis goes on after the motion has returned, as it does at a speed.
        """
        if self.agent is not None:
            return self._failed(what, f"{self.agent.name} has the machine", "take it back first")
        self.doing, self.carried_through = what, through
        if axis:
            self.underway.add(axis)
        self.tell("command", what, axis)
        try:
            motion()
        except Interrupted:
            self.tell("info", f"{what}: {ENDED}", axis)
            return f"{what}: {ENDED}"
        except ServoError as error:
            if isinstance(error, NoPower | DriveFault | Refused):  # it does not move
                self.underway.discard(axis)
            return self._failed(what, *words(error), axis)
        except (SdoAbort, ValueError) as error:
            return self._failed(what, str(error), "", axis)
        finally:
            self.doing, self.carried_through = "", False
        if not goes_on:
            self.underway.discard(axis)
        self.tell("done", what, axis)
        return ""

    def _failed(self, what: str, why: str, remedy: str = "", axis: str = "") -> str:
        said = "; ".join(filter(None, (why, remedy)))
        text = said if said.startswith(what) else f"{what}: {said}"
        self.tell("refused", text, axis, why, remedy)
        return said

    def enable(self, axis: str) -> str:
        """Bring the drive to OPERATION_ENABLED."""
        moves = (self.value(axis, "modes_of_operation_display") or 0) in STREAMED
        return self.run(
            f"{axis}: enable", self.masters[axis].enable, axis, through=True, goes_on=moves
        )

    def disable(self, axis: str) -> str:
        """Switch the power off; an agent hands the machine back."""
        self.release()
        return self.run(f"{axis}: disable", self.masters[axis].disable, axis)

    def reset_fault(self, axis: str) -> str:
        """Reset the fault."""
        return self.run(f"{axis}: fault reset", self.masters[axis].reset_fault, axis, through=True)

    def set_mode(self, axis: str, mode: int) -> str:
        """Select a mode of operation."""
        return self.run(
            f"{axis}: mode {Mode(mode).name.lower()}",
            lambda: self.masters[axis].set_mode(Mode(mode)), axis, through=True,
            goes_on=mode in STREAMED,
        )

    def home(self, axis: str, method: int | None = None) -> str:
        """Home the axis, by default with the method that is set."""
        master = self.masters[axis]
        return self.run(f"{axis}: home", lambda: master.home(method=method, timeout=MOVES), axis)

    def move(self, axis: str, position: float, *, relative: bool = False) -> str:
        """Move to a position (m or rad), or by a distance."""
        master = self.masters[axis]

        def motion() -> None:  # by a distance: from where the axis is, whatever 60F2h says
            begin = master.position if relative else 0.0
            master.move_to(begin + position, immediate=True, timeout=MOVES)

        name, scale = self.unit(axis)
        by = "by" if relative else "to"
        return self.run(f"{axis}: move {by} {position * scale:g} {name}", motion, axis)

    def jog(self, axis: str, velocity: float) -> str:
        """Run at a velocity (m/s or rad/s); 0 stops."""
        name, scale = self.unit(axis)
        what = f"{axis}: jog at {velocity * scale:g} {name}/s"
        return self.run(
            what, lambda: self.masters[axis].jog(velocity), axis, goes_on=velocity != 0.0
        )

    def stop(self, axis: str | None = None) -> str:
        """Stop an axis, or all, in any mode; it stays powered and at rest until a new command."""
        return self._stop("stop", axis, Master.stop)

    def quick_stop(self, axis: str | None = None) -> str:
        """Quick-stop an axis, or all at once; this takes precedence over an agent."""
        return self._stop("quick stop", axis, Master.quick_stop)

    def _stop(self, what: str, axis: str | None, how: Callable[[Master], Any]) -> str:
        """Stop the axes at once, so that none waits for another."""
        self.release()
        axes = [name for name in ((axis,) if axis else self.axes) if self.powered(name)]
        named = f"{', '.join(axes) or axis or 'all axes'}: {what}"
        if not axes:
            self.tell("stop", f"{named}: there is no power, so nothing is driven", axis or "")
            return ""
        self.tell("stop", named, axis or "")
        said = self.run(named, lambda: how(Master(self.port, *axes)), through=True)
        self.underway.difference_update(axes)
        return said

    def abandon(self, why: str) -> None:
        """End the motions that a tab which is no longer there has commanded."""
        axes = [name for name in self.axes if name in self.underway and self.powered(name)]
        if not (axes or self.agent):
            return
        self.tell("alarm", f"{why}: what it had set in motion is stopped", "", why, "take control")
        self.release()
        if axes:
            self.run(f"{', '.join(axes)}: stop", Master(self.port, *axes).stop, through=True)
            self.underway.difference_update(axes)

    def control_word(self, axis: str, word: int) -> str:
        """Send a controlword unchanged."""
        if self.agent is not None:
            return f"{self.agent.name} has the machine: take it back first"
        return self.command(axis, "controlword", word & 0xFFFF)

    def command(self, axis: str, name: int | str, *arguments: float) -> str:
        """Write an object on behalf of a tab and log it; -> the reason of a refusal."""
        wrong = self.write(axis, name, *arguments)
        known = f"{name:04X}h" if isinstance(name, int) else name
        sub = f":{int(arguments[0]):02X}" if len(arguments) > 1 else ""
        hexadecimal = f"{int(arguments[-1]):04X}h" if name == "controlword" else ""
        what = f"{axis}: {known}{sub} = {hexadecimal or f'{arguments[-1]:.10g}'}"
        if wrong:
            self.tell("refused", f"{what}: {wrong}", axis, wrong)
        else:
            self.tell("command", what, axis)
            self.underway.add(axis)
        return wrong

    def release(self) -> None:
        """Take the machine back from an agent."""
        agent, self.agent = self.agent, None
        if agent is not None:
            agent.release()
            self.tell("done", f"{agent.name} has given the machine back")

    # ----------------------------------------------------------- what is shown

    def shown(self) -> dict[str, Any]:
        """The present state of everything that the pages show, as plain values."""
        return {
            "time": self.time,
            "doing": self.doing,
            "agent": self.agent.name if self.agent else "",
            "holder": self.control.holder,
            "messages": self.messages,
            "kept": [*self.kept],
            "scope": self.scope.state,
            "twin": self.beside.state if self.beside else "",
            "lesson": self.pupil.present if self.pupil else None,
            "axes": {name: self._axis(name) for name in self.axes},
        }

    def _axis(self, axis: str) -> dict[str, Any]:
        """Everything that the pages show of an axis, in the units of `unit`."""
        units, (_, scale) = self.units(axis), self.unit(axis)
        position, velocity = units.position * scale, units.velocity * scale
        fault, remedy = self.fault_of(axis)

        def of(name: str) -> int:
            return int(self.present(axis, name) or 0)

        return {
            "mode": of("modes_of_operation_display"),
            "controlword": of("controlword"),
            "statusword": of("statusword"),
            "position": of("position_actual_value") * position,
            "velocity": of("velocity_actual_value") * velocity,
            "torque": of("torque_actual_value") * 0.1,  # % of the rated torque
            "following_error": of("following_error_actual_value") * position,
            "target": of("target_position") * position,
            "homing_method": of("homing_method"),
            "fault": fault,
            "remedy": remedy,
        } | self._status(axis)
