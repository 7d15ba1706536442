"""Homing: each method is a few legs of a table, run by one small engine.

Source: CiA 402-2, homing methods. A leg travels in one direction until an event; the next leg
follows. The last leg latches: the event's exact encoder count, taken in the velocity cycle in which
it came, is the home position. Searching legs (`latch` 0) accept the event by level, so a run that
begins on the switch goes straight on; latching legs need the edge, while moving their own way.
Afterwards the zero position is the home position plus the home offset 607Ch (CiA 402-2).
"""

from enum import IntEnum

import numpy as np

from . import encoder
from .encoder import Event, Switch
from .jit import block
from .ramps import advance, close_position_loop, plan_velocity


class Progress(IntEnum):
    """What has become of homing since its last start."""

    IDLE = 0  # not started, or interrupted
    SEARCHING = 1
    STOPPING = 2  # home is found, the axis comes to rest
    ATTAINED = 3
    FAILED = 4


class HomingError(IntEnum):
    """Why homing failed or ended early."""

    NONE = 0
    INTERRUPTED = 1  # halt, or the start bit was taken back
    OPPOSITE_SWITCH = 2  # the limit switch at the wrong end came first
    NO_INDEX = 3  # more than two revolutions without an index pulse


# method, direction, slow (speed for zero, not for switch), until, latch
LEGS = (
    (1, -1, 0, Event.NEGATIVE_LIMIT_ON, 0),
    (1, +1, 1, Event.NEGATIVE_LIMIT_OFF, 0),
    (1, +1, 1, Event.INDEX, 1),
    (2, +1, 0, Event.POSITIVE_LIMIT_ON, 0),
    (2, -1, 1, Event.POSITIVE_LIMIT_OFF, 0),
    (2, -1, 1, Event.INDEX, 1),
    (17, -1, 0, Event.NEGATIVE_LIMIT_ON, 0),
    (17, +1, 1, Event.NEGATIVE_LIMIT_OFF, 1),
    (18, +1, 0, Event.POSITIVE_LIMIT_ON, 0),
    (18, -1, 1, Event.POSITIVE_LIMIT_OFF, 1),
    (33, -1, 1, Event.INDEX, 1),
    (34, +1, 1, Event.INDEX, 1),
)
HERE = (35, 37)  # the present position is home; nothing moves

METHOD, DIRECTION, SLOW, UNTIL, LATCH = np.array(LEGS, np.int64).T.copy()
FIRST = np.full(256, -1, np.int64)  # [method & 0xFF] -> first leg
for _row in range(len(LEGS) - 1, -1, -1):
    FIRST[METHOD[_row] & 0xFF] = _row
METHODS = tuple(sorted({*METHOD.tolist(), *HERE}))

INDEX_SEARCH = 2  # revolutions


@block
def start(axis):
    """Begin the method 6098h from wherever the axis is."""
    close_position_loop(axis)
    method = int(axis.od.homing_method)
    axis.homed = 0
    axis.homing_error = HomingError.NONE
    axis.homing = Progress.SEARCHING
    axis.homing_leg = FIRST[method & 0xFF]
    if axis.homing_leg < 0:
        _found(axis, axis.counts)
    else:
        _begin_leg(axis)


@block
def abandon(axis, error):
    """Note that a running homing ends without a result; who calls it stops the axis."""
    if axis.homing == Progress.SEARCHING or axis.homing == Progress.STOPPING:
        axis.homing = Progress.IDLE if error == HomingError.INTERRUPTED else Progress.FAILED
        axis.homing_error = error
        axis.latch_event = Event.NONE
        axis.homed = 0


@block
def interrupt(axis, error):
    """Abandon homing and come to rest with the homing acceleration."""
    abandon(axis, error)
    plan_velocity(axis, 0.0, axis.homing_acceleration, axis.homing_acceleration, axis.jerk)


@block
def demand(axis):
    """One position cycle of the engine."""
    advance(axis)
    if axis.homing == Progress.SEARCHING:
        _search(axis)
    elif axis.homing == Progress.STOPPING and axis.profile_done and axis.standstill:
        axis.homing = Progress.ATTAINED


@block
def _begin_leg(axis):
    leg = axis.homing_leg
    speed = axis.homing_speed_zero if SLOW[leg] else axis.homing_speed_switch
    rate = axis.homing_acceleration
    plan_velocity(axis, DIRECTION[leg] * speed, rate, rate, axis.jerk)
    axis.latched = 0
    axis.latch_event = Event.NONE
    axis.homing_start_counts = axis.counts


@block
def _search(axis):
    leg = axis.homing_leg
    direction, until = DIRECTION[leg], UNTIL[leg]
    ahead = Switch.POSITIVE_LIMIT if direction > 0 else Switch.NEGATIVE_LIMIT
    on_its_way = axis.velocity_demand * direction > 0
    if axis.latched:
        if LATCH[leg]:
            _found(axis, axis.latch_counts)
        else:
            _next_leg(axis)
    elif not LATCH[leg] and _is_now(axis, until):
        _next_leg(axis)
    elif axis.switches & ahead and on_its_way:
        interrupt(axis, HomingError.OPPOSITE_SWITCH)
    elif until == Event.INDEX and _too_far(axis):
        interrupt(axis, HomingError.NO_INDEX)
    elif on_its_way:
        axis.latch_event = until
    else:
        axis.latch_event = Event.NONE
        axis.homing_start_counts = axis.counts


@block
def _is_now(axis, until):
    if until == Event.INDEX:
        return False
    active = axis.switches & (1 << ((until - 1) >> 1)) != 0
    return active == (until & 1 == 1)


@block
def _too_far(axis):
    travelled = abs(axis.counts - axis.homing_start_counts) * axis.rad_per_increment
    return travelled > INDEX_SEARCH * 2 * np.pi


@block
def _next_leg(axis):
    axis.homing_leg += 1
    _begin_leg(axis)


@block
def _found(axis, counts):
    offset = int(np.floor(axis.home_offset / axis.rad_per_increment + 0.5))
    encoder.set_zero(axis, counts + offset)
    axis.latch_event = Event.NONE
    axis.latched = 0
    axis.homed = 1
    axis.homing = Progress.STOPPING
    rate = axis.homing_acceleration
    plan_velocity(axis, 0.0, rate, rate, axis.jerk)
