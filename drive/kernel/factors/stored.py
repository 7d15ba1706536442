"""Stored values that keep their meaning when a factor or the polarity changes.

In models with `values_keep_meaning` an object stores a value, not its number: after the change it
shows the same value in the new units (Metronix ARS 2000 6.3.1, 6.3.2.5; Festo CMMP-AS 5.3). Kept is
each value as it was written, with the unit of then, so that rounding for the eye moves nothing.
"""

import math
from enum import IntEnum

import numpy as np

from ..jit import block
from ..record import KINDS, OWN_STORED, Axis
from .units import EXACT, Kind, product

OFF = 0xFFFFFFFF  # a window of this size is switched off
WRITTEN = -(1 << 62)  # in `kept_shown`: no number equals it
FARTHEST = 2.0**33  # beyond what any object shows


class Stored(IntEnum):
    """Values a master stores in these units: place in `AXIS.kept_raw`, named as the field of `od`.

    Values of an array lie one behind the other.
    """

    TARGET_POSITION = 0
    POSITION_OFFSET = 1
    HOME_OFFSET = 2
    INTERPOLATION_DATA_RECORD = 3
    SET_POSITION = 4
    SOFTWARE_POSITION_LIMIT = 5
    POSITION_RANGE_LIMIT = 7
    TARGET_VELOCITY = 9
    VELOCITY_OFFSET = 10
    FOLLOWING_ERROR_WINDOW = 11
    POSITION_WINDOW = 12
    POSITION_ERROR_LIMIT = 13
    POSITION_ERROR_TOLERANCE = 14
    MAX_PROFILE_VELOCITY = 15
    PROFILE_VELOCITY = 16
    END_VELOCITY = 17
    HOMING_SPEEDS = 18
    MAX_SLIPPAGE = 20
    VELOCITY_WINDOW = 21
    VELOCITY_THRESHOLD = 22
    POSITION_CONTROL_V_MAX = 23
    PROFILE_ACCELERATION = 24
    PROFILE_DECELERATION = 25
    MAX_ACCELERATION = 26
    MAX_DECELERATION = 27
    QUICK_STOP_DECELERATION = 28
    HOMING_ACCELERATION = 29
    LIMIT_SWITCH_DECELERATION = 30
    PROFILE_JERK = 31
    VELOCITY_RAMPS = 35
    LIMIT_SPEED = 39
    OWN = 40  # objects of the model without kernel behaviour


_S, _K = Stored, Kind
_I = np.int64  # one type for all numbers: what takes them is compiled once


@block
def follow(axis: Axis):
    """Show what is stored in the units that are in force now, if they are others than before."""
    od = axis.od
    position, velocity = axis.rad_per_position_unit, axis.rad_s_per_velocity_unit
    new = (position, velocity, abs(position), abs(velocity), axis.rad_s2_per_acceleration_unit)
    known, changed = axis.unit[Kind.WIDTH] > 0.0, False
    for kind in range(KINDS):
        if not abs(new[kind]) < math.inf or new[kind] == 0.0:
            return  # a factor of 0 makes no unit
        changed = changed or axis.unit[kind] != new[kind]
    if not changed:
        return
    increments, turns = od.position_encoder_resolution
    a, b = product(axis.position_denominator, axis.position_numerator, turns, increments)
    if axis.older_factor_group:
        speed, rate = od.velocity_encoder_factor, od.acceleration_factor
        c, d = product(speed[0], speed[1], 1, 4096 * 60)
        e, f = product(rate[0], rate[1], 1, 256 * 60)
    else:
        c, d = product(a, b, od.velocity_factor[0], od.velocity_factor[1])
        e, f = product(a, b, od.acceleration_factor[0], od.acceleration_factor[1])
    numerators = (-a if new[0] < 0.0 else a, -c if new[1] < 0.0 else c, a, c, e)
    denominators = (b, d, b, d, f)
    if known:
        _show_all(axis, (new, numerators, denominators))
        axis.converted = 1
    for kind in range(KINDS):
        axis.unit[kind] = new[kind]
        axis.unit_numerator[kind] = numerators[kind]
        axis.unit_denominator[kind] = denominators[kind]


