"""Limits of the motion: software position limits 607Dh and limit switches.

Software limits count from the axis zero, so they act once the axis is homed (inferred; CiA 402-2
relates them to the zero position and leaves the unreferenced axis open). Homing ignores both: it
needs the switches. A direction that a limit stopped stays locked until the master asks for another.
"""

import math

from .encoder import Switch
from .faults import Cause, raise_fault
from .jit import block
from .words import Limit


@block
def clamp_target(axis, target):
    """The nearest allowed target (rad)."""
    axis.target_wanted = target
    if axis.homed:
        return min(max(target, axis.position_limit_min), axis.position_limit_max)
    return target


@block
def nearest_turn(axis, target, option):
    """On a rotary axis (607Bh) the place that `target` (rad) means, counted on over the turns.

    `option` is 60F2h bits 6-7: 0 stay within the range, 1 only negative, 2 only positive direction,
    3 the shortest way. A linear axis has only one such place.
    """
    if axis.range <= 0.0:
        return target
    shown = (axis.position_demand - axis.range_min) % axis.range + axis.range_min
    way = (target - axis.range_min) % axis.range + axis.range_min - shown
    if option == 1 and way > 0:
        way -= axis.range
    elif option == 2 and way < 0:
        way += axis.range
    elif option == 3:
        way -= axis.range * math.floor(way / axis.range + 0.5)
    return axis.position_demand + way


@block
def show_clamped(axis):
    """Say which software limit holds the present target back, as long as it does."""
    if axis.homed and axis.target_wanted > axis.position_limit_max:
        axis.limits |= Limit.SOFTWARE_POSITION_MAX
        raise_fault(axis, Cause.SOFTWARE_LIMIT_MAX)
    elif axis.homed and axis.target_wanted < axis.position_limit_min:
        axis.limits |= Limit.SOFTWARE_POSITION_MIN
        raise_fault(axis, Cause.SOFTWARE_LIMIT_MIN)


@block
def at_switch(axis, direction):
    """Whether the limit switch on the way of `direction` (any signed number) is active."""
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
def locked(axis, goal, deceleration):
    """Whether a velocity demand has to brake: a switch or a software limit is ahead.

    `goal` is the velocity wanted (rad/s). The lock holds until another direction is asked for.
    """
    if goal * axis.blocked <= 0.0:
        axis.blocked = 0
    way = goal if goal != 0.0 else axis.velocity_demand
    if at_switch(axis, way) or _before_software_limit(axis, way, deceleration):
        axis.blocked = 1 if way > 0 else -1
    return axis.blocked != 0


@block
def _before_software_limit(axis, direction, deceleration):
    """Whether the axis must brake now to stop at the software limit ahead in `direction`."""
    if not axis.homed:
        return False
    speed = max(axis.velocity_demand * (1.0 if direction > 0 else -1.0), 0.0)
    path = speed * (speed / (2 * deceleration) + 2 * axis.position_period)
    if axis.jerk[0] > 0.0:
        path += speed * deceleration / (2 * min(axis.jerk[1], axis.jerk[3]))
    if direction > 0 and axis.position + path >= axis.position_limit_max:
        axis.limits |= Limit.SOFTWARE_POSITION_MAX
        raise_fault(axis, Cause.SOFTWARE_LIMIT_MAX)
        return True
    if direction < 0 and axis.position - path <= axis.position_limit_min:
        axis.limits |= Limit.SOFTWARE_POSITION_MIN
        raise_fault(axis, Cause.SOFTWARE_LIMIT_MIN)
        return True
    return False
