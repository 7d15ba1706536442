"""The cascade controller: position P, velocity PI with anti-windup, torque limit and lag.

    velocity_command = feed_forward * velocity_demand + position_gain * (demand - actual)
    torque           = gain * e + integral + inertia * acceleration_demand + torque_offset

In a torque mode the demand goes directly to the torque limit; a speed limiter with the velocity
gain reduces the torque above the maximum motor speed, or a lower limit (2416h of some models).

The position loop runs once a position cycle, the velocity loop once a velocity cycle. The
integrator is updated with the torque that was actually possible (back-calculation), so it never
winds up behind a limit. The current loop is a first-order lag, sampled exactly.

With another structure, filters, an observer or a winding with a voltage limit, and in torque modes,
the velocity loop is `_special`. The PID position controller of structure 1 computes the torque
set-point itself in every velocity cycle:

    torque = filters(P e + I integral of e + D de/dt + FFv * velocity_demand + FFa * acceleration)

Its D part uses a difference filtered with the time constant D / (10 P), as in maxon's EPOS4
(inferred), or the observer's speed.
"""

import math
from enum import IntEnum

from . import contacts, filters, observer, winding
from .jit import block
from .record import Axis
from .words import Limit, State


class Control(IntEnum):
    """Which loop the demand feeds."""

    POSITION = 0
    VELOCITY = 1
    TORQUE = 2


class Structure(IntEnum):
    """`AXIS.structure`: how a position error becomes torque."""

    CASCADE = 0  # P for the position, PI for the velocity
    PID = 1


PID_FILTER = 10.0  # P / D over the rate of the D part's low-pass


@block
def torque_allowed(axis: Axis):
    """Whether the inputs that act on the transistors directly allow torque, in any state.

    They are safe torque off (IEC 61800-5-2) and, if contacts are in use, contact S1.
    """
    return axis.sto_input and not (contacts.in_use(axis) and contacts.blocked(axis))


@block
def energised(axis: Axis):
    """Whether the motor has power: enabled, quick stop or fault reaction, and torque allowed."""
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
        ahead = axis.velocity_demand
        if axis.shaped:
            axis.feed_forward += axis.feed_forward_filter * (ahead - axis.feed_forward)
            ahead = axis.feed_forward
        command = axis.velocity_feed_forward * ahead + axis.velocity_correction
    axis.velocity_command = min(max(command, -axis.max_speed), axis.max_speed)
    if axis.velocity_command != command:
        axis.limits |= Limit.SPEED
    axis.special = axis.shaped or axis.control == Control.TORQUE


@block
def velocity_loop(axis: Axis):
    """One velocity cycle: command and measured speed in (rad/s), shaft torque out (Nm)."""
    if not energised(axis):
        axis.velocity_integral = 0.0
        axis.torque_command = 0.0
        axis.torque = 0.0
        if axis.shaped:
            _begin(axis)
        return
    if axis.special:
        _special(axis)
        return
    error = axis.velocity_command - axis.velocity
    wanted = _pi(axis, error) + axis.torque_offset
    possible = _limited(axis, wanted)
    _integrate(axis, error, possible - wanted)
    axis.torque_command = possible
    axis.torque += axis.torque_filter * (possible - axis.torque)


@block
def _pi(axis: Axis, error):
    """Torque (Nm) of the velocity controller with its acceleration feed-forward."""
    return (
        axis.velocity_gain * error
        + axis.velocity_integral
        + axis.inertia_feed_forward * axis.acceleration_demand
    )


@block
def _limited(axis: Axis, wanted):
    """The torque (Nm) within the limits of the drive."""
    possible = min(
        max(wanted, -min(axis.torque_limit_negative, axis.torque_ceiling)),
        min(axis.torque_limit_positive, axis.torque_ceiling),
    )
    if possible != wanted:
        axis.limits |= Limit.TORQUE
    return possible


