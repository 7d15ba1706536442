"""The border between drive units and SI: the only file that converts.

``receive`` turns the raw objects of a record into SI parameters after any of them was written,
``publish`` turns what the cycle found into raw objects. Factor group as in CiA 402-2 / IEC
61800-7-201: position units = increments * (608Fh) * (6091h) * (6092h), or for models that say so
the older one of DSP 402 V2 (6093h, 6094h, 6097h). All are integers, reduced to one exact fraction.
Positions are rounded to the nearest unit, halves upwards; an INTEGER32 position wraps as a counter
does, every other value saturates.
"""

import math

from . import encoder, probe, statusword, sync
from .jit import block
from .words import Mode

JERK_FREE, JERK_LIMITED = 2, 3  # motion profile types
JERK_FREE_TIME = 0.02  # s, until a jerk-free ramp has its acceleration (inferred)
OFF = 0xFFFFFFFF  # a window of this size is switched off
TURN_OPTION = (0, 3, 3, 0, 2, 1)  # position range mode -> `limits.nearest_turn`
FRACTION_LIMIT = 1 << 31  # of both parts of the fraction: keeps every product inside 63 bits


@block
def receive(axis):
    """Derive every SI parameter from the raw objects (drive units) of `axis`."""
    od = axis.od
    axis.parameters_changed = 0
    _units(axis)
    position = axis.rad_per_position_unit
    velocity = axis.rad_s_per_velocity_unit
    acceleration = axis.rad_s2_per_acceleration_unit

    axis.rated_torque = max(int(od.motor_rated_torque), 1) * 1e-3
    per_mille = axis.rated_torque * 1e-3
    ceiling = min(int(od.max_torque), int(od.max_current))
    axis.torque_limit_positive = min(ceiling, int(od.positive_torque_limit)) * per_mille
    axis.torque_limit_negative = min(ceiling, int(od.negative_torque_limit)) * per_mille
    axis.torque_slope = od.torque_slope * per_mille

    axis.target_position = od.target_position * position
    axis.target_velocity = od.target_velocity * velocity
    axis.target_torque = od.target_torque * per_mille
    axis.position_offset = od.position_offset * position
    axis.velocity_offset = od.velocity_offset * velocity
    axis.torque_offset = od.torque_offset * per_mille
    axis.home_offset = od.home_offset * position
    axis.ip_data = od.interpolation_data_record * position

    first = od.software_position_limit[0] * position
    second = od.software_position_limit[1] * position
    axis.position_limit_min = min(first, second)
    axis.position_limit_max = max(first, second)
    if od.software_position_limit[0] >= od.software_position_limit[1]:
        axis.position_limit_min = -math.inf
        axis.position_limit_max = math.inf

    first = od.position_range_limit[0] * position
    second = od.position_range_limit[1] * position
    axis.range_min = min(first, second)
    ordered = od.position_range_limit[0] < od.position_range_limit[1]
    axis.range = abs(second - first) if ordered else 0.0
    axis.turn_option = int(od.positioning_option_code) >> 6 & 3
    if axis.range_needs_mode:
        axis.turn_option = TURN_OPTION[min(int(od.position_range_mode), 5)]
        if od.position_range_mode == 0:
            axis.range = 0.0

    axis.max_speed = od.max_motor_speed * (2 * math.pi / 60)
    axis.max_profile_speed = min(od.max_profile_velocity * abs(velocity), axis.max_speed)
    axis.profile_speed = min(od.profile_velocity * abs(velocity), axis.max_profile_speed)
    axis.end_speed = min(od.end_velocity * abs(velocity), axis.profile_speed)
    axis.acceleration = min(int(od.profile_acceleration), int(od.max_acceleration)) * acceleration
    axis.deceleration = min(int(od.profile_deceleration), int(od.max_deceleration)) * acceleration
    axis.quick_stop_deceleration = od.quick_stop_deceleration * acceleration
    jerks = max(int(od.profile_jerk_use), 1)  # 1: for all, 2: acceleration and deceleration, 4
    kind = od.motion_profile_type
    for i in range(4):
        axis.jerk[i] = od.profile_jerk[i % jerks] * acceleration if kind == JERK_LIMITED else 0.0
        if kind == JERK_FREE:
            rate = axis.deceleration if i & 1 else axis.acceleration
            axis.jerk[i] = rate / JERK_FREE_TIME
    axis.homing_speed_switch = od.homing_speeds[0] * abs(velocity)
    axis.homing_speed_zero = od.homing_speeds[1] * abs(velocity)
    axis.homing_acceleration = od.homing_acceleration * acceleration
    axis.homing_torque = od.homing_stop_torque * per_mille
    axis.homing_stop_cycles = _cycles(axis, int(od.homing_stop_time))
    axis.homing_timeout_cycles = _cycles(axis, int(od.homing_timeout))
    axis.brake_release_cycles = _cycles(axis, int(od.brake_release_time))
    engage = od.brake_release_time if axis.single_brake_delay else od.brake_engage_time
    axis.brake_engage_cycles = _cycles(axis, int(engage))
    axis.max_slippage = od.max_slippage * abs(velocity)
    _vl(axis)
    if axis.cycle_count == 0 or not axis.period_at_reset:
        period = od.interpolation_time_units * 10.0 ** int(od.interpolation_time_index)
        axis.interpolation_cycles = max(1, int(math.floor(period / axis.position_period + 0.5)))

    axis.following_error_window = _window(int(od.following_error_window), abs(position))
    axis.following_error_cycles = _cycles(axis, int(od.following_error_time_out))
    axis.position_window = _window(int(od.position_window), abs(position))
    axis.position_window_cycles = _cycles(axis, int(od.position_window_time))
    axis.velocity_window = od.velocity_window * abs(velocity)
    axis.velocity_window_cycles = _cycles(axis, int(od.velocity_window_time))
    axis.velocity_threshold = od.velocity_threshold * abs(velocity)
    axis.velocity_threshold_cycles = _cycles(axis, int(od.velocity_threshold_time))

    _limits_of_some_models(axis)
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


