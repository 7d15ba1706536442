"""Setpoint generators: one profile of constant-jerk segments for moves, ramps and stops.

A profile starts from any present demand (position, velocity, acceleration) and is travelled in
closed form, so it ends exactly where and when planned.

The one building block is the ramp: the quickest change from (velocity, acceleration) to (goal, 0).
Along constant jerk the square of the acceleration is linear in the velocity, a²/2 = j · v, so a
ramp is a trapezoid in that plane: up at the jerk that begins it, along the limit, down at the jerk
that ends it. Growing and shrinking speed have limits and jerks of their own, so the plane is cut at
velocity 0, and a ramp through it is two such trapezoids with the acceleration that both can take.
No jerk limit is an infinite jerk.

A move follows the ramp to the profile velocity until the ramp to the end velocity, begun there,
ends at the target: where that is follows by bisection, because the distance is continuous in it.
Where the acceleration jumps (no jerk limit) and where velocity 0 is crossed, the acceleration there
is bisected in place of the time: the jerks before and behind can be decades apart, and then a time
that differs by its last bit leads past the target.
What starts behind its target, or too fast for it, does the same the other way round. With equal
limits that is time-optimal from any state.

A sin² ramp (6086h = 1) is one segment of another shape, a wave of the acceleration from 0 over the
limit back to 0: a = limit · sin²(pi · t / T) with T = 2 · change / limit, so its mean velocity is
the one in the middle. What is left of an acceleration before it goes as the falling half of such a
wave, and a short move has the whole waves of a lower speed.
"""

import math

from .cascade import Control
from .jit import block, rare
from .record import SEGMENTS, Axis

BISECTIONS = 200  # ends earlier, when the interval no longer shrinks
# begin of acceleration, begin of deceleration, end of acceleration, end of deceleration: the order
# of 60A4h
UP, DOWN, QUICK_STOP = 0, 1, 2  # slopes of vl
NO_JERK_LIMIT = (0.0, 0.0, 0.0, 0.0)
SINE = -1.0  # in the place of a jerk: ramps are sin²
FALL_TIME = (
    0.02  # s, in which an acceleration as high as the limit goes before a sin² ramp (inferred)
)
SHORTEST = 1e-9  # s, of a wave; a shorter one is its mean acceleration
UNSTORED = SEGMENTS  # a ramp that begins there only counts its distance


@block
def profile_jerk(axis: Axis):
    """The jerk limits of the profile (rad/s³), all 0 for a trapezoid, `SINE` for sin²."""
    return axis.jerk[0], axis.jerk[1], axis.jerk[2], axis.jerk[3]


@block
def _or_infinite(jerk):
    return jerk if jerk != 0.0 else math.inf


@block
def _limits(acceleration, deceleration, jerk):
    """What a ramp may use: both limits, then the four jerks, infinite where there is none."""
    return (
        acceleration,
        deceleration,
        _or_infinite(jerk[0]),
        _or_infinite(jerk[1]),
        _or_infinite(jerk[2]),
        _or_infinite(jerk[3]),
    )


@block
def _after(x, v, t, a, jerk, wave):
    """Where constant jerk leads from (x, v, a) in the time `t`; -> (x, v, a).

    With a `wave` (rad/s) the acceleration is a wave as high as `a`, that begins with the phase
    `jerk` (0 or pi: at its foot or on its top).
    """
    if wave > 0.0:
        angle = wave * t + jerk
        x += v * t + a / 2 * (t * t / 2 + (math.cos(angle) - math.cos(jerk)) / (wave * wave))
        return x, v + a / 2 * (t - math.sin(angle) / wave), a / 2 * (1.0 - math.cos(angle))
    x += (v + (a / 2 + jerk * t / 6) * t) * t
    return x, v + (a + jerk * t / 2) * t, a + jerk * t


@block
def _segment(axis: Axis, n, x, v, duration, a, jerk, wave):
    """Travel one segment (see `_after`) from (x, v); -> (n, x, v) behind it."""
    if not duration > 0.0:
        return n, x, v
    if n < SEGMENTS:
        axis.segment_duration[n] = duration
        axis.segment_begin_velocity[n] = v
        axis.segment_acceleration[n] = a
        axis.segment_jerk[n] = jerk
        axis.segment_wave[n] = wave
    x, v, _ = _after(x, v, duration, a, jerk, wave)
    return n + 1, x, v


