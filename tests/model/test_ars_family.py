"""Festo CMMP-AS and Metronix ARS 2000: where they depart from CiA 402 (sections in drive.toml)."""

import pytest

from conftest import Shaft
from servogym.drive.canopen.frame import parse
from servogym.drive.canopen.node import Node
from servogym.drive.kernel.homing import HomingError, Progress
from servogym.drive.kernel.words import State
from servogym.drive.objects.abort import Abort, SdoAbort

MODELS = ("festo_cmmp_as", "metronix_ars2000")
PP, PV, TQ, HM, IP = 1, 3, 4, 6, 7


@pytest.fixture(params=MODELS)
def shaft(request):
    shaft = Shaft(request.param)
    shaft.drive.commission({"motor_rated_torque": 1270, "velocity_control_gain": 92})
    return shaft


def refused(shaft, name, value):
    with pytest.raises(SdoAbort) as error:
        shaft.drive.write(name, value)
    return error.value.code


def test_fault_looks_like_fault_reaction_until_compatibility_bit_7(shaft):
    shaft.drive.inject("06-0")
    shaft.step(3)
    assert shaft.drive.state == State.FAULT
    assert shaft.read("statusword") & 0x4F == 0x0F
    shaft.write(compatibility_control=0x80)
    shaft.step()
    assert shaft.read("statusword") & 0x4F == 0x08


def test_voltage_enabled_is_the_power_stage_and_inverted_in_one_of_them(shaft):
    inverted = shaft.drive.model.name == "metronix_ars2000"
    assert shaft.bit(0x10) == inverted
    shaft.control(0x06)
    shaft.control(0x07)
    assert shaft.bit(0x10) != inverted
    shaft.write(compatibility_control=0x80)
    shaft.step()
    assert shaft.bit(0x10)


def test_without_enable_logic_2_the_bus_cannot_enable(shaft):
    assert shaft.bit(0x200)
    shaft.write(enable_logic=0)
    for word in (6, 7, 15):
        shaft.control(word)
    assert shaft.drive.state == State.SWITCH_ON_DISABLED
    assert not shaft.bit(0x200)


def test_both_enable_inputs_are_needed(shaft):
    shaft.axis.enable_input = 0
    shaft.control(6)
    assert shaft.drive.state == State.SWITCH_ON_DISABLED
    assert shaft.read("digital_inputs") & 8
    assert "enable input" in shaft.drive.why()


def test_losing_the_controller_enable_coasts_in_torque_mode_and_brakes_otherwise(shaft):
    shaft.enable(TQ)
    shaft.axis.enable_input = 0
    shaft.step(2)
    assert shaft.drive.state == State.SWITCH_ON_DISABLED
    shaft.axis.enable_input = 1
    shaft.enable(PV)
    shaft.write(target_velocity=1000)
    shaft.step(600)
    shaft.axis.enable_input = 0
    shaft.step(2)
    assert shaft.drive.state == State.QUICK_STOP_ACTIVE
    shaft.until(lambda: shaft.drive.state == State.SWITCH_ON_DISABLED)
    assert abs(shaft.speed) < 2


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("quick_stop_option_code", 2),
        ("shutdown_option_code", 0),
        ("disable_operation_option_code", -1),
        ("fault_reaction_option_code", 0),
    ],
)
def test_option_codes_are_fixed(shaft, name, value):
    assert shaft.read(name) == value
    shaft.drive.write(name, value)
    assert refused(shaft, name, value + 1) == Abort.VALUE_TOO_HIGH


def test_disable_operation_brakes_with_the_quick_stop_deceleration(shaft):
    shaft.enable(PV)
    shaft.write(target_velocity=1000)
    shaft.step(600)
    shaft.control(0x07)
    assert shaft.drive.state == State.OPERATION_ENABLED
    shaft.until(lambda: shaft.drive.state == State.SWITCHED_ON)
    assert abs(shaft.speed) < 2


def test_reactions_are_set_by_main_number_down_to_the_least_allowed(shaft):
    shaft.write(error_number=4, error_reaction_code=3)
    assert shaft.read("error_reaction_code") == 3
    shaft.drive.inject("drive_temperature")
    shaft.step(3)
    assert shaft.drive.state == State.SWITCH_ON_DISABLED
    assert shaft.bit(0x80)
    shaft.write(error_number=6, error_reaction_code=1)
    assert shaft.read("error_reaction_code") == 8, "a short circuit always switches off"
    assert refused(shaft, "error_reaction_code", 2) == Abort.INVALID_VALUE
    assert refused(shaft, "error_number", 97) == Abort.VALUE_TOO_HIGH