@block
def _limits_of_some_models(axis):
    od = axis.od
    position, velocity = abs(axis.rad_per_position_unit), abs(axis.rad_s_per_velocity_unit)
    limit = od.position_error_limit * position
    axis.position_error_limit = limit if limit > 0.0 else math.inf
    limit = od.position_control_v_max * velocity
    axis.correction_limit = limit if limit > 0.0 else math.inf
    axis.dead_band = od.position_error_tolerance * position
    axis.limit_deceleration = od.limit_switch_deceleration * axis.rad_s2_per_acceleration_unit
    time = od.velocity_display_filter_time * 1e-6
    axis.display_filter = 1.0 - math.exp(-axis.position_period / time) if time > 0 else 1.0
    axis.switch_inversion = int(od.switch_polarity) & 7
    if axis.switch_types:
        limit_inverted = 0 if od.limit_switch_polarity else 3
        axis.switch_inversion = limit_inverted | (0 if od.homing_switch_polarity else 4)


@block
def _vl(axis):
    """Velocity mode: vl units are 1/min times the dimension factor 604Ch."""
    od = axis.od
    if od.vl_dimension_factor[1] == 0 or od.vl_set_point_factor[1] == 0:
        return  # a drive without this mode
    axis.vl_rad_s = od.vl_dimension_factor[0] / od.vl_dimension_factor[1] * (2 * math.pi / 60)
    scaled = float(od.vl_target_velocity) * od.vl_set_point_factor[0] / od.vl_set_point_factor[1]
    if axis.inverter:
        scaled = _inverter(axis, scaled)
    amount = min(
        max(abs(scaled), float(od.vl_velocity_min_max_amount[0])),
        float(od.vl_velocity_min_max_amount[1]),
    )
    bounded = math.copysign(amount, scaled) if scaled != 0 else 0.0
    axis.vl_target = min(max(bounded * axis.vl_rad_s, -axis.max_speed), axis.max_speed)
    axis.vl_acceleration = _vl_ramp(
        axis, od.vl_acceleration_delta_speed, od.vl_acceleration_delta_time
    )
    axis.vl_deceleration = _vl_ramp(
        axis, od.vl_deceleration_delta_speed, od.vl_deceleration_delta_time
    )
    axis.vl_quick_stop = _vl_ramp(axis, od.vl_quick_stop_delta_speed, od.vl_quick_stop_delta_time)


@block
def _inverter(axis, line):
    """Frequencies as speeds, and the setpoint that parameter 434 chooses (1/min)."""
    od = axis.od
    per_millihertz = 0.06 / max(int(od.pole_pairs), 1)  # 1/min
    rad_s = per_millihertz * 2 * math.pi / 60
    axis.stop_threshold = od.stop_threshold * rad_s
    axis.control_deviation = od.control_deviation * rad_s
    axis.stop_hold_time = od.stop_holding_time * 1e-3
    axis.dc_brake_time = od.braking_time * 1e-3
    internal = od.internal_frequency * per_millihertz
    if od.ramp_setpoint == 1:
        return internal
    return line if od.ramp_setpoint == 2 else line + internal


@block
def _vl_ramp(axis, speed, time):
    """Speed over time (rad/s²); a time of 0 s is the steepest ramp: all speed in one cycle."""
    steepest = max(axis.max_speed, 1.0) / axis.position_period
    if time == 0:
        return steepest
    return min(max(speed * abs(axis.vl_rad_s) / time, 1e-3), steepest)