@block
def _wave(axis: Axis, n, x, v, goal, limit):
    """The sin² ramp from the velocity `v` to `goal`; -> (n, x, v)."""
    duration = 2 * abs(goal - v) / limit
    a = math.copysign(limit, goal - v)
    if duration < SHORTEST:
        n, x, _ = _segment(axis, n, x, v, duration, a / 2, 0.0, 0.0)
    else:
        n, x, _ = _segment(axis, n, x, v, duration, a, 0.0, 2 * math.pi / duration)
    return n, x, goal


@block
def _release(axis: Axis, n, x, v, a, limits):
    """Take the acceleration away at once; -> (n, x, v)."""
    sign, size = math.copysign(1.0, a), abs(a)
    end = limits[4]
    if end < 0.0:  # sin²
        fall = FALL_TIME * size / min(limits[0], limits[1])
        if fall < SHORTEST:
            return _segment(axis, n, x, v, fall, a / 2, 0.0, 0.0)
        return _segment(axis, n, x, v, fall, a, math.pi, math.pi / fall)
    if v * sign < 0.0:  # slows down
        end = limits[5]
        left = size * size - 2 * end * abs(v)  # of a², where the velocity would be 0
        if left > 0.0:
            at_zero = math.sqrt(left)
            slow = 2 * abs(v) / (size + at_zero)  # s
            n, x, v = _segment(axis, n, x, v, slow, a, -sign * end, 0.0)
            v, size, end = 0.0, at_zero, limits[4]
    return _segment(axis, n, x, v, size / end, sign * size, -sign * end, 0.0)


@block
def _trapezoid(axis: Axis, n, x, v, change, sign, first, last, limit, begin, end):
    """Change the velocity by `sign` · `change` on one side of 0; -> (n, x, v).

    The acceleration is `first` before it and `last` behind it, both magnitudes.
    """
    peak, up, down = limit, limit - first, limit - last
    play = 1 / begin + 1 / end
    if play > 0.0:
        gain = (2 * change + (last * last - first * first) / end) / play  # of a²
        square = first * first + gain
        if square < limit * limit:
            peak = math.sqrt(max(square, 0.0))
            up, down = peak - first, peak - last
            if first > 0.0 and square > 0.0:
                up = gain / (peak + first)  # a difference of what is nearly equal
            if last > 0.0 and square > 0.0:
                loss = (2 * change + (first * first - last * last) / begin) / play
                down = loss / (peak + last)
    if peak < last:  # which is above the limit only if `first` is
        peak, up, down = last, last - first, 0.0
    rise = begin if up >= 0.0 else -end  # more than the limit is taken back
    used = up * (peak + first) / (2 * rise) + down * (peak + last) / (2 * end)
    hold = max(change - used, 0.0) / peak if peak >= limit else 0.0
    time = up / rise
    if hold == 0.0 and time > 0.0 and (up < 0.0 or peak == last):  # one line from first to last
        time, down = 2 * change / (first + last), 0.0
    elif down == 0.0 and peak == last and 0.0 < peak < limit:  # begins with a jump to `last`
        hold = change / peak
    n, x, v = _segment(axis, n, x, v, time, sign * first, sign * rise, 0.0)
    n, x, v = _segment(axis, n, x, v, hold, sign * peak, 0.0, 0.0)
    return _segment(axis, n, x, v, down / end, sign * peak, -sign * end, 0.0)


@block
def _crossing(v, first, goal, limits):
    """Lowest and highest acceleration with which a ramp from `v` to `goal` can cross velocity 0.

    `first` is the acceleration it begins with. All are magnitudes.
    """
    most = math.sqrt(first * first + 2 * limits[3] * abs(v))
    least = math.sqrt(max(first * first - 2 * limits[5] * abs(v), 0.0))
    last = min(limits[0], limits[1], most, math.sqrt(2 * limits[4] * abs(goal)))
    return least, max(last, least)


@block
def _ramp(axis: Axis, n, x, v, a, goal, limits):
    """The quickest change from (v, a) to (goal, 0); -> (n, x) behind it."""
    released, x_released, v_released = _release(axis, n, x, v, a, limits)
    sign = 1.0 if goal >= v_released else -1.0
    first = abs(a)
    if limits[4] < 0.0:  # sin²
        n, x, v = released, x_released, v_released
        if v * goal < 0.0:
            n, x, v = _wave(axis, n, x, v, 0.0, limits[1])
        n, x, v = _wave(axis, n, x, v, goal, limits[0] if abs(goal) > abs(v) else limits[1])
        return n, x
    if v_released == goal:
        return released, x_released
    if a * sign <= 0.0:
        n, x, v, first = released, x_released, v_released, 0.0
    if v * sign < 0.0:
        last, change = 0.0, sign * (goal - v)
        if goal * sign > 0.0:
            change = abs(v)
            _, last = _crossing(v, first, goal, limits)
        n, x, v = _trapezoid(
            axis, n, x, v, change, sign, first, last, limits[1], limits[3], limits[5]
        )
        if goal * sign <= 0.0:
            return n, x
        v, first = 0.0, last
    change = sign * (goal - v)
    n, x, v = _trapezoid(axis, n, x, v, change, sign, first, 0.0, limits[0], limits[2], limits[4])
    return n, x