@block
def _show_all(axis: Axis, new):
    """Write every stored value in new units (`Kind`: size, numerators, denominators)."""
    od = axis.od
    od.target_position = _signed(axis, _S.TARGET_POSITION, od.target_position, _K.POSITION, new)
    od.position_offset = _signed(axis, _S.POSITION_OFFSET, od.position_offset, _K.POSITION, new)
    od.home_offset = _signed(axis, _S.HOME_OFFSET, od.home_offset, _K.POSITION, new)
    number = od.interpolation_data_record
    number = _signed(axis, _S.INTERPOLATION_DATA_RECORD, number, _K.POSITION, new)
    od.interpolation_data_record = number
    od.set_position = _signed(axis, _S.SET_POSITION, od.set_position, _K.POSITION, new)
    for i in range(2):
        number = od.software_position_limit[i]
        number = _signed(axis, _S.SOFTWARE_POSITION_LIMIT + i, number, _K.POSITION, new)
        od.software_position_limit[i] = number
        number = od.position_range_limit[i]
        number = _signed(axis, _S.POSITION_RANGE_LIMIT + i, number, _K.POSITION, new)
        od.position_range_limit[i] = number
        number = od.homing_speeds[i]
        od.homing_speeds[i] = _unsigned(axis, _S.HOMING_SPEEDS + i, number, _K.SPEED, new)
    od.target_velocity = _signed(axis, _S.TARGET_VELOCITY, od.target_velocity, _K.VELOCITY, new)
    od.velocity_offset = _signed(axis, _S.VELOCITY_OFFSET, od.velocity_offset, _K.VELOCITY, new)
    od.max_slippage = _signed(axis, _S.MAX_SLIPPAGE, od.max_slippage, _K.SPEED, new)
    number = od.limit_switch_deceleration
    number = _signed(axis, _S.LIMIT_SWITCH_DECELERATION, number, _K.ACCELERATION, new)
    od.limit_switch_deceleration = number
    number = od.following_error_window
    od.following_error_window = _shown(
        axis, _S.FOLLOWING_ERROR_WINDOW, _I(number), _K.WIDTH, new, 0, OFF - 1
    )
    number = od.position_window
    od.position_window = _shown(axis, _S.POSITION_WINDOW, _I(number), _K.WIDTH, new, 0, OFF - 1)
    number = od.velocity_window
    od.velocity_window = _shown(axis, _S.VELOCITY_WINDOW, _I(number), _K.SPEED, new, 0, 0xFFFF)
    number = od.velocity_threshold
    number = _shown(axis, _S.VELOCITY_THRESHOLD, _I(number), _K.SPEED, new, 0, 0xFFFF)
    od.velocity_threshold = number
    number = od.position_error_limit
    od.position_error_limit = _unsigned(axis, _S.POSITION_ERROR_LIMIT, number, _K.WIDTH, new)
    number = od.position_error_tolerance
    number = _unsigned(axis, _S.POSITION_ERROR_TOLERANCE, number, _K.WIDTH, new)
    od.position_error_tolerance = number
    number = od.max_profile_velocity
    od.max_profile_velocity = _unsigned(axis, _S.MAX_PROFILE_VELOCITY, number, _K.SPEED, new)
    od.profile_velocity = _unsigned(axis, _S.PROFILE_VELOCITY, od.profile_velocity, _K.SPEED, new)
    od.end_velocity = _unsigned(axis, _S.END_VELOCITY, od.end_velocity, _K.SPEED, new)
    number = od.position_control_v_max
    od.position_control_v_max = _unsigned(axis, _S.POSITION_CONTROL_V_MAX, number, _K.SPEED, new)
    number = od.profile_acceleration
    number = _unsigned(axis, _S.PROFILE_ACCELERATION, number, _K.ACCELERATION, new)
    od.profile_acceleration = number
    number = od.profile_deceleration
    number = _unsigned(axis, _S.PROFILE_DECELERATION, number, _K.ACCELERATION, new)
    od.profile_deceleration = number
    number = od.max_acceleration
    od.max_acceleration = _unsigned(axis, _S.MAX_ACCELERATION, number, _K.ACCELERATION, new)
    number = od.max_deceleration
    od.max_deceleration = _unsigned(axis, _S.MAX_DECELERATION, number, _K.ACCELERATION, new)
    number = od.quick_stop_deceleration
    number = _unsigned(axis, _S.QUICK_STOP_DECELERATION, number, _K.ACCELERATION, new)
    od.quick_stop_deceleration = number
    number = od.homing_acceleration
    od.homing_acceleration = _unsigned(axis, _S.HOMING_ACCELERATION, number, _K.ACCELERATION, new)
    for i in range(4):
        number = od.profile_jerk[i]
        od.profile_jerk[i] = _unsigned(axis, _S.PROFILE_JERK + i, number, _K.ACCELERATION, new)
        number = od.velocity_ramps[i]
        number = _signed(axis, _S.VELOCITY_RAMPS + i, number, _K.ACCELERATION, new)
        od.velocity_ramps[i] = number
    od.limit_speed = _signed(axis, _S.LIMIT_SPEED, od.limit_speed, _K.SPEED, new)
    _show_own(axis, new)


