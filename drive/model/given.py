"""Checks of values and object names that a user gives."""

import functools
import math
import operator
from collections.abc import Iterable
from typing import Any, SupportsFloat

from .model import load, model_names
from .names import hint

PROFILE = "generic"  # it has most names, and loads fastest


def finite(name: str, value: Any) -> int | float:
    """A finite number. Raises ValueError naming a value that is none."""
    if not isinstance(value, SupportsFloat) or not math.isfinite(value):
        raise ValueError(f"{name} = {value!r} is not a finite number")
    return value if isinstance(value, int) else float(value)


def whole(name: str, value: Any, low: int, high: int, unit: str = "") -> int:
    """A whole number from `low` to `high`. Raises ValueError naming it, its range and unit."""
    try:
        number = operator.index(value)
    except TypeError:
        number = None
    if number is None or isinstance(value, bool) or not low <= number <= high:
        behind = f" ({unit})" if unit else ""
        raise ValueError(f"{name} = {value!r:.40} is not a whole number in {low}..{high}{behind}")
    return number


def octets(name: str, value: Any) -> bytes | bytearray | memoryview:
    """Bytes. Raises ValueError naming a value that is none."""
    if not isinstance(value, bytes | bytearray | memoryview):
        raise ValueError(f"{name} = {value!r:.40} are not bytes")
    return value


def refuse_unknown(name: str, known: Iterable[str]) -> None:
    """Raise ValueError with similar names for an object that no model of this package has."""
    if not _in_a_model(name):
        raise ValueError(f"no drive has the object {name!r}: {hint(name, known)}")


@functools.cache
def _in_a_model(name: str) -> bool:
    others = [each for each in model_names() if each != PROFILE]
    return any(name in load(each).names for each in (PROFILE, *others))
