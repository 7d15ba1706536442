"""Lessons: tasks from small text files, checked by the state of the drive.

A lesson is a TOML file::

    title = "Home the axis"
    about = "What it is about."
    axis = "linear"                     # kind of machine it was written for, told to the reader

    [begin]                             # what is done when the lesson starts, all optional
    positions = { x = 0.12 }            # m or rad; power off and on again there
    write = { homing_method = 17 }
    inject = ["encoder_loss"]
    disturb = { "Cable drag" = 300 }

    [[step]]
    text = "Enable the drive."
    hint = "The transitions 2, 3 and 4."
    check = { state = "OPERATION_ENABLED" }
    begin = { inject = ["overvoltage"] }   # done when the step begins

What can be checked, all of it at once: ``state``, ``fault`` (a cause, or "" for none), ``homed``,
``refused`` (a command), ``mode``, ``position`` (two numbers, mm or °), ``standstill``, and
``objects``, by name with two numbers each.
"""

import math
import tomllib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ...drive.advice import cause_of, refused
from ...drive.diagrams import Mode, State
from ...drive.model.files import content
from .disturbances import DISTURBANCES, clear, disturb, inject
from .session import Session

SHIPPED = Path(__file__).parent / "exercises"
CHECKED = ("state", "fault", "homed", "refused", "mode", "position", "standstill", "objects")
BEGUN = ("positions", "write", "inject", "disturb", "clear")
EVERY = 8  # cycles between two looks


@dataclass(frozen=True)
class Step:
    """One thing to do."""

    text: str
    check: dict[str, Any]
    hint: str = ""
    begin: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Lesson:
    """A task."""

    title: str
    about: str
    axis: str
    begin: dict[str, Any]
    steps: tuple[Step, ...]


def load(path: Path) -> Lesson:
    """A lesson of a file. Raises ValueError with file and reason."""
    try:
        data = tomllib.loads(content(path, "a lesson").decode())
        steps = tuple(
            Step(str(row["text"]), _known(row["check"], CHECKED), str(row.get("hint", "")),
                 _known(row.get("begin", {}), BEGUN))
            for row in data["step"]
        )  # fmt: skip
        if not steps:
            raise ValueError("it has no step")
        for step in steps:
            _judge(step.check)
        return Lesson(
            str(data["title"]), str(data.get("about", "")), str(data.get("axis", "")),
            _known(data.get("begin", {}), BEGUN), steps,
        )  # fmt: skip
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError, TypeError, ValueError) as error:
        raise ValueError(f"lesson {path}: {error}") from None
    except KeyError as error:
        raise ValueError(f"lesson {path}: {error} is missing") from None


def load_all(folder: Path = SHIPPED) -> list[Lesson]:
    """The lessons of a folder, in the order of their files' names."""
    files = sorted(folder.glob("*.toml"))
    if not files:
        raise ValueError(f"--lessons {folder}: there is no .toml file in it")
    return [load(file) for file in files]


def _known(table: Any, names: tuple[str, ...]) -> dict[str, Any]:
    if not isinstance(table, dict) or (unknown := table.keys() - set(names)):
        which = ", ".join(sorted(unknown)) if isinstance(table, dict) else repr(table)
        raise ValueError(f"{which} is unknown, use {', '.join(names)}")
    return table


def _judge(check: dict[str, Any]) -> None:
    """Raises ValueError for a check that could never hold."""
    if not check:
        raise ValueError("a step checks nothing")
    if "state" in check and check["state"] not in State.__members__:
        raise ValueError(f"state {check['state']!r} is unknown, use {', '.join(State.__members__)}")
    if "mode" in check and check["mode"] not in Mode.__members__:
        raise ValueError(f"mode {check['mode']!r} is unknown, use {', '.join(Mode.__members__)}")
    ranges = {"position": check.get("position", [0, 0])} | check.get("objects", {})
    for name, pair in ranges.items():
        if len(pair) != 2 or not all(math.isfinite(end) for end in pair) or pair[0] > pair[1]:
            raise ValueError(f"{name} = {pair!r} is no range of two numbers")


class Pupil:
    """A lesson that is being done on an axis of a session.

    Args:
        session: whose drive is looked at.
        axis: which of them.
        lesson: to be done.

    Raises:
        ValueError: the machine cannot begin as the lesson says.
    """

    def __init__(self, session: Session, axis: str, lesson: Lesson):
        self.session, self.axis, self.lesson = session, axis, lesson
        self.step = 0
        self.times: list[float] = []
        self._cycle = 0
        self._begun = session.time
        self._begin(lesson.begin)
        self._begin(lesson.steps[0].begin)

    @property
    def done(self) -> bool:
        """Whether all is done."""
        return self.step >= len(self.lesson.steps)

    @property
    def present(self) -> tuple[str, int, str]:
        """Title, number of the present step, its text; the text is empty when all is done."""
        text = "" if self.done else self.lesson.steps[self.step].text
        return self.lesson.title, self.step, text

    def look(self) -> None:
        """See whether the present step is done; called after each cycle."""
        self._cycle += 1
        if self._cycle % EVERY or self.done:
            return
        if holds(self.session, self.axis, self.lesson.steps[self.step].check):
            self.times.append(self.session.time - self._begun)
            self.step += 1
            self.session.tell("done", f"step {self.step} of {self.lesson.title!r} is done")
            if not self.done:
                self._begin(self.lesson.steps[self.step].begin)

    def _begin(self, begin: dict[str, Any]) -> None:
        session, axis = self.session, self.axis
        if begin.get("clear"):
            clear(session, axis)
        if "positions" in begin:
            places = begin["positions"]
            session.release()
            clear(session, axis)
            session.machine.reset(positions={n: p for n, p in places.items() if n in session.axes})
        for name, value in begin.get("write", {}).items():
            if wrong := session.write(axis, name, value):
                raise ValueError(f"{self.lesson.title}: {wrong}")
        for cause in begin.get("inject", []):
            if wrong := inject(session, axis, cause):
                raise ValueError(f"{self.lesson.title}: {wrong}")
        for name, value in begin.get("disturb", {}).items():
            known = {row.name: row for row in DISTURBANCES}
            if name not in known:
                raise ValueError(f"{self.lesson.title}: disturb {name!r}, use {', '.join(known)}")
            if wrong := disturb(session, axis, known[name], value):
                raise ValueError(f"{self.lesson.title}: {wrong}")


def holds(session: Session, axis: str, check: dict[str, Any]) -> bool:
    """Whether the drive is as a check says."""
    drive = session.machine.drives[axis]
    _, scale = session.unit(axis)
    place = drive.axis.od.position_actual_value * session.port.units(axis).position * scale
    seen = {
        "state": lambda want: drive.state.name == want,
        "fault": lambda want: cause_of(drive.axis) == want,
        "homed": lambda want: bool(drive.axis.homed) == want,
        "refused": lambda want: refused(drive.axis) == want,
        "mode": lambda want: drive.mode.name == want,
        "position": lambda want: want[0] <= place <= want[1],
        "standstill": lambda want: bool(drive.axis.standstill) == want,
        "objects": lambda want: all(
            low <= drive.read(name) <= high for name, (low, high) in want.items()
        ),
    }
    return all(seen[name](want) for name, want in check.items())
