"""Homing: every method is a few legs of a table, run by one small engine.

Source: CiA 402-2, homing methods 1-14, 17-30, 33-35, 37; methods -1, -2, -17, -18 (on a mechanical
stop) as the Festo CMMP-AS and Metronix ARS 2000 manuals number them. A leg travels in one direction
until an event, then the next leg follows. The last leg latches: the exact encoder count of its
event, taken in the velocity cycle in which it came, is the home position.

- Switches are searched for at the faster speed 6099h:01 and accepted by level, so a run that begins
  on the switch goes straight on. A switch that is left, and every edge that is latched, has to
  change while the axis moves the leg's own way.
- The edge that counts is always met at the slower speed 6099h:02: where the standard's path meets
  it in the direction of the search, the axis passes it and comes back (inferred).
- A limit switch on the way either reverses the search (methods 7-14, 23-30) or ends it in error.
- An index pulse right at the edge may be the next one in another run. Where it lies nearer than a
  sixteenth of a revolution the drive warns, as long as it stays in homing mode: move the switch, or
  turn the coupling, by half a revolution.
- Afterwards the zero position is the home position plus the home offset 607Ch (CiA 402-2).
"""

import math
from collections.abc import Mapping
from enum import IntEnum

import numpy as np

from . import encoder
from .encoder import Event, Switch
from .faults import Cause, raise_fault
from .jit import block
from .ramps import advance, close_position_loop, plan_position, plan_velocity, profile_jerk, rest
from .record import MAKER_LEGS, MAKER_METHODS
from .words import Compatibility


class Progress(IntEnum):
    """Progress of homing since its last start."""

    IDLE = 0  # not started, or interrupted
    SEARCHING = 1
    STOPPING = 2  # home is found, the axis comes to rest
    ATTAINED = 3
    FAILED = 4
    TO_ZERO = 5  # home is found, the axis travels to the zero position (some models)


class HomingError(IntEnum):
    """Why homing failed or ended early."""

    NONE = 0
    INTERRUPTED = 1  # halt, quick stop, a change of mode, or the start bit was taken back
    LIMIT_SWITCH = 2  # a limit switch that should not come on this way, or came twice
    NO_INDEX = 3  # more than two revolutions without an index pulse
    TIMEOUT = 4  # 2012h:03
    SPEED_ZERO = 5  # a homing speed 6099h is zero, the search could never end
    UNKNOWN_METHOD = 6
    HALTED = 7  # only of models where halt ends homing in error


# cause of a fault by HomingError, which a model may react to
CAUSE = np.array(
    [
        {
            HomingError.INTERRUPTED: int(Cause.HOMING_INTERRUPTED),
            HomingError.LIMIT_SWITCH: int(Cause.HOMING_SWITCH),
            HomingError.NO_INDEX: int(Cause.HOMING_INDEX),
            HomingError.TIMEOUT: int(Cause.HOMING_TIMEOUT),
            HomingError.HALTED: int(Cause.HOMING_INTERRUPTED),
        }.get(error, 0)
        for error in HomingError
    ]
)


END = -1  # next leg: home is found
ERROR = -2  # limit switch on the way: homing fails
FAST, SLOW, OWN = 0, 1, 2  # 6099h:01, 6099h:02, the object of a drive model's own
_HOME_ON, _HOME_OFF = Event.HOME_ON, Event.HOME_OFF

