"""The border between drive units and SI: the only room that converts.

``receive`` turns the raw objects of a record into SI parameters after any of them was written,
``publish`` turns what the cycle found into raw objects. Positions are rounded to the nearest unit,
halves upwards; an INTEGER32 position wraps as a counter does, every other value saturates.
`units` has the factor group, `stored` the values that keep their meaning when it changes.
"""

import math

from .. import cascade, encoder, probe, statusword, sync
from ..jit import block, entry
from ..ramps import SINE
from ..record import Axis
from ..words import Mode, SetPointSource
from .stored import OFF, WRITTEN, Stored, follow, ordered, value
from .units import measure

SINE_SQUARED, JERK_FREE, JERK_LIMITED = 1, 2, 3  # motion profile types
JERK_FREE_TIME = 0.02  # s, until a jerk-free ramp has its acceleration (inferred)
RAD_S_PER_MINUTE = 2 * math.pi / 60
TURN_OPTION = (0, 3, 3, 0, 2, 1)  # position range mode -> `limits.nearest_turn`
_S = Stored


@block
def receive(axis: Axis):
    """Derive every SI parameter from the raw objects (drive units) of `axis`."""
    od = axis.od
    axis.parameters_changed = 0
    _units(axis)
    position = axis.rad_per_position_unit
    velocity = axis.rad_s_per_velocity_unit
    width, speed = abs(position), abs(velocity)
    acceleration = axis.rad_s2_per_acceleration_unit

    axis.rated_torque = max(int(od.motor_rated_torque), 1) * 1e-3
    per_mille = axis.rated_torque * 1e-3
    ceiling = min(int(od.max_torque), int(od.max_current))
    axis.torque_limit_positive = min(ceiling, int(od.positive_torque_limit)) * per_mille
    axis.torque_limit_negative = min(ceiling, int(od.negative_torque_limit)) * per_mille
    axis.torque_slope = od.torque_slope * per_mille

    axis.target_position = value(axis, _S.TARGET_POSITION, od.target_position, position)
    axis.target_velocity = value(axis, _S.TARGET_VELOCITY, od.target_velocity, velocity)
    axis.target_torque = od.target_torque * per_mille
    axis.position_offset = value(axis, _S.POSITION_OFFSET, od.position_offset, position)
    axis.velocity_offset = value(axis, _S.VELOCITY_OFFSET, od.velocity_offset, velocity)
    axis.torque_offset = od.torque_offset * per_mille
    axis.home_offset = value(axis, _S.HOME_OFFSET, od.home_offset, position)
    record = od.interpolation_data_record
    axis.ip_data = value(axis, _S.INTERPOLATION_DATA_RECORD, record, position)

    limits = od.software_position_limit
    first = value(axis, _S.SOFTWARE_POSITION_LIMIT, limits[0], position)
    second = value(axis, _S.SOFTWARE_POSITION_LIMIT + 1, limits[1], position)
    axis.position_limit_min = min(first, second)
    axis.position_limit_max = max(first, second)
    if not ordered(axis, _S.SOFTWARE_POSITION_LIMIT, limits[0], limits[1]):
        axis.position_limit_min = -math.inf
        axis.position_limit_max = math.inf

    limits = od.position_range_limit
    first = value(axis, _S.POSITION_RANGE_LIMIT, limits[0], position)
    second = value(axis, _S.POSITION_RANGE_LIMIT + 1, limits[1], position)
    axis.range_min = min(first, second)
    rotary = ordered(axis, _S.POSITION_RANGE_LIMIT, limits[0], limits[1])
    axis.range = abs(second - first) if rotary else 0.0
    axis.turn_option = int(od.positioning_option_code) >> 6 & 3
    if axis.range_needs_mode:
        axis.turn_option = TURN_OPTION[min(int(od.position_range_mode), 5)]
        if od.position_range_mode == 0:
            axis.range = 0.0

    axis.max_speed = od.max_motor_speed * (2 * math.pi / 60)
    top = value(axis, _S.MAX_PROFILE_VELOCITY, od.max_profile_velocity, speed)
    axis.max_profile_speed = min(top, axis.max_speed)
    profile = value(axis, _S.PROFILE_VELOCITY, od.profile_velocity, speed)
    axis.profile_speed = min(profile, axis.max_profile_speed)
    axis.end_speed = min(value(axis, _S.END_VELOCITY, od.end_velocity, speed), axis.profile_speed)
    axis.acceleration = min(
        _rate(axis, _S.PROFILE_ACCELERATION, od.profile_acceleration),
        _rate(axis, _S.MAX_ACCELERATION, od.max_acceleration),
    )
    axis.deceleration = min(
        _rate(axis, _S.PROFILE_DECELERATION, od.profile_deceleration),
        _rate(axis, _S.MAX_DECELERATION, od.max_deceleration),
    )
    axis.quick_stop_deceleration = _rate(
        axis, _S.QUICK_STOP_DECELERATION, od.quick_stop_deceleration
    )
    jerks = max(int(od.profile_jerk_use), 1)  # 1: for all, 2: acceleration and deceleration, 4
    kind = od.motion_profile_type
    for i in range(4):
        j = i % jerks
        jerk = value(axis, _S.PROFILE_JERK + j, od.profile_jerk[j], acceleration)
        axis.jerk[i] = jerk if kind == JERK_LIMITED else 0.0
        if kind == SINE_SQUARED:
            axis.jerk[i] = SINE
        if kind == JERK_FREE:
            steepest = axis.deceleration if i & 1 else axis.acceleration
            axis.jerk[i] = steepest / JERK_FREE_TIME
    axis.homing_speed_switch = value(axis, _S.HOMING_SPEEDS, od.homing_speeds[0], speed)
    axis.homing_speed_zero = value(axis, _S.HOMING_SPEEDS + 1, od.homing_speeds[1], speed)
    axis.homing_acceleration = _rate(axis, _S.HOMING_ACCELERATION, od.homing_acceleration)
    axis.homing_torque = od.homing_stop_torque * per_mille
    axis.homing_stop_cycles = _cycles(axis, int(od.homing_stop_time))
    axis.homing_timeout_cycles = _cycles(axis, int(od.homing_timeout))
    axis.brake_release_cycles = _cycles(axis, int(od.brake_release_time))
    engage = od.brake_release_time if axis.single_brake_delay else od.brake_engage_time
    axis.brake_engage_cycles = _cycles(axis, int(engage))
    axis.max_slippage = value(axis, _S.MAX_SLIPPAGE, od.max_slippage, speed)
    _vl(axis)
    if axis.cycle_count == 0 or not axis.period_at_reset:
        period = od.interpolation_time_units * 10.0 ** int(od.interpolation_time_index)
        axis.interpolation_cycles = max(1, int(math.floor(period / axis.position_period + 0.5)))

    window = od.following_error_window
    axis.following_error_window = _window(axis, _S.FOLLOWING_ERROR_WINDOW, window, width)
    axis.following_error_cycles = _cycles(axis, int(od.following_error_time_out))
    axis.position_window = _window(axis, _S.POSITION_WINDOW, od.position_window, width)
    axis.position_window_cycles = _cycles(axis, int(od.position_window_time))
    axis.velocity_window = value(axis, _S.VELOCITY_WINDOW, od.velocity_window, speed)
    axis.velocity_window_cycles = _cycles(axis, int(od.velocity_window_time))
    axis.velocity_threshold = value(axis, _S.VELOCITY_THRESHOLD, od.velocity_threshold, speed)
    axis.velocity_threshold_cycles = _cycles(axis, int(od.velocity_threshold_time))

    _limits_of_some_models(axis)
    if axis.own_velocity_ramps:
        _velocity_ramps(axis)
    axis.position_gain = od.position_control_gain * axis.position_gain_unit
    axis.velocity_gain = od.velocity_control_gain * axis.velocity_gain_unit
    # an action time below the cycle would make the anti-windup overshoot without bound
    time = max(od.velocity_control_time * 1e-6, axis.velocity_period)
    integrates = od.velocity_control_time > 0
    axis.velocity_integral_gain = axis.velocity_gain / time if integrates else 0.0
    axis.velocity_filter = _share(axis, od.velocity_filter_time * 1e-6)
    axis.torque_filter = _share(axis, axis.torque_time_constant)
    axis.velocity_feed_forward = od.velocity_feed_forward * 1e-3
    axis.inertia_feed_forward = od.acceleration_feed_forward * 1e-9
    cascade.receive(axis)