def test_three_objects_are_views_on_the_reactions(shaft):
    for name, main in (("enable_dc_link_undervoltage_error", 2), ("iit_error_enable", 31)):
        assert shaft.read(name) == 0
        shaft.drive.write(name, 1)
        shaft.write(error_number=main)
        assert shaft.read("error_reaction_code") == 5
        shaft.write(error_reaction_code=3)
        assert shaft.read(name) == 0
    shaft.write(position_error_switch_off_limit=500, error_number=17)
    assert shaft.read("error_reaction_code") == 8
    assert shaft.read("position_error_switch_off_limit") == 500
    shaft.write(error_reaction_code=3)
    assert shaft.read("position_error_switch_off_limit") == 0


def test_reactions_survive_save_and_reset(shaft):
    shaft.write(error_number=3, error_reaction_code=8)
    shaft.drive.write(0x1010, 1, 0x65766173)
    shaft.drive.reset()
    shaft.write(error_number=3)
    assert shaft.read("error_reaction_code") == 8


def block_shaft(shaft):
    """Hold the shaft while the demand moves on."""
    shaft.enable(PP)
    shaft.blocked = shaft.angle
    shaft.write(target_position=65536 * 5, profile_velocity=300, following_error_window=2000)
    shaft.control(0x1F, 300)


def test_a_following_error_is_a_message_and_the_switch_off_limit_a_fault(shaft):
    block_shaft(shaft)
    assert shaft.drive.state == State.OPERATION_ENABLED
    assert shaft.bit(0x2000)
    assert shaft.bit(0x80)
    assert shaft.read("last_warning_code") == 0x8000 | 27 << 4
    shaft.write(position_error_switch_off_limit=3000)
    shaft.step(5)
    assert shaft.drive.state == State.FAULT
    assert shaft.drive.fault.startswith("8611h")


def test_the_second_set_point_is_acknowledged_until_it_is_started(shaft):
    shaft.enable(PP)
    shaft.write(target_position=65536, profile_velocity=600)
    shaft.control(0x1F)
    assert shaft.bit(0x1000)
    shaft.control(0x0F)
    assert not shaft.bit(0x1000), "the first one is under way, there is room for the next"
    shaft.write(target_position=2 * 65536)
    shaft.control(0x1F)
    shaft.control(0x0F)
    assert shaft.bit(0x1000), "no room until the second is started"
    shaft.until(lambda: not shaft.bit(0x1000))
    assert abs(shaft.read("position_demand_value") - 65536) < 500
    shaft.until(lambda: shaft.bit(0x400))
    assert abs(shaft.read("position_actual_value") - 2 * 65536) < 1820


def test_relative_counts_from_the_demand_and_halt_ends_the_job(shaft):
    shaft.enable(PP)
    shaft.write(target_position=65536 * 4, profile_velocity=600)
    shaft.control(0x1F, 400)
    shaft.control(0x10F, 1000)
    assert shaft.bit(0x400)
    held = shaft.read("position_demand_value")
    assert 0 < held < 65536 * 4
    shaft.control(0x0F, 400)
    assert shaft.read("position_demand_value") == held, "clearing halt does not resume"
    shaft.write(target_position=1000)
    shaft.control(0x5F, 1500)
    assert abs(shaft.read("position_demand_value") - held - 1000) <= 1


@pytest.mark.parametrize(("method", "compatibility"), [(34, 0), (35, 0x04), (35, 0x01)])
def test_the_present_position_is_home_by_an_old_or_a_new_number(shaft, method, compatibility):
    shaft.write(compatibility_control=compatibility, homing_method=method)
    shaft.enable(HM)
    shaft.control(0x1F, 30)
    assert shaft.bit(0x1000)
    assert shaft.axis.homing == Progress.ATTAINED
    assert abs(shaft.angle) < 0.01


def test_one_bit_of_the_homing_scheme_sets_the_other(shaft):
    shaft.write(compatibility_control=0x01)
    assert shaft.read("compatibility_control") == 0x05
    shaft.write(compatibility_control=0x04)
    assert shaft.read("compatibility_control") == 0x05


def test_homing_may_be_followed_by_a_move_to_zero(shaft):
    shaft.write(compatibility_control=0x44, homing_method=35, home_offset=-20_000)
    shaft.enable(HM)
    shaft.control(0x1F, 3)
    assert not shaft.bit(0x400)
    shaft.until(lambda: shaft.axis.homing == Progress.ATTAINED)
    assert abs(shaft.read("position_actual_value")) < 100


