"""Setpoint generators: one profile of constant-jerk segments for moves, ramps and stops.

A profile starts from the present demand (position, velocity, acceleration), whatever it is, and is
travelled in closed form, so it ends exactly where and when planned. Without jerk limit a segment
has constant acceleration (trapezoid); with it a velocity change takes up to three segments.
A move is: ramp to a cruising velocity, cruise, ramp to the end velocity. The cruising velocity is
the one at which the two ramps cover the distance; it is found by bisection, because the distance is
continuous in it, and capped at the profile velocity. That is time-optimal from standstill.
"""

import math

from .cascade import Control
from .jit import block

BISECTIONS = 200  # ends earlier, when the interval no longer shrinks
# begin of acceleration, begin of deceleration, end of acceleration, end of deceleration: the order
# of 60A4h
NO_JERK_LIMIT = (0.0, 0.0, 0.0, 0.0)


@block
def profile_jerk(axis):
    """The jerk limits of the profile (rad/s³), all 0 for a trapezoid."""
    return axis.jerk[0], axis.jerk[1], axis.jerk[2], axis.jerk[3]


@block
def _append(axis, n, duration, acceleration, jerk):
    if duration > 0.0:
        axis.segment_duration[n] = duration
        axis.segment_acceleration[n] = acceleration
        axis.segment_jerk[n] = jerk
        return n + 1
    return n


@block
def _s_ramp(axis, n, v0, a0, v1, rate, begin, end):
    """Up to three segments from (v0, a0) to (v1, 0); -> (n, distance).

    `rate` limits the acceleration, the jerks `begin` its growth and `end` its decay; the two are
    the same where a0 is not 0.
    """
    release = v0 + a0 * abs(a0) / (2 * end)  # velocity where a0 would be gone
    sign = 1.0 if v1 >= release else -1.0
    change, b0 = sign * (v1 - v0), sign * a0
    peak = min(math.sqrt(max((2 * begin * change + b0 * b0) * end / (begin + end), 0.0)), rate)
    t1 = abs(peak - b0) / begin
    t3 = peak / end
    rest = change - (peak + b0) / 2 * t1 - peak / 2 * t3
    t2 = rest / peak if rest > 0 and peak > 0 else 0.0
    j1 = sign * begin if peak >= b0 else -sign * begin
    top = sign * peak
    n = _append(axis, n, t1, a0, j1)
    n = _append(axis, n, t2, top, 0.0)
    n = _append(axis, n, t3, top, -sign * end)
    distance = v0 * t1 + a0 * t1 * t1 / 2 + j1 * t1 * t1 * t1 / 6
    v = v0 + (a0 + top) / 2 * t1
    distance += v * t2 + top * t2 * t2 / 2
    v += top * t2
    distance += v * t3 + top * t3 * t3 / 3
    return n, distance


@block
def _ramp_same_sign(axis, n, v0, a0, v1, acceleration, deceleration, jerk):
    rate = acceleration if abs(v1) > abs(v0) else deceleration
    if jerk[0] > 0.0:
        begin, end = (jerk[0], jerk[2]) if abs(v1) > abs(v0) else (jerk[1], jerk[3])
        if a0 != 0.0:  # the gentlest of all: keeps the distance continuous in v1
            rate = min(acceleration, deceleration)
            begin = end = min(jerk)
        return _s_ramp(axis, n, v0, a0, v1, rate, begin, end)
    duration = abs(v1 - v0) / rate
    n = _append(axis, n, duration, rate if v1 > v0 else -rate, 0.0)
    return n, (v0 + v1) / 2 * duration


@block
def _ramp(axis, n, v0, a0, v1, acceleration, deceleration, jerk):
    """Append a change of velocity from (v0, a0) to (v1, 0); -> (n, distance).

    `acceleration` limits growing, `deceleration` shrinking speed, so a reversal is two ramps.
    """
    if v0 * v1 < 0.0:
        n, first = _ramp_same_sign(axis, n, v0, a0, 0.0, acceleration, deceleration, jerk)
        n, second = _ramp_same_sign(axis, n, 0.0, 0.0, v1, acceleration, deceleration, jerk)
        return n, first + second
    return _ramp_same_sign(axis, n, v0, a0, v1, acceleration, deceleration, jerk)


@block
def _begin(axis, n, end_velocity):
    axis.segments = n
    axis.segment = 0
    axis.segment_time = 0.0
    axis.segment_position = axis.position_demand
    axis.segment_velocity = axis.velocity_demand
    axis.profile_end_velocity = end_velocity
    axis.profile_done = 0


@block
def plan_velocity(axis, velocity, acceleration, deceleration, jerk):
    """Plan a change of the demand velocity to `velocity` (rad/s); `jerk`: as `profile_jerk`."""
    a0 = axis.acceleration_demand if jerk[0] > 0.0 else 0.0
    n, _ = _ramp(axis, 0, axis.velocity_demand, a0, velocity, acceleration, deceleration, jerk)
    axis.profile_to_position = 0
    _begin(axis, n, velocity)