@block
def _limits_of_some_models(axis: Axis):
    od = axis.od
    width, speed = abs(axis.rad_per_position_unit), abs(axis.rad_s_per_velocity_unit)
    limit = value(axis, _S.POSITION_ERROR_LIMIT, od.position_error_limit, width)
    axis.position_error_limit = limit if limit > 0.0 else math.inf
    limit = value(axis, _S.POSITION_CONTROL_V_MAX, od.position_control_v_max, speed)
    axis.correction_limit = limit if limit > 0.0 else math.inf
    band = od.position_error_tolerance
    share = od.limit_current / max(int(od.motor_rated_current), 1)
    axis.limit_torque = abs(share) * axis.rated_torque if od.motor_rated_current else math.inf
    axis.limit_speed = abs(value(axis, _S.LIMIT_SPEED, od.limit_speed, speed))
    axis.dead_band = value(axis, _S.POSITION_ERROR_TOLERANCE, band, width)
    rate, acceleration = od.limit_switch_deceleration, axis.rad_s2_per_acceleration_unit
    axis.limit_deceleration = value(axis, _S.LIMIT_SWITCH_DECELERATION, rate, acceleration)
    time = od.velocity_display_filter_time * 1e-6
    axis.display_filter = 1.0 - math.exp(-axis.position_period / time) if time > 0 else 1.0
    axis.switch_inversion = int(od.switch_polarity) & 7
    if axis.switch_types:
        limit_inverted = 0 if od.limit_switch_polarity else 3
        axis.switch_inversion = limit_inverted | (0 if od.homing_switch_polarity else 4)


