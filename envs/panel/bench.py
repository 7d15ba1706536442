"""Bench: drives on a port, one who commands them, a scope, messages; what each panel has.

`session.Session` is the bench of a machine in this process, `bus.BusBench` that of nodes on a bus.
A motion runs to its end inside its call, exchange by exchange; whatever paces that looks after
other requests meanwhile and may end the motion with `Interrupted`. A change of state or mode, which
what comes after it needs, is carried through, unless it is a stop that comes.
"""

from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from typing import Any, Protocol

import numpy as np

from ...drive.diagrams import ENABLED, Mode
from ...drive.master import Master, Refused, ServoError, Units
from ...drive.master.port import Port
from ...drive.model.model import DriveModel
from ...drive.model.rows import Object
from ...drive.objects.abort import SdoAbort
from .control import Control
from .recorder import Recorder

CHANNELS = (
    "position_actual_value", "velocity_actual_value", "torque_actual_value",
    "following_error_actual_value",
)  # fmt: skip
MOVES = 600.0  # s of the drives' time a motion may take
MESSAGES = 50
HERE = ":"  # between an axis and its channel, where there are several axes


ENDED = "ended by another command"
BUTTONS = {"enable()": "Enable", "reset_fault()": "Reset fault", "home()": "Home"}


class Interrupted(Exception):
    """A motion was ended by another command."""


def _words(error: Exception) -> str:
    """What went wrong and what to do, for who sees the drive's words beside it."""
    if not isinstance(error, ServoError):
        return str(error)
    said = "; ".join(filter(None, (error.received, error.next_step))) or str(error)
    for call, button in BUTTONS.items():
        said = said.replace(call, button)
    return said


class Agent(Protocol):
    """Commands the machine in the place of a person."""

    name: str

    def step(self) -> None:
        """One step of its own; it lets the cycles pass through the session."""

    def release(self) -> None:
        """Give the machine back."""


