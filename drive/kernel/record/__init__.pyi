"""Types of the record, written by `make stub`. Not to be edited.

Scalars stand as int and float: what the control cycle computes with.
"""

from typing import Any

import numpy as np

from .quantity import Kind as Kind, Quantity as Quantity

IP_RECORDS: int
KINDS: int
MAKER_LEGS: int
MAKER_METHODS: int
OWN: int
OWN_STORED: int
SEGMENTS: int
SET_POINTS: int
STORED: int
ANALOG_INPUTS: int
FAULT_CAUSES: int
FAULT_ROWS: int
HISTORY: int
VENDOR_BYTES: int

class Objects:
    """`AXIS.od`: the object dictionary's variables."""

    error_register: int
    """1001h, bits by kind of error"""
    error_count: int
    """1003h:00, entries in the history"""
    error_field: np.ndarray
    """8 values; 1003h, newest first"""
    error_code: int
    """603Fh, last error"""
    abort_connection_option_code: int
    """6007h"""
    controlword: int
    """6040h"""
    statusword: int
    """6041h"""
    vl_target_velocity: int
    """vl unit; 6042h"""
    vl_velocity_demand: int
    """vl unit; 6043h"""
    vl_velocity_actual_value: int
    """vl unit; 6044h"""
    vl_velocity_min_max_amount: np.ndarray
    """2 values; vl unit; 6046h"""
    vl_acceleration_delta_speed: int
    """vl unit; 6048h:01"""
    vl_acceleration_delta_time: int
    """s; 6048h:02"""
    vl_deceleration_delta_speed: int
    """vl unit; 6049h:01"""
    vl_deceleration_delta_time: int
    """s; 6049h:02"""
    vl_quick_stop_delta_speed: int
    """vl unit; 604Ah:01"""
    vl_quick_stop_delta_time: int
    """s; 604Ah:02"""
    vl_set_point_factor: np.ndarray
    """2 values; 604Bh, numerator, denominator"""
    vl_dimension_factor: np.ndarray
    """2 values; 604Ch, numerator, denominator; 1/min per vl unit"""
    quick_stop_option_code: int
    """605Ah"""
    shutdown_option_code: int
    """605Bh"""
    disable_operation_option_code: int
    """605Ch"""
    halt_option_code: int
    """605Dh"""
    fault_reaction_option_code: int
    """605Eh"""
    modes_of_operation: int
    """6060h"""
    modes_of_operation_display: int
    """6061h"""
    position_demand_value: int
    """position unit; 6062h"""
    position_actual_internal_value: int
    """increment; 6063h"""
    position_actual_value: int
    """position unit; 6064h"""
    following_error_window: int
    """position unit; 6065h; FFFFFFFFh switches it off"""
    following_error_time_out: int
    """ms; 6066h"""
    position_window: int
    """position unit; 6067h; FFFFFFFFh switches it off"""
    position_window_time: int
    """ms; 6068h"""
    velocity_demand_value: int
    """velocity unit; 606Bh"""
    velocity_actual_value: int
    """velocity unit; 606Ch"""
    velocity_window: int
    """velocity unit; 606Dh"""
    velocity_window_time: int
    """ms; 606Eh"""
    velocity_threshold: int
    """velocity unit; 606Fh, below it the axis stands still"""
    velocity_threshold_time: int
    """ms; 6070h"""
    target_torque: int
    """rated torque/1000; 6071h"""
    max_torque: int
    """rated torque/1000; 6072h"""
    max_current: int
    """rated current/1000; 6073h"""
    torque_demand: int
    """rated torque/1000; 6074h"""
    motor_rated_current: int
    """mA; 6075h"""
    motor_rated_torque: int
    """mNm; 6076h"""
    torque_actual_value: int
    """rated torque/1000; 6077h"""
    current_actual_value: int
    """rated current/1000; 6078h"""
    dc_link_circuit_voltage: int
    """mV; 6079h"""
    target_position: int
    """position unit; 607Ah"""
    position_range_limit: np.ndarray
    """2 values; position unit; 607Bh, min and max are one place"""
    home_offset: int
    """position unit; 607Ch"""
    software_position_limit: np.ndarray
    """2 values; position unit; 607Dh, min and max"""
    polarity: int
    """607Eh, bit 7 position, bit 6 velocity"""
    max_profile_velocity: int
    """velocity unit; 607Fh"""
    max_motor_speed: int
    """1/min; 6080h"""
    profile_velocity: int
    """velocity unit; 6081h"""
    end_velocity: int
    """velocity unit; 6082h"""
    profile_acceleration: int
    """acceleration unit; 6083h"""
    profile_deceleration: int
    """acceleration unit; 6084h"""
    quick_stop_deceleration: int
    """acceleration unit; 6085h"""
    motion_profile_type: int
    """6086h, 0 trapezoid, 1 sin², 2 jerk-free, 3 jerk-limited"""
    torque_slope: int
    """rated torque/1000 per s; 6087h"""
    torque_profile_type: int
    """6088h, 0 linear"""
    position_encoder_resolution: np.ndarray
    """2 values; 608Fh, increments, motor revolutions"""
    gear_ratio: np.ndarray
    """2 values; 6091h, motor revolutions, shaft revolutions"""
    feed_constant: np.ndarray
    """2 values; 6092h, position units, shaft revolutions"""
    velocity_factor: np.ndarray
    """2 values; 6096h, numerator, divisor of position units/s"""
    acceleration_factor: np.ndarray
    """2 values; 6097h, numerator, divisor of position units/s²"""
    position_factor: np.ndarray
    """2 values; 6093h of DSP 402 V2, increments per position unit"""
    velocity_encoder_factor: np.ndarray
    """2 values; 6094h of DSP 402 V2, per velocity unit"""
    homing_method: int
    """6098h"""
    homing_speeds: np.ndarray
    """2 values; velocity unit; 6099h, search for switch, for zero"""
    homing_acceleration: int
    """acceleration unit; 609Ah"""
    homing_speed_own: int
    """velocity unit; no standard object: of legs in a homing.csv that say `own`"""
    profile_jerk_use: int
    """60A3h, number of jerks in use"""
    profile_jerk: np.ndarray
    """4 values; jerk unit; 60A4h"""
    touch_probe_function: int
    """60B8h"""
    touch_probe_status: int
    """60B9h"""
    touch_probe_position: np.ndarray
    """4 values; position unit; 60BAh-60BDh, 1 pos/neg, 2 pos/neg"""
    position_offset: int
    """position unit; 60B0h"""
    velocity_offset: int
    """velocity unit; 60B1h"""
    torque_offset: int
    """rated torque/1000; 60B2h"""
    interpolation_sub_mode_select: int
    """60C0h, 0 linear"""
    interpolation_data_record: int
    """position unit; 60C1h:01"""
    interpolation_time_units: int
    """10^index s; 60C2h:01"""
    interpolation_time_index: int
    """60C2h:02"""
    interpolation_maximum_buffer_size: int
    """record; 60C4h:01"""
    interpolation_actual_buffer_size: int
    """record; 60C4h:02"""
    interpolation_buffer_organization: int
    """60C4h:03, 0 FIFO, 1 ring"""
    interpolation_buffer_position: int
    """record; 60C4h:04, used entries"""
    interpolation_size_of_data_record: int
    """byte; 60C4h:05"""
    interpolation_buffer_clear: int
    """60C4h:06, 0 clears and locks, 1 enables access"""
    max_acceleration: int
    """acceleration unit; 60C5h"""
    max_deceleration: int
    """acceleration unit; 60C6h"""
    positive_torque_limit: int
    """rated torque/1000; 60E0h"""
    negative_torque_limit: int
    """rated torque/1000; 60E1h"""
    positioning_option_code: int
    """60F2h, bits 0-1: what a relative target counts from"""
    following_error_actual_value: int
    """position unit; 60F4h, demand minus actual"""
    max_slippage: int
    """speed unit; 60F8h; 0 switches it off"""
    control_effort: int
    """velocity unit; 60FAh, output of the position controller"""
    velocity_control_gain: int
    """velocity gain unit; 60F9h:01"""
    velocity_control_time: int
    """µs; 60F9h:02, integral action time; 0 = none"""
    velocity_filter_time: int
    """µs; 60F9h:04, filter of the measured velocity"""
    position_control_gain: int
    """position gain unit; 60FBh:01"""
    velocity_feed_forward: int
    """1/1000; 2010h:01, share of the demand velocity"""
    acceleration_feed_forward: int
    """1e-9 kg·m²; 2010h:02, inertia fed forward"""
    active_limits: int
    """2011h, `words.Limit` bits active now"""
    homing_stop_torque: int
    """rated torque/1000; 2012h:01, limit on the way to a stop"""
    homing_stop_time: int
    """ms; 2012h:02, standing against it"""
    homing_timeout: int
    """ms; 2012h:03; 0 switches it off"""
    homing_error: int
    """2012h:04, `homing.HomingError`"""
    homing_index_distance: int
    """revolution/1000; 2012h:05, from the edge to the index"""
    position_source: int
    """201Ah, 1: the encoder at the load, the speed from the motor's"""
    i2t_time: int
    """ms; 2013h:01, how long the motor bears max torque; 0 = no model"""
    i2t_level: int
    """1/1000; 2013h:02, 1000 = the limit is reduced to rated torque"""
    motor_temperature: int
    """0.1 degC; 2014h:01"""
    motor_temperature_limit: int
    """0.1 degC; 2014h:02"""
    motor_thermal_resistance: int
    """mK/W; 2014h:03; 0 = no model"""
    motor_thermal_time: int
    """s; 2014h:04"""
    motor_winding_loss: int
    """mW; 2014h:05, copper loss at rated torque"""
    brake_fitted: int
    """2015h:01"""
    brake_release_time: int
    """ms; 2015h:02, set-points wait for it"""
    brake_engage_time: int
    """ms; 2015h:03, the power stage stays on for it"""
    switch_polarity: int
    """2016h, bit 0 negative, 1 positive limit, 2 home: normally closed"""
    limit_switch_reaction: int
    """2017h, stop as 605Ah codes 1-4"""
    chopper_voltage: int
    """mV; 2018h:01, the brake chopper switches on"""
    overvoltage: int
    """mV; 2018h:02"""
    undervoltage: int
    """mV; 2018h:03"""
    link_capacitance: int
    """µF; 2018h:04; 0 = a stiff supply"""
    chopper_resistance: int
    """mOhm; 2018h:05; 0 = none fitted"""
    chopper_energy: int
    """mJ; 2018h:06, turned into heat since power-on"""
    supply_voltage: int
    """mV; 2018h:07, rectified"""
    motor_torque_constant: int
    """µNm/A; 201Bh:01"""
    motor_voltage_constant: int
    """µV·s/rad; 201Bh:02; 0 = as the torque constant"""
    motor_resistance: int
    """µOhm; 201Bh:03; 0 = the voltage limits no torque"""
    motor_inductance: int
    """nH; 201Bh:04; 0 = the current follows the voltage at once"""
    supply_resistance: int
    """µOhm; 201Bh:05, before the DC link; 0 = it does not sag"""
    control_structure: int
    """201Ch:01, `cascade.Structure`"""
    pid_gain: int
    """µNm/rad; 201Ch:02, of the PID position controller"""
    pid_integral_gain: int
    """mNm/(rad·s); 201Ch:03"""
    pid_derivative_gain: int
    """µNm·s/rad; 201Ch:04"""
    velocity_torque_feed_forward: int
    """µNm·s/rad; 201Ch:05, of the PID controller"""
    feed_forward_filter_time: int
    """µs; 201Ch:06, of the velocity feed-forward"""
    torque_command_filter_time: int
    """µs; 201Dh:01, low-pass of the torque command"""
    notch_frequency: np.ndarray
    """2 values; 0.1 Hz; 201Dh:02, :05; 0 = off"""
    notch_damping: np.ndarray
    """2 values; 1/1000; 201Dh:03, :06, of its poles: half its width"""
    notch_depth: np.ndarray
    """2 values; 1/1000; 201Dh:04, :07, gain at its frequency"""
    observer_bandwidth: int
    """0.1 Hz; 201Eh:01; 0 = the speed is the filtered difference"""
    observer_inertia: int
    """1e-12 kg·m²; 201Eh:02; 0 = as the acceleration feed-forward"""
    reaction_code: np.ndarray
    """256 values; by row of the model's faults: reaction code + 1, 0 = as listed"""
    fault_reaction: np.ndarray
    """32 values; 2020h, `faults.Reaction` of each cause"""
    set_point_loss_limit: int
    """2019h, missing set-points that are bridged; more are a fault; 0 = off"""
    digital_inputs: int
    """60FDh"""
    touch_probe_counter: np.ndarray
    """4 values; 60D5h-60D8h, edges stored"""
    position_demand_internal_value: int
    """increment; 60FCh"""
    velocity_sensor_actual_value: int
    """6069h, 4096 min per revolution"""
    velocity_display_filter_time: int
    """µs; filter of velocity_actual_value_filtered"""
    velocity_actual_value_filtered: int
    """velocity unit"""
    position_error_limit: int
    """position unit; following error that is a fault; 0 = off"""
    position_control_v_max: int
    """velocity unit; 60FBh:04, limit of 60FAh; 0 = off"""
    position_error_tolerance: int
    """position unit; 60FBh:05, dead band of the controller"""
    position_range_mode: int
    """607Bh: 0 off, 1-2 shortest way, 4 positive, 5 negative"""
    limit_switch_deceleration: int
    """acceleration unit; 0 = the stop of 2017h"""
    limit_switch_polarity: int
    """0 normally closed, 1 normally open"""
    homing_switch_polarity: int
    """0 normally closed, 1 normally open"""
    limit_switch_selector: int
    """1: the two limit switches change places"""
    enable_logic: int
    """2: the bus may enable the power stage"""
    compatibility_control: int
    """`words.Compatibility` bits"""
    manufacturer_status: int
    """`words.ManufacturerStatus` bits"""
    manufacturer_status_mask: int
    """bits that make statusword bit 14"""
    manufacturer_status_invert: int
    """bits inverted before"""
    command_source: int
    """`contacts.Source`: controlword, contacts, or both"""
    dc_brake_time: int
    """ms; braking at the current limit ends after it (stop_by_demand)"""
    stop_velocity: int
    """1/1000 1/min; below it a ramp has ended (stop_by_demand)"""
    stop_hold_time: int
    """ms; for which it has to be below"""
    vl_window: int
    """1/1000 1/min; around the target of vl (vl_window_bit)"""
    vl_internal_velocity: int
    """1/1000 1/min; second set-point of vl"""
    vl_setpoint_source: int
    """`words.SetPointSource`"""
    vl_anticlockwise: np.ndarray
    """3 values; 1/1000 1/min/s; slopes of vl in negative direction: up, down, quick stop; 0 = as in positive"""
    current_limit_channel: int
    """2415h:01, 1-3 an analog input, 4: limit_current acts"""
    limit_current: int
    """mA; 2415h:02"""
    speed_limit_channel: int
    """2416h:01, 1-3 an analog input, 4: limit_speed acts"""
    limit_speed: int
    """speed unit; 2416h:02"""
    analog_input_offset: np.ndarray
    """3 values; mV; 2401h, taken away"""
    velocity_ramps_enable: int
    """2090h:01, 0: pv has no ramps (own_velocity_ramps)"""
    velocity_ramps: np.ndarray
    """4 values; acceleration unit; 2090h:02-05"""
    homing_switch_selector: int
    """6510h:13h, 0: the home switch is DIN9, 1: DIN8"""
    output_function: np.ndarray
    """3 values; 2420h:01-03, of DOUT1-DOUT3 (output_functions)"""
    output_function_more: np.ndarray
    """2 values; 2420h:11-12, a byte an output"""
    latch_control: int
    """bits 0-3: probe 1 pos, neg, probe 2 pos, neg; 8-12: one shown"""
    latch_status: int
    """bits 0-3 stored, 8-11 the one shown, 12-15 inputs"""
    latch_position: np.ndarray
    """4 values; position unit; positive, negative edge of the probe shown; the newest of each probe"""
    sample_mode: int
    """1: locked after one event"""
    sample_status: int
    """bit 0 falling, bit 1 rising edge has come"""
    sample_status_mask: int
    """bits that make statusword bit 15"""
    sample_control: int
    """1 bits clear the status"""
    interpolation_data_relative: int
    """60C1h:02, 1: relative"""
    last_warning_code: int
    """bit 15 active, bits 4-11 main, 0-3 sub-number"""
    set_position: int
    """position unit; the present position is to have this value"""
    digital_outputs: np.ndarray
    """2 values; 60FEh, physical outputs and bit mask"""
    target_velocity: int
    """velocity unit; 60FFh"""
    vendor: np.ndarray
    """1024 values; objects of the model without kernel behaviour"""
    def __getitem__(self, field: str) -> Any: ...
    def __setitem__(self, field: str, value: Any) -> None: ...

