"""Cyclic synchronous position: the master's trajectory, one target a bus cycle (CiA 402-2, csp).

A set-point counts as new when process data were latched, or 607Ah or 60B0h changed. The drive
interpolates linearly from the last demand to it over the interpolation time period 60C2h and then
holds, so the demand velocity is the slope of the master's own trajectory. Position and velocity
offsets 60B0h and 60B1h are added; the torque offset 60B2h acts in the cascade.

An RPDO of type 254 or 255 may repeat a set-point for the sake of another object, so a repeated one
is new only once the interpolation to it has ended (inferred).

A target that is too far for one period is approached at the maximum speed, period by period, and
before a software limit on the quick stop ramp; the limit shows as long as it holds. Where
set-points came one period apart and one is missing, the drive goes on with the last slope, for as
many periods as 2019h lets them be missing (inferred).
"""

from .. import limits
from ..cascade import energised
from ..jit import block, rare
from ..ramps import close_position_loop
from ..record import Axis
from ..stop import Stop
from ..words import Latched, Limit

SMOOTHING = 0.25  # of the acceleration fed forward, per set-point: whole units make it coarse


@rare
def start(axis: Axis):
    """Hold where the demand is until a new set-point comes."""
    close_position_loop(axis)
    hold(axis)


@block
def hold(axis: Axis):
    """End the interpolation at the present demand."""
    axis.interpolation_start = axis.position_demand
    axis.interpolation_target = axis.position_demand
    axis.interpolation_wanted = axis.position_demand
    axis.interpolation_cycle = axis.interpolation_cycles + 1
    axis.interpolation_velocity = 0.0
    axis.set_points_in_time = 0


@block
def demand(axis: Axis):
    """Interpolate one position cycle further."""
    target = axis.target_position + axis.position_offset
    cyclic = axis.sync == Latched.CYCLIC
    if cyclic or target != axis.last_target_position or (axis.sync and _reached(axis, target)):
        aim(axis, target, cyclic)
    travel(axis, axis.velocity_offset)


@block
def _reached(axis: Axis, target):
    """Whether the interpolation has ended at the set-point `target` (rad), not at a hold."""
    wanted = limits.clamp(axis, limits.nearest_count(axis, target))
    ended = axis.interpolation_cycle >= axis.interpolation_cycles
    return ended and axis.interpolation_wanted == wanted == axis.interpolation_target


@block
def aim(axis: Axis, target, cyclic):
    """Go to `target` (rad), a new set-point; `cyclic`: the next one is due a period later."""
    in_time = axis.interpolation_cycle == axis.interpolation_cycles
    axis.set_points_in_time = cyclic and in_time
    axis.interpolation_wanted = limits.clamp_target(axis, limits.nearest_count(axis, target))
    _begin_period(axis)


@block
def _begin_period(axis: Axis):
    """Interpolate towards the set-point, as far as limits let it within one period."""
    start_at, target = axis.position_demand, axis.interpolation_wanted
    if limits.at_switch(axis, target - start_at):
        target = start_at
    period = axis.interpolation_cycles * axis.position_period
    target = _within_reach(axis, start_at, target, period)
    velocity = (target - start_at) / period
    acceleration = (velocity - axis.interpolation_velocity) / period
    axis.acceleration_demand += SMOOTHING * (acceleration - axis.acceleration_demand)
    axis.interpolation_velocity = velocity
    axis.interpolation_start = start_at
    axis.interpolation_target = target
    axis.interpolation_cycle = 0


@block
def _within_reach(axis: Axis, start_at, target, period):
    """How far towards `target` (rad) the limits let it in one `period` (s); shows which do not."""
    farthest = axis.max_speed * period
    if abs(target - start_at) > farthest:
        axis.limits |= Limit.SPEED
        target = min(max(target, start_at - farthest), start_at + farthest)
    return limits.before_limit(axis, start_at, target, period)


@block
def travel(axis: Axis, offset):
    """Move the demand along the interpolation; `offset` (rad/s) is added to its velocity."""
    limits.show_clamped(axis)
    short = axis.interpolation_wanted != axis.interpolation_target
    if short and axis.interpolation_cycle >= axis.interpolation_cycles:
        _begin_period(axis)
        short = axis.interpolation_wanted != axis.interpolation_target
    if short and not limits.at_switch(axis, axis.interpolation_wanted - axis.position_demand):
        period = axis.interpolation_cycles * axis.position_period
        _within_reach(axis, axis.interpolation_start, axis.interpolation_wanted, period)
    axis.interpolation_cycle += 1
    late = axis.interpolation_cycle - axis.interpolation_cycles
    if late <= 0 or _bridged(axis, late):
        way = axis.interpolation_target - axis.interpolation_start
        share = axis.interpolation_cycle / axis.interpolation_cycles
        place = axis.interpolation_start + way * share
        axis.velocity_demand = axis.interpolation_velocity + offset
        if late > 0:
            period = axis.position_period
            place = limits.before_limit(
                axis, axis.position_demand, limits.clamp(axis, place), period
            )
            axis.velocity_demand = (place - axis.position_demand) / period + offset
        axis.position_demand = place
    else:
        if not axis.set_points_in_time:
            axis.position_demand = axis.interpolation_target
        axis.velocity_demand = offset
        axis.acceleration_demand = 0.0
        axis.interpolation_velocity = 0.0
    axis.target = axis.interpolation_target


@block
def _bridged(axis: Axis, late):
    """Whether the drive goes on at the last slope, `late` cycles after a set-point was due."""
    allowed = int(axis.od.set_point_loss_limit) * axis.interpolation_cycles
    if not axis.set_points_in_time or late > allowed:
        return False
    return not limits.at_switch(axis, axis.interpolation_velocity)


@block
def status(axis: Axis):
    """Bit 10 is reserved; drive_follows_command, following_error."""
    axis.mode_bit12 = energised(axis) and axis.stop == Stop.NONE
    axis.mode_bit13 = axis.following_error_exceeded
