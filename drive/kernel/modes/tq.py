"""Profile torque: target torque 6071h, approached with the torque slope 6087h (CiA 402-2, tq)."""

from .. import limits
from ..cascade import Control, energised
from ..jit import block, rare


@rare
def start(axis):
    """Take over the torque that is acting."""
    if axis.control != Control.TORQUE:
        axis.torque_demand = axis.torque_command
    axis.control = Control.TORQUE
    axis.blocked = 0


@block
def demand(axis):
    """Ramp the torque demand (Nm); the offset 60B2h is added behind the ramp by the cascade."""
    goal = 0.0 if axis.halted else axis.target_torque  # halted here: a model that uses the slope
    axis.position_demand = axis.position
    if limits.brakes(axis, goal):
        axis.torque_demand = axis.torque_command
        return
    step = axis.torque_slope * axis.position_period
    axis.torque_demand += min(max(goal - axis.torque_demand, -step), step)


@block
def status(axis):
    """target_reached: the demand is there."""
    reached = energised(axis) and axis.torque_demand == axis.target_torque
    axis.mode_bit10 = axis.standstill if axis.halted else reached
