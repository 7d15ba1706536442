"""What a task tells of itself: metrics of its own, and a sensor of the load."""

import re
from typing import NamedTuple

METRES = re.compile(r"\((µ?)m(|/[^)]*)\)")  # a unit in a heading


class Metric(NamedTuple):
    """A row of the table of a comparison: what its values mean."""

    heading: str  # with unit
    better: str  # "high" or "low"; empty: neither
    what: str


def in_unit(heading: str, unit: str) -> str:
    """A heading for coordinates in `unit`: "m", "rad", or "m or rad".

    >>> in_unit("peak following error (µm)", "rad")
    'peak following error (µrad)'
    """

    def converted(found: re.Match[str]) -> str:
        return f"({' or '.join(found[1] + one + found[2] for one in unit.split(' or '))})"

    return METRES.sub(converted, heading)


class Sensor(NamedTuple):
    """Sensor at the load, which the drive does not read: two observations and their scales."""

    name: str  # of the observation of its deflection from the axis
    rate_name: str  # and of the rate of that
    deflection: float  # m
    rate: float  # m/s