@block
def _begin(axis: Axis, n, end_velocity):
    axis.segments = min(n, SEGMENTS)
    axis.segment = 0
    axis.segment_time = 0.0
    axis.segment_position = axis.position_demand
    axis.segment_velocity = axis.velocity_demand
    axis.profile_end_velocity = end_velocity
    axis.profile_done = 0


@block
def vl_rate(axis: Axis, n, direction):
    """Slope of vl (rad/s²) in a direction: `UP`, `DOWN` or `QUICK_STOP`."""
    if direction < 0.0:
        return axis.vl_anticlockwise[n]
    return (axis.vl_acceleration, axis.vl_deceleration, axis.vl_quick_stop)[n]


@rare
def plan_velocity(axis: Axis, velocity, acceleration, deceleration, jerk):
    """Plan a change of the demand velocity to `velocity` (rad/s); `jerk`: as `profile_jerk`."""
    limits = _limits(acceleration, deceleration, jerk)
    v, a = axis.velocity_demand, axis.acceleration_demand
    n, _ = _ramp(axis, 0, 0.0, v, a, velocity, limits)
    axis.profile_to_position = 0
    _begin(axis, n, velocity)


@block
def stopping_distance(axis: Axis, v, a, deceleration, jerk):
    """Signed way (rad) of the quickest stop from (v, a) (rad/s, rad/s²); plans nothing."""
    limits = _limits(deceleration, deceleration, jerk)
    return _ramp(axis, UNSTORED, 0.0, v, a, 0.0, limits)[1]


@block
def _stops_within(axis: Axis, room, speed, deceleration, jerk):
    """Whether a speed can stop within `room` (rad), from the cycle after this one on."""
    path = stopping_distance(axis, speed, 0.0, deceleration, jerk)
    return path + speed * axis.position_period <= room


@block
def _fastest_within(axis: Axis, room, speed, deceleration, jerk):
    """The highest speed (rad/s) up to `speed` that can stop within `room`."""
    if _stops_within(axis, room, speed, deceleration, jerk):
        return speed
    low, high = 0.0, speed
    for _ in range(BISECTIONS):
        middle = (low + high) / 2
        if middle in (low, high):
            break
        if _stops_within(axis, room, middle, deceleration, jerk):
            low = middle
        else:
            high = middle
    return low


@block
def _reachable(axis: Axis, distance, v, a, wanted, limits):
    """The end velocity next to `wanted` with which `distance` can be passed without turning round.

    0 where the axis cannot but pass the target and come back.
    """
    if wanted == 0.0 or distance == 0.0:
        return 0.0
    way = math.copysign(1.0, distance)
    if (distance - _ramp(axis, UNSTORED, 0.0, v, a, wanted, limits)[1]) * way >= 0.0:
        return wanted
    _, _, released = _release(axis, UNSTORED, 0.0, v, a, limits)
    low, high = way * max(way * released, 0.0), wanted
    if (distance - _ramp(axis, UNSTORED, 0.0, v, a, low, limits)[1]) * way < 0.0:
        return 0.0
    for _ in range(BISECTIONS):
        middle = (low + high) / 2
        if middle in (low, high):
            break
        if (distance - _ramp(axis, UNSTORED, 0.0, v, a, middle, limits)[1]) * way >= 0.0:
            low = middle
        else:
            high = middle
    return low