@block
def _units(axis):
    od = axis.od
    numerator, denominator = older_fraction(od) if axis.older_factor_group else fraction(od)
    axis.position_numerator = numerator
    axis.position_denominator = denominator
    resolution = od.position_encoder_resolution[0] / od.position_encoder_resolution[1]
    axis.rad_per_increment = 2 * math.pi / resolution
    unit = axis.rad_per_increment * denominator / numerator
    if axis.older_factor_group:
        per_minute = 2 * math.pi / 60
        speed = od.velocity_encoder_factor[0] / od.velocity_encoder_factor[1] * per_minute / 4096
        acceleration = od.acceleration_factor[0] / od.acceleration_factor[1] * per_minute / 256
    else:
        speed = unit * od.velocity_factor[0] / od.velocity_factor[1]
        acceleration = unit * od.acceleration_factor[0] / od.acceleration_factor[1]
    axis.rad_per_position_unit = -unit if od.polarity & 0x80 else unit
    axis.rad_s_per_velocity_unit = -speed if od.polarity & 0x40 else speed
    axis.rad_s2_per_acceleration_unit = acceleration


@block
def fraction(od):
    """Position units per increment as a reduced fraction; objects.py keeps it below 2^31."""
    a, b = int(od.position_encoder_resolution[1]), int(od.position_encoder_resolution[0])
    c, d = int(od.gear_ratio[1]), int(od.gear_ratio[0])
    e, f = int(od.feed_constant[0]), int(od.feed_constant[1])
    a, b = reduced(a, b)
    a, d = reduced(a, d)
    a, f = reduced(a, f)
    c, b = reduced(c, b)
    c, d = reduced(c, d)
    c, f = reduced(c, f)
    e, b = reduced(e, b)
    e, d = reduced(e, d)
    e, f = reduced(e, f)
    return a * c * e, b * d * f


@block
def older_fraction(od):
    """The same from 6093h: internal positions have 65536 increments a revolution (DSP 402 V2)."""
    a, b = 65536 * int(od.position_encoder_resolution[1]), int(od.position_encoder_resolution[0])
    c, d = int(od.position_factor[1]), int(od.position_factor[0])
    a, b = reduced(a, b)
    a, d = reduced(a, d)
    c, b = reduced(c, b)
    c, d = reduced(c, d)
    return a * c, b * d


@block
def reduced(numerator, denominator):
    """The same fraction in lowest terms."""
    common = math.gcd(numerator, denominator)
    return numerator // common, denominator // common


@block
def _window(units, size):
    return math.inf if units == OFF else units * size


@block
def _cycles(axis, milliseconds):
    return int(math.ceil(milliseconds * 1e-3 / axis.position_period - 1e-9))


@block
def _share(axis, time_constant):
    """Weight of a new sample in a first-order lag sampled every velocity cycle."""
    return 1.0 - math.exp(-axis.velocity_period / time_constant) if time_constant > 0 else 1.0


@block
def increments_to_units(axis, increments):
    """Position units of an encoder count, exact, halves rounded upwards."""
    numerator, denominator = axis.position_numerator, axis.position_denominator
    if axis.od.polarity & 0x80:
        increments = -increments
    whole = increments // denominator
    rest = increments - whole * denominator
    return whole * numerator + (2 * rest * numerator + denominator) // (2 * denominator)


@block
def set_position(axis):
    """2030h of some models: the present position gets a value; nothing moves."""
    axis.set_position_wanted = 0
    wanted = axis.od.set_position * axis.rad_per_position_unit
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
def _in_range(od, units):
    """A position as 607Bh shows it: past one limit it goes on at the other."""
    low, high = int(od.position_range_limit[0]), int(od.position_range_limit[1])
    return low + (units - low) % (high - low) if low < high else units


@block
def publish(axis):
    """Write every object a master can read of this cycle."""
    od = axis.od
    counts = axis.counts - axis.zero_counts
    od.position_actual_internal_value = _wrapped32(counts)
    od.position_demand_internal_value = _integer32(axis.position_demand / axis.rad_per_increment)
    od.position_actual_value = _in_range(od, _wrapped32(increments_to_units(axis, counts)))
    per_position = 1.0 / axis.rad_per_position_unit
    per_velocity = 1.0 / axis.rad_s_per_velocity_unit
    od.position_demand_value = _in_range(od, _integer32(axis.position_demand * per_position))
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
    if axis.probe_stored != 0 or od.touch_probe_status != 0 or probe.command(axis) != 0:
        for i in range(4):
            probed = increments_to_units(axis, axis.probe_counts[i] - axis.zero_counts)
            od.touch_probe_position[i] = _wrapped32(probed)
        probe.publish(axis)
    od.statusword = statusword.compose(axis)
    axis.limits = 0
