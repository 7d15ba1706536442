"""Descriptions that a task gives of itself: its own metrics, and a sensor at the load."""

import re
from typing import NamedTuple

METRES = re.compile(r"\((µ?)m(|/[^)]*)\)")  # a unit in a heading


class Metric(NamedTuple):
    """The description of a metric in the table of a comparison."""

    heading: str  # with unit
    better: str  # "high" or "low"; empty: neither
    what: str


def in_unit(heading: str, unit: str) -> str:
    """Return a heading for coordinates in `unit`: "m", "rad", or "m or rad".

    >>> in_unit("peak following error (µm)", "rad")
    'peak following error (µrad)'
    """

    def converted(found: re.Match[str]) -> str:
        return f"({' or '.join(found[1] + one + found[2] for one in unit.split(' or '))})"

    return METRES.sub(converted, heading)


class Sensor(NamedTuple):
    """Sensor at the load, which the drive does not read: two observations and their scales."""

    name: str  # observation of the deflection from the axis
    rate_name: str  # observation of the rate of the deflection
    deflection: float  # m, that is 1.0
    rate: float  # m/s, that is 1.0
