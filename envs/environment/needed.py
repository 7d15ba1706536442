"""The attributes that a task has to define, and the messages if one is missing or wrong."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from ...drive.model.model import DriveModel
from ..engine.checks import misfit
from ..engine.machine import Machine
from ..exchange.batch import JUDGED_NAMES


class Requirement(NamedTuple):
    """A required attribute: its meaning, and a check of its value."""

    what: str
    fits: Callable[[Any], bool]


def _texts(value: Any) -> bool:
    return isinstance(value, tuple | list) and all(isinstance(text, str) for text in value)


def _numbers(kind: str) -> Callable[[Any], bool]:
    """Return a check for a record, possibly nested, whose numbers all have one type."""

    def fits(value: Any) -> bool:
        return isinstance(value, np.dtype) and bool(value.names) and all(map(leaf, _parts(value)))

    def leaf(part: np.dtype) -> bool:
        return fits(part) if part.names else part == np.dtype(kind)

    return fits


def _parts(record: np.dtype) -> list[np.dtype]:
    return [record[name].base for name in record.names or ()]


def _episode(value: Any) -> bool:
    return isinstance(value, np.dtype) and {*JUDGED_NAMES} <= {*(value.names or ())}


def _takes_one(value: Any) -> bool:
    return callable(value) and not misfit(value, None)


NEEDED = {
    "ID": Requirement(
        "its id in the registry of Gymnasium, such as 'mylab/Nudge-v0'",
        lambda value: isinstance(value, str),
    ),
    "RPDO": Requirement("a tuple of the names of the objects that the agent commands", _texts),
    "TPDO": Requirement("a tuple of the names of the objects that the agent sees", _texts),
    "DRIVES": Requirement("a tuple of the names of the drives that the agent commands", _texts),
    "ACTION": Requirement("a record made by servogym.envs.action", _numbers("f8")),
    "OBSERVATION": Requirement("a record made by servogym.envs.observation", _numbers("f4")),
    "EPISODE": Requirement("a record made by servogym.envs.episode", _episode),
    "STEPS": Requirement(
        "the number of steps of an episode, a whole number from 1 on",
        lambda value: type(value) is int and value >= 1,
    ),
    "act": Requirement("a compiled function (episode, action, rpdos)", callable),
    "judge": Requirement("a compiled function (episode, rpdos, tpdos, observation)", callable),
    "_make": Requirement("a method (model) that builds the machine", _takes_one),
    "_begin": Requirement("a method (options) that begins an episode", _takes_one),
}


def check(task: Any, base: type) -> None:
    """Raise ValueError naming a missing or wrong attribute of a task, and the remedy.

    Args:
        task: an environment; some attributes may depend on its arguments.
        base: base class of all tasks; an attribute defined only there is missing.
    """
    name = type(task).__name__
    for attribute, need in NEEDED.items():
        value = getattr(task, attribute, None)
        own = vars(task).get(attribute, getattr(type(task), attribute, None))
        if own is None or (callable(own) and own is getattr(base, attribute, None)):
            raise ValueError(f"task {name} lacks {attribute}: give it {need.what}")
        if not need.fits(value):
            raise ValueError(f"task {name}: {attribute} = {own!r:.80}: give it {need.what}")


def check_modes(task: Any, model: DriveModel) -> None:
    """Raise ValueError if the drive model lacks a mode of the task."""
    for mode in task.MODES:
        if mode not in model.modes:
            raise ValueError(
                f"drive {model.name!r} has no mode {mode.name.lower()}, which this task needs: "
                f"it has {', '.join(each.name.lower() for each in model.modes)}"
            )


def built(task: Any, machine: Any) -> Machine:
    """Check the result of ``_make`` of a task. Raises ValueError if it is not a machine."""
    if not isinstance(machine, Machine):
        raise ValueError(
            f"task {type(task).__name__}: _make returned {machine!r:.80}: return the machine, as "
            "linear_axis(model) makes one"
        )
    return machine
