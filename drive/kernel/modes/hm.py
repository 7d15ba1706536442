"""Homing mode: start and interruption by controlword bit 4, and the bits that tell how it went.

Statusword (CiA 402-2, hm): bits 13/12/10 = 000 in progress, 001 interrupted or not started, 010
attained but still moving, 011 done, 100 error and moving, 101 error and at rest.
"""

from .. import homing
from ..homing import HomingError, Progress
from ..jit import block, rare
from ..ramps import close_position_loop, plan_velocity, profile_jerk
from ..words import Controlword


@rare
def start(axis):
    """Come to rest and wait for the start bit."""
    close_position_loop(axis)
    rate = axis.homing_acceleration
    plan_velocity(axis, 0.0, rate, rate, profile_jerk(axis))


@block
def demand(axis):
    """Rising edge of bit 4 starts, falling edge interrupts, the engine moves."""
    bit4 = int(axis.od.controlword) & Controlword.NEW_SET_POINT
    running = homing.busy(axis)
    if bit4 and not axis.bit4:
        homing.start(axis)
    elif running and not bit4:
        homing.interrupt(axis, HomingError.INTERRUPTED)
    homing.demand(axis)


@block
def status(axis):
    """target_reached, homing_attained, homing_error."""
    axis.mode_bit10 = axis.standstill and not homing.busy(axis)
    axis.mode_bit12 = axis.homing == Progress.STOPPING or axis.homing == Progress.ATTAINED
    axis.mode_bit13 = axis.homing == Progress.FAILED
