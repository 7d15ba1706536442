"""Arguments of a user: what is wrong is told with name, value, range and unit."""

import math
import os

THREADS = "SERVOGYM_THREADS"  # what an executor grants a worker


def in_range(name: str, value: float, low: float, high: float, unit: str) -> float:
    """`value` as a float. Raises ValueError naming it, its range and its unit."""
    try:
        number = float(value)
    except (TypeError, ValueError):
        number = math.nan
    if not low <= number <= high:
        raise ValueError(f"{name} = {value!r} is out of range {low:g}..{high:g} {unit}")
    return number


def whole(name: str, value: float, low: int, high: int) -> int:
    """`value` as an int. Raises ValueError naming it and its range."""
    try:
        number = int(value)
    except (TypeError, ValueError, OverflowError):
        number = low - 1
    if number != value or not low <= number <= high:
        raise ValueError(f"{name} = {value!r} must be a whole number {low}..{high}")
    return number


def cores() -> int:
    """Of this machine, those that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def threads() -> int:
    """How many a vector takes where it is not told: what is granted, else one a core."""
    granted = os.environ.get(THREADS, "")
    return max(int(granted), 1) if granted.isdigit() else cores()
