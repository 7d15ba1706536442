"""The cascade controller: position P, velocity PI with anti-windup, torque limit and lag.

    velocity_command = feed_forward * velocity_demand + position_gain * (demand - actual)
    torque           = gain * e + integral + inertia * acceleration_demand + torque_offset

In a torque mode the demand goes straight to the limit; a speed limiter on the same velocity gain
takes torque away above the maximum motor speed, or a lower limit (2416h of some models).

The position loop runs once a position cycle, the velocity loop once a velocity cycle. The
integrator is updated with the torque that was really possible (back-calculation), so it never
winds up behind a limit. The current loop is a first-order lag, sampled exactly.
"""

from enum import IntEnum

from . import contacts
from .jit import block
from .record import Axis
from .words import Limit, State


class Control(IntEnum):
    """Which loop the demand feeds."""

    POSITION = 0
    VELOCITY = 1
    TORQUE = 2


@block
def torque_allowed(axis: Axis):
    """Whether the inputs that act on the transistors themselves let torque pass, in any state.

    Safe torque off (IEC 61800-5-2); the contact S1, where contacts are looked at.
    """
    return axis.sto_input and not (contacts.in_use(axis) and contacts.blocked(axis))


@block
def energised(axis: Axis):
    """Whether the motor is fed: enabled, in a quick stop or fault reaction, and torque allowed."""
    return torque_allowed(axis) and (
        axis.state == State.OPERATION_ENABLED
        or axis.state == State.QUICK_STOP_ACTIVE
        or axis.state == State.FAULT_REACTION_ACTIVE
    )


@block
def position_loop(axis: Axis):
    """Turn the demand of this position cycle into the velocity controller's command."""
    axis.velocity_correction = 0.0
    command = axis.velocity_demand
    if axis.control == Control.POSITION:
        error = axis.position_demand - axis.position
        if abs(error) > axis.dead_band:
            correction = axis.position_gain * error
            bound = axis.correction_limit
            axis.velocity_correction = min(max(correction, -bound), bound)
        command = axis.velocity_feed_forward * axis.velocity_demand + axis.velocity_correction
    axis.velocity_command = min(max(command, -axis.max_speed), axis.max_speed)
    if axis.velocity_command != command:
        axis.limits |= Limit.SPEED


@block
def velocity_loop(axis: Axis):
    """One velocity cycle: command and measured speed in (rad/s), shaft torque out (Nm)."""
    if not energised(axis):
        axis.velocity_integral = 0.0
        axis.torque_command = 0.0
        axis.torque = 0.0
        return
    error = axis.velocity_command - axis.velocity
    if axis.control == Control.TORQUE:
        wanted = _speed_limited(axis, axis.torque_demand + axis.torque_offset)
    else:
        wanted = (
            axis.velocity_gain * error
            + axis.velocity_integral
            + axis.inertia_feed_forward * axis.acceleration_demand
            + axis.torque_offset
        )
    possible = min(
        max(wanted, -min(axis.torque_limit_negative, axis.torque_ceiling)),
        min(axis.torque_limit_positive, axis.torque_ceiling),
    )
    if possible != wanted:
        axis.limits |= Limit.TORQUE
    if axis.control == Control.TORQUE:
        axis.velocity_integral = possible
    elif axis.velocity_gain > 0:
        axis.velocity_integral += (
            axis.velocity_period
            * axis.velocity_integral_gain
            * (error + (possible - wanted) / axis.velocity_gain)
        )
    axis.torque_command = possible
    axis.torque += axis.torque_filter * (possible - axis.torque)


@block
def _speed_limited(axis: Axis, torque):
    highest = axis.velocity_gain * (axis.torque_speed - axis.velocity)
    lowest = axis.velocity_gain * (-axis.torque_speed - axis.velocity)
    allowed = min(max(torque, lowest), highest)
    if allowed != torque:
        axis.limits |= Limit.SPEED
    return allowed