# Methods that find an edge. method: (leg where home switch is off, leg where it is on, legs)
# leg: (direction, speed, until, next leg, leg after a limit switch on the way)
_EDGE = {
    17: (0, 0, [(-1, FAST, Event.NEGATIVE_LIMIT_ON, 1, ERROR),
                (+1, SLOW, Event.NEGATIVE_LIMIT_OFF, END, ERROR)]),
    19: (0, 2, [(+1, FAST, _HOME_ON, 1, ERROR),
                (-1, SLOW, _HOME_OFF, END, ERROR),
                (-1, FAST, _HOME_OFF, 0, ERROR)]),
    20: (0, 1, [(+1, FAST, _HOME_ON, 1, ERROR),
                (-1, FAST, _HOME_OFF, 2, ERROR),
                (+1, SLOW, _HOME_ON, END, ERROR)]),
    23: (0, 2, [(+1, FAST, _HOME_ON, 3, 1),
                (-1, FAST, _HOME_ON, 2, ERROR),
                (-1, FAST, _HOME_OFF, 0, ERROR),
                (-1, SLOW, _HOME_OFF, END, ERROR)]),
    24: (0, 2, [(+1, FAST, _HOME_ON, 2, 1),
                (-1, FAST, _HOME_ON, 2, ERROR),
                (-1, FAST, _HOME_OFF, 3, ERROR),
                (+1, SLOW, _HOME_ON, END, ERROR)]),
    25: (0, 2, [(+1, FAST, _HOME_ON, 2, 1),
                (-1, FAST, _HOME_ON, 2, ERROR),
                (+1, FAST, _HOME_OFF, 3, ERROR),
                (-1, SLOW, _HOME_ON, END, ERROR)]),
    26: (0, 2, [(+1, FAST, _HOME_ON, 2, 1),
                (-1, FAST, _HOME_ON, 3, ERROR),
                (+1, FAST, _HOME_OFF, 1, 1),
                (+1, SLOW, _HOME_OFF, END, ERROR)]),
}
_MIRROR = {17: 18, 19: 21, 20: 22, 23: 27, 24: 28, 25: 29, 26: 30}
_MIRRORED_EVENT = {
    Event.NEGATIVE_LIMIT_ON: Event.POSITIVE_LIMIT_ON,
    Event.NEGATIVE_LIMIT_OFF: Event.POSITIVE_LIMIT_OFF,
}
# Methods without a switch.
_PLAIN = {
    33: (0, 0, [(-1, SLOW, Event.INDEX, END, ERROR)]),
    34: (0, 0, [(+1, SLOW, Event.INDEX, END, ERROR)]),
    -17: (0, 0, [(-1, SLOW, Event.STOP, END, ERROR)]),
    -18: (0, 0, [(+1, SLOW, Event.STOP, END, ERROR)]),
    -1: (0, 0, [(-1, SLOW, Event.STOP, 1, ERROR), (+1, SLOW, Event.INDEX, END, ERROR)]),
    -2: (0, 0, [(+1, SLOW, Event.STOP, 1, ERROR), (-1, SLOW, Event.INDEX, END, ERROR)]),
}
HERE = (35, 37)  # the present position is home; nothing moves


def _mirrored(method):
    off, on, legs = method
    return off, on, [
        (-direction, speed, _MIRRORED_EVENT.get(until, until), following, limit)
        for direction, speed, until, following, limit in legs
    ]


def _to_index(method):
    """Methods 1-14 are 17-30 continued in the same direction to the first index pulse."""
    off, on, legs = method
    index = len(legs)
    direction = next(leg[0] for leg in legs if leg[3] == END)
    edges = [(*leg[:3], index if leg[3] == END else leg[3], leg[4]) for leg in legs]
    return off, on, [*edges, (direction, SLOW, Event.INDEX, END, ERROR)]


_edge = _EDGE | {_MIRROR[number]: _mirrored(method) for number, method in _EDGE.items()}
METHODS = {
    **{number - 16: _to_index(method) for number, method in _edge.items()},
    **_edge,
    **_PLAIN,
}
NUMBERS = tuple(sorted({*METHODS, *HERE}))

# first leg with the home switch off, first leg with it on, legs
Method = tuple[int, int, list[tuple[int, int, int, int, int]]]


def _table(
    methods: Mapping[int, Method], base: int = 0
) -> tuple[dict[int, tuple[int, int]], list[tuple[int, ...]]]:
    """Rows of the first legs by method, and all rows; jumps are row numbers from `base` on."""
    first: dict[int, tuple[int, int]] = {}
    rows: list[tuple[int, ...]] = []
    for number, (off, on, legs) in methods.items():
        here = base + len(rows)
        first[number] = here + off, here + on
        for leg in legs:
            rows.append((*leg[:3], *(here + jump if jump >= 0 else jump for jump in leg[3:])))
    return first, rows


# The same as arrays for the kernel: one row a leg.
_first, _rows = _table(METHODS)
FIRST = np.full((2, 256), ERROR, np.int64)  # [home switch active, method & 0xFF] -> row
FIRST[:, HERE] = END
for _number, _places in _first.items():
    FIRST[:, _number & 0xFF] = _places