def test_homing_that_takes_too_long_is_fault_11_3(shaft):
    shaft.write(homing_timeout=100, homing_method=17)
    shaft.enable(HM)
    shaft.control(0x1F)
    shaft.until(lambda: shaft.drive.state == State.FAULT)
    assert shaft.drive.fault.startswith("8A83h")


def test_a_halted_homing_has_failed_and_its_method_cannot_change_meanwhile(shaft):
    shaft.enable(HM)
    shaft.control(0x1F, 50)
    assert refused(shaft, "homing_method", 18) == Abort.DEVICE_STATE
    shaft.control(0x11F, 50)
    assert shaft.bit(0x2000)
    assert shaft.axis.homing_error == HomingError.HALTED
    shaft.write(homing_method=18)


def test_switches_may_be_normally_closed_and_change_places(shaft):
    assert shaft.read("digital_inputs") & 7 == 0
    shaft.write(limit_switch_polarity=0)
    shaft.step(2)
    assert shaft.read("digital_inputs") & 7 == 3
    shaft.write(limit_switch_polarity=1, homing_switch_polarity=0)
    shaft.axis.negative_limit_switch = 1
    shaft.step(2)
    assert shaft.read("digital_inputs") & 7 == 5
    shaft.write(limit_switch_selector=1)
    shaft.step(2)
    assert shaft.read("digital_inputs") & 7 == 6


def test_a_limit_switch_stops_a_move_and_warns(shaft):
    shaft.enable(PV)
    shaft.write(target_velocity=500)
    shaft.step(600)
    shaft.axis.positive_limit_switch = 1
    shaft.step(100)
    assert abs(shaft.speed) < 1
    assert shaft.drive.state == State.OPERATION_ENABLED
    assert shaft.bit(0x80)
    assert shaft.read("last_warning_code") == 0x8000 | 43 << 4 | 1


def test_position_sampling_stores_both_edges(shaft):
    shaft.enable(PV)
    shaft.write(target_velocity=100, sample_mode=1, sample_status_mask=2)
    shaft.step(400)
    shaft.axis.touch_probe[0] = 1
    shaft.step(20)
    first = shaft.read("sample_position_rising_edge")
    for level in (0, 1):
        shaft.axis.touch_probe[0] = level
        shaft.step(20)
    assert shaft.read("sample_status") == 3
    assert shaft.read("sample_position_rising_edge") == first, "autolock keeps the first"
    assert shaft.read("sample_position_falling_edge") > first
    if shaft.drive.model.name == "metronix_ars2000":
        assert shaft.bit(0x8000)
    shaft.write(sample_control=2)
    shaft.step(2)
    assert shaft.read("sample_status") == 1


def test_the_manufacturer_bit_is_inverted_masked_and_ored(shaft):
    assert shaft.read("manufacturer_statusword_1") == 0x6
    assert not shaft.bit(0x4000)
    shaft.write(manufacturer_status_mask_1=1, manufacturer_status_invert_1=1)
    shaft.step()
    assert shaft.bit(0x4000), "not referenced"
    shaft.write(set_position_absolute=12345)
    shaft.step(2)
    assert not shaft.bit(0x4000)
    assert shaft.read("position_actual_value") == 12345


def test_factors_are_at_most_2_to_the_24(shaft):
    assert refused(shaft, "position_factor_numerator", (1 << 24) + 1) == Abort.INTERNAL_INCOMPATIBLE
    assert refused(shaft, "velocity_encoder_factor_divisor", 0) == Abort.VALUE_TOO_LOW
    shaft.write(position_factor_divisor=225, position_factor_numerator=4096)
    shaft.step()
    shaft.angle = 3.14159265358979
    shaft.step(2)
    assert shaft.read("position_actual_value") == 1800, "a tenth of a degree"


def test_four_errors_are_remembered(shaft):
    for number in ("06-0", "07-0", "06-0", "07-0", "06-0"):
        shaft.drive.inject(number)
        shaft.step(3)
        shaft.drive.clear_injected()
        shaft.step()
        shaft.control(0x80)
        shaft.control(0)
    assert shaft.drive.read(0x1003, 0) == 4
    assert [shaft.drive.read(0x1003, n) for n in (1, 2, 3, 4)] == [0x2320, 0x3210, 0x2320, 0x3210]