@rare
def plan_position(axis: Axis, target, speed, end_speed, room, acceleration, deceleration, jerk):
    """Plan a move of the demand to `target` (rad) at up to `speed` (rad/s).

    The target is passed at `end_speed` in the direction of the move, or at what can be reached
    without a run-up and can stop within `room` (rad) behind it. All limits are magnitudes, `jerk`
    is four of them as `profile_jerk` gives.
    """
    limits = _limits(acceleration, deceleration, jerk)
    distance = target - axis.position_demand
    v, a = axis.velocity_demand, axis.acceleration_demand
    asked = end = 0.0
    if end_speed > 0.0:
        asked = _fastest_within(axis, room, min(end_speed, speed), deceleration, jerk)
        asked = math.copysign(asked, distance)
        end = _reachable(axis, distance, v, a, asked, limits)
        if not _stops_within(axis, room, abs(end), deceleration, jerk):
            end = 0.0
    n, x = _ramp(axis, 0, 0.0, v, a, end, limits)
    if x != distance and (end == asked or end == 0.0):
        n, x = _plan_over(axis, distance, math.copysign(speed, distance - x), end, limits)
    left = (distance - x) / end if end != 0.0 else 0.0
    if 0.0 < left < axis.position_period:  # what rounding left
        n, x, _ = _segment(axis, n, x, end, left, 0.0, 0.0, 0.0)
    axis.profile_to_position = 1
    axis.profile_position = target
    _begin(axis, n, end)


@block
def _plan_over(axis: Axis, distance, cruise, end, limits):
    """Follow the ramp to `cruise` as long as the ramp to `end` does not lead beyond `distance`.

    -> (n, x) at the end of both, as `_ramp`.
    """
    way = math.copysign(1.0, cruise)
    x, v, a = 0.0, axis.velocity_demand, axis.acceleration_demand
    ramp, x_cruise = _ramp(axis, 0, 0.0, v, a, cruise, limits)
    left = distance - _ramp(axis, UNSTORED, x_cruise, cruise, 0.0, end, limits)[1]
    if left * way >= 0.0:
        pause = left / cruise if cruise != 0.0 else math.inf
        n, x, _ = _segment(axis, ramp, x_cruise, cruise, pause, 0.0, 0.0, 0.0)
        return _ramp(axis, n, x, cruise, 0.0, end, limits)
    if limits[4] < 0.0:
        return _over_by_speed(axis, distance, cruise, end, limits)
    crossed, x, before, most = _cross(axis, distance, cruise, end, limits)
    if before != most:
        return _ramp(axis, crossed, x, 0.0, before, end, limits)
    i, low, high, jerk = crossed, 0.0, 0.0, 0.0
    for i in range(crossed, ramp + 1):
        v, a, jerk, high = cruise, 0.0, 0.0, 0.0
        if i < ramp:
            v, high = axis.segment_begin_velocity[i], axis.segment_duration[i]
            a, jerk = axis.segment_acceleration[i], axis.segment_jerk[i]
        if (distance - _ramp(axis, UNSTORED, x, v, a, end, limits)[1]) * way < 0.0:
            return _over_by_jump(axis, i, distance, x, v, before, a, way, end, limits)
        _, x_end, v_end = _segment(axis, UNSTORED, x, v, high, a, jerk, 0.0)
        before = a + jerk * high
        if (distance - _ramp(axis, UNSTORED, x_end, v_end, before, end, limits)[1]) * way <= 0.0:
            break
        x = x_end
    for _ in range(BISECTIONS):
        middle = (low + high) / 2
        if middle in (low, high):
            break
        _, x_end, v_end = _segment(axis, UNSTORED, x, v, middle, a, jerk, 0.0)
        behind = _ramp(axis, UNSTORED, x_end, v_end, a + jerk * middle, end, limits)[1]
        if (distance - behind) * way > 0.0:
            low = middle
        else:
            high = middle
    n, x, v = _segment(axis, i, x, v, low, a, jerk, 0.0)
    return _ramp(axis, n, x, v, a + jerk * low, end, limits)


@block
def _over_by_jump(axis: Axis, n, distance, x, v, low, high, way, end, limits):
    """Let an acceleration that jumps from `low` to `high` jump only as far as leads to `distance`.

    -> (n, x) at the end, as `_plan_over`.
    """
    for _ in range(BISECTIONS):
        middle = (low + high) / 2
        if middle in (low, high):
            break
        if (distance - _ramp(axis, UNSTORED, x, v, middle, end, limits)[1]) * way > 0.0:
            low = middle
        else:
            high = middle
    return _ramp(axis, n, x, v, low, end, limits)


