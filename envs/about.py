"""What a task tells of itself: metrics of its own, and a sensor of the load."""

from typing import NamedTuple


class Metric(NamedTuple):
    """A row of the table of a comparison: what its values mean."""

    heading: str  # with unit
    better: str  # "high" or "low"; empty: neither
    what: str


class Sensor(NamedTuple):
    """Of the load of an axis, which the drive does not see: two observations, and what 1.0 is."""

    name: str  # of the observation of its deflection from the axis
    rate_name: str  # and of the rate of that
    deflection: float  # m
    rate: float  # m/s
