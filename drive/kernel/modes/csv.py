"""Cyclic synchronous velocity: the master's velocity, one target a bus cycle (CiA 402-2, csv).

Between set-points the demand moves linearly over the interpolation time period 60C2h. The velocity
offset 60B1h is added. Where a limit is ahead the drive brakes on the quick stop ramp instead.
"""

from .. import limits
from ..cascade import Control, energised
from ..jit import block, rare
from ..ramps import NO_JERK_LIMIT
from ..record import Axis
from ..stop import Stop
from ..words import Latched, Limit


@rare
def start(axis: Axis):
    """Go on with the present demand velocity until a set-point comes."""
    if axis.control == Control.TORQUE:
        axis.velocity_demand = axis.velocity
    axis.control = Control.VELOCITY
    axis.blocked = 0
    axis.interpolation_start_velocity = axis.velocity_demand
    axis.interpolation_target_velocity = axis.velocity_demand
    axis.interpolation_cycle = axis.interpolation_cycles


@block
def demand(axis: Axis):
    """Interpolate one position cycle further, or brake before a limit."""
    wanted = axis.target_velocity + axis.velocity_offset
    goal = min(max(wanted, -axis.max_speed), axis.max_speed)
    if goal != wanted:
        axis.limits |= Limit.SPEED
    axis.position_demand = axis.position
    if limits.locked(axis, goal, axis.quick_stop_deceleration, NO_JERK_LIMIT):
        step = axis.quick_stop_deceleration * axis.position_period
        axis.velocity_demand -= min(max(axis.velocity_demand, -step), step)
        axis.interpolation_target_velocity = axis.velocity_demand
        axis.interpolation_cycle = axis.interpolation_cycles  # what has been cut off does not go on
        axis.acceleration_demand = 0.0
        return
    arrived = axis.interpolation_cycle >= axis.interpolation_cycles
    new = axis.sync or goal != axis.interpolation_target_velocity
    if axis.sync == Latched.CYCLIC or (arrived and new):
        axis.interpolation_start_velocity = axis.velocity_demand
        axis.interpolation_target_velocity = goal
        axis.interpolation_cycle = 0
    axis.acceleration_demand = 0.0
    if axis.interpolation_cycle < axis.interpolation_cycles:
        axis.interpolation_cycle += 1
        change = axis.interpolation_target_velocity - axis.interpolation_start_velocity
        share = axis.interpolation_cycle / axis.interpolation_cycles
        axis.velocity_demand = axis.interpolation_start_velocity + change * share
        axis.acceleration_demand = change / (axis.interpolation_cycles * axis.position_period)


@block
def status(axis: Axis):
    """Bits 10 and 13 are reserved; drive_follows_command."""
    axis.mode_bit12 = energised(axis) and axis.stop == Stop.NONE
