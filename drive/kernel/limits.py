"""Limits of the motion: software position limits 607Dh and limit switches.

Software limits count from the axis zero, so they act once the axis is homed (inferred; CiA 402-2
relates them to the zero position and leaves the unreferenced axis open). Homing ignores both: it
needs the switches. A direction that a limit stopped stays locked until the master asks for another.

607Dh bounds the demand and the actual position (CiA 402-2), so the drive brakes before it in every
mode, on the quick stop ramp where the mode has no ramp of its own (inferred). With
`limit_at_set_point` it bounds the position set-points only, where they reach it.
"""

import math

from . import stop
from .cascade import Control
from .encoder import Switch
from .faults import Cause, Reaction, raise_fault
from .jit import block, rare
from .ramps import NO_JERK_LIMIT, steepest, stopping_distance
from .record import ANALOG_INPUTS, Axis
from .words import Limit, Mode

COUNTS = 2.0**32  # of an INTEGER32
BY_SWITCH, BY_SOFTWARE = 1, 2  # of `blocked`, signed by the direction
FULL_SCALE = 10.0  # V of an analog input


@block
def clamp_target(axis: Axis, target):
    """The nearest allowed target (rad)."""
    axis.target_wanted = target
    return clamp(axis, target)


@block
def clamp(axis: Axis, place):
    """`place` (rad) within the software limits of a homed axis."""
    if axis.homed:
        return min(max(place, axis.position_limit_min), axis.position_limit_max)
    return place


@block
def room(axis: Axis, place, direction):
    """Distance (rad) from `place` to the software limit ahead in `direction` (its sign counts)."""
    if not axis.homed:
        return math.inf
    if direction > 0:
        return axis.position_limit_max - place
    return place - axis.position_limit_min


@block
def nearest_turn(axis: Axis, target, option):
    """The position that `target` (rad) means on a rotary axis (607Bh), counted over the turns.

    `option` is 60F2h bits 6-7: 0 stay within the range, 1 only negative, 2 only positive direction,
    3 the shortest way. A linear axis has only one such place.
    """
    if axis.range <= 0.0:
        return target
    here = abs(axis.rad_per_position_unit) / 2  # less than that is rounding, not a way round
    way = _on_turn(axis, target, here) - _on_turn(axis, axis.position_demand, here)
    if option == 1 and way > here:
        way -= axis.range
    elif option == 2 and way < -here:
        way += axis.range
    elif option == 3:
        way -= axis.range * math.floor(way / axis.range + 0.5)
    return axis.position_demand + way


@block
def _on_turn(axis: Axis, place, here):
    """A position within the range from 0 on, where a rounding error before it counts as 0."""
    place -= axis.range_min
    return place - axis.range * math.floor((place + here) / axis.range)


@block
def nearest_count(axis: Axis, target):
    """The position nearest to the demand that a cyclic `target` (rad) can mean.

    A position is an INTEGER32 that wraps, so a target beyond its end continues at the other one.
    With 607Bh it continues over the turns.
    """
    if axis.range > 0.0:
        return nearest_turn(axis, target, 3)
    whole = COUNTS * abs(axis.rad_per_position_unit)
    return target - whole * math.floor((target - axis.position_demand) / whole + 0.5)


@block
def meant(axis: Axis, target):
    """The position (rad) that an absolute `target` of a move means.

    It is unique between software limits. If nothing bounds the travel, it wraps at the ends of
    INTEGER32, as the difference of two of them does in 32 bits (inferred).
    """
    if axis.range > 0.0 or (axis.homed and axis.position_limit_max < math.inf):
        return nearest_turn(axis, target, axis.turn_option)
    return nearest_count(axis, target)


@block
def show_clamped(axis: Axis):
    """Report the software limit that holds back the present target, if any."""
    if axis.homed and axis.target_wanted > axis.position_limit_max:
        _show(axis, 1)
    elif axis.homed and axis.target_wanted < axis.position_limit_min:
        _show(axis, -1)


@rare
def _show(axis: Axis, direction):
    """Report that the software limit ahead in `direction` acts."""
    if direction > 0:
        axis.limits |= Limit.SOFTWARE_POSITION_MAX
        raise_fault(axis, Cause.SOFTWARE_LIMIT_MAX)
    else:
        axis.limits |= Limit.SOFTWARE_POSITION_MIN
        raise_fault(axis, Cause.SOFTWARE_LIMIT_MIN)


@block
def before_limit(axis: Axis, start, target, period):
    """The farthest position towards `target` (rad) after one `period` (s) of constant speed.

    From there the quick stop ramp 6085h, in steps of such periods, still ends at the limit ahead.
    """
    way = target - start
    space = max(room(axis, start, way), 0.0)
    if axis.limit_at_set_point or space == math.inf:
        return target
    step = axis.quick_stop_deceleration * period * period
    steps = math.floor((math.sqrt(1.0 + 8.0 * space / step) - 1.0) / 2.0)  # of the ramp
    farthest = space / (steps + 1) + step * steps / 2
    if abs(way) <= farthest:
        return target
    _show(axis, way)
    return start + math.copysign(farthest, way)


