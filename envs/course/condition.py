"""Conditions on a drive at one instant, as the files of exercises state them.

A condition is a table of these keys, all of which have to hold at once:

| key | value | holds when |
|---|---|---|
| ``state`` | name, or a list of them | device control is in that state |
| ``command`` | name | the controlword gives that command |
| ``mode`` | name | 6061h shows that mode |
| ``fault`` | cause, "" for none | that cause has stopped the drive |
| ``refused`` | command | that command was refused since the step began |
| ``homed`` | true or false | the axis has a reference |
| ``homing`` | method, or a list | that homing method is being carried out, 0 for none |
| ``moving`` | true or false | the axis moves (606Fh) |
| ``position``, ``velocity`` | two numbers | mm and mm/s, or ° and °/s, lie between them |
| ``torque`` | two numbers | the torque (per mille of rated) lies between them |
| ``peak_torque`` | two numbers | its largest magnitude since the step began lies between them |
| ``following_error`` | two numbers | 60F4h (mm or °) lies between them |
| ``written`` | name, or a list | one of these objects has just changed its value |
| ``objects`` | table of two numbers each | the values of these objects lie between them |
| ``unless`` | a condition | that one does not hold |
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from ...drive.kernel.faults import Cause
from ...drive.kernel.words import Command, Mode, State
from ...drive.model.names import hint


@dataclass(slots=True)
class Look:
    """A drive at one instant.

    Args:
        time: of the machine (s).
        state, command, mode, fault, refused: names, empty for none.
        homed, moving: whether the axis has a reference, and whether it moves.
        homing: homing method that is being carried out, 0 for none.
        position, velocity, following_error: values in mm and mm/s, or ° and °/s.
        torque, peak_torque: values in per mille of the rated torque.
        written: objects whose values have changed since the previous look.
        values: values of all parameters by name (drive units).
    """

    time: float
    state: str
    command: str
    mode: str
    fault: str
    refused: str
    homed: bool
    homing: int
    moving: bool
    position: float
    velocity: float
    torque: float
    peak_torque: float
    following_error: float
    written: frozenset[str]
    values: Mapping[str, float]


def _named(known: Mapping[str, Any]) -> Callable[[str, Any], str]:
    def check(key: str, value: Any) -> str:
        for name in value if isinstance(value, list) else [value]:
            if name not in known:
                return f"{key} = {name!r}: {hint(str(name), known)}"
        return ""

    return check


def _truth(key: str, value: Any) -> str:
    return "" if isinstance(value, bool) else f"{key} = {value!r}: use true or false"


def _whole(key: str, value: Any) -> str:
    whole = all(isinstance(each, int) and not isinstance(each, bool) for each in any_of(value))
    return "" if whole else f"{key} = {value!r} is not a whole number"


def _condition(key: str, value: Any) -> str:
    try:
        check(value)
    except ValueError as error:
        return f"{key}: {error}"
    return ""


def _range(key: str, value: Any) -> str:
    fine = (
        isinstance(value, list)
        and len(value) == 2
        and all(isinstance(end, int | float) and not math.isnan(end) for end in value)
        and value[0] <= value[1]
    )
    return "" if fine else f"{key} = {value!r} is not a range of two numbers"


def _ranges(key: str, value: Any) -> str:
    if not isinstance(value, Mapping) or not value:
        return f"{key} = {value!r}: give ranges by name"
    return next(filter(None, (_range(f"{key}.{n}", pair) for n, pair in value.items())), "")


def _text(key: str, value: Any) -> str:
    names = value if isinstance(value, list) else [value]
    fine = names and all(isinstance(name, str) and name for name in names)
    return "" if fine else f"{key} = {value!r}: name objects"


def any_of(value: Any) -> list[Any]:
    """Return a list of one or several values."""
    return value if isinstance(value, list) else [value]


def _within(number: float, pair: list[float]) -> bool:
    return pair[0] <= number <= pair[1]


CAUSES = {"": None} | {cause.name.lower(): cause for cause in Cause if cause}

# key: the check of its value, which returns an error or "", and whether it holds at a look
KEYS: dict[str, tuple[Callable[[str, Any], str], Callable[[Look, Any], bool]]] = {
    "state": (_named(State.__members__), lambda look, want: look.state in any_of(want)),
    "command": (_named(Command.__members__), lambda look, want: look.command in any_of(want)),
    "mode": (_named(Mode.__members__), lambda look, want: look.mode in any_of(want)),
    "fault": (_named(CAUSES), lambda look, want: look.fault in any_of(want)),
    "refused": (_named(Command.__members__), lambda look, want: look.refused in any_of(want)),
    "homed": (_truth, lambda look, want: look.homed == want),
    "homing": (_whole, lambda look, want: look.homing in any_of(want)),
    "moving": (_truth, lambda look, want: look.moving == want),
    "position": (_range, lambda look, want: _within(look.position, want)),
    "velocity": (_range, lambda look, want: _within(look.velocity, want)),
    "torque": (_range, lambda look, want: _within(look.torque, want)),
    "peak_torque": (_range, lambda look, want: _within(look.peak_torque, want)),
    "following_error": (_range, lambda look, want: _within(look.following_error, want)),
    "written": (_text, lambda look, want: not look.written.isdisjoint(any_of(want))),
    "objects": (
        _ranges,
        lambda look, want: all(
            name in look.values and _within(look.values[name], pair) for name, pair in want.items()
        ),
    ),
    "unless": (_condition, lambda look, want: not holds(look, want)),
}


def check(table: Any) -> dict[str, Any]:
    """Check a condition of a file. Raises ValueError for a part that could never hold."""
    if not isinstance(table, Mapping) or not table:
        raise ValueError(f"{table!r} is not a condition: use {', '.join(KEYS)}")
    for key, value in table.items():
        if key not in KEYS:
            raise ValueError(f"{key} is unknown: {hint(str(key), KEYS)}")
        if wrong := KEYS[key][0](key, value):
            raise ValueError(wrong)
    return dict(table)


def holds(look: Look, condition: Mapping[str, Any]) -> bool:
    """Return whether a condition holds with all of its keys."""
    return all(KEYS[key][1](look, want) for key, want in condition.items())