@block
def _cross(axis: Axis, distance, cruise, end, limits):
    """Follow the ramp to `cruise` as far as velocity 0, if it crosses it.

    The acceleration at the crossing is the highest from which the ramp to `end` does not lead
    beyond `distance`. -> (n, x) there, that acceleration, and the one of the ramp to `cruise`;
    (0, 0.0, a, a) where nothing is crossed, or the ramp to `end` begins elsewhere.
    """
    way = math.copysign(1.0, cruise)
    n, x, v, a = 0, 0.0, axis.velocity_demand, axis.acceleration_demand
    _, _, released = _release(axis, UNSTORED, x, v, a, limits)
    first = max(a * way, 0.0)
    crosses = (v if first > 0.0 else released) * way < 0.0 and (cruise - released) * way > 0.0
    if not crosses or cruise == 0.0:
        return n, x, a, a
    if first == 0.0:
        n, x, v = _release(axis, n, x, v, a, limits)
    low, most = _crossing(v, first, cruise, limits)
    if end * way > 0.0:
        _, low = _crossing(v, first, end, limits)
    if _misses(axis, distance, x, v, first, low, way, end, limits) < 0.0:
        return 0, 0.0, a, a
    high = middle = most
    for _ in range(BISECTIONS):
        if _misses(axis, distance, x, v, first, middle, way, end, limits) >= 0.0:
            low = middle
        else:
            high = middle
        middle = (low + high) / 2
        if middle in (low, high):
            break
    n, x, _ = _brake(axis, n, x, v, first, low, way, limits)
    return n, x, way * low, way * most


@block
def _brake(axis: Axis, n, x, v, first, last, way, limits):
    """Slow down to velocity 0, with the acceleration `last` there; -> (n, x, v)."""
    return _trapezoid(axis, n, x, v, abs(v), way, first, last, limits[1], limits[3], limits[5])


@block
def _misses(axis: Axis, distance, x, v, first, last, way, end, limits):
    """How far before `distance` the ramp to `end` ends if velocity 0 is crossed with `last`."""
    _, x, _ = _brake(axis, UNSTORED, x, v, first, last, way, limits)
    return (distance - _ramp(axis, UNSTORED, x, 0.0, way * last, end, limits)[1]) * way


@block
def _over_by_speed(axis: Axis, distance, cruise, end, limits):
    """Plan a ramp of whole sin² parts to the highest speed up to `cruise` that fits the way."""
    way = math.copysign(1.0, cruise)
    v, a = axis.velocity_demand, axis.acceleration_demand
    low, high = end, cruise
    for _ in range(BISECTIONS):
        middle = (low + high) / 2
        if middle in (low, high):
            break
        x = _ramp(axis, UNSTORED, 0.0, v, a, middle, limits)[1]
        x = _ramp(axis, UNSTORED, x, middle, 0.0, end, limits)[1]
        if (distance - x) * way > 0.0:
            low = middle
        else:
            high = middle
    n, x = _ramp(axis, 0, 0.0, v, a, low, limits)
    return _ramp(axis, n, x, low, 0.0, end, limits)


@block
def steepest(axis: Axis):
    """Largest jerk (rad/s³) of the segment being travelled, if that is a wave, else 0."""
    if axis.segment >= axis.segments:
        return 0.0
    return abs(axis.segment_acceleration[axis.segment]) * axis.segment_wave[axis.segment] / 2


@block
def duration(axis: Axis):
    """Time the planned profile takes (s)."""
    total = 0.0
    for i in range(axis.segments):
        total += axis.segment_duration[i]
    return total


@block
def advance(axis: Axis):
    """Move the demand along the profile by one position cycle."""
    t = axis.segment_time + axis.position_period
    while axis.segment < axis.segments and t >= axis.segment_duration[axis.segment]:
        i = axis.segment
        d = axis.segment_duration[i]
        axis.segment_position, axis.segment_velocity, _ = _along(axis, i, d)
        axis.segment += 1
        if axis.segment < axis.segments:  # as planned, without the rounding of a higher one
            axis.segment_velocity = axis.segment_begin_velocity[axis.segment]
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
    axis.position_demand, axis.velocity_demand, axis.acceleration_demand = _along(
        axis, axis.segment, t
    )


@block
def _along(axis: Axis, i, t):
    """(position, velocity, acceleration) at the time `t` in the segment `i`, which is under way."""
    return _after(
        axis.segment_position, axis.segment_velocity, t, axis.segment_acceleration[i],
        axis.segment_jerk[i], axis.segment_wave[i],
    )


@block
def rest(axis: Axis):
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
def close_position_loop(axis: Axis):
    """Change to position control without a jump, from any loop."""
    if axis.control == Control.POSITION:
        return
    if axis.control == Control.TORQUE:
        axis.velocity_demand = axis.velocity
        axis.acceleration_demand = 0.0
    # this cycle's demand comes one step later, so begin one step behind
    axis.position_demand = axis.position - axis.velocity_demand * axis.position_period
    axis.control = Control.POSITION
