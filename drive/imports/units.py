"""Units of an imported drive: factor group, velocity unit and period of the set-points.

A file describes the objects, but often leaves their values to a commissioning tool: an encoder of
one increment, a factor of 0, no feed constant.
"""

from fractions import Fraction
from typing import Any

from ..kernel.factors.units import FRACTION_LIMIT
from .rows import FEED, GEAR, PERIOD, RESOLUTION, ObjectRows, held

_LONGEST_PERIOD = 0.1  # s; inferred: the cycle of a bus is shorter
_VELOCITY_UNIT, _VELOCITY_FACTOR, _REVOLUTIONS_PER_MINUTE = 0x60A9, 0x6096, 0xB447


def fit_factors(objects: ObjectRows, fixed: dict[str, Any]) -> bool:
    """Use the profile for objects of the factor group that are missing or 1 in the file.

    Args:
        objects: the rows, whose defaults can change.
        fixed: receives the factors that no object of the file holds.

    Returns:
        Whether velocities are in 1/min.
    """
    usual = int(objects.base.objects[RESOLUTION, 1].default)
    increments, turns = objects.default(RESOLUTION, 1), objects.default(RESOLUTION, 2)
    if increments is not None and increments <= 1:
        objects.replace_default(RESOLUTION, 1, usual, "no encoder has one increment")
        increments = usual
    increments, turns = increments or usual, turns or 1
    in_rpm = _velocity_unit(objects, fixed, increments)
    feed, per = objects.default(FEED, 1), objects.default(FEED, 2)
    if feed is None:
        fixed["feed_constant"] = [increments, turns]
        feed, per = increments, turns
    elif feed <= 1 and (per or 1) == 1:
        objects.replace_default(FEED, 1, increments, "a position unit is then an increment")
        feed = increments
    gear = objects.default(GEAR, 1) or 1, objects.default(GEAR, 2) or 1
    if (FEED, 2) not in objects.rows and (FEED, 1) in objects.rows:
        per = 1
    fraction = Fraction(turns, increments) * Fraction(gear[1], gear[0])
    fraction *= Fraction(feed, per or 1)
    too_long = max(fraction.numerator, fraction.denominator) > FRACTION_LIMIT
    if too_long and (FEED, 1) in objects.rows:
        why = "the factors together would be no exact fraction"
        objects.replace_default(FEED, 1, increments, why)
    return in_rpm


def _velocity_unit(objects: ObjectRows, fixed: dict[str, Any], increments: int) -> bool:
    """Read the velocity unit from 60A9h: whether it is 1/min with a power of ten (CiA 303-2)."""
    unit = objects.default(_VELOCITY_UNIT, 0) or 0
    power = (unit >> 24 ^ 0x80) - 0x80  # a signed byte
    if unit >> 8 & 0xFFFF != _REVOLUTIONS_PER_MINUTE or not -6 <= power <= 0:
        return False
    # position units are increments here, where the file says nothing else
    factor = increments, 60 * 10**-power
    if (_VELOCITY_FACTOR, 1) not in objects.rows:
        fixed["velocity_factor"] = [*factor]
    elif objects.default(_VELOCITY_FACTOR, 1) == objects.default(_VELOCITY_FACTOR, 2) == 1:
        for subindex, value in enumerate(factor, 1):
            objects.replace_default(_VELOCITY_FACTOR, subindex, value, "60A9h says 1/min")
    else:
        return False
    return True


def fit_period(objects: ObjectRows) -> None:
    """Use the profile for a period of the set-points (60C2h) that no master uses."""
    value, index = objects.default(PERIOD, 1), objects.default(PERIOD, 2)
    if value is None or index is None:
        return
    if not (objects.rows[PERIOD, 1]["field"] and objects.rows[PERIOD, 2]["field"]):
        return  # of another type: nothing follows from it
    index = held(index, "INTEGER8")
    if index <= 0 and value * 10.0**index <= _LONGEST_PERIOD:
        return
    for subindex in (1, 2):
        usual = int(objects.base.objects[PERIOD, subindex].default)
        if (value, index)[subindex - 1] != usual:
            objects.replace_default(
                PERIOD, subindex, usual, f"no master sends set-points every {value}e{index} s"
            )