class Bench:
    """What pages and clock need of drives, wherever they are.

    Args:
        port: the way to the drives.
        title: what people call it.
    """

    machine: Any = None  # `engine.machine.Machine`, where it is in this process
    real_time = False  # time passes by itself: nobody paces it
    commands = True  # False: nothing is ever sent
    seats_who_comes = True  # who opens the page first has control
    sampling = "Every position cycle is a sample, {rate} a second of the machine."
    absent: Mapping[str, str] = {}  # name of a page or part -> why it cannot be had here

    def __init__(self, port: Port, title: str):
        self.port, self.title = port, title
        self.control = Control()
        self.axes = tuple(port.models)
        self.masters = {name: Master(port, name) for name in self.axes}
        self.time = 0.0  # s that have passed, over resets and snapshots
        self.pace: Callable[[], None] = lambda: None
        self.doing = ""  # the motion under way
        self.carried_through = False  # it does not end for the next one
        self.messages: list[tuple[int, str, str]] = []  # number, kind, text
        self._number = 0
        self.agent: Agent | None = None
        self.pupil: Any = None  # `lessons.Pupil`: the lesson that is being done
        self.lessons: tuple[Any, ...] = ()  # `lessons.Lesson`: that are offered
        self.laboratory: Any = None  # `session.Laboratory`, given by who serves
        self.no_policies = ""  # why there is none
        self.delay = 0.0  # s by which commands come late
        self.kept: dict[str, bytes] = {}  # snapshots of the machine by name

    def _scope(self, period: float) -> Recorder:
        """A scope with the usual channels of the first axis."""
        first = self.axes[0]
        known = [name for name in CHANNELS if name in self.model(first).names] or ["statusword"]
        names = [self.channel(first, name) for name in known]
        return Recorder(self.reader, self.unit_of, period, names)

    scope: Recorder

    # ------------------------------------------------------ what each bench has

    def exchange(self) -> None:
        """Let a little time pass: paced, recorded, watched."""
        raise NotImplementedError

    def rows(self, axis: str) -> list[Object]:
        """The objects of a drive."""
        raise NotImplementedError

    def value(self, axis: str, name: str) -> float | None:
        """An object as it is known now (drive units), without waiting; None: not known yet."""
        raise NotImplementedError

    def texts(self, axis: str, rows: Iterable[Object]) -> list[str]:
        """Values of objects as people read them; what cannot be read says why."""
        raise NotImplementedError

    def pulse(self) -> str:
        """How time passes, in a word or two, where the clock does not know it."""
        return ""

    def write(self, axis: str, name: int | str, *arguments: float) -> str:
        """Write an object as a master does; -> why it is refused, if it is."""
        raise NotImplementedError

    def powered(self, axis: str) -> bool:
        """Whether a drive is in OPERATION_ENABLED."""
        raise NotImplementedError

    def mapped(self, axis: str, direction: str) -> list[Object]:
        """The objects in the process data of a direction, rx or tx."""
        raise NotImplementedError

    def fields(self) -> tuple[str, ...]:
        """Channels of the scope that are no objects."""
        return ()

    def channel_reader(self, axis: str, name: str) -> Callable[[], float]:
        """What gives the value of a channel. Raises ValueError for an unknown one."""
        raise NotImplementedError

    def channel_unit(self, axis: str, name: str) -> str:
        """The unit of a channel."""
        raise NotImplementedError

    def _axis(self, name: str) -> dict[str, Any]:
        """All that is shown of an axis."""
        raise NotImplementedError

    # ----------------------------------------------------------------- the drives

    def model(self, axis: str) -> DriveModel:
        """What kind of drive it is."""
        return self.port.models[axis]

    def units(self, axis: str) -> Units:
        """What a drive unit is at the load."""
        return self.port.units(axis)

    def unit(self, axis: str) -> tuple[str, float]:
        """The unit people read positions in, and how many make one of the port's."""
        known = {"m": ("mm", 1e3), "rad": ("°", 180 / np.pi)}
        return known.get(self.port.units(axis).name, ("units", 1.0))

    def acceleration(self, axis: str) -> float:
        """What an acceleration unit is at the load, m/s² or rad/s²; 0: not known."""
        return 0.0

    # --------------------------------------------------------------------- channels

    def channel(self, axis: str, name: str) -> str:
        """What the scope calls an object of an axis."""
        return f"{axis}{HERE}{name}" if len(self.axes) > 1 else name

    def channels(self) -> list[str]:
        """All the scope can show."""
        return [
            self.channel(axis, name)
            for axis in self.axes
            for name in (
                *sorted(row.name for row in self.rows(axis) if row.pdo and row.format),
                *self.fields(),
            )
        ]

    def _found(self, channel: str) -> tuple[str, str]:
        axis, colon, name = channel.partition(HERE)
        if colon and axis in self.axes:
            return axis, name
        return self.axes[0], channel

    def reader(self, channel: str) -> Callable[[], float]:
        """What gives the value of a channel. Raises ValueError for an unknown one."""
        return self.channel_reader(*self._found(channel))

    def unit_of(self, channel: str) -> str:
        """The unit of a channel."""
        return self.channel_unit(*self._found(channel))

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
        """Leave a message; `kind` is done or error, for all who watch info or alarm."""
        self._number += 1
        self.messages = [*self.messages[1 - MESSAGES :], (self._number, kind, text)]

    # ---------------------------------------------------------------- motions

    def run(self, what: str, motion: Callable[[], None], *, through: bool = False) -> str:
        """Carry out a motion; -> what came of it, empty if all went well.

        Args:
            what: it is, in words.
            motion: lets time pass until it is done.
            through: whether the next motion waits for its end.
        """
        if self.agent is not None:
            return self._failed(what, f"{self.agent.name} has the machine: take it back first")
        self.doing, self.carried_through = what, through
        try:
            motion()
        except Interrupted:
            return f"{what}: {ENDED}"
        except (ServoError, SdoAbort) as error:
            return self._failed(what, _words(error))
        finally:
            self.doing, self.carried_through = "", False
        self.tell("done", what)
        return ""

    def _failed(self, what: str, why: str) -> str:
        self.tell("error", why if why.startswith(what) else f"{what}: {why}")
        return why

    def enable(self, axis: str) -> str:
        """Walk to OPERATION_ENABLED."""
        return self.run(f"{axis}: enable", self.masters[axis].enable, through=True)

    def disable(self, axis: str) -> str:
        """Take the power off."""
        return self.run(f"{axis}: disable", self.masters[axis].disable)

    def reset_fault(self, axis: str) -> str:
        """Reset the fault."""
        return self.run(f"{axis}: fault reset", self.masters[axis].reset_fault, through=True)

    def set_mode(self, axis: str, mode: int) -> str:
        """Select a mode of operation."""
        return self.run(
            f"{axis}: mode {Mode(mode).name.lower()}",
            lambda: self.masters[axis].set_mode(Mode(mode)),
            through=True,
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
            stop = self.masters[name].quick_stop
            if self.powered(name) and (wrong := self.run(f"{name}: quick stop", stop)):
                return wrong
        return ""

    def control_word(self, axis: str, word: int) -> str:
        """Send a controlword as it is."""
        if self.agent is not None:
            return f"{self.agent.name} has the machine: take it back first"
        return self.write(axis, "controlword", word & 0xFFFF)

    def release(self) -> None:
        """Take the machine back from an agent."""
        agent, self.agent = self.agent, None
        if agent is not None:
            agent.release()
            self.tell("done", f"{agent.name} has given the machine back")

    # ------------------------------------------------------------ what is seen

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
