"""Profiles against closed forms, against ruckig, and against their own limits."""

import math

import numba
import numpy as np
import pytest
import ruckig
from hypothesis import example, given, settings
from hypothesis import strategies as st

from servogym.drive import ramps, record

PERIOD = 5e-4


@numba.njit
def _plan(axis, target, speed, end, acceleration, deceleration, jerk):
    ramps.plan_position(axis, target, speed, end, acceleration, deceleration, jerk)
    return ramps.duration(axis)


@numba.njit
def _plan_speed(axis, velocity, acceleration, deceleration, jerk):
    ramps.plan_velocity(axis, velocity, acceleration, deceleration, jerk)
    return ramps.duration(axis)


def plan(*arguments):
    *others, jerk = arguments
    return _plan(*others, jerk if isinstance(jerk, tuple) else (jerk,) * 4)


def plan_speed(*arguments):
    *others, jerk = arguments
    return _plan_speed(*others, (jerk,) * 4)


@numba.njit
def travel(axis, cycles, out):
    for i in range(cycles):
        ramps.advance(axis)
        out[i, 0] = axis.position_demand
        out[i, 1] = axis.velocity_demand
        out[i, 2] = axis.acceleration_demand


def axis_at(position=0.0, velocity=0.0, acceleration=0.0):
    axis = record.make(1)[0]
    axis.position_period = PERIOD
    axis.position_demand = position
    axis.velocity_demand = velocity
    axis.acceleration_demand = acceleration
    return axis


def travelled(axis, time):
    out = np.empty((math.ceil(time / PERIOD) + 3, 3))
    travel(axis, len(out), out)
    return out


def trapezoid_time(distance, speed, acceleration, deceleration):
    """Closed form, rest to rest."""
    peak = min(
        speed, math.sqrt(2 * distance * acceleration * deceleration / (acceleration + deceleration))
    )
    ramps_ = peak * peak / 2 * (1 / acceleration + 1 / deceleration)
    return peak / acceleration + peak / deceleration + (distance - ramps_) / peak


def jerk_limited_time(distance, speed, acceleration, jerk):
    """Closed form of the symmetric seven-segment profile, rest to rest."""

    def ramp(v):
        if v * jerk >= acceleration**2:
            return v / acceleration + acceleration / jerk
        return 2 * math.sqrt(v / jerk)

    if speed * ramp(speed) <= distance:
        return ramp(speed) + distance / speed
    low, high = 0.0, speed
    for _ in range(200):
        middle = (low + high) / 2
        low, high = (middle, high) if middle * ramp(middle) < distance else (low, middle)
    return 2 * ramp(high)


positive = st.floats(0.5, 500.0)
distances = st.floats(1e-4, 200.0)


@given(distances, positive, positive, positive)
def test_trapezoid_from_rest_takes_the_closed_form_time(distance, speed, up, down):
    time = plan(axis_at(), distance, speed, 0.0, up, down, 0.0)
    assert time == pytest.approx(trapezoid_time(distance, speed, up, down), rel=1e-9)


@given(distances, positive, positive, st.floats(50.0, 1e5))
def test_jerk_limited_from_rest_takes_the_closed_form_time(distance, speed, acceleration, jerk):
    time = plan(axis_at(), distance, speed, 0.0, acceleration, acceleration, jerk)
    assert time == pytest.approx(
        jerk_limited_time(distance, speed, acceleration, jerk), rel=1e-8, abs=1e-12
    )


def ruckig_time(distance, velocity, acceleration, speed, limit, jerk):
    wanted = ruckig.InputParameter(1)
    wanted.current_velocity = [velocity]
    wanted.current_acceleration = [acceleration]
    wanted.target_position = [distance]
    wanted.max_velocity, wanted.max_acceleration, wanted.max_jerk = [speed], [limit], [jerk]
    trajectory = ruckig.Trajectory(1)
    result = ruckig.Ruckig(1).calculate(wanted, trajectory)
    assert result in (ruckig.Result.Working, ruckig.Result.Finished)
    return trajectory.duration


@given(distances, positive, positive, st.floats(50.0, 1e5))
def test_from_rest_no_time_is_lost_against_ruckig(distance, speed, acceleration, jerk):
    own = plan(axis_at(), distance, speed, 0.0, acceleration, acceleration, jerk)
    best = ruckig_time(distance, 0.0, 0.0, speed, acceleration, jerk)
    assert own == pytest.approx(best, rel=1e-6, abs=1e-9)


@given(st.floats(-50, 50), st.floats(-1, 1), st.floats(0.5, 60))
def test_in_motion_it_is_never_faster_than_ruckig_and_at_most_two_fifths_slower(d, share, speed):
    v = share * speed
    limit, jerk = 300.0, 20_000.0
    own = plan(axis_at(0.0, v, 0.0), d, speed, 0.0, limit, limit, jerk)
    best = ruckig_time(d, v, 0.0, speed, limit, jerk)
    assert own >= best - 1e-6
    assert own <= 1.4 * best + 0.02


