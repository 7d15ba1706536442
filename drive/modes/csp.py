"""Cyclic synchronous position: the master's trajectory, one target a bus cycle (CiA 402-2, csp).

A set-point counts as new when process data were latched or 607Ah changed. The drive interpolates
linearly from the last demand to it over the interpolation time period 60C2h and then holds, so the
demand velocity is the slope of the master's own trajectory. Position and velocity offsets 60B0h and
60B1h are added; the torque offset 60B2h acts in the cascade.
"""

from .. import limits
from ..cascade import energised
from ..jit import block
from ..ramps import close_position_loop
from ..stop import Stop
from ..words import Limit

SMOOTHING = 0.25  # of the acceleration fed forward, per set-point: whole units make it coarse


@block
def start(axis):
    """Hold where the demand is until a new set-point comes."""
    close_position_loop(axis)
    hold(axis)


@block
def hold(axis):
    """End the interpolation at the present demand."""
    axis.interpolation_start = axis.position_demand
    axis.interpolation_target = axis.position_demand
    axis.interpolation_cycle = axis.interpolation_cycles
    axis.interpolation_velocity = 0.0


@block
def demand(axis):
    """Interpolate one position cycle further."""
    if axis.sync or axis.target_position != axis.last_target_position:
        wanted = limits.nearest_turn(axis, axis.target_position + axis.position_offset, 3)
        aim(axis, limits.clamp_target(axis, wanted))
    travel(axis, axis.velocity_offset)


@block
def aim(axis, target):
    """Make `target` (rad) the end of a new interpolation period, as far as limits let it."""
    start_at = axis.position_demand
    if limits.at_switch(axis, target - start_at):
        target = start_at
    period = axis.interpolation_cycles * axis.position_period
    farthest = axis.max_speed * period
    if abs(target - start_at) > farthest:
        axis.limits |= Limit.SPEED
        target = min(max(target, start_at - farthest), start_at + farthest)
    velocity = (target - start_at) / period
    acceleration = (velocity - axis.interpolation_velocity) / period
    axis.acceleration_demand += SMOOTHING * (acceleration - axis.acceleration_demand)
    axis.interpolation_velocity = velocity
    axis.interpolation_start = start_at
    axis.interpolation_target = target
    axis.interpolation_cycle = 0


@block
def travel(axis, offset):
    """Move the demand along the interpolation; `offset` (rad/s) is added to its velocity."""
    limits.show_clamped(axis)
    if axis.interpolation_cycle < axis.interpolation_cycles:
        axis.interpolation_cycle += 1
        way = axis.interpolation_target - axis.interpolation_start
        share = axis.interpolation_cycle / axis.interpolation_cycles
        axis.position_demand = axis.interpolation_start + way * share
        axis.velocity_demand = axis.interpolation_velocity + offset
    else:
        axis.position_demand = axis.interpolation_target
        axis.velocity_demand = offset
        axis.acceleration_demand = 0.0
        axis.interpolation_velocity = 0.0
    axis.target = axis.interpolation_target


@block
def status(axis):
    """Bit 10 is reserved; drive_follows_command, following_error."""
    axis.mode_bit10 = 0
    axis.mode_bit12 = energised(axis) and axis.stop == Stop.NONE
    axis.mode_bit13 = axis.following_error_exceeded