def test_load_acts_at_once_and_only_without_power(shaft):
    shaft.write(profile_velocity=77, compatibility_control=0x80)
    shaft.enable(PP)
    with pytest.raises(SdoAbort) as error:
        shaft.drive.write(0x1011, 1, 0x64616F6C)
    assert error.value.code == Abort.DEVICE_STATE
    shaft.control(0)
    shaft.drive.write(0x1011, 1, 0x64616F6C)
    assert shaft.read("profile_velocity") == 1000
    assert shaft.read("compatibility_control") == 0


def synchronise(shaft, period, n):
    for _ in range(n):
        shaft.axis.sync_pulse = 1
        shaft.step(period)


def test_interpolated_position_waits_for_sync_and_for_access(shaft):
    shaft.write(interpolation_time_index=-3, interpolation_time_period_value=5)
    shaft.drive.write(0x1010, 1, 0x65766173)
    shaft.drive.reset()
    shaft.step()
    period = int(shaft.axis.interpolation_cycles)
    assert period == round(5e-3 / shaft.axis.position_period)
    shaft.enable(IP)
    assert shaft.read("modes_of_operation_display") == -1
    synchronise(shaft, period, 2)
    assert shaft.read("modes_of_operation_display") == -1
    synchronise(shaft, period, 3)
    assert shaft.read("modes_of_operation_display") == 7
    with pytest.raises(SdoAbort) as error:
        shaft.drive.write(0x60C1, 1, 100)
    assert error.value.code == Abort.DEVICE_STATE
    shaft.drive.write(0x60C4, 6, 1)
    shaft.write(controlword=0x1F)
    for target in range(0, 4000, 100):
        shaft.drive.write(0x60C1, 1, target)
        synchronise(shaft, period, 1)
    assert shaft.bit(0x1000)
    assert abs(shaft.read("position_actual_value") - 3900) < 300
    shaft.step(3 * period)
    assert shaft.read("modes_of_operation_display") == -1
    assert shaft.drive.fault.startswith("8781h"), "synchronisation lost"


def test_the_interpolation_period_acts_after_a_reset(shaft):
    before = int(shaft.axis.interpolation_cycles)
    shaft.write(interpolation_time_period_value=10)
    shaft.step(3)
    assert shaft.axis.interpolation_cycles == before


def test_moving_shows_in_every_mode(shaft):
    shaft.enable(PV)
    assert not shaft.bit(0x100)
    shaft.write(target_velocity=100)
    shaft.step(300)
    assert shaft.bit(0x100)
    assert abs(shaft.read("velocity_sensor_actual_value") / 4096 - 100) < 5


def test_the_range_needs_a_mode(shaft):
    shaft.write(min_position_range_limit=0, max_position_range_limit=65536)
    shaft.step()
    assert shaft.axis.range == 0.0
    for mode, option in ((1, 3), (2, 3), (4, 2), (5, 1)):
        shaft.write(position_range_limit_enable=mode)
        shaft.step()
        assert shaft.axis.range > 0
        assert shaft.axis.turn_option == option


# ------------------------------------------------------------------- on the bus


class Bus:
    """A node of the family, PRE-OPERATIONAL, and the clock."""

    def __init__(self, model):
        self.shaft = Shaft(model)
        self.drive = self.shaft.drive
        self.node = Node(self.drive)
        self.time = 0
        self.run(1)

    def run(self, milliseconds, *frames):
        got = []
        for text in frames:
            self.node.receive(parse(text), self.time)
        for _ in range(milliseconds):
            self.time += 1000
            self.shaft.step(2)
            got += [str(frame) for frame in self.node.poll(self.time)]
        return got

    def sdo(self, index, subindex, value):
        return self.drive.objects.store(self.drive.objects.slots[index, subindex], value)


@pytest.fixture(params=MODELS)
def bus(request):
    return Bus(request.param)


def test_a_pdo_is_set_up_only_while_it_is_off_and_the_node_not_operational(bus):
    assert bus.sdo(0x1800, 1, 0x1C1) == Abort.DEVICE_STATE, "another identifier needs bit 31"
    assert bus.sdo(0x1800, 1, 0x8000_01C1) == Abort.NONE
    assert bus.drive.read(0x1800, 1) == 0xC000_01C1, "bit 30 always reads 1"
    assert bus.sdo(0x1800, 1, 0x1C1) == Abort.NONE
    assert bus.sdo(0x1800, 2, 1) == Abort.DEVICE_STATE, "it is on"
    assert bus.sdo(0x1A00, 0, 0) == Abort.DEVICE_STATE
    bus.run(1, "000#0101")
    assert bus.sdo(0x1800, 1, 0x8000_01C1) == Abort.DEVICE_STATE, "the node is operational"