@block
def _show_own(axis: Axis, new):
    """The same for objects of the model that only stand in its bytes."""
    for j in range(OWN_STORED):
        size = abs(int(axis.own_size[j]))
        if not 0 < size <= 8 or axis.own_kind[j] >= KINDS:
            return
        if axis.own_place[j] > len(axis.od.vendor) - size:
            return
        at, sign, number = int(axis.own_place[j]), 1 << (8 * size - 1), 0
        for k in range(size):
            number |= int(axis.od.vendor[at + k]) << 8 * k
        high = 2 * sign - 1
        low = 0
        if axis.own_size[j] < 0:
            number = (number ^ sign) - sign
            low, high = -sign, sign - 1
        number = _shown(axis, _S.OWN + j, number, _I(axis.own_kind[j]), new, low, high)
        for k in range(size):
            axis.od.vendor[at + k] = number >> 8 * k & 0xFF


@block
def _signed(axis: Axis, n, number, kind, new):
    return _shown(axis, n, _I(number), kind, new, -0x80000000, 0x7FFFFFFF)


@block
def _unsigned(axis: Axis, n, number, kind, new):
    return _shown(axis, n, _I(number), kind, new, 0, 0xFFFFFFFF)


@block
def _shown(axis: Axis, n, number, kind, new, low, high):
    """The number of stored value `n` in new units; how it was written is kept."""
    if number > high:
        axis.kept_shown[n] = WRITTEN
        return number  # a window that is switched off
    if not axis.converted or axis.kept_shown[n] != number:
        axis.kept_raw[n] = number
        axis.kept_unit[n] = axis.unit[kind]
        axis.kept_numerator[n] = axis.unit_numerator[kind]
        axis.kept_denominator[n] = axis.unit_denominator[kind]
    units, numerators, denominators = new
    shown = _rounded(
        int(axis.kept_raw[n]), axis.kept_unit[n] / units[kind],
        int(axis.kept_numerator[n]), int(axis.kept_denominator[n]),
        int(numerators[kind]), int(denominators[kind]),
    )  # fmt: skip
    shown = min(max(shown, low), high)
    axis.kept_shown[n] = shown
    return shown


@block
def _rounded(number, ratio, a, b, c, d):
    """`number` * `ratio` to the nearest, halves upwards; the ratio is ``a / b / (c / d)``."""
    about = min(max(number * ratio, -FARTHEST), FARTHEST)
    shown = int(math.floor(about + 0.5))
    p, q = a * d, b * c  # of these only q has to fit, see below
    if abs(about) == FARTHEST or q == 0 or abs(float(b) * float(c)) >= EXACT:
        return shown
    if q < 0:
        p, q = -p, -q
    beyond = 2 * number * p - (2 * shown - 1) * q  # a small number: what overflows cancels
    if beyond < 0:
        return shown - 1
    return shown + 1 if beyond >= 2 * q else shown


@block
def value(axis: Axis, n, number, unit):
    """Stored value `n` (SI): as it was written, or the number it has been given since."""
    if axis.converted and axis.kept_shown[n] == number:
        return axis.kept_raw[n] * axis.kept_unit[n]
    return number * unit


@block
def ordered(axis: Axis, n, low, high):
    """Whether of a pair of stored values the first is the lower one, as they were written."""
    if axis.converted and axis.kept_shown[n] == low and axis.kept_shown[n + 1] == high:
        first = axis.kept_raw[n] * abs(axis.kept_unit[n])
        return first < axis.kept_raw[n + 1] * abs(axis.kept_unit[n + 1])
    return low < high