LEGS = np.array(_rows, np.int64)
DIRECTION, SPEED, UNTIL, NEXT, AT_LIMIT = range(5)  # its columns
STANDARD_LEGS = len(LEGS)
LAST_LEG = STANDARD_LEGS + MAKER_LEGS - 1


def with_own(axis, methods: Mapping[int, Method]) -> None:
    """Write the homing methods that a drive model defines to a record."""
    first, rows = _table(methods, STANDARD_LEGS)
    axis.maker_method[: len(first)] = [*first]
    axis.maker_first[: 2 * len(first)] = [place for pair in first.values() for place in pair]
    axis.maker_leg[: 5 * len(rows)] = [cell for row in rows for cell in row]


INDEX_SEARCH = 2  # revolutions
INDEX_MARGIN = 1 / 16  # revolution from the edge to the index pulse, at least (inferred)


@block
def start(axis):
    """Begin the method 6098h from wherever the axis is."""
    close_position_loop(axis)
    axis.homed = 0
    axis.homing_error = HomingError.NONE
    axis.index_near = 0
    axis.homing = Progress.SEARCHING
    axis.homing_cycles = 0
    row = _first_leg(axis, 1 if axis.switches & Switch.HOME else 0)
    if row == END:
        _found(axis, axis.counts)
    elif row == ERROR:
        interrupt(axis, HomingError.UNKNOWN_METHOD)
    elif axis.homing_speed_switch <= 0.0 or axis.homing_speed_zero <= 0.0:
        interrupt(axis, HomingError.SPEED_ZERO)
    else:
        _begin_leg(axis, row)


@block
def _first_leg(axis, on_home):
    """Row of the leg with which the method begins; END or ERROR where there is none."""
    method = _method(axis)
    row = FIRST[on_home, method & 0xFF]
    if row == ERROR and method != 0:
        for k in range(MAKER_METHODS):
            if axis.maker_method[k] == method:
                row = int(axis.maker_first[2 * k + on_home])
    return row


@block
def _leg(axis, row, column):
    """A cell of the table of legs; legs of the drive model follow those of the standard."""
    row = min(max(row, 0), LAST_LEG)  # a program may have written the record
    if row < STANDARD_LEGS:
        return LEGS[row, column]
    return int(axis.maker_leg[5 * (row - STANDARD_LEGS) + column])


@block
def _method(axis):
    """6098h; some models number 33-35 one lower until compatibility_control says otherwise."""
    method = int(axis.od.homing_method)
    standard = axis.od.compatibility_control & Compatibility.HOMING_METHOD_SCHEME
    if axis.old_homing_numbers and not standard and 32 <= method <= 34:
        return method + 1
    return method


@block
def abandon(axis, error):
    """End a running homing without a result; the caller stops the axis."""
    if busy(axis):
        axis.homing_error = error
        cause = CAUSE[axis.homing_error]
        if cause != Cause.NONE:
            raise_fault(axis, cause)
        axis.homing = Progress.IDLE if error == HomingError.INTERRUPTED else Progress.FAILED
        axis.latch_event = Event.NONE
        axis.homed = 0


@block
def interrupt(axis, error):
    """Abandon homing and come to rest with the homing acceleration."""
    abandon(axis, error)
    plan_velocity(axis, 0.0, axis.homing_acceleration, axis.homing_acceleration, profile_jerk(axis))


@block
def demand(axis):
    """One position cycle of the engine."""
    advance(axis)
    if axis.index_near:
        raise_fault(axis, Cause.INDEX_NEAR)
    if axis.homing == Progress.SEARCHING:
        axis.homing_cycles += 1
        _search(axis)
        if axis.homing_timeout_cycles and axis.homing_cycles > axis.homing_timeout_cycles:
            interrupt(axis, HomingError.TIMEOUT)
    elif axis.homing == Progress.STOPPING and axis.profile_done and axis.standstill:
        if axis.od.compatibility_control & Compatibility.HOMING_TO_ZERO:
            axis.homing = Progress.TO_ZERO
            rate = axis.homing_acceleration
            speed = axis.homing_speed_switch
            plan_position(axis, 0.0, speed, 0.0, math.inf, rate, rate, profile_jerk(axis))
        else:
            axis.homing = Progress.ATTAINED
    elif axis.homing == Progress.TO_ZERO and axis.profile_done and axis.standstill:
        axis.homing = Progress.ATTAINED