def check_limits(v0, a0, target, speed, end, up, down, jerk):
    """No sample leaves the limits, but for what the initial state forces, and the target is hit."""
    axis = axis_at(0.0, v0, a0)
    time = plan(axis, target, speed, end, up, down, jerk)
    assert math.isfinite(time)
    assert time >= 0
    out = travelled(axis, min(time, 50.0))
    position, velocity, acceleration = out.T
    forced = a0 * a0 / (2 * min(jerk)) if jerk[0] else 0.0
    assert np.abs(velocity).max() <= max(speed, abs(v0) + forced) + 1e-6
    top = max(up, down, abs(a0) if jerk[0] else 0.0)
    assert np.abs(acceleration).max() <= top * (1 + 1e-9) + 1e-6
    steps = np.diff(np.concatenate(([v0], velocity)))
    assert np.abs(steps).max() <= top * PERIOD + 1e-6
    if jerk[0]:
        bends = np.diff(np.concatenate(([a0], acceleration)))
        assert np.abs(bends).max() <= max(jerk) * PERIOD * (1 + 1e-9) + 1e-6
    moves = np.diff(np.concatenate(([0.0], position)))
    assert np.abs(moves).max() <= max(speed, abs(v0) + forced) * PERIOD + 1e-6
    if time <= 50.0:
        assert axis.profile_done
        assert abs(abs(velocity[-1]) - min(end, speed)) < 1e-6
        if end == 0.0:
            assert position[-1] == target


CASES = {
    "v0": st.floats(-100, 100),
    "a0": st.floats(-500, 500),
    "target": st.floats(-500, 500),
    "speed": st.floats(0.5, 100),
    "end": st.just(0.0) | st.floats(0, 20),
    "up": st.floats(5, 1000),
    "down": st.floats(5, 1000),
    "jerk": st.just((0.0,) * 4) | st.tuples(*[st.floats(100, 1e5)] * 4),
}


@given(**CASES)
@example(v0=0.0, a0=0.0, target=0.0, speed=1.0, end=0.0, up=5.0, down=5.0, jerk=(0.0,) * 4)
@example(
    v0=50.0, a0=-500.0, target=0.0, speed=0.5, end=20.0, up=5.0, down=1000.0, jerk=(100.0,) * 4
)
def test_limits_hold_from_any_state_and_the_target_is_hit(**case):
    check_limits(**case)


@pytest.mark.slow
def test_limits_hold_long():
    settings(settings.get_profile("long"))(given(**CASES)(check_limits))()


@given(st.floats(-100, 100), st.floats(-400, 400), st.floats(-100, 100), st.floats(100, 1e5))
def test_velocity_ramp_ends_at_its_velocity_without_a_jump(v0, a0, v1, jerk):
    axis = axis_at(0.0, v0, a0)
    time = plan_speed(axis, v1, 200.0, 400.0, jerk)
    out = travelled(axis, time)
    assert out[-1, 1] == v1
    assert out[-1, 2] == 0.0
    assert np.abs(np.diff(out[:, 1])).max() <= max(400.0, abs(a0)) * PERIOD + 1e-9
    assert np.abs(np.diff(np.concatenate(([a0], out[:, 2])))).max() <= jerk * PERIOD + 1e-6


def test_each_phase_of_a_move_has_a_jerk_of_its_own():
    jerk = (1000.0, 2000.0, 3000.0, 4000.0)  # begin of acceleration and deceleration, end of them
    axis = axis_at()
    time = plan(axis, 100.0, 20.0, 0.0, 100.0, 200.0, jerk)
    assert axis.segment_jerk[: axis.segments].tolist() == [1000, 0, -3000, 0, -2000, 0, 4000]
    expected = [0.1, 20 / 100 - (0.1 + 1 / 30) / 2, 1 / 30]
    expected += [0.1, 20 / 200 - (0.1 + 0.05) / 2, 0.05]
    got = axis.segment_duration[: axis.segments].tolist()
    assert got[:3] + got[4:] == pytest.approx(expected)
    assert travelled(axis, time)[-1].tolist() == [100.0, 0.0, 0.0]


def test_speed_and_slowing_down_have_rates_of_their_own():
    axis = axis_at(0.0, 10.0)
    assert plan_speed(axis, -5.0, 20.0, 50.0, 0.0) == pytest.approx(10 / 50 + 5 / 20)


def test_the_demand_is_the_closed_form_at_every_cycle():
    axis = axis_at()
    time = plan(axis, 20.0, 30.0, 0.0, 400.0, 200.0, 0.0)
    out = travelled(axis, time)
    t = PERIOD * np.arange(1, len(out) + 1)
    peak = 30.0
    up, down = peak / 400, peak / 200
    expected = np.where(
        t < up,
        200 * t**2,
        np.where(t < time - down, 200 * up**2 + peak * (t - up), 20 - 100 * (time - t) ** 2),
    )
    expected[t >= time] = 20.0
    np.testing.assert_allclose(out[:, 0], expected, atol=1e-9)


def test_an_end_velocity_is_reached_at_the_target_and_kept():
    axis = axis_at()
    time = plan(axis, 5.0, 20.0, 8.0, 400.0, 400.0, 0.0)
    out = travelled(axis, time)
    index = int(time / PERIOD)
    assert out[index, 1] == pytest.approx(8.0)
    assert out[index, 0] == pytest.approx(5.0 + 8.0 * (PERIOD * (index + 1) - time))