@block
def _velocity_ramps(axis: Axis):
    """2090h: a write of 6083h or 6084h goes there too, for both directions (Metronix 8.6)."""
    od = axis.od
    for k in range(2):
        number = od.profile_deceleration if k else od.profile_acceleration
        now = _rate(axis, _S.PROFILE_ACCELERATION + k, number)
        if axis.ramps_seen[k] > 0.0 and axis.ramps_seen[k] != now:
            for i in range(k, 4, 2):
                od.velocity_ramps[i] = min(int(number), 0x7FFFFFFF)
                axis.kept_shown[_S.VELOCITY_RAMPS + i] = WRITTEN
        axis.ramps_seen[k] = now
    for i in range(4):
        axis.velocity_ramps[i] = _rate(axis, _S.VELOCITY_RAMPS + i, od.velocity_ramps[i])


@block
def _vl(axis: Axis):
    """Velocity mode: vl units are 1/min times the dimension factor 604Ch."""
    od = axis.od
    if od.vl_dimension_factor[1] == 0 or od.vl_set_point_factor[1] == 0:
        return  # a drive without this mode
    axis.vl_rad_s = od.vl_dimension_factor[0] / od.vl_dimension_factor[1] * (2 * math.pi / 60)
    scaled = float(od.vl_target_velocity) * od.vl_set_point_factor[0] / od.vl_set_point_factor[1]
    internal = od.vl_internal_velocity * 1e-3
    if od.vl_setpoint_source == SetPointSource.INTERNAL:
        scaled = internal
    elif od.vl_setpoint_source == SetPointSource.SUM:
        scaled += internal
    amount = min(
        max(abs(scaled), float(od.vl_velocity_min_max_amount[0])),
        float(od.vl_velocity_min_max_amount[1]),
    )
    if od.vl_target_velocity != 0:
        axis.vl_sign = 1 if od.vl_target_velocity > 0 else -1
    sign = scaled
    if axis.vl_keeps_sign and od.vl_setpoint_source == SetPointSource.BUS:
        sign = float(axis.vl_sign) if axis.vl_sign != 0 else 1.0
    bounded = math.copysign(amount, sign) if sign != 0 else 0.0
    axis.vl_target = min(max(bounded * axis.vl_rad_s, -axis.max_speed), axis.max_speed)
    axis.vl_acceleration = _vl_ramp(
        axis, od.vl_acceleration_delta_speed, od.vl_acceleration_delta_time
    )
    axis.vl_deceleration = _vl_ramp(
        axis, od.vl_deceleration_delta_speed, od.vl_deceleration_delta_time
    )
    axis.vl_quick_stop = _vl_ramp(axis, od.vl_quick_stop_delta_speed, od.vl_quick_stop_delta_time)
    for n in range(3):
        rate = (axis.vl_acceleration, axis.vl_deceleration, axis.vl_quick_stop)[n]
        own = int(od.vl_anticlockwise[n])
        axis.vl_anticlockwise[n] = _vl_ramp(axis, own * 1e-3, 1) if own else rate
    axis.vl_window = od.vl_window * (1e-3 * RAD_S_PER_MINUTE)
    axis.stop_velocity = od.stop_velocity * (1e-3 * RAD_S_PER_MINUTE)
    axis.stop_hold_time = od.stop_hold_time * 1e-3
    axis.dc_brake_time = od.dc_brake_time * 1e-3


@block
def _vl_ramp(axis: Axis, speed, time):
    """Speed over time (rad/s²); a time of 0 s is the steepest ramp: all speed in one cycle."""
    steepest = max(axis.max_speed, 1.0) / axis.position_period
    if time == 0:
        return steepest
    return min(max(speed * abs(axis.vl_rad_s) / time, 1e-3), steepest)


@block
def _units(axis: Axis):
    measure(axis)
    if axis.values_keep_meaning:
        follow(axis)


@entry
def units_changed(axes, index):
    """Let the numbers of stored values follow the factors now; the next cycle would do it, too."""
    _units(axes[index])


@block
def _rate(axis: Axis, n, number):
    """A stored acceleration; 0, which process data may bring, counts as one unit."""
    rate = value(axis, n, number, axis.rad_s2_per_acceleration_unit)
    return rate if rate > 0.0 else axis.rad_s2_per_acceleration_unit


