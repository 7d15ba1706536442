"""Values that a user gives for objects by name."""

import functools
import math
from collections.abc import Iterable
from typing import Any, SupportsFloat

from .model import load, model_names
from .near import near

PROFILE = "generic"  # most names are there, and it is the smallest


def finite(name: str, value: Any) -> int | float:
    """A number. Raises ValueError for what is none, naming it."""
    if not isinstance(value, SupportsFloat) or not math.isfinite(value):
        raise ValueError(f"{name} = {value!r} is no finite number")
    return value if isinstance(value, int) else float(value)


def refuse_unknown(name: str, known: Iterable[str]) -> None:
    """Raise ValueError, with near names of those `known`, for one that is in no model of ours."""
    if not _in_a_model(name):
        raise ValueError(f"no drive has the object {name!r}: {near(name, known)}")


@functools.cache
def _in_a_model(name: str) -> bool:
    others = [each for each in model_names() if each != PROFILE]
    return any(name in load(each).names for each in (PROFILE, *others))