class Axis:
    """One servo axis: its objects in drive units, all else in SI at the motor shaft."""

    od: Objects
    position_period: float
    """s; position-controller cycle"""
    velocity_period: float
    """s; velocity-controller cycle"""
    velocity_cycles: int
    """velocity cycles per position cycle"""
    position_gain_unit: float
    """1/s; one unit of 60FBh:01"""
    velocity_gain_unit: float
    """Nm·s/rad; one unit of 60F9h:01"""
    temperature_unit: float
    """K; one unit of the motor temperature"""
    older_factor_group: int
    """1: 6093h, 6094h, 6097h as in DSP 402 V2"""
    values_keep_meaning: int
    """1: a changed factor or polarity changes numbers only"""
    fault_shows_reaction: int
    """1: FAULT shows 000Fh, see `statusword`"""
    voltage_bit: int
    """bit 4: 0 mains voltage, 1 power stage on, 2 off, 3 never"""
    remote_bit: int
    """bit 9: 0 always, 1 enable_logic is 2 and is needed to enable"""
    moving_bit: int
    """1: bit 8 shows that the axis moves"""
    limit_bit_is_i2t: int
    """1: bit 11 shows the I²t limit only"""
    manufacturer_bit: int
    """1: bit 14 from manufacturer status, mask and inversion"""
    top_bit: int
    """bit 15: 0 nothing, 1 referenced, 2 sampled, 3 too hot soon"""
    set_point_capacity: int
    """set-points, with the running one; 0 = as many as fit"""
    halt_ends_job: int
    """1: a halted set-point is dropped, a halted homing has failed"""
    torque_mode_coasts: int
    """1: without controller enable the power goes off at once"""
    limit_at_set_point: int
    """1: 607Dh ends position set-points where they reach it"""
    old_homing_numbers: int
    """1: 32-34 mean 33-35 until compatibility_control says so"""
    switch_types: int
    """1: polarity objects per kind of switch instead of 2016h"""
    single_brake_delay: int
    """1: the release time is the engage time too"""
    range_needs_mode: int
    """1: 607Bh acts only with a position_range_mode"""
    ip_needs_sync: int
    """1: ip waits for SYNC in its time grid"""
    period_at_reset: int
    """1: 60C2h acts after the next reset"""
    latch_words: int
    """1: the touch probe is commanded by latch_control"""
    sync_monitored: int
    """1: set-points may not stay away in any mode, see 2019h"""
    connection_loss_runs_down: int
    """1: 6007h = 2 stops as transition 5 does"""
    stop_by_demand: int
    """1: a stop ends by its demand, see stop_velocity"""
    vl_without_ramp_bits: int
    """1: controlword bits 4-6 mean nothing in vl"""
    vl_keeps_sign: int
    """1: vl runs at the least amount while its target is 0"""
    vl_window_bit: int
    """1: bit 10 in vl: the velocity is within vl_window"""
    reset_lock: int
    """ms; time after a fault in which it cannot be reset"""
    own_velocity_ramps: int
    """1: pv has ramps by direction, see velocity_ramps"""
    output_functions: int
    """1: digital outputs show what output_function says"""
    history_depth: int
    """entries of 1003h; 0 = all"""
    torque_time_constant: float
    """s; first-order response of the current loop; 0 = ideal"""
    supported_modes: int
    """bit of `words.mode_bit` set: the mode, as 6502h"""
    fault_code: np.ndarray
    """32 values; emergency error code of each cause"""
    fault_number: np.ndarray
    """32 values; manufacturer's number: main << 4 | sub"""
    fault_register: np.ndarray
    """32 values; error register bits of each cause"""
    following_error_window: float
    """rad; following_error_window, 6065h; FFFFFFFFh switches it off; inf = off"""
    following_error_cycles: int
    """position cycle; following_error_time_out, 6066h"""
    position_window: float
    """rad; position_window, 6067h; FFFFFFFFh switches it off; inf = off"""
    position_window_cycles: int
    """position cycle; position_window_time, 6068h"""
    velocity_window: float
    """rad/s; velocity_window, 606Dh"""
    velocity_window_cycles: int
    """position cycle; velocity_window_time, 606Eh"""
    velocity_threshold: float
    """rad/s; velocity_threshold, 606Fh, below it the axis stands still"""
    velocity_threshold_cycles: int
    """position cycle; velocity_threshold_time, 6070h"""
    target_torque: float
    """Nm; target_torque, 6071h"""
    target_position: float
    """rad; target_position, 607Ah"""
    range_min: float
    """rad; position_range_limit, 607Bh, min and max are one place"""
    range_max: float
    """rad; position_range_limit, 607Bh, min and max are one place"""
    home_offset: float
    """rad; home_offset, 607Ch"""
    position_limit_min: float
    """rad; software_position_limit, 607Dh, min and max"""
    position_limit_max: float
    """rad; software_position_limit, 607Dh, min and max"""
    max_profile_speed: float
    """rad/s; max_profile_velocity, 607Fh"""
    max_speed: float
    """rad/s; max_motor_speed, 6080h"""
    profile_speed: float
    """rad/s; profile_velocity, 6081h"""
    end_speed: float
    """rad/s; end_velocity, 6082h"""
    acceleration: float
    """rad/s²; profile_acceleration, 6083h"""
    deceleration: float
    """rad/s²; profile_deceleration, 6084h"""
    quick_stop_deceleration: float
    """rad/s²; quick_stop_deceleration, 6085h"""
    torque_slope: float
    """Nm/s; torque_slope, 6087h"""
    homing_speed_switch: float
    """rad/s; homing_speeds, 6099h, search for switch, for zero"""
    homing_speed_zero: float
    """rad/s; homing_speeds, 6099h, search for switch, for zero"""
    homing_acceleration: float
    """rad/s²; homing_acceleration, 609Ah"""
    homing_speed_own: float
    """rad/s; homing_speed_own, no standard object: of legs in a homing.csv that say `own`"""
    jerk: np.ndarray
    """4 values; rad/s³; profile_jerk, 60A4h"""
    position_offset: float
    """rad; position_offset, 60B0h"""
    velocity_offset: float
    """rad/s; velocity_offset, 60B1h"""
    torque_offset: float
    """Nm; torque_offset, 60B2h"""
    ip_data: float
    """rad; interpolation_data_record, 60C1h:01"""
    max_acceleration: float
    """rad/s²; max_acceleration, 60C5h"""
    max_deceleration: float
    """rad/s²; max_deceleration, 60C6h"""
    max_slippage: float
    """rad/s; max_slippage, 60F8h; 0 switches it off"""
    velocity_gain: float
    """Nm·s/rad; velocity_control_gain, 60F9h:01"""
    velocity_filter: float
    """velocity_filter_time, 60F9h:04, filter of the measured velocity"""
    position_gain: float
    """1/s; position_control_gain, 60FBh:01"""
    velocity_feed_forward: float
    """velocity_feed_forward, 2010h:01, share of the demand velocity"""
    inertia_feed_forward: float
    """kg·m²; acceleration_feed_forward, 2010h:02, inertia fed forward"""
    homing_torque: float
    """Nm; homing_stop_torque, 2012h:01, limit on the way to a stop"""
    homing_stop_cycles: int
    """position cycle; homing_stop_time, 2012h:02, standing against it"""
    homing_timeout_cycles: int
    """position cycle; homing_timeout, 2012h:03; 0 switches it off"""
    brake_release_cycles: int
    """position cycle; brake_release_time, 2015h:02, set-points wait for it"""
    pid_velocity: float
    """Nm·s/rad; velocity_torque_feed_forward, 201Ch:05, of the PID controller"""
    feed_forward_filter: float
    """feed_forward_filter_time, 201Ch:06, of the velocity feed-forward"""
    display_filter: float
    """velocity_display_filter_time, filter of velocity_actual_value_filtered"""
    position_error_limit: float
    """rad; position_error_limit, following error that is a fault; 0 = off; inf = off"""
    correction_limit: float
    """rad/s; position_control_v_max, 60FBh:04, limit of 60FAh; 0 = off; inf = off"""
    dead_band: float
    """rad; position_error_tolerance, 60FBh:05, dead band of the controller"""
    limit_deceleration: float
    """rad/s²; limit_switch_deceleration, 0 = the stop of 2017h"""
    dc_brake_time: float
    """s; dc_brake_time, braking at the current limit ends after it (stop_by_demand)"""
    stop_velocity: float
    """rad/s; stop_velocity, below it a ramp has ended (stop_by_demand)"""
    stop_hold_time: float
    """s; stop_hold_time, for which it has to be below"""
    vl_window: float
    """rad/s; vl_window, around the target of vl (vl_window_bit)"""
    limit_speed: float
    """rad/s; limit_speed, 2416h:02"""
    target_velocity: float
    """rad/s; target_velocity, 60FFh"""
    rad_per_increment: float
    """rad; encoder resolution"""
    rad_per_position_unit: float
    """rad; signed by polarity"""
    rad_s_per_velocity_unit: float
    """rad/s; signed by polarity"""
    rad_s2_per_acceleration_unit: float
    """rad/s²"""
    position_numerator: int
    """position units per increment, reduced fraction"""
    position_denominator: int
    """position units per increment, reduced fraction"""
    converted: int
    """units have changed since power-on"""
    kept_shown: np.ndarray
    """53 values; drive unit; the number shown; a write changes it"""
    kept_raw: np.ndarray
    """53 values; drive unit; the number as it was written"""
    kept_unit: np.ndarray
    """53 values; rad, rad/s, rad/s²; the unit in which it was written"""
    kept_numerator: np.ndarray
    """53 values; the same in revolutions and s, exact; 0 = too long"""
    kept_denominator: np.ndarray
    """53 values"""
    own_place: np.ndarray
    """12 values; byte; in `od.vendor`"""
    own_size: np.ndarray
    """12 values; byte; negative: signed; 0 = none"""
    own_kind: np.ndarray
    """12 values; `Kind`"""
    maker_method: np.ndarray
    """4 values; 6098h; 0 = none"""
    maker_first: np.ndarray
    """8 values; row of the first leg: switch off, on"""
    maker_leg: np.ndarray
    """80 values; columns of `homing.LEGS`, leg by leg"""
    own_modes: int
    """key of the model's own modes of operation, see `modes.own`; 0 = none"""
    unit: np.ndarray
    """5 values; rad, rad/s, rad/s²"""
    unit_numerator: np.ndarray
    """5 values; in revolutions and s, exact; 0 = too long"""
    unit_denominator: np.ndarray
    """5 values"""
    rated_torque: float
    """Nm"""
    range: float
    """rad; 607Bh, max minus min; 0 = a linear axis"""
    vl_rad_s: float
    """rad/s; per vl unit"""
    vl_target: float
    """rad/s; with set-point factor and amounts applied"""
    vl_acceleration: float
    """rad/s²"""
    vl_deceleration: float
    """rad/s²"""
    vl_quick_stop: float
    """rad/s²"""
    vl_anticlockwise: np.ndarray
    """3 values; rad/s²; acceleration, deceleration, quick stop"""
    vl_sign: int
    """of the last vl target that was not 0; 0 = none yet"""
    current_limit: float
    """Nm; of 2415h; inf = off"""
    limit_torque: float
    """Nm; the same with its source at full scale"""
    torque_speed: float
    """rad/s; highest in a torque mode: of 2416h, or max_speed"""
    velocity_ramps: np.ndarray
    """4 values; rad/s²; 2090h: up, down; both in negative direction"""
    ramps_seen: np.ndarray
    """2 values; rad/s²; 6083h, 6084h when they were copied there; 0 = never"""
    brake_engage_cycles: int
    """position cycle"""
    interpolation_cycles: int
    """position cycle; 60C2h"""
    turn_option: int
    """`limits.nearest_turn`"""
    switch_inversion: int
    """`encoder.Switch` bits of normally closed switches"""
    velocity_integral_gain: float
    """Nm/rad; gain / integral action time"""
    torque_filter: float
    """share of the new command, per velocity cycle"""
    torque_limit_positive: float
    """Nm"""
    torque_limit_negative: float
    """Nm; a magnitude"""
    shaped: int
    """more than P over PI acts: the fields from here to the observer's"""
    structure: int
    """`cascade.Structure`"""
    pid: np.ndarray
    """3 values; Nm/rad, Nm/(rad·s), Nm·s/rad; gains P, I, D"""
    pid_filter: float
    """share of a new difference in the D part, per velocity cycle"""
    command_filter: float
    """share of the new torque command, per velocity cycle"""
    notch: np.ndarray
    """2 values; b0, b1, b2, a1, a2 of both notch filters"""
    torque_constant: float
    """Nm/A"""
    voltage_constant: float
    """V·s/rad"""
    resistance: float
    """Ohm; 0 = the voltage limits no torque"""
    current_decay: float
    """share of the current that is left after a velocity cycle"""
    observer_gain: np.ndarray
    """3 values; of position, speed and load in the observer; 0 = off"""
    observer_inertia: float
    """kg·m²"""
    shaft_angle: float
    """rad; true angle of the motor shaft"""
    load_angle: float
    """rad; the same by the encoder at the load, if `position_source` is 1"""
    negative_limit_switch: int
    """1 = active"""
    positive_limit_switch: int
    """1 = active"""
    home_switch: int
    """1 = active"""
    touch_probe: np.ndarray
    """2 values; 1 = active"""
    terminals: int
    """contacts S1-S8, see `contacts`"""
    inputs: int
    """further digital inputs, bits 16-31 as in 60FDh"""
    analog_inputs: np.ndarray
    """3 values; V; AIN0-AIN2"""
    enable_input: int
    """1 = the controller may be enabled"""
    sto_input: int
    """1 = torque is allowed, 0 = safe torque off"""
    connection_lost: int
    """1 = the bus says so, option code 6007h acts"""
    lost_node: int
    """node-id whose heartbeat is missing; 0 = the master, by guarding"""
    rpdo_too_short: int
    """1 = the bus says so: an RPDO had too few bytes"""
    rpdo_timeout: int
    """1 = the bus says so: an RPDO's event timer has run out"""
    injected: int
    """bit n: cause n is forced to be present"""
    index_missing: int
    """injected: no index pulse comes"""
    ambient_temperature: float
    """degC"""
    outputs: int
    """digital outputs as they are, bits as in 60FEh (output_functions)"""
    outputs_told: np.ndarray
    """2 values; 60FEh in the last cycle"""
    cycle_count: int
    """position cycle; since power-on"""
    velocity_cycle: int
    """velocity cycle; position within the position cycle"""
    parameters_changed: int
    """factors.receive has to run"""
    sampled: int
    """the encoder has been read at least once"""
    counts: int
    """increment; from the encoder's own zero"""
    motor_counts: int
    """increment; of the motor's encoder, where `counts` are of the load's"""
    zero_counts: int
    """increment; of the axis zero"""
    position: float
    """rad; from the axis zero"""
    velocity: float
    """rad/s; filtered difference of counts"""
    switches: int
    """`encoder.Switch` bits at the last velocity cycle"""
    latch_event: int
    """`homing.Event` awaited by the latch; 0 = disarmed"""
    latched: int
    """the awaited event has come"""
    latch_counts: int
    """increment; encoder count at the event"""
    state: int
    """`words.State`"""
    transition: int
    """last transition of CiA 402, 0..16"""
    pending_transition: int
    """its ramp is running; 0 = none"""
    reset_bit: int
    """fault reset bit of the previous cycle"""
    stop: int
    """`device_control.Stop` in force; 0 = none"""
    stop_cycles: int
    """position cycle; since the stop began"""
    hold_cycles: int
    """position cycle; below the stop threshold"""
    fault_cycle: int
    """position cycle; when the last fault came"""
    contacts: int
    """terminals, or remote contacts where they count"""
    reverse: int
    """the contacts ask for anticlockwise"""
    halted: int
    """halt is in force"""
    refused_command: int
    """last command without a transition, `words.Command`"""
    refused_state: int
    """state that refused it"""
    mode: int
    """active mode, as 6061h"""
    mode_started: int
    """the mode has taken over the demand"""
    bit4: int
    """controlword bit 4 of the previous cycle"""
    control: int
    """`cascade.Control`: which loop is closed"""
    position_demand: float
    """rad"""
    velocity_demand: float
    """rad/s"""
    acceleration_demand: float
    """rad/s²"""
    torque_demand: float
    """Nm"""
    mode_bit10: int
    """target reached"""
    mode_bit12: int
    """mode specific"""
    mode_bit13: int
    """mode specific"""
    ramp_rate: float
    """rad/s²; deceleration of the ramp being travelled (vl)"""
    segments: int
    """in the profile"""
    segment: int
    """being travelled"""
    segment_time: float
    """s; since its begin"""
    segment_duration: np.ndarray
    """16 values; s"""
    segment_begin_velocity: np.ndarray
    """16 values; rad/s"""
    segment_acceleration: np.ndarray
    """16 values; rad/s²; at its begin"""
    segment_jerk: np.ndarray
    """16 values; rad/s³; with a wave its phase (rad)"""
    segment_wave: np.ndarray
    """16 values; rad/s; of a sin² ramp, see `ramps`; 0 = none"""
    segment_position: float
    """rad; at the begin of the segment being travelled"""
    segment_velocity: float
    """rad/s; at the begin of the segment being travelled"""
    profile_position: float
    """rad; exact end of a profile to a position"""
    profile_end_velocity: float
    """rad/s"""
    profile_to_position: int
    """the profile ends at profile_position"""
    profile_done: int
    set_points: int
    """in the buffer; the first is being executed"""
    set_point_started: int
    """the first one has been planned"""
    acknowledged: int
    """set-point acknowledge, statusword bit 12"""
    set_point_position: np.ndarray
    """4 values; rad; as given"""
    set_point_relative: np.ndarray
    """4 values"""
    set_point_speed: np.ndarray
    """4 values; rad/s"""
    set_point_end_speed: np.ndarray
    """4 values; rad/s"""
    set_point_acceleration: np.ndarray
    """4 values; rad/s²"""
    set_point_deceleration: np.ndarray
    """4 values; rad/s²"""
    set_point_jerk: np.ndarray
    """4 values; rad/s³"""
    target: float
    """rad; of the running or last set-point"""
    target_wanted: float
    """rad; the same before the software limits"""
    blocked: int
    """direction locked until it is left: ±1 by a switch, ±2 by 607Dh"""
    interpolation_cycle: int
    """position cycle; since the last set-point"""
    synchronised: int
    """set-points come with process data"""
    silence: int
    """position cycle; since process data were latched"""
    interpolation_start_velocity: float
    """rad/s"""
    interpolation_target_velocity: float
    """rad/s"""
    interpolation_start: float
    """rad"""
    interpolation_target: float
    """rad; end of this period"""
    interpolation_wanted: float
    """rad; the set-point, more than one period away or the same"""
    set_points_in_time: int
    """the last two came one period apart"""
    interpolation_velocity: float
    """rad/s; slope between the last two set-points"""
    ip_buffer: np.ndarray
    """64 values; rad; interpolated position, data records waiting"""
    ip_first: int
    """oldest record"""
    ip_records: int
    """waiting"""
    ip_active: int
    """data records are evaluated"""
    last_ip_data: float
    """rad; ip_data of the previous cycle"""
    last_target_position: float
    """rad; with position_offset, of the previous cycle"""
    sync: int
    """`words.Latched`: process data that came since the last position cycle"""
    sync_pulse: int
    """SYNC has come since the last position cycle"""
    sync_gap: int
    """position cycle; since the last SYNC"""
    sync_wait: int
    """position cycle; interpolation has been waiting for SYNC"""
    sync_good: int
    """SYNCs in the time grid without a break"""
    set_position_wanted: int
    """set_position has been written"""
    homed: int
    """the zero position is valid"""
    homing: int
    """`homing.Progress`"""
    homing_cycles: int
    """position cycle; since the start"""
    stop_timer: int
    """position cycle; standing against a mechanical stop"""
    homing_error: int
    """`homing.HomingError` of the last run; 0 = none"""
    homing_start_counts: int
    """increment; where the leg began to move its way"""
    homing_leg: int
    """row of homing.LEGS in progress"""
    index_near: int
    """home may jump by a revolution: the edge is near the index pulse"""
    velocity_command: float
    """rad/s; into the velocity controller"""
    velocity_correction: float
    """rad/s; of the position controller"""
    velocity_integral: float
    """Nm"""
    feed_forward: float
    """rad/s; filtered velocity demand"""
    special: int
    """`shaped`, or a torque mode: not P over PI alone"""
    pid_error: float
    """rad; of the last velocity cycle"""
    pid_difference: float
    """rad/s; filtered, of the error"""
    command_filtered: float
    """Nm; low-pass of the torque command"""
    notch_state: np.ndarray
    """2 values; Nm; of both notch filters"""
    angle_known: int
    """`last_angle` is of the velocity cycle before"""
    last_angle: float
    """rad; of the shaft"""
    observed: np.ndarray
    """3 values; rad, rad/s, rad/s²; position, speed, and what the load adds"""
    torque_command: float
    """Nm; after limits"""
    torque: float
    """Nm; at the shaft"""
    limits: int
    """`words.Limit` bits active now"""
    following_error: float
    """rad; demand minus actual"""
    velocity_shown: float
    """rad/s; filtered for display"""
    following_error_timer: int
    """position cycle; outside the window"""
    following_error_exceeded: int
    """outside for longer than the time-out"""
    window_timer: int
    """position cycle; inside the position or velocity window"""
    standstill_timer: int
    """position cycle; above the velocity threshold"""
    standstill: int
    heat: float
    """Nm²·s; I²t integral above rated torque"""
    torque_ceiling: float
    """Nm; what I²t and homing on a stop allow now"""
    motor_heating: float
    """K; above ambient"""
    dc_link: float
    """V"""
    shaft_work: float
    """J; of the torque since the last position cycle"""
    link_energy: float
    """J; turned into heat by the brake chopper"""
    probe_stored: int
    """bits: probe 1 pos, neg, probe 2 pos, neg"""
    probe_inputs: int
    """touch probe inputs at the last velocity cycle"""
    probe_counts: np.ndarray
    """4 values; increment; latched"""
    probe_newest: np.ndarray
    """2 values; of each probe, 0 positive, 1 negative edge"""
    brake_released: int
    """the brake lets the shaft turn"""
    brake_timer: int
    """position cycle; since its last command"""
    brake_gripping: int
    """the brake engages before the power goes off"""
    fault: int
    """`faults.Cause` that led to FAULT; 0 = none"""
    faults: int
    """bit n: cause n stops the drive or came afterwards, not reset yet"""
    fault_raised: int
    """a cause that device control has not handled yet; 0 = none"""
    faults_present: int
    """bit n: cause n is still present"""
    warnings: int
    """bit n: cause n is shown as a warning"""
    error_events: int
    """entries made in the history since power-on"""
    event_code: np.ndarray
    """8 values; error code of the last ones, at event % HISTORY"""
    event_cause: np.ndarray
    """8 values; and their cause; 0 = a communication error"""
    def __getitem__(self, field: str) -> Any: ...
    def __setitem__(self, field: str, value: Any) -> None: ...

Row = tuple[str, str | tuple[str, tuple[int, ...]], str, str]
OBJECTS: tuple[Quantity, ...]
QUIRKS: tuple[Row, ...]
FIELDS: tuple[Row, ...]
PLACES: dict[str, int]
RAD_S_PER_MINUTE: float
SIZES: dict[str, float | str]
OD: np.dtype
AXIS: np.dtype
UNITS: dict[str, str]

def accessible(dtype: np.dtype) -> np.dtype: ...
def make(n: int) -> np.ndarray: ...
