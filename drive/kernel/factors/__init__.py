"""The conversion between drive units and SI units, which happens only here.

``receive`` converts the raw objects of a record into SI parameters after any of them was written;
``publish`` converts the results of the cycle into raw objects. Positions are rounded to the nearest
unit, halves upwards; an INTEGER32 position wraps as a counter does, any other value saturates.
`units` contains the factor group, `stored` the values that keep their meaning when it changes, and
`rows` the conversions of single quantities; this file combines several of them.
"""

import math

from .. import cascade, encoder, probe, statusword, sync
from ..jit import block, entry, rare
from ..ramps import SINE
from ..record import KINDS, PLACES, RAD_S_PER_MINUTE, Axis, Kind
from ..words import Mode, SetPointSource
from .rows import cycles, integer32, lag, publish_rows, rate, receive_rows, show_rows
from .stored import WRITTEN, ordered, show_own, value
from .units import measure, product

SINE_SQUARED, JERK_FREE, JERK_LIMITED = 1, 2, 3  # motion profile types
JERK_FREE_TIME = 0.02  # s, until a jerk-free ramp has its acceleration (inferred)
TURN_OPTION = (0, 3, 3, 0, 2, 1)  # position range mode -> `limits.nearest_turn`
# places of values that are combined
SOFTWARE_POSITION_LIMIT = PLACES["software_position_limit"]
POSITION_RANGE_LIMIT = PLACES["position_range_limit"]
PROFILE_ACCELERATION = PLACES["profile_acceleration"]  # and 6084h behind it
VELOCITY_RAMPS = PLACES["velocity_ramps"]
SET_POSITION = PLACES["set_position"]


@rare
def receive(axis: Axis):
    """Derive every SI parameter from the raw objects (drive units) of `axis`.

    The rows of the table convert each object alone; then several are combined.
    """
    od = axis.od
    axis.parameters_changed = 0
    _units(axis)
    axis.rated_torque = max(int(od.motor_rated_torque), 1) * 1e-3
    receive_rows(axis)
    ceiling = min(int(od.max_torque), int(od.max_current))
    per_mille = axis.rated_torque * 1e-3
    axis.torque_limit_positive = min(ceiling, int(od.positive_torque_limit)) * per_mille
    axis.torque_limit_negative = min(ceiling, int(od.negative_torque_limit)) * per_mille
    _ends(axis)
    axis.max_profile_speed = min(axis.max_profile_speed, axis.max_speed)
    axis.profile_speed = min(axis.profile_speed, axis.max_profile_speed)
    axis.end_speed = min(axis.end_speed, axis.profile_speed)
    axis.acceleration = min(axis.acceleration, axis.max_acceleration)
    axis.deceleration = min(axis.deceleration, axis.max_deceleration)
    _jerk(axis)
    engage = od.brake_release_time if axis.single_brake_delay else od.brake_engage_time
    axis.brake_engage_cycles = cycles(axis, int(engage))
    _vl(axis)
    if axis.cycle_count == 0 or not axis.period_at_reset:
        period = od.interpolation_time_units * 10.0 ** int(od.interpolation_time_index)
        axis.interpolation_cycles = max(1, int(math.floor(period / axis.position_period + 0.5)))
    share = od.limit_current / max(int(od.motor_rated_current), 1)
    axis.limit_torque = abs(share) * axis.rated_torque if od.motor_rated_current else math.inf
    axis.switch_inversion = int(od.switch_polarity) & 7
    if axis.switch_types:
        limit_inverted = 0 if od.limit_switch_polarity else 3
        axis.switch_inversion = limit_inverted | (0 if od.homing_switch_polarity else 4)
    if axis.own_velocity_ramps:
        _velocity_ramps(axis)
    # an action time below the cycle would make the anti-windup overshoot without bound
    time = max(od.velocity_control_time * 1e-6, axis.velocity_period)
    integrates = od.velocity_control_time > 0
    axis.velocity_integral_gain = axis.velocity_gain / time if integrates else 0.0
    axis.torque_filter = lag(axis.torque_time_constant, axis.velocity_period)
    cascade.receive(axis)


@block
def _ends(axis: Axis):
    """Set the limits of 607Dh and the range of 607Bh; without two ends in order there is none."""
    od = axis.od
    first, second = axis.position_limit_min, axis.position_limit_max
    axis.position_limit_min = min(first, second)
    axis.position_limit_max = max(first, second)
    limits = od.software_position_limit
    if not ordered(axis, SOFTWARE_POSITION_LIMIT, limits[0], limits[1]):
        axis.position_limit_min = -math.inf
        axis.position_limit_max = math.inf
    first, second = axis.range_min, axis.range_max
    limits = od.position_range_limit
    axis.range_min = min(first, second)
    rotary = ordered(axis, POSITION_RANGE_LIMIT, limits[0], limits[1])
    axis.range = abs(second - first) if rotary else 0.0
    axis.turn_option = int(od.positioning_option_code) >> 6 & 3
    if axis.range_needs_mode:
        axis.turn_option = TURN_OPTION[min(int(od.position_range_mode), 5)]
        if od.position_range_mode == 0:
            axis.range = 0.0


@block
def _jerk(axis: Axis):
    """Set the jerks from 60A4h by their number in use, 60A3h, or as the profile type 6086h asks."""
    jerks = max(int(axis.od.profile_jerk_use), 1)  # 1: for all, 2: acceleration and deceleration, 4
    kind = axis.od.motion_profile_type
    written = (axis.jerk[0], axis.jerk[1], axis.jerk[2], axis.jerk[3])
    for i in range(4):
        axis.jerk[i] = written[i % jerks] if kind == JERK_LIMITED else 0.0
        if kind == SINE_SQUARED:
            axis.jerk[i] = SINE
        if kind == JERK_FREE:
            steepest = axis.deceleration if i & 1 else axis.acceleration
            axis.jerk[i] = steepest / JERK_FREE_TIME


