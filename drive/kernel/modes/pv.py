"""Profile velocity: the target velocity 60FFh, approached on ramps (CiA 402-2, pv)."""

from .. import limits, monitor, stop
from ..cascade import Control, energised
from ..jit import block, rare
from ..ramps import NO_JERK_LIMIT, advance, plan_velocity, profile_jerk
from ..record import Axis
from ..words import Limit


@rare
def start(axis: Axis):
    """Take over the present demand velocity."""
    if axis.control == Control.TORQUE:
        axis.velocity_demand = axis.velocity
        axis.acceleration_demand = 0.0
    axis.control = Control.VELOCITY
    axis.blocked = 0
    _, deceleration = _rates(axis, 0.0)
    plan_velocity(axis, 0.0, deceleration, deceleration, profile_jerk(axis))


@block
def demand(axis: Axis):
    """Ramp towards the target velocity, or to zero where a limit is ahead."""
    wanted = axis.target_velocity + axis.velocity_offset
    goal = min(max(wanted, -axis.max_profile_speed), axis.max_profile_speed)
    if goal != wanted:
        axis.limits |= Limit.SPEED
    acceleration, deceleration = _rates(axis, goal)
    jerk = profile_jerk(axis)
    if limits.locked(axis, goal, deceleration, jerk):
        goal = 0.0
        if limits.at_switch(axis, axis.velocity_demand):
            deceleration, jerk = stop.limit_switch_rate(axis), NO_JERK_LIMIT
    if goal != axis.profile_end_velocity:
        plan_velocity(axis, goal, acceleration, deceleration, jerk)
    advance(axis)
    axis.position_demand = axis.position


@block
def _rates(axis: Axis, goal):
    """Acceleration and deceleration (rad/s²) on the way to `goal` (rad/s), from 6083h and 6084h.

    Some models have ramps by direction in 2090h, or none at all (Metronix 8.6, Festo 7.6).
    """
    if not axis.own_velocity_ramps:
        return axis.acceleration, axis.deceleration
    if not axis.od.velocity_ramps_enable:
        steep = max(axis.max_speed, 1.0) / axis.position_period
        return steep, steep
    sign = axis.rad_s_per_velocity_unit
    return (
        axis.velocity_ramps[2 if goal * sign < 0.0 else 0],
        axis.velocity_ramps[3 if axis.velocity_demand * sign < 0.0 else 1],
    )


@block
def status(axis: Axis):
    """target_reached, speed_is_zero, max_slippage_error."""
    deviation = axis.target_velocity - axis.velocity
    inside = monitor.in_window(axis, deviation, axis.velocity_window, axis.velocity_window_cycles)
    axis.mode_bit10 = axis.standstill if axis.halted else energised(axis) and inside
    axis.mode_bit12 = axis.standstill
    slip = abs(axis.velocity_demand - axis.velocity)
    axis.mode_bit13 = energised(axis) and 0.0 < axis.max_slippage < slip
