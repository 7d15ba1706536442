"""Cyclic synchronous torque: the target torque 6071h acts as it comes (CiA 402-2, cst)."""

from .. import limits
from ..cascade import Control, energised
from ..jit import block, rare
from ..stop import Stop


@rare
def start(axis):
    """Let the torque command through."""
    axis.control = Control.TORQUE
    axis.blocked = 0


@block
def demand(axis):
    """The target torque (Nm); the offset 60B2h is added by the cascade."""
    axis.position_demand = axis.position
    braking = limits.brakes(axis, axis.target_torque)
    axis.torque_demand = axis.torque_command if braking else axis.target_torque


@block
def status(axis):
    """Bits 10 and 13 are reserved; drive_follows_command."""
    follows = axis.stop == Stop.NONE and axis.control == Control.TORQUE
    axis.mode_bit12 = energised(axis) and follows