def test_type_feh_sends_with_the_inhibit_time_as_period(bus):
    for subindex, value in ((2, 0xFE), (3, 100), (1, 0x181)):
        assert bus.sdo(0x1800, subindex, value) == Abort.NONE
    assert len(bus.run(100, "000#0101")) == 10


def test_type_ffh_sends_on_a_change_of_the_unmasked_bits(bus):
    assert bus.sdo(0x2014, 1, 0x0008) == Abort.NONE
    assert bus.sdo(0x1800, 1, 0x181) == Abort.NONE
    assert len(bus.run(5, "000#0101")) == 1
    bus.drive.write("controlword", 6)
    assert bus.run(5) == [], "ready to switch on: bit 3 is as before"
    bus.drive.inject("06-0")
    frames = bus.run(5)
    assert [frame for frame in frames if frame.startswith("181#")]
    assert [frame for frame in frames if frame.startswith("081#2023")]


def test_a_short_rpdo_is_fault_12_5(bus):
    assert bus.sdo(0x1400, 1, 0x201) == Abort.NONE
    bus.run(2, "000#0101")
    frames = bus.run(3, "201#06")
    assert len(frames) == 1
    assert frames[0].startswith("081#1082"), "8210h, the code of CiA 301"
    assert bus.drive.axis.od.controlword == 0
    assert bus.drive.axis.warnings or bus.drive.model.name == "metronix_ars2000"


def test_sync_on_the_bus_lets_interpolated_position_start(bus):
    bus.drive.write("interpolation_time_period_value", 5)
    bus.drive.write(0x1010, 1, 0x65766173)
    bus.run(1, "000#8101", "000#0101")
    period = bus.drive.axis.interpolation_cycles * bus.drive.axis.position_period * 1e3
    assert period == pytest.approx(5, abs=0.3)
    if bus.drive.model.name == "metronix_ars2000":
        return  # its 416 µs do not divide the test's clock
    bus.shaft.enable(IP)
    for _ in range(5):
        bus.run(5, "080#")
    assert bus.drive.read("modes_of_operation_display") == 7
    bus.run(20)
    assert bus.drive.read("modes_of_operation_display") == -1


def test_node_guarding_begins_with_the_first_request(bus):
    bus.sdo(0x100C, 0, 50)
    bus.sdo(0x100D, 0, 1)
    assert bus.run(200) == []
    assert bus.run(1, "701#R") == ["701#7F"]
    assert bus.run(40, "701#R") == ["701#FF"]
    assert any(frame.startswith("081#3081") for frame in bus.run(60))
    assert bus.drive.state == State.FAULT


def test_a_halt_in_torque_mode_takes_the_torque_away_on_the_slope(shaft):
    shaft.enable(TQ)
    shaft.write(torque_slope=1000, target_torque=300)
    shaft.until(lambda: shaft.read("torque_demand") == 300)
    shaft.write(controlword=0x10F)
    cycles = shaft.until(lambda: shaft.read("torque_demand") == 0)
    assert cycles * shaft.axis.position_period == pytest.approx(0.3, abs=0.01)
    shaft.write(controlword=0x0F)
    shaft.until(lambda: shaft.read("torque_demand") == 300)


def test_a_jerk_free_ramp_builds_its_acceleration_up(shaft):
    shaft.write(motion_profile_type=2, profile_velocity=600)
    shaft.enable(PP)
    shaft.write(target_position=65536)
    shaft.control(0x1F, 3)
    assert 0 < shaft.axis.acceleration_demand < 0.2 * shaft.axis.acceleration
    shaft.step(45)
    assert shaft.axis.acceleration_demand == pytest.approx(shaft.axis.acceleration, rel=0.2)


def test_loading_defaults_leaves_what_belongs_to_the_motor(shaft):
    shaft.write(pole_number=8, encoder_offset_angle=100)
    shaft.drive.write(0x1011, 1, 0x64616F6C)
    assert shaft.read("pole_number") == 8
    assert shaft.read("encoder_offset_angle") == 100


def test_the_error_register_forgets_a_warning_that_has_gone(shaft):
    shaft.drive.inject("31-0")
    shaft.step(3)
    assert shaft.read("error_register") & 1
    shaft.drive.clear_injected()
    shaft.step(3)
    assert shaft.read("error_register") == 0