@block
def _velocity_ramps(axis: Axis):
    """Copy a write of 6083h or 6084h to 2090h, for both directions (Metronix 8.6)."""
    od = axis.od
    for k in range(2):
        number = od.profile_deceleration if k else od.profile_acceleration
        now = _rate(axis, PROFILE_ACCELERATION + k, number)
        if axis.ramps_seen[k] > 0.0 and axis.ramps_seen[k] != now:
            for i in range(k, 4, 2):
                od.velocity_ramps[i] = min(int(number), 0x7FFFFFFF)
                axis.kept_shown[VELOCITY_RAMPS + i] = WRITTEN
        axis.ramps_seen[k] = now
    for i in range(4):
        axis.velocity_ramps[i] = _rate(axis, VELOCITY_RAMPS + i, od.velocity_ramps[i])


@block
def _vl(axis: Axis):
    """Set the target and ramps of velocity mode; a vl unit is 1/min times 604Ch."""
    od = axis.od
    if od.vl_dimension_factor[1] == 0 or od.vl_set_point_factor[1] == 0:
        return  # a drive without this mode
    axis.vl_rad_s = od.vl_dimension_factor[0] / od.vl_dimension_factor[1] * RAD_S_PER_MINUTE
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


@block
def _vl_ramp(axis: Axis, speed, time):
    """Speed over time (rad/s²); a time of 0 s is the steepest ramp, full speed in one cycle."""
    steepest = max(axis.max_speed, 1.0) / axis.position_period
    if time == 0:
        return steepest
    return min(max(speed * abs(axis.vl_rad_s) / time, 1e-3), steepest)


@block
def _follow(axis: Axis):
    """Show stored values in the present units if these have changed."""
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
        show_rows(axis, (new, numerators, denominators))
        show_own(axis, (new, numerators, denominators))
        axis.converted = 1
    for kind in range(KINDS):
        axis.unit[kind] = new[kind]
        axis.unit_numerator[kind] = numerators[kind]
        axis.unit_denominator[kind] = denominators[kind]


@block
def _units(axis: Axis):
    measure(axis)
    if axis.values_keep_meaning:
        _follow(axis)


@entry
def units_changed(axes, index):
    """Convert stored values to the present factors now instead of in the next cycle."""
    _units(axes[index])


@block
def _rate(axis: Axis, n, number):
    """A stored acceleration; 0, which process data may bring, counts as one unit."""
    unit = axis.rad_s2_per_acceleration_unit
    return rate(value(axis, n, number, unit), unit)


@block
def increments_to_units(axis: Axis, increments):
    """Position units of an encoder count, exact, halves rounded upwards."""
    numerator, denominator = axis.position_numerator, axis.position_denominator
    if axis.od.polarity & 0x80:
        increments = -increments
    whole = increments // denominator
    rest = increments - whole * denominator
    return whole * numerator + (2 * rest * numerator + denominator) // (2 * denominator)


@rare
def set_position(axis: Axis):
    """Give the present position a value (2030h of some models); nothing moves."""
    axis.set_position_wanted = 0
    wanted = value(axis, SET_POSITION, axis.od.set_position, axis.rad_per_position_unit)
    increments = int(math.floor(wanted / axis.rad_per_increment + 0.5))
    encoder.set_zero(axis, axis.counts - increments)
    axis.homed = 1


@block
def _wrapped32(value):
    return ((value + 2147483648) & 0xFFFFFFFF) - 2147483648


@block
def _count32(position):
    """Nearest INTEGER32, wrapped as a counter."""
    return _wrapped32(int(math.floor(min(max(position, -(2.0**62)), 2.0**62) + 0.5)))


@block
def _in_range(axis: Axis, units):
    """A position as 607Bh shows it: it wraps from one limit to the other."""
    first, second = axis.od.position_range_limit[0], axis.od.position_range_limit[1]
    if axis.range <= 0.0 or first == second:
        return units
    low = min(int(first), int(second))
    return low + (units - low) % (max(int(first), int(second)) - low)


@block
def publish(axis: Axis):
    """Write every object in which a master can read the results of this cycle."""
    od = axis.od
    counts = axis.counts - axis.zero_counts
    od.position_actual_internal_value = _wrapped32(counts)
    od.position_demand_internal_value = _count32(axis.position_demand / axis.rad_per_increment)
    od.position_actual_value = _in_range(axis, _wrapped32(increments_to_units(axis, counts)))
    per_position = 1.0 / axis.rad_per_position_unit
    od.position_demand_value = _in_range(axis, _count32(axis.position_demand * per_position))
    axis.velocity_shown += axis.display_filter * (axis.velocity - axis.velocity_shown)
    od.velocity_sensor_actual_value = integer32(axis.velocity * (60 / (2 * math.pi) * 4096))
    publish_rows(axis)
    waiting = axis.mode == Mode.INTERPOLATED_POSITION and not sync.locked(axis)
    od.modes_of_operation_display = -1 if waiting else axis.mode
    od.digital_inputs = statusword.digital_inputs(axis)
    probing = axis.probe_stored != 0 or od.touch_probe_status != 0 or probe.command(axis) != 0
    if probing or axis.latch_words:
        for i in range(4):
            probed = increments_to_units(axis, axis.probe_counts[i] - axis.zero_counts)
            od.touch_probe_position[i] = _wrapped32(probed)
        probe.publish(axis)
    od.statusword = statusword.compose(axis)
    axis.limits = 0
