"""Exercises: TOML files that state the goals, their order, and known wrong approaches.

An exercise is a file::

    title = "Stop it the right way"
    about = "The subject of the exercise."
    unit = 1                            # of the course
    axis = "linear"                     # kind of machine

    [[wrong]]                           # an approach that is wrong in every step
    when = { written = "following_error_window" }
    say = "That hides the cause."

    [begin]                             # changes to a fresh machine, all optional
    positions = { x = 0.12 }            # m or rad
    write = { profile_velocity = 200000 }
    disturb = { cable_drag = 130 }      # N
    inject = ["overvoltage"]

    [[step]]
    text = "Enable the drive."
    hints = ["The transitions 2, 3 and 4.", "0006h, 0007h, 000Fh."]
    begin = { write = { max_torque = 1200 } }          # when the step begins
    goal = [{ command = "QUICK_STOP" }, { state = "SWITCH_ON_DISABLED" }]
    throughout = { mode = "PROFILE_POSITION" }         # has to hold during the step

    [step.predict]                                     # asked before the step counts
    question = "Where does it come to rest?"
    options = ["At once", "After its ramp"]
    answer = 1
    why = "605Ah = 2 slows down on the quick stop ramp."

    [[step.wrong]]                                     # a wrong approach
    when = { command = "DISABLE_VOLTAGE" }
    say = "0000h takes the power away: the axis coasts."

``goal`` is a list of conditions (`condition`) that have to hold one after the other; the step is
done when the last one holds. A wrong approach ends the exercise, which then begins again with a
fresh machine. It also ends when an object changes by which it is measured (units, polarity, home
offset, rated values, standstill), unless a goal names that object, or when the axis gets another
reference after the one that a goal asks for.
"""

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ...drive.model.files import content
from ...drive.model.names import hint
from ..engine.machine import Machine
from ..engine.parameters import PARAMETERS, Joint
from .condition import any_of, check

SHIPPED = Path(__file__).parent / "exercises"


# disturbances of an axis by name, and the parameters of the machine that they set
DISTURBANCES = {
    "cable_drag": "chain_drag",  # N or Nm
    "friction": "coulomb_friction",  # N or Nm
    "encoder_noise": "encoder_noise",  # m or rad
}


def disturb(machine: Machine, axis: str, name: str, value: float) -> None:
    """Set the size of a disturbance of an axis, a key of `DISTURBANCES`."""
    PARAMETERS[DISTURBANCES[name]].set(Joint(machine, axis), value)


@dataclass(frozen=True)
class Begin:
    """Changes to a machine at the beginning of an exercise or a step.

    Args:
        positions: positions of joints (m or rad) by drive, at which the power is switched on again.
        write: values of objects by name (drive units).
        inject: causes of faults.
        disturb: sizes of `DISTURBANCES` by name.
    """

    positions: Mapping[str, float] = field(default_factory=dict)
    write: Mapping[str, float] = field(default_factory=dict)
    inject: tuple[str, ...] = ()
    disturb: Mapping[str, float] = field(default_factory=dict)

    def act(self, machine: Machine, axis: str) -> None:
        """Apply the changes. Raises ValueError for anything that the machine cannot do."""
        if self.positions:
            machine.reset(positions=self.positions)
        drive = machine.drives[axis]
        for name, value in self.write.items():
            drive.commission({name: value})
        for cause in self.inject:
            drive.inject(cause)
        for name, value in self.disturb.items():
            disturb(machine, axis, name, value)


@dataclass(frozen=True)
class Prediction:
    """A question to be answered before the run shows the answer.

    Args:
        question: the question.
        options: possible answers.
        answer: number of the correct one, from 0.
        why: explanation, shown afterwards.
    """

    question: str
    options: tuple[str, ...]
    answer: int
    why: str


@dataclass(frozen=True)
class Step:
    """One step of an exercise.

    Args:
        text: the instruction.
        goal: conditions that have to hold one after the other.
        hints: hints, the vaguest first.
        throughout: condition that has to hold during the whole step, or empty.
        wrong: conditions that must never hold, each with a message.
        predict: question to be answered first, or None.
        begin: changes to the machine at the beginning.
    """

    text: str
    goal: tuple[dict[str, Any], ...]
    hints: tuple[str, ...] = ()
    throughout: Mapping[str, Any] = field(default_factory=dict)
    wrong: tuple[tuple[dict[str, Any], str], ...] = ()
    predict: Prediction | None = None
    begin: Begin = Begin()


@dataclass(frozen=True)
class Exercise:
    """An exercise of several steps.

    Args:
        name: name of its file, without the suffix.
        title, about: title and description.
        unit: unit of the course, 0 for none.
        axis: kind of machine, key of `servogym.envs.plants.catalogue.AXES`.
        begin: changes to a fresh machine.
        steps: the steps in their order.
    """

    name: str
    title: str
    about: str
    unit: int
    axis: str
    begin: Begin
    steps: tuple[Step, ...]

    @property
    def asked_for(self) -> set[str]:
        """Names of the objects in its goals."""
        return {
            name for step in self.steps for goal in step.goal
            for name in (*any_of(goal.get("written", [])), *goal.get("objects", ()))
        }