@block
def _window(axis: Axis, n, units, size):
    return math.inf if units == OFF else value(axis, n, units, size)


@block
def _cycles(axis: Axis, milliseconds):
    return int(math.ceil(milliseconds * 1e-3 / axis.position_period - 1e-9))


@block
def _share(axis: Axis, time_constant):
    """Weight of a new sample in a first-order lag sampled every velocity cycle."""
    return 1.0 - math.exp(-axis.velocity_period / time_constant) if time_constant > 0 else 1.0


@block
def increments_to_units(axis: Axis, increments):
    """Position units of an encoder count, exact, halves rounded upwards."""
    numerator, denominator = axis.position_numerator, axis.position_denominator
    if axis.od.polarity & 0x80:
        increments = -increments
    whole = increments // denominator
    rest = increments - whole * denominator
    return whole * numerator + (2 * rest * numerator + denominator) // (2 * denominator)


@block
def set_position(axis: Axis):
    """2030h of some models: the present position gets a value; nothing moves."""
    axis.set_position_wanted = 0
    wanted = value(axis, _S.SET_POSITION, axis.od.set_position, axis.rad_per_position_unit)
    increments = int(math.floor(wanted / axis.rad_per_increment + 0.5))
    encoder.set_zero(axis, axis.counts - increments)
    axis.homed = 1


@block
def _integer32(value):
    """Nearest INTEGER32, saturated."""
    return int(math.floor(min(max(value, -2147483648.0), 2147483647.0) + 0.5))


@block
def _integer16(value):
    return int(math.floor(min(max(value, -32768.0), 32767.0) + 0.5))


@block
def _wrapped32(value):
    return ((value + 2147483648) & 0xFFFFFFFF) - 2147483648


@block
def _count32(position):
    """Nearest INTEGER32, wrapped as a counter."""
    return _wrapped32(int(math.floor(min(max(position, -(2.0**62)), 2.0**62) + 0.5)))


@block
def _in_range(axis: Axis, units):
    """A position as 607Bh shows it: past one limit it goes on at the other."""
    first, second = axis.od.position_range_limit[0], axis.od.position_range_limit[1]
    if axis.range <= 0.0 or first == second:
        return units
    low = min(int(first), int(second))
    return low + (units - low) % (max(int(first), int(second)) - low)


@block
def publish(axis: Axis):
    """Write every object a master can read of this cycle."""
    od = axis.od
    counts = axis.counts - axis.zero_counts
    od.position_actual_internal_value = _wrapped32(counts)
    od.position_demand_internal_value = _count32(axis.position_demand / axis.rad_per_increment)
    od.position_actual_value = _in_range(axis, _wrapped32(increments_to_units(axis, counts)))
    per_position = 1.0 / axis.rad_per_position_unit
    per_velocity = 1.0 / axis.rad_s_per_velocity_unit
    od.position_demand_value = _in_range(axis, _count32(axis.position_demand * per_position))
    od.following_error_actual_value = _integer32(axis.following_error * per_position)
    od.velocity_demand_value = _integer32(axis.velocity_demand * per_velocity)
    od.velocity_actual_value = _integer32(axis.velocity * per_velocity)
    axis.velocity_shown += axis.display_filter * (axis.velocity - axis.velocity_shown)
    od.velocity_actual_value_filtered = _integer32(axis.velocity_shown * per_velocity)
    od.velocity_sensor_actual_value = _integer32(axis.velocity * (60 / (2 * math.pi) * 4096))
    od.control_effort = _integer32(axis.velocity_correction * per_velocity)
    per_mille = 1e3 / axis.rated_torque
    od.torque_demand = _integer16(axis.torque_command * per_mille)
    torque = _integer16(axis.torque * per_mille)
    od.torque_actual_value = torque
    od.current_actual_value = torque  # a torque-constant motor: both are per mille of rated
    waiting = axis.mode == Mode.INTERPOLATED_POSITION and not sync.locked(axis)
    od.modes_of_operation_display = -1 if waiting else axis.mode
    od.active_limits = axis.limits
    od.digital_inputs = statusword.digital_inputs(axis)
    od.homing_error = axis.homing_error
    per_vl = 1.0 / axis.vl_rad_s if axis.vl_rad_s != 0.0 else 0.0
    od.vl_velocity_demand = _integer16(axis.velocity_demand * per_vl)
    od.vl_velocity_actual_value = _integer16(axis.velocity * per_vl)
    probing = axis.probe_stored != 0 or od.touch_probe_status != 0 or probe.command(axis) != 0
    if probing or axis.latch_words:
        for i in range(4):
            probed = increments_to_units(axis, axis.probe_counts[i] - axis.zero_counts)
            od.touch_probe_position[i] = _wrapped32(probed)
        probe.publish(axis)
    od.statusword = statusword.compose(axis)
    axis.limits = 0
