"""Velocity mode of frequency inverters: vl target velocity 6042h with ramps (CiA 402-2, vl).

Acceleration and deceleration are a change of speed over a time, 6048h and 6049h. Controlword bit 4
enable_ramp = 0 stops on the quick stop ramp 604Ah, bit 5 unlock_ramp = 0 freezes the ramp's output,
bit 6 reference_ramp = 0 sets its input to zero. The set-point factor 604Bh multiplies the target,
the amounts 6046h bound it from below and above, the dimension factor 604Ch makes 1/min of it.
"""

from .. import limits
from ..cascade import Control, energised
from ..jit import block, rare
from ..ramps import DOWN, NO_JERK_LIMIT, QUICK_STOP, UP, advance, plan_velocity, vl_rate
from ..record import Axis
from ..words import Controlword

RAMP = Controlword.NEW_SET_POINT | Controlword.CHANGE_SET_IMMEDIATELY | Controlword.RELATIVE


@rare
def start(axis: Axis):
    """Take over the present demand velocity."""
    if axis.control == Control.TORQUE:
        axis.velocity_demand = axis.velocity
    axis.acceleration_demand = 0.0
    axis.control = Control.VELOCITY
    axis.blocked = 0
    rate = vl_rate(axis, DOWN, axis.velocity_demand)
    plan_velocity(axis, 0.0, rate, rate, NO_JERK_LIMIT)


@block
def demand(axis: Axis):
    """Travel the ramp towards the target, unless the controlword stops or freezes it."""
    controlword = int(axis.od.controlword)
    axis.position_demand = axis.position
    goal = -axis.vl_target if axis.reverse else axis.vl_target
    way = axis.velocity_demand if axis.velocity_demand != 0.0 else goal
    deceleration, quick = vl_rate(axis, DOWN, way), vl_rate(axis, QUICK_STOP, way)
    acceleration = vl_rate(axis, UP, goal if goal != 0.0 else way)
    if axis.vl_without_ramp_bits:
        controlword = RAMP
    if not controlword & Controlword.NEW_SET_POINT:
        goal, deceleration = 0.0, quick
    elif not controlword & Controlword.CHANGE_SET_IMMEDIATELY:
        axis.acceleration_demand = 0.0
        plan_velocity(axis, axis.velocity_demand, acceleration, deceleration, NO_JERK_LIMIT)
        return
    elif not controlword & Controlword.RELATIVE:
        goal = 0.0
    if limits.locked(axis, goal, quick, NO_JERK_LIMIT):
        goal, deceleration = 0.0, quick
    if goal != axis.profile_end_velocity or deceleration != axis.ramp_rate:
        axis.ramp_rate = deceleration
        plan_velocity(axis, goal, acceleration, deceleration, NO_JERK_LIMIT)
    advance(axis)
    axis.position_demand = axis.position


@block
def status(axis: Axis):
    """target_reached: the ramp has ended (inferred), or with `vl_window_bit` the speed is there."""
    axis.mode_bit10 = axis.standstill if axis.halted else energised(axis) and axis.profile_done
    if axis.vl_window_bit:
        deviation = (-axis.vl_target if axis.reverse else axis.vl_target) - axis.velocity
        axis.mode_bit10 = energised(axis) and abs(deviation) <= axis.vl_window
