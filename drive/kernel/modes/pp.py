"""Profile position: set-points handed over by handshake, travelled as ramps (CiA 402-2, pp).

A rising edge of new_set_point (bit 4) puts target and profile parameters as they are now into the
buffer and sets set_point_acknowledge (bit 12). The bit falls when the master has taken
new_set_point back and the buffer has room again. change_set_immediately (bit 5) throws away what is
buffered and starts at once from the present demand; otherwise set-points queue up, and with
change_on_set_point (bit 9) the axis passes the running target at its profile velocity. A relative
set-point (bit 6) counts from what 60F2h says, by default the preceding target.
"""

from .. import limits, monitor, stop
from ..cascade import energised
from ..faults import Cause, raise_fault
from ..jit import block, rare
from ..ramps import advance, close_position_loop, plan_position, plan_velocity, profile_jerk
from ..record import SET_POINTS, Axis
from ..words import Controlword


@block
def forget(axis: Axis):
    """Drop all set-points."""
    axis.set_points = 0
    axis.acknowledged = 0


@block
def handshake(axis: Axis, controlword, bit4):
    """Accept a set-point on the rising edge of bit 4, acknowledge with bit 12."""
    if bit4 and not axis.bit4:
        if controlword & Controlword.CHANGE_SET_IMMEDIATELY:
            axis.set_points = 0
        elif axis.set_points == 1 and controlword & Controlword.CHANGE_ON_SET_POINT:
            axis.set_point_end_speed[0] = axis.set_point_speed[0]
            axis.set_point_started = 0
        if axis.set_points < _capacity(axis):
            _accept(axis, controlword)
            axis.acknowledged = 1
    elif not bit4:
        axis.acknowledged = 1 if axis.set_points >= _capacity(axis) else 0


@block
def _capacity(axis: Axis):
    return int(axis.set_point_capacity) if axis.set_point_capacity else SET_POINTS


@block
def _accept(axis: Axis, controlword):
    i = axis.set_points
    axis.set_point_position[i] = axis.target_position
    axis.set_point_relative[i] = 1 if controlword & Controlword.RELATIVE else 0
    axis.set_point_speed[i] = axis.profile_speed
    axis.set_point_end_speed[i] = axis.end_speed
    axis.set_point_acceleration[i] = axis.acceleration
    axis.set_point_deceleration[i] = axis.deceleration
    for j in range(len(axis.jerk)):
        axis.set_point_jerk[i, j] = axis.jerk[j]
    axis.set_points = i + 1
    if i == 0:
        axis.set_point_started = 0
        axis.window_timer = 0


@rare
def start(axis: Axis):
    """Take over: go on with the set-point in hand, or come to rest."""
    close_position_loop(axis)
    axis.set_point_started = 0
    plan_velocity(axis, 0.0, axis.deceleration, axis.deceleration, profile_jerk(axis))


@block
def demand(axis: Axis):
    """Start what waits, travel it, and go to the next set-point at its end."""
    limits.show_clamped(axis)
    going = axis.set_points > 0 or axis.profile_end_velocity != 0.0
    if limits.at_switch(axis, axis.velocity_demand) and going:
        forget(axis)
        stop.at_limit_switch(axis)
    if axis.set_points > 0 and not axis.set_point_started:
        _begin(axis)
    advance(axis)
    if axis.profile_done and axis.set_points > 0:
        _drop_first(axis)
        if axis.set_points > 0:
            _begin(axis)
        elif axis.velocity_demand != 0.0:  # passed at the end velocity, and nothing follows
            raise_fault(axis, Cause.FOLLOW_UP_MISSING)
            plan_velocity(axis, 0.0, axis.deceleration, axis.deceleration, profile_jerk(axis))


@block
def _begin(axis: Axis):
    target = axis.set_point_position[0]
    if axis.set_point_relative[0]:
        target += _origin(axis)
    else:
        target = limits.meant(axis, target)
    axis.set_point_relative[0] = 0
    axis.set_point_position[0] = target
    axis.set_point_started = 1
    if limits.suppressed(axis, target):
        _drop_first(axis)
        return
    axis.target = limits.clamp_target(axis, target)
    if limits.at_switch(axis, axis.target - axis.position_demand):
        _drop_first(axis)
        return
    plan_position(
        axis,
        axis.target,
        axis.set_point_speed[0],
        axis.set_point_end_speed[0],
        limits.room(axis, axis.target, axis.target - axis.position_demand),
        axis.set_point_acceleration[0],
        axis.set_point_deceleration[0],
        (
            axis.set_point_jerk[0, 0],
            axis.set_point_jerk[0, 1],
            axis.set_point_jerk[0, 2],
            axis.set_point_jerk[0, 3],
        ),
    )


@block
def _origin(axis: Axis):
    """What a relative set-point counts from: 60F2h bits 0-1."""
    option = int(axis.od.positioning_option_code) & 3
    if option == 1:
        return axis.position_demand
    if option == 2:
        return axis.position
    return axis.target


@block
def _drop_first(axis: Axis):
    axis.set_points -= 1
    axis.set_point_started = 0
    axis.window_timer = 0
    for i in range(axis.set_points):
        axis.set_point_position[i] = axis.set_point_position[i + 1]
        axis.set_point_relative[i] = axis.set_point_relative[i + 1]
        axis.set_point_speed[i] = axis.set_point_speed[i + 1]
        axis.set_point_end_speed[i] = axis.set_point_end_speed[i + 1]
        axis.set_point_acceleration[i] = axis.set_point_acceleration[i + 1]
        axis.set_point_deceleration[i] = axis.set_point_deceleration[i + 1]
        for j in range(len(axis.jerk)):
            axis.set_point_jerk[i, j] = axis.set_point_jerk[i + 1, j]


@block
def status(axis: Axis):
    """target_reached, set_point_acknowledge, following_error."""
    deviation = axis.target - axis.position
    inside = monitor.in_window(axis, deviation, axis.position_window, axis.position_window_cycles)
    arrived = energised(axis) and axis.set_points == 0 and inside
    axis.mode_bit10 = axis.standstill if axis.halted else arrived
    axis.mode_bit12 = axis.acknowledged
    axis.mode_bit13 = axis.following_error_exceeded
