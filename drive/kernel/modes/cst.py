"""Cyclic synchronous torque: the target torque 6071h acts as it comes (CiA 402-2, cst)."""

from .. import limits
from ..cascade import Control, energised
from ..jit import block
from ..stop import Stop


@block
def start(axis):
    """Let the torque command through."""
    axis.control = Control.TORQUE


@block
def demand(axis):
    """The target torque (Nm); the offset 60B2h is added by the cascade."""
    axis.torque_demand = 0.0 if limits.at_switch(axis, axis.target_torque) else axis.target_torque
    axis.position_demand = axis.position
    axis.velocity_demand = axis.velocity


@block
def status(axis):
    """Bits 10 and 13 are reserved; drive_follows_command."""
    axis.mode_bit10 = 0
    axis.mode_bit12 = energised(axis) and axis.stop == Stop.NONE
    axis.mode_bit13 = 0
