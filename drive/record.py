"""AXIS: one servo axis as one record. Every parameter, state, input and output is a named field.

The record has two halves, and each quantity lives in exactly one of them:

``od``
    the object dictionary's variables, in *drive units* and in the CiA 301 type of their object
    (``od.target_position`` is an INTEGER32 in position units). SDO and PDO move these bytes
    and nothing else.
everything else
    what the control cycle works on, in SI units at the motor shaft (rad, rad/s, Nm, s), and the
    counters, which are whole cycles.

`factors` is the only place that converts between the halves. Reset is an assignment, a snapshot
is a copy of the bytes, many drives are an array, and two drives cannot share hidden state.
"""

import numpy as np

SEGMENTS = 16  # constant-jerk segments one motion profile may need (`ramps.plan_position`)
SET_POINTS = 4  # buffered profile-position set-points
FAULT_CAUSES = 32  # rows of the cause table (`faults.Cause`)
HISTORY = 8  # depth of pre-defined error field 1003h
VENDOR_BYTES = 1024  # objects of a drive model that the kernel does not read

# field, type, unit, meaning (the object is bound to the field in the model's objects.csv)
OBJECTS = (
    ("error_register", "u1", "", "1001h, bits by kind of error"),
    ("error_count", "u1", "", "1003h:00, entries in the history"),
    ("error_field", ("<u4", (HISTORY,)), "", "1003h, newest first"),
    ("error_code", "<u2", "", "603Fh, last error"),
    ("controlword", "<u2", "", "6040h"),
    ("statusword", "<u2", "", "6041h"),
    ("quick_stop_option_code", "<i2", "", "605Ah"),
    ("shutdown_option_code", "<i2", "", "605Bh"),
    ("disable_operation_option_code", "<i2", "", "605Ch"),
    ("halt_option_code", "<i2", "", "605Dh"),
    ("fault_reaction_option_code", "<i2", "", "605Eh"),
    ("modes_of_operation", "i1", "", "6060h"),
    ("modes_of_operation_display", "i1", "", "6061h"),
    ("position_demand_value", "<i4", "position unit", "6062h"),
    ("position_actual_internal_value", "<i4", "increment", "6063h"),
    ("position_actual_value", "<i4", "position unit", "6064h"),
    ("following_error_window", "<u4", "position unit", "6065h; FFFFFFFFh switches it off"),
    ("following_error_time_out", "<u2", "ms", "6066h"),
    ("position_window", "<u4", "position unit", "6067h; FFFFFFFFh switches it off"),
    ("position_window_time", "<u2", "ms", "6068h"),
    ("velocity_demand_value", "<i4", "velocity unit", "606Bh"),
    ("velocity_actual_value", "<i4", "velocity unit", "606Ch"),
    ("velocity_window", "<u2", "velocity unit", "606Dh"),
    ("velocity_window_time", "<u2", "ms", "606Eh"),
    ("velocity_threshold", "<u2", "velocity unit", "606Fh, below it the axis stands still"),
    ("velocity_threshold_time", "<u2", "ms", "6070h"),
    ("target_torque", "<i2", "rated torque/1000", "6071h"),
    ("max_torque", "<u2", "rated torque/1000", "6072h"),
    ("max_current", "<u2", "rated current/1000", "6073h"),
    ("torque_demand", "<i2", "rated torque/1000", "6074h"),
    ("motor_rated_current", "<u4", "mA", "6075h"),
    ("motor_rated_torque", "<u4", "mNm", "6076h"),
    ("torque_actual_value", "<i2", "rated torque/1000", "6077h"),
    ("current_actual_value", "<i2", "rated current/1000", "6078h"),
    ("target_position", "<i4", "position unit", "607Ah"),
    ("home_offset", "<i4", "position unit", "607Ch"),
    ("software_position_limit", ("<i4", (2,)), "position unit", "607Dh, min and max"),
    ("polarity", "u1", "", "607Eh, bit 7 position, bit 6 velocity"),
    ("max_profile_velocity", "<u4", "velocity unit", "607Fh"),
    ("max_motor_speed", "<u4", "1/min", "6080h"),
    ("profile_velocity", "<u4", "velocity unit", "6081h"),
    ("end_velocity", "<u4", "velocity unit", "6082h"),
    ("profile_acceleration", "<u4", "acceleration unit", "6083h"),
    ("profile_deceleration", "<u4", "acceleration unit", "6084h"),
    ("quick_stop_deceleration", "<u4", "acceleration unit", "6085h"),
    ("motion_profile_type", "<i2", "", "6086h, 0 trapezoid, 3 jerk-limited"),
    ("torque_slope", "<u4", "rated torque/1000 per s", "6087h"),
    ("position_encoder_resolution", ("<u4", (2,)), "", "608Fh, increments, motor revolutions"),
    ("gear_ratio", ("<u4", (2,)), "", "6091h, motor revolutions, shaft revolutions"),
    ("feed_constant", ("<u4", (2,)), "", "6092h, position units, shaft revolutions"),
    ("velocity_factor", ("<u4", (2,)), "", "6096h, numerator, divisor of position units/s"),
    ("acceleration_factor", ("<u4", (2,)), "", "6097h, numerator, divisor of position units/s²"),
    ("homing_method", "i1", "", "6098h"),
    ("homing_speeds", ("<u4", (2,)), "velocity unit", "6099h, search for switch, for zero"),
    ("homing_acceleration", "<u4", "acceleration unit", "609Ah"),
    ("profile_jerk", "<u4", "jerk unit", "60A4h:01"),
    ("position_offset", "<i4", "position unit", "60B0h"),
    ("velocity_offset", "<i4", "velocity unit", "60B1h"),
    ("torque_offset", "<i2", "rated torque/1000", "60B2h"),
    ("interpolation_time_units", "u1", "10^index s", "60C2h:01"),
    ("interpolation_time_index", "i1", "", "60C2h:02"),
    ("max_acceleration", "<u4", "acceleration unit", "60C5h"),
    ("max_deceleration", "<u4", "acceleration unit", "60C6h"),
    ("positive_torque_limit", "<u2", "rated torque/1000", "60E0h"),
    ("negative_torque_limit", "<u2", "rated torque/1000", "60E1h"),
    ("following_error_actual_value", "<i4", "position unit", "60F4h, demand minus actual"),
    ("control_effort", "<i4", "velocity unit", "60FAh, output of the position controller"),
    ("velocity_control_gain", "<u4", "µNm·s/rad", "60F9h:01"),
    ("velocity_control_time", "<u4", "µs", "60F9h:02, integral action time; 0 = none"),
    ("velocity_filter_time", "<u4", "µs", "60F9h:04, filter of the measured velocity"),
    ("position_control_gain", "<u4", "0.001/s", "60FBh:01"),
    ("velocity_feed_forward", "<u2", "1/1000", "2010h:01, share of the demand velocity"),
    ("acceleration_feed_forward", "<u4", "1e-9 kg·m²", "2010h:02, inertia fed forward"),
    ("active_limits", "<u2", "", "2011h, `words.Limit` bits active now"),
    ("digital_inputs", "<u4", "", "60FDh"),
    ("target_velocity", "<i4", "velocity unit", "60FFh"),
    ("vendor", ("u1", (VENDOR_BYTES,)), "", "objects of the model without kernel behaviour"),
)