@block
def _plan_over(axis, cruise, end, acceleration, deceleration, jerk):
    """Ramps to `cruise` and on to `end`; -> (segments of the first, of both, distance of both)."""
    a0 = axis.acceleration_demand if jerk[0] > 0.0 else 0.0
    first, before = _ramp(
        axis, 0, axis.velocity_demand, a0, cruise, acceleration, deceleration, jerk
    )
    both, after = _ramp(axis, first, cruise, 0.0, end, acceleration, deceleration, jerk)
    return first, both, before + after


@block
def plan_position(axis, target, speed, end_speed, acceleration, deceleration, jerk):
    """Plan a move of the demand to `target` (rad) at up to `speed` (rad/s).

    The target is passed at `end_speed` in the direction of the move. All limits are magnitudes,
    `jerk` is four of them as `profile_jerk` gives.
    """
    distance = target - axis.position_demand
    end = math.copysign(min(end_speed, speed), distance)
    low, high = -speed, speed
    if _plan_over(axis, high, end, acceleration, deceleration, jerk)[2] <= distance:
        cruise = high
    elif _plan_over(axis, low, end, acceleration, deceleration, jerk)[2] >= distance:
        cruise = low
    else:
        for _ in range(BISECTIONS):
            cruise = (low + high) / 2
            if cruise in (low, high):
                break
            if _plan_over(axis, cruise, end, acceleration, deceleration, jerk)[2] < distance:
                low = cruise
            else:
                high = cruise
        cruise = (low + high) / 2
    first, both, covered = _plan_over(axis, cruise, end, acceleration, deceleration, jerk)
    pause = (distance - covered) / cruise if abs(cruise) == speed and speed > 0.0 else 0.0
    if pause > 0.0:
        for i in range(both, first, -1):
            axis.segment_duration[i] = axis.segment_duration[i - 1]
            axis.segment_acceleration[i] = axis.segment_acceleration[i - 1]
            axis.segment_jerk[i] = axis.segment_jerk[i - 1]
        _append(axis, first, pause, 0.0, 0.0)
        both += 1
    axis.profile_to_position = 1
    axis.profile_position = target
    _begin(axis, both, end)


@block
def duration(axis):
    """Time the planned profile takes (s)."""
    total = 0.0
    for i in range(axis.segments):
        total += axis.segment_duration[i]
    return total


@block
def advance(axis):
    """Move the demand along the profile by one position cycle."""
    t = axis.segment_time + axis.position_period
    while axis.segment < axis.segments and t >= axis.segment_duration[axis.segment]:
        i = axis.segment
        d, a, j = axis.segment_duration[i], axis.segment_acceleration[i], axis.segment_jerk[i]
        axis.segment_position += (axis.segment_velocity + (a / 2 + j * d / 6) * d) * d
        axis.segment_velocity += (a + j * d / 2) * d
        axis.segment += 1
        t -= d
    if axis.segment >= axis.segments:
        if not axis.profile_done:
            axis.profile_done = 1
            axis.segment_velocity = axis.profile_end_velocity
            if axis.profile_to_position:
                axis.segment_position = axis.profile_position
        axis.segment_position += axis.segment_velocity * t
        axis.segment_time = 0.0
        axis.position_demand = axis.segment_position
        axis.velocity_demand = axis.segment_velocity
        axis.acceleration_demand = 0.0
        return
    axis.segment_time = t
    i = axis.segment
    a, j = axis.segment_acceleration[i], axis.segment_jerk[i]
    axis.position_demand = (
        axis.segment_position + (axis.segment_velocity + (a / 2 + j * t / 6) * t) * t
    )
    axis.velocity_demand = axis.segment_velocity + (a + j * t / 2) * t
    axis.acceleration_demand = a + j * t


@block
def rest(axis):
    """Let the demand follow the axis, as long as nothing is controlled."""
    axis.control = Control.POSITION
    axis.position_demand = axis.position
    axis.velocity_demand = 0.0
    axis.acceleration_demand = 0.0
    axis.torque_demand = 0.0
    axis.target = axis.position
    axis.target_wanted = axis.position
    axis.segments = 0
    axis.segment = 0
    axis.segment_position = axis.position
    axis.segment_velocity = 0.0
    axis.profile_done = 1


@block
def close_position_loop(axis):
    """Take the axis over into position control without a jump, from whatever loop was closed."""
    if axis.control == Control.POSITION:
        return
    if axis.control == Control.TORQUE:
        axis.velocity_demand = axis.velocity
        axis.acceleration_demand = 0.0
    # this cycle's demand comes one step later, so begin one step behind
    axis.position_demand = axis.position - axis.velocity_demand * axis.position_period
    axis.control = Control.POSITION
