"""A rotary axis (607Bh): which way a target is reached, against whole-number arithmetic."""

import math

import numpy as np
import pytest

from conftest import Shaft
from servogym.drive.kernel import jit, limits, record

UNIT = 2 * math.pi / 1_048_576  # rad
WITHIN, NEGATIVE, POSITIVE, SHORTEST = range(4)  # 60F2h bits 6-7


def way(shown, goal, size, option):
    """Position units to go from `shown` to `goal`, places of one turn of `size` units.

    CiA 402-2, 60F2h: within the range as on a line; in one direction only; the shorter way, of two
    equal ones either.
    """
    straight = goal - shown
    if option == WITHIN:
        return (straight,)
    forward = straight % size
    if option == POSITIVE:
        return (forward,)
    if option == NEGATIVE:
        return (forward - size if forward else 0,)
    if 2 * forward == size:
        return forward, forward - size
    return (forward if 2 * forward < size else forward - size,)


@jit.block
def nearest(axis, demand, target, option):
    axis.position_demand = demand
    return limits.nearest_turn(axis, target, option)


@pytest.mark.parametrize("option", range(4))
def test_a_target_on_a_turn_is_reached_by_the_way_60f2h_says(option):
    random = np.random.default_rng(option)
    axis = record.make(1)[0]
    axis.rad_per_position_unit = UNIT
    for case in range(200 if jit.DISABLED else 5_000):
        size = int(10 ** random.uniform(0.5, 7))
        low = int(random.integers(-size, size))
        turns = int(random.integers(-200, 200))
        shown = int(random.integers(low, low + size))
        if case % 5 == 0:  # the borders, where rounding could make a turn of its own
            shown = low + (case // 5 % 2) * (size - 1)
        goal = shown if case % 3 == 0 else int(random.integers(low, low + size))
        axis.range, axis.range_min = size * UNIT, low * UNIT
        demand = (shown + turns * size) * UNIT
        got = (nearest(axis, demand, goal * UNIT, option) - demand) / UNIT
        assert min(abs(got - w) for w in way(shown, goal, size, option)) < 0.01, (
            f"{shown} -> {goal} of {size}: {got}"
        )


@pytest.mark.parametrize(
    ("option", "targets", "ends"),
    [
        (WITHIN, (900_000, 100_000), (900_000, 100_000)),
        (NEGATIVE, (900_000, 100_000, 100_000), (-100_000, -900_000, -900_000)),
        (POSITIVE, (900_000, 100_000, 100_000), (900_000, 1_100_000, 1_100_000)),
        (SHORTEST, (900_000, 100_000, 500_000), (-100_000, 100_000, 500_000)),
    ],
)
def test_moves_on_a_turn_of_a_million_units_end_where_the_table_says(option, targets, ends):
    shaft = Shaft()
    shaft.write(
        min_position_range_limit=0, max_position_range_limit=1_000_000,
        positioning_option_code=option << 6, profile_velocity=20_000_000,
        profile_acceleration=200_000_000, profile_deceleration=200_000_000,
        following_error_window=0xFFFFFFFF,
    )
    shaft.enable(1)
    for target, end in zip(targets, ends, strict=True):
        shaft.write(target_position=target)
        shaft.control(0x1F)
        shaft.control(0x0F)
        shaft.until(lambda: shaft.axis.set_points == 0)
        assert shaft.axis.position_demand / UNIT == pytest.approx(end, abs=0.01)
        assert shaft.read("position_demand_value") == target