@block
def busy(axis):
    """Whether a homing has been started and has not ended yet."""
    now = axis.homing
    return now == Progress.SEARCHING or now == Progress.STOPPING or now == Progress.TO_ZERO


@block
def pushing(axis):
    """Whether the axis is moving against a mechanical stop, with the torque of 2012h:01."""
    return axis.homing == Progress.SEARCHING and _leg(axis, axis.homing_leg, UNTIL) == Event.STOP


@block
def _begin_leg(axis, row):
    axis.homing_leg = row
    kind, speed = _leg(axis, row, SPEED), axis.homing_speed_switch
    if kind == SLOW:
        speed = axis.homing_speed_zero
    elif kind == OWN:
        speed = axis.homing_speed_own
    if speed <= 0.0:
        interrupt(axis, HomingError.SPEED_ZERO)
        return
    rate = axis.homing_acceleration
    plan_velocity(axis, _leg(axis, row, DIRECTION) * speed, rate, rate, profile_jerk(axis))
    axis.latched = 0
    axis.latch_event = Event.NONE
    axis.homing_start_counts = axis.counts
    axis.stop_timer = 0


@block
def _search(axis):
    row = axis.homing_leg
    direction, until = _leg(axis, row, DIRECTION), _leg(axis, row, UNTIL)
    ahead = Switch.POSITIVE_LIMIT if direction > 0 else Switch.NEGATIVE_LIMIT
    on_its_way = axis.velocity_demand * direction > 0
    if axis.latched or _reached(axis, row, until):
        _next_leg(axis, row)
    elif axis.switches & ahead and on_its_way and until != Event.STOP:
        turn = _leg(axis, row, AT_LIMIT)
        if turn == ERROR:
            interrupt(axis, HomingError.LIMIT_SWITCH)
        else:
            _begin_leg(axis, turn)
    elif until == Event.INDEX and _too_far(axis):
        interrupt(axis, HomingError.NO_INDEX)
    elif on_its_way:
        axis.latch_event = until
    else:
        axis.latch_event = Event.NONE
        axis.homing_start_counts = axis.counts


@block
def _reached(axis, row, until):
    """Whether an event without an exact count has come: a switch, or a mechanical stop."""
    if until == Event.STOP:
        return _at_stop(axis)
    if until == Event.INDEX or until & 1 == 0 or _leg(axis, row, NEXT) == END:
        return False
    return axis.switches & (1 << ((until - 1) >> 1)) != 0


@block
def _at_stop(axis):
    """Whether the axis stands against the torque limit of 2012h:01 for the time of 2012h:02."""
    blocked = axis.standstill and abs(axis.torque_command) >= 0.99 * axis.homing_torque
    axis.stop_timer = axis.stop_timer + 1 if blocked else 0
    if axis.stop_timer <= axis.homing_stop_cycles:
        return False
    axis.latch_counts = axis.counts
    axis.velocity_integral = 0.0  # it pushes against the stop: a springy axis would wait for it
    rest(axis)
    return True


@block
def _too_far(axis):
    travelled = abs(axis.counts - axis.homing_start_counts) * axis.rad_per_increment
    return travelled > INDEX_SEARCH * 2 * math.pi


@block
def _next_leg(axis, row):
    following = _leg(axis, row, NEXT)
    if following == END:
        if _leg(axis, row, UNTIL) == Event.INDEX and row != _first_leg(axis, 0):
            _look_at_index(axis)
        _found(axis, axis.latch_counts)
    else:
        _begin_leg(axis, following)


@block
def _look_at_index(axis):
    """Measure the distance from edge or stop to the index pulse; near 0 and 1 turns, warn."""
    way = abs(axis.latch_counts - axis.homing_start_counts) * axis.rad_per_increment
    turns = way / (2 * math.pi)
    axis.od.homing_index_distance = int(min(1000.0 * turns, 65535.0))
    axis.index_near = not INDEX_MARGIN <= turns <= 1.0 - INDEX_MARGIN


@block
def _found(axis, counts):
    offset = int(math.floor(axis.home_offset / axis.rad_per_increment + 0.5))
    encoder.set_zero(axis, counts + offset)
    axis.latch_event = Event.NONE
    axis.latched = 0
    axis.homed = 1
    axis.homing = Progress.STOPPING
    rate = axis.homing_acceleration
    plan_velocity(axis, 0.0, rate, rate, profile_jerk(axis))