@block
def _integrate(axis: Axis, error, missing):
    """The integrator of the velocity controller; `missing` is what the limits took away (Nm)."""
    if axis.velocity_gain > 0:
        axis.velocity_integral += (
            axis.velocity_period
            * axis.velocity_integral_gain
            * (error + missing / axis.velocity_gain)
        )


@block
def _begin(axis: Axis):
    """Without torque, continue the observer and reset the filters."""
    observer.run(axis)
    winding.follow(axis)
    filters.clear(axis)
    axis.feed_forward = axis.pid_difference = 0.0
    axis.pid_error = axis.position_demand - axis.position


@block
def _special(axis: Axis):
    """One velocity cycle of torque modes, other structures, filters, and the winding."""
    observer.run(axis)
    pid = axis.structure == Structure.PID and axis.control == Control.POSITION
    error = axis.velocity_command - axis.velocity
    if axis.control == Control.TORQUE:
        wanted = axis.torque_demand
    elif pid:
        # the demand moves on between two position cycles, or its steps would be kicks of the D part
        ahead = axis.velocity_cycle * axis.velocity_period * axis.velocity_demand
        error = axis.position_demand + ahead - axis.position
        wanted = _pid(axis, error)
    else:
        wanted = _pi(axis, error)
    if axis.shaped:
        wanted = filters.run(axis, wanted)
    wanted += axis.torque_offset
    if axis.control == Control.TORQUE:
        wanted = _speed_limited(axis, wanted)
    possible = _limited(axis, wanted)
    torque = axis.torque + axis.torque_filter * (possible - axis.torque)
    if axis.resistance > 0.0:
        lowest, highest = winding.torque_range(axis)
        if not lowest <= torque <= highest:
            torque = min(max(torque, lowest), highest)
            possible = min(max(possible, lowest), highest)
            axis.limits |= Limit.VOLTAGE
    if axis.control == Control.TORQUE:
        axis.velocity_integral = possible
    elif pid:
        if (possible - wanted) * error >= 0.0:  # a limit stops the integrator that pushes into it
            axis.velocity_integral += axis.velocity_period * axis.pid[1] * error
    else:
        _integrate(axis, error, possible - wanted)
    axis.torque_command = possible
    axis.torque = torque


@block
def _pid(axis: Axis, error):
    """Torque (Nm) of the PID position controller; its integral is `velocity_integral`."""
    difference = (error - axis.pid_error) / axis.velocity_period
    axis.pid_error = error
    axis.pid_difference += axis.pid_filter * (difference - axis.pid_difference)
    if axis.observer_gain[0] > 0.0:
        axis.pid_difference = axis.velocity_demand - axis.velocity
    return (
        axis.pid[0] * error
        + axis.velocity_integral
        + axis.pid[2] * axis.pid_difference
        + axis.pid_velocity * axis.velocity_demand
        + axis.inertia_feed_forward * axis.acceleration_demand
    )


@block
def receive(axis: Axis):
    """Set the parameters of `_special` from the objects."""
    od = axis.od
    axis.structure = od.control_structure
    axis.pid[0] = od.pid_gain * 1e-6
    axis.pid[1] = od.pid_integral_gain * 1e-3
    axis.pid[2] = od.pid_derivative_gain * 1e-6
    axis.pid_filter = 1.0
    if axis.pid[0] > 0.0 and axis.pid[2] > 0.0:
        rate = PID_FILTER * axis.pid[0] / axis.pid[2]
        axis.pid_filter = 1.0 - math.exp(-axis.velocity_period * rate)
    filtered, observed, limited = (
        filters.receive(axis),
        observer.receive(axis),
        winding.receive(axis),
    )
    other = axis.structure != Structure.CASCADE or od.feed_forward_filter_time > 0
    axis.shaped = other or filtered or observed or limited


@block
def _speed_limited(axis: Axis, torque):
    highest = axis.velocity_gain * (axis.torque_speed - axis.velocity)
    lowest = axis.velocity_gain * (-axis.torque_speed - axis.velocity)
    allowed = min(max(torque, lowest), highest)
    if allowed != torque:
        axis.limits |= Limit.SPEED
    return allowed