def load(path: str | Path) -> Exercise:
    """Read an exercise from a file.

    Raises:
        ValueError: an error in the file, with file, step and key.
    """
    path = Path(path)
    try:
        data = tomllib.loads(content(path, "an exercise").decode())
        _known(data, ("title", "about", "unit", "axis", "begin", "wrong", "step"), "")
        rows, wrong = _required(data, "step"), _wrong(data)
        if not isinstance(rows, list) or not rows:
            raise ValueError("it has no step: add [[step]]")
        return Exercise(
            path.stem, _text(data, "title"), str(data.get("about", "")), int(data.get("unit", 0)),
            str(data.get("axis", "linear")), _begin(data.get("begin", {})),
            tuple(_step(number, row, wrong) for number, row in enumerate(rows, 1)),
        )
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError, TypeError, ValueError) as error:
        raise ValueError(f"exercise {path}: {error}") from None


def load_all(folder: str | Path = SHIPPED) -> list[Exercise]:
    """Return the exercises of a folder by file name. Raises ValueError if there are none."""
    files = sorted(Path(folder).glob("*.toml"))
    if not files:
        raise ValueError(f"--lessons {folder}: there is no .toml file in it")
    return [load(file) for file in files]


def named(name: str, folder: str | Path = SHIPPED) -> Exercise:
    """Return an exercise by its name or its path. Raises ValueError if it does not exist."""
    if name.endswith(".toml"):
        return load(name)
    known = {path.stem: path for path in sorted(Path(folder).glob("*.toml"))}
    if name not in known:
        raise ValueError(f"there is no exercise {name!r}: {hint(name, known)}")
    return load(known[name])


def _wrong(row: Mapping[str, Any]) -> tuple[tuple[dict[str, Any], str], ...]:
    """Read the wrong approaches of an exercise or a step."""
    rows = row.get("wrong", [])
    for each in rows:
        _known(each, ("when", "say"), "wrong: ")
    return tuple((check(_required(each, "when")), _text(each, "say")) for each in rows)


def _step(number: int, row: Any, wrong: tuple[tuple[dict[str, Any], str], ...]) -> Step:
    try:
        known = ("text", "goal", "hints", "throughout", "wrong", "predict", "begin")
        _known(row, known, "step: ")
        goal = _required(row, "goal")
        if not isinstance(goal, list) or not goal:
            raise ValueError("goal: give at least one condition")
        hints = row.get("hints", [])
        if not isinstance(hints, list) or not all(isinstance(hint, str) for hint in hints):
            raise ValueError(f"hints = {hints!r}: give a list of sentences")
        return Step(
            _text(row, "text"), tuple(check(each) for each in goal), tuple(hints),
            check(row["throughout"]) if "throughout" in row else {}, (*_wrong(row), *wrong),
            _prediction(row["predict"]) if "predict" in row else None, _begin(row.get("begin", {})),
        )
    except (TypeError, ValueError) as error:
        raise ValueError(f"step {number}: {error}") from None


def _prediction(row: Any) -> Prediction:
    _known(row, ("question", "options", "answer", "why"), "predict: ")
    options, answer = _required(row, "options"), _required(row, "answer")
    if not isinstance(options, list) or len(options) < 2:
        raise ValueError("predict: give at least two options")
    if not isinstance(answer, int) or not 0 <= answer < len(options):
        raise ValueError(f"predict: answer = {answer!r} is out of range 0..{len(options) - 1}")
    return Prediction(_text(row, "question"), tuple(map(str, options)), answer, _text(row, "why"))


def _begin(row: Any) -> Begin:
    _known(row, ("positions", "write", "inject", "disturb"), "begin: ")
    for name in row.get("disturb", {}):
        if name not in DISTURBANCES:
            raise ValueError(f"disturb {name!r}: {hint(str(name), DISTURBANCES)}")
    return Begin(
        dict(row.get("positions", {})), dict(row.get("write", {})), tuple(row.get("inject", ())),
        dict(row.get("disturb", {})),
    )


def _known(row: Any, names: tuple[str, ...], where: str) -> None:
    if not isinstance(row, Mapping):
        raise ValueError(f"{where}{row!r} is not a table")
    for name in row:
        if name not in names:
            raise ValueError(f"{where}{name} is unknown: {hint(str(name), names)}")


def _required(row: Mapping[str, Any], name: str) -> Any:
    if name not in row:
        raise ValueError(f"{name!r} is missing")
    return row[name]


def _text(row: Mapping[str, Any], name: str) -> str:
    text = _required(row, name)
    if not isinstance(text, str) or not text.strip():
        raise ValueError(f"{name} = {text!r}: write a sentence")
    return text