@block
def suppressed(axis: Axis, target):
    """Whether a move must not start because its target (rad) is beyond a software limit.

    This applies to models that have a fault for it (Festo CMMP-AS, 40-2 and 40-3).
    """
    cause = Cause.NONE
    rounding = abs(axis.rad_per_position_unit) / 2
    if axis.homed and target > axis.position_limit_max + rounding:
        cause = Cause.TARGET_BEHIND_MAX
    elif axis.homed and target < axis.position_limit_min - rounding:
        cause = Cause.TARGET_BEHIND_MIN
    if cause == Cause.NONE or axis.od.fault_reaction[cause] == Reaction.IGNORE:
        return False
    raise_fault(axis, cause)
    return True


@block
def by_source(axis: Axis):
    """2415h and 2416h: limits of current and of the speed in tq, fixed or by an analog input."""
    od = axis.od
    axis.current_limit = math.inf
    if od.current_limit_channel:
        axis.current_limit = axis.limit_torque * _share(axis, od.current_limit_channel)
    axis.torque_speed = axis.max_speed
    if od.speed_limit_channel:
        limit = axis.limit_speed * _share(axis, od.speed_limit_channel)
        axis.torque_speed = min(axis.max_speed, limit)


@block
def _share(axis: Axis, channel):
    """The share of 10 V at analog input 0, 1 or 2 (channels 1, 2, 3); 1 for a fixed value (4)."""
    if channel > ANALOG_INPUTS:
        return 1.0
    offset = axis.od.analog_input_offset[channel - 1] * 1e-3
    return min(abs(axis.analog_inputs[channel - 1] - offset) / FULL_SCALE, 1.0)


@block
def at_switch(axis: Axis, direction):
    """Whether the limit switch ahead in `direction` (its sign counts) is active."""
    if direction > 0 and axis.switches & Switch.POSITIVE_LIMIT:
        axis.limits |= Limit.POSITIVE_LIMIT_SWITCH
        raise_fault(axis, Cause.POSITIVE_BLOCKED)
        return True
    if direction < 0 and axis.switches & Switch.NEGATIVE_LIMIT:
        axis.limits |= Limit.NEGATIVE_LIMIT_SWITCH
        raise_fault(axis, Cause.NEGATIVE_BLOCKED)
        return True
    return False


@block
def locked(axis: Axis, goal, deceleration, jerk):
    """Whether a velocity demand has to brake because a switch or a software limit is ahead.

    `goal` is the velocity wanted (rad/s); it can stop at `deceleration` with `jerk`. The lock holds
    until another direction is asked for.
    """
    if goal * axis.blocked <= 0.0:
        axis.blocked = 0
    way = goal if goal != 0.0 else axis.velocity_demand
    sign = 1 if way > 0 else -1
    if at_switch(axis, way):
        axis.blocked = sign * BY_SWITCH
    elif _before_software_limit(axis, way, deceleration, jerk):
        axis.blocked = sign * BY_SOFTWARE
    if abs(axis.blocked) == BY_SOFTWARE:
        _show(axis, axis.blocked)
    elif axis.blocked != 0:
        positive, negative = Limit.POSITIVE_LIMIT_SWITCH, Limit.NEGATIVE_LIMIT_SWITCH
        axis.limits |= positive if axis.blocked > 0 else negative
    return axis.blocked != 0


@block
def brakes(axis: Axis, torque):
    """Whether to brake instead of applying `torque` (Nm), at or before a limit; brakes if so.

    A torque mode brakes on the quick stop ramp, at a switch on that of the switch, and then stands,
    until the torque asked for turns away (inferred: CiA 402-2 bounds the actual position and leaves
    torque modes open).
    """
    if axis.control == Control.TORQUE:
        axis.acceleration_demand = (axis.velocity - axis.velocity_demand) / axis.position_period
        axis.velocity_demand = axis.velocity
    rate, way = axis.quick_stop_deceleration, axis.velocity_demand
    ahead = locked(axis, torque, rate, NO_JERK_LIMIT)
    if torque * way >= 0.0 or abs(way) > axis.velocity_threshold:
        ahead = ahead or at_switch(axis, way)
        ahead = ahead or (way != 0.0 and _before_software_limit(axis, way, rate, NO_JERK_LIMIT))
    if not ahead:
        axis.control = Control.TORQUE
        return False
    if axis.control == Control.TORQUE:
        axis.velocity_integral = 0.0
    axis.control = Control.VELOCITY
    if at_switch(axis, way):
        rate = stop.limit_switch_rate(axis)
    step = rate * axis.position_period
    axis.velocity_demand -= min(max(way, -step), step)
    axis.acceleration_demand = 0.0
    return True


@block
def _before_software_limit(axis: Axis, direction, deceleration, jerk):
    """Whether the axis must brake now to stop at the software limit ahead in `direction`.

    Two cycles pass until it does, in which the acceleration may still grow.
    """
    if not axis.homed or (axis.limit_at_set_point and axis.mode == Mode.PROFILE_TORQUE):
        return False
    sign = 1.0 if direction > 0 else -1.0
    delay = 2 * axis.position_period
    growth = jerk[0] if jerk[0] >= 0.0 else steepest(axis)
    acceleration = axis.acceleration_demand * sign + growth * delay
    speed = max(axis.velocity_demand * sign + max(acceleration, 0.0) * delay, 0.0)
    path = speed * delay + stopping_distance(axis, speed, acceleration, deceleration, jerk)
    if path < room(axis, axis.position, direction):
        return False
    _show(axis, direction)
    return True