# field, type, unit, meaning
FIELDS = (
    # what the model fixes
    ("position_period", "f8", "s", "position-controller cycle"),
    ("velocity_period", "f8", "s", "velocity-controller cycle"),
    ("velocity_cycles", "i8", "", "velocity cycles per position cycle"),
    ("torque_time_constant", "f8", "s", "first-order response of the current loop; 0 = ideal"),
    ("supported_modes", "i8", "", "bit n-1 set: mode n, as 6502h"),
    ("negative_homing", "i8", "", "bit n set: homing method -n"),
    ("positive_homing", "i8", "", "bit n set: homing method n"),
    ("fault_code", ("<u2", (FAULT_CAUSES,)), "", "emergency error code of each cause"),
    ("fault_register", ("u1", (FAULT_CAUSES,)), "", "error register bits of each cause"),
    ("fault_reaction", ("u1", (FAULT_CAUSES,)), "", "`faults.Reaction` of each cause"),
    # parameters in SI, made by factors.receive
    ("rad_per_increment", "f8", "rad", "encoder resolution"),
    ("rad_per_position_unit", "f8", "rad", "signed by polarity"),
    ("rad_s_per_velocity_unit", "f8", "rad/s", "signed by polarity"),
    ("rad_s2_per_acceleration_unit", "f8", "rad/s²", ""),
    ("position_numerator", "i8", "", "position units per increment, reduced fraction"),
    ("position_denominator", "i8", "", "position units per increment, reduced fraction"),
    ("rated_torque", "f8", "Nm", ""),
    ("target_position", "f8", "rad", ""),
    ("target_velocity", "f8", "rad/s", ""),
    ("target_torque", "f8", "Nm", ""),
    ("position_offset", "f8", "rad", ""),
    ("velocity_offset", "f8", "rad/s", ""),
    ("torque_offset", "f8", "Nm", ""),
    ("home_offset", "f8", "rad", ""),
    ("position_limit_min", "f8", "rad", "software limit"),
    ("position_limit_max", "f8", "rad", "software limit"),
    ("max_speed", "f8", "rad/s", "motor"),
    ("profile_speed", "f8", "rad/s", "6081h limited by 607Fh and the motor"),
    ("max_profile_speed", "f8", "rad/s", "607Fh limited by the motor"),
    ("end_speed", "f8", "rad/s", ""),
    ("acceleration", "f8", "rad/s²", "6083h limited by 60C5h"),
    ("deceleration", "f8", "rad/s²", "6084h limited by 60C6h"),
    ("quick_stop_deceleration", "f8", "rad/s²", ""),
    ("jerk", "f8", "rad/s³", "0 = trapezoid"),
    ("torque_slope", "f8", "Nm/s", ""),
    ("homing_speed_switch", "f8", "rad/s", ""),
    ("homing_speed_zero", "f8", "rad/s", ""),
    ("homing_acceleration", "f8", "rad/s²", ""),
    ("interpolation_cycles", "i8", "position cycle", "60C2h"),
    ("following_error_window", "f8", "rad", "inf = off"),
    ("following_error_cycles", "i8", "position cycle", ""),
    ("position_window", "f8", "rad", "inf = off"),
    ("position_window_cycles", "i8", "position cycle", ""),
    ("velocity_window", "f8", "rad/s", ""),
    ("velocity_window_cycles", "i8", "position cycle", ""),
    ("velocity_threshold", "f8", "rad/s", ""),
    ("velocity_threshold_cycles", "i8", "position cycle", ""),
    ("position_gain", "f8", "1/s", ""),
    ("velocity_gain", "f8", "Nm·s/rad", ""),
    ("velocity_integral_gain", "f8", "Nm/rad", "gain / integral action time"),
    ("velocity_filter", "f8", "", "share of the new sample, per velocity cycle"),
    ("torque_filter", "f8", "", "share of the new command, per velocity cycle"),
    ("velocity_feed_forward", "f8", "", ""),
    ("inertia_feed_forward", "f8", "kg·m²", ""),
    ("torque_limit_positive", "f8", "Nm", ""),
    ("torque_limit_negative", "f8", "Nm", "a magnitude"),
    # inputs from the plant
    ("shaft_angle", "f8", "rad", "true angle of the motor shaft"),
    ("negative_limit_switch", "u1", "", "1 = active"),
    ("positive_limit_switch", "u1", "", "1 = active"),
    ("home_switch", "u1", "", "1 = active"),
    # time
    ("cycle_count", "i8", "position cycle", "since power-on"),
    ("velocity_cycle", "i8", "velocity cycle", "position within the position cycle"),
    # encoder
    ("parameters_changed", "u1", "", "factors.receive has to run"),
    ("sampled", "u1", "", "the encoder has been read at least once"),
    ("counts", "i8", "increment", "from the encoder's own zero"),
    ("zero_counts", "i8", "increment", "of the axis zero"),
    ("position", "f8", "rad", "from the axis zero"),
    ("velocity", "f8", "rad/s", "filtered difference of counts"),
    ("switches", "i8", "", "`encoder.Switch` bits at the last velocity cycle"),
    ("latch_event", "i8", "", "`homing.Event` awaited by the latch; 0 = disarmed"),
    ("latched", "u1", "", "the awaited event has come"),
    ("latch_counts", "i8", "increment", "encoder count at the event"),
    # device control
    ("state", "i8", "", "`words.State`"),
    ("transition", "i8", "", "last transition of CiA 402, 0..16"),
    ("pending_transition", "i8", "", "its ramp is running; 0 = none"),
    ("reset_bit", "u1", "", "fault reset bit of the previous cycle"),
    ("stop", "i8", "", "`device_control.Stop` in force; 0 = none"),
    ("stop_cycles", "i8", "position cycle", "since the stop began"),
    ("halted", "u1", "", "halt is in force"),
    ("refused_command", "i8", "", "last command without a transition, `words.Command`"),
    ("refused_state", "i8", "", "state that refused it"),
    # mode of operation
    ("mode", "i8", "", "active mode, as 6061h"),
    ("mode_started", "u1", "", "the mode has taken over the demand"),
    ("bit4", "u1", "", "controlword bit 4 of the previous cycle"),
    ("control", "i8", "", "`cascade.Control`: which loop is closed"),
    ("position_demand", "f8", "rad", ""),
    ("velocity_demand", "f8", "rad/s", ""),
    ("acceleration_demand", "f8", "rad/s²", ""),
    ("torque_demand", "f8", "Nm", ""),
    ("mode_bit10", "u1", "", "target reached"),
    ("mode_bit12", "u1", "", "mode specific"),
    ("mode_bit13", "u1", "", "mode specific"),
    # motion profile in progress, see ramps
    ("segments", "i8", "", "in the profile"),
    ("segment", "i8", "", "being travelled"),
    ("segment_time", "f8", "s", "since its begin"),
    ("segment_duration", ("f8", (SEGMENTS,)), "s", ""),
    ("segment_acceleration", ("f8", (SEGMENTS,)), "rad/s²", "at its begin"),
    ("segment_jerk", ("f8", (SEGMENTS,)), "rad/s³", ""),
    ("segment_position", "f8", "rad", "at the begin of the segment being travelled"),
    ("segment_velocity", "f8", "rad/s", "at the begin of the segment being travelled"),
    ("profile_position", "f8", "rad", "exact end of a profile to a position"),
    ("profile_end_velocity", "f8", "rad/s", ""),
    ("profile_to_position", "u1", "", "the profile ends at profile_position"),
    ("profile_done", "u1", "", ""),
    # profile position
    ("set_points", "i8", "", "in the buffer; the first is being executed"),
    ("set_point_started", "u1", "", "the first one has been planned"),
    ("acknowledged", "u1", "", "set-point acknowledge, statusword bit 12"),
    ("set_point_position", ("f8", (SET_POINTS,)), "rad", "as given"),
    ("set_point_relative", ("u1", (SET_POINTS,)), "", ""),
    ("set_point_speed", ("f8", (SET_POINTS,)), "rad/s", ""),
    ("set_point_end_speed", ("f8", (SET_POINTS,)), "rad/s", ""),
    ("set_point_acceleration", ("f8", (SET_POINTS,)), "rad/s²", ""),
    ("set_point_deceleration", ("f8", (SET_POINTS,)), "rad/s²", ""),
    ("set_point_jerk", ("f8", (SET_POINTS,)), "rad/s³", ""),
    ("target", "f8", "rad", "of the running or last set-point"),
    ("blocked", "i8", "", "direction locked by a limit until it is left: -1, 0, +1"),
    # cyclic synchronous
    ("interpolation_cycle", "i8", "position cycle", "since the last set-point"),
    ("interpolation_start", "f8", "rad", ""),
    ("interpolation_target", "f8", "rad", ""),
    ("interpolation_velocity", "f8", "rad/s", "slope between the last two set-points"),
    ("last_target_position", "f8", "rad", "target_position of the previous cycle"),
    ("sync", "u1", "", "process data were latched since the last position cycle"),
    # homing
    ("homed", "u1", "", "the zero position is valid"),
    ("homing", "i8", "", "`homing.Progress`"),
    ("homing_error", "i8", "", "`homing.HomingError` of the last run; 0 = none"),
    ("homing_start_counts", "i8", "increment", "where the leg began to move its way"),
    ("homing_leg", "i8", "", "row of homing.LEGS in progress"),
    # cascade
    ("velocity_command", "f8", "rad/s", "into the velocity controller"),
    ("velocity_correction", "f8", "rad/s", "of the position controller"),
    ("velocity_integral", "f8", "Nm", ""),
    ("torque_command", "f8", "Nm", "after limits"),
    ("torque", "f8", "Nm", "at the shaft"),
    # limits and monitoring
    ("limits", "i8", "", "`words.Limit` bits active now"),
    ("following_error", "f8", "rad", "demand minus actual"),
    ("following_error_timer", "i8", "position cycle", "outside the window"),
    ("following_error_exceeded", "u1", "", "outside for longer than the time-out"),
    ("window_timer", "i8", "position cycle", "inside the position or velocity window"),
    ("standstill_timer", "i8", "position cycle", "above the velocity threshold"),
    ("standstill", "u1", "", ""),
    # faults
    ("fault", "i8", "", "`faults.Cause` that led to FAULT; 0 = none"),
    ("fault_raised", "i8", "", "a cause device control has not yet seen; 0 = none"),
    ("faults_present", "i8", "", "bit n: cause n is still present"),
    ("warnings", "i8", "", "bit n: cause n is shown as a warning"),
)


def _dtype(rows):
    return [(name, *kind) if isinstance(kind, tuple) else (name, kind) for name, kind, _, _ in rows]


OD = np.dtype(_dtype(OBJECTS), align=True)
AXIS = np.dtype([("od", OD), *_dtype(FIELDS)], align=True)
UNITS = {f"od.{name}": unit for name, _, unit, _ in OBJECTS} | {
    name: unit for name, _, unit, _ in FIELDS
}


def make(n: int) -> np.recarray:
    """Records of `n` axes, all zero, shape ``(n,)``; `model.DriveModel.reset` fills them."""
    return np.zeros(n, AXIS).view(np.recarray)
