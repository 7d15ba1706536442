"""Sentences of the ARS family's manuals, named by section: m Metronix, f Festo CMMP-AS."""

import pytest

from conftest import Shaft
from servogym.drive.canopen.frame import parse
from servogym.drive.canopen.node import Node
from servogym.drive.drive import Drive
from servogym.drive.kernel.words import State
from servogym.drive.objects.abort import Abort, SdoAbort

LOAD = 0x64616F6C
PV, HM = 3, 6


@pytest.fixture(params=("festo_cmmp_as", "metronix_ars2000"))
def shaft(request):
    shaft = Shaft(request.param)
    shaft.drive.commission({"motor_rated_torque": 1270, "velocity_control_gain": 92})
    return shaft


def answer(shaft, index, subindex, value):
    try:
        shaft.drive.write(index, subindex, value)
    except SdoAbort as error:
        return error.code
    return Abort.NONE


def test_m_6_1_2_1_f_5_1_load_only_without_power_stage(shaft):
    assert answer(shaft, 0x1011, 1, LOAD) == Abort.NONE
    for word in (6, 7):
        shaft.control(word)
    assert shaft.drive.state == State.SWITCHED_ON
    assert answer(shaft, 0x1011, 1, LOAD) == Abort.DEVICE_STATE
    shaft.control(6)
    assert answer(shaft, 0x1011, 1, LOAD) == Abort.NONE


@pytest.mark.parametrize("subindex", [0x30, 0x3A])
def test_m_6_4_2_2_f_5_4_pwm_is_written_only_without_power_stage(shaft, subindex):
    assert answer(shaft, 0x6510, subindex, 1) == Abort.NONE
    for word in (6, 7):
        shaft.control(word)
    assert answer(shaft, 0x6510, subindex, 0) == Abort.DEVICE_STATE
    assert shaft.drive.read(0x6510, subindex) == 1


@pytest.mark.parametrize(
    ("index", "subindex", "limit", "factor"),
    [(0x60FB, 4, 131_072, 0x6094), (0x6510, 0x15, 3_000_000, 0x6097)],
)
def test_m_6_7_2_3_6_14_2_5_f_5_7_5_14_ranges_in_1_per_minute(
    shaft, index, subindex, limit, factor
):
    assert answer(shaft, index, subindex, limit) == Abort.NONE
    assert answer(shaft, index, subindex, limit + 1) == Abort.VALUE_TOO_HIGH
    divisor = shaft.drive.read(factor, 2)
    shaft.drive.write(index, subindex, 1)
    shaft.drive.write(factor, 2, 10 * divisor)  # units of 0.1 1/min
    assert answer(shaft, index, subindex, 10 * limit) == Abort.NONE
    assert answer(shaft, index, subindex, 10 * limit + 1) == Abort.VALUE_TOO_HIGH


def test_m_6_10_2_2_f_5_10_increments_are_4_times_1_to_8192(shaft):
    for value in (4, 8, 4096, 32768):
        assert answer(shaft, 0x201A, 1, value) == Abort.NONE
        assert shaft.drive.read(0x2028) == value
    assert answer(shaft, 0x201A, 1, 0) == Abort.VALUE_TOO_LOW
    assert answer(shaft, 0x201A, 1, 32772) == Abort.VALUE_TOO_HIGH
    assert answer(shaft, 0x201A, 1, 4097) == Abort.INVALID_VALUE
    assert answer(shaft, 0x2028, 0, 4098) == Abort.INVALID_VALUE


def test_m_8_7_2_4_max_torque_is_at_least_1000():
    shaft = Shaft("metronix_ars2000")
    assert answer(shaft, 0x6072, 0, 999) == Abort.VALUE_TOO_LOW
    assert answer(shaft, 0x6072, 0, 1000) == Abort.NONE
    assert answer(Shaft("festo_cmmp_as"), 0x6072, 0, 999) == Abort.NONE


@pytest.mark.parametrize(
    ("index", "allowed"), [(-3, range(1, 11)), (-4, range(10, 101, 10))], ids=["ms", "0.1 ms"]
)
def test_m_8_4_2_5_f_7_4_2_periods_by_index(shaft, index, allowed):
    shaft.write(interpolation_time_index=index)
    taken = [n for n in range(1, 256) if answer(shaft, 0x60C2, 1, n) == Abort.NONE]
    assert taken == [*allowed]


def test_m_6_13_2_3_f_5_13_outputs_read_back_what_they_are(shaft):
    brake, dout1, dout2 = 1, 1 << 25, 1 << 26
    shaft.axis.od.brake_fitted = 1
    shaft.step()
    assert shaft.drive.read(0x60FE, 1) == brake
    shaft.enable(PV)
    assert shaft.drive.read(0x60FE, 1) == 0
    shaft.drive.write(0x2420, 1, 10)  # holding brake released
    shaft.drive.write(0x2420, 2, 11)  # power stage on
    shaft.step()
    assert shaft.drive.read(0x60FE, 1) == dout1 | dout2
    shaft.control(0)
    shaft.step(5)
    assert shaft.drive.read(0x60FE, 1) == brake


def test_m_6_13_2_4_f_5_13_direct_switching_makes_the_function_off_or_on(shaft):
    dout1, dout2, extra = 1 << 25, 1 << 26, 1 << 21
    shaft.drive.write(0x2420, 1, 11)
    shaft.drive.write(0x2420, 2, 16)
    shaft.drive.write(0x60FE, 2, dout1 | extra)
    shaft.step()
    assert [shaft.drive.read(0x2420, n) for n in (1, 2)] == [0, 16]
    shaft.drive.write(0x60FE, 1, dout1 | dout2 | extra)
    shaft.step()
    assert [shaft.drive.read(0x2420, n) for n in (1, 2)] == [12, 16]
    assert shaft.drive.read(0x2420, 0x12) == 12 << 8
    assert shaft.drive.read(0x60FE, 1) == dout1 | extra


def test_m_6_13_2_4_f_5_13_functions_of_the_outputs_follow_homing(shaft):
    active, valid = 1 << 25, 1 << 26
    shaft.drive.write(0x2420, 1, 5)
    shaft.drive.write(0x2420, 2, 16)
    shaft.step()
    assert not shaft.drive.read(0x60FE, 1) & (active | valid)
    shaft.write(homing_method=17)
    shaft.enable(HM)
    shaft.control(0x1F, 20)
    assert shaft.drive.read(0x60FE, 1) & (active | valid) == active
    shaft.control(0x0F, 400)
    shaft.write(homing_method=35)
    shaft.control(0x1F, 20)
    assert shaft.drive.read(0x60FE, 1) & (active | valid) == valid


def test_m_6_8_1_2_f_5_8_limit_current_from_the_field_bus(shaft):
    shaft.write(motor_rated_current=2000)
    shaft.drive.write(0x2415, 2, 500)  # mA: a quarter of the rated current, and torque
    shaft.inertia = 1.0
    shaft.enable(PV)
    shaft.write(target_velocity=1000)
    shaft.step(200)
    assert shaft.torque > 0.5 * 1.27, "0: no limitation"
    shaft.drive.write(0x2415, 1, 4)
    shaft.step(200)
    assert shaft.torque == pytest.approx(1.27 / 4, rel=1e-2)


def test_m_7_1_5_1_f_5_14_bit_7_while_a_direction_is_locked(shaft):
    shaft.enable(PV)
    shaft.write(target_velocity=1000)
    shaft.step(100)
    shaft.axis.positive_limit_switch = 1
    shaft.step(400)
    assert shaft.bit(0x80)
    shaft.axis.positive_limit_switch = 0
    shaft.step(400)
    assert abs(shaft.speed) < 1.0, "the direction is still locked"
    assert shaft.bit(0x80)
    shaft.write(target_velocity=-1000)
    shaft.step(400)
    assert not shaft.bit(0x80)


def test_m_6_7_2_14_f_5_7_without_a_range_mode_nothing_wraps(shaft):
    shaft.write(min_position_range_limit=-1000, max_position_range_limit=1000)
    shaft.angle += 100.0
    shaft.step(3)
    assert shaft.read("position_actual_value") > 1000
    assert shaft.read("position_demand_value") > 1000


def test_m_6_13_2_3_f_5_13_outputs_are_switched_by_pdo_as_by_sdo(shaft):
    drive = shaft.drive
    drive.map_pdos([["physical_outputs", "bit_mask"]], [])
    drive.write(0x2420, 1, 16)
    drive.exchange(drive.pack(physical_outputs=1 << 25, bit_mask=1 << 25))
    shaft.step()
    assert drive.read(0x2420, 1) == 12
    assert shaft.axis.outputs & 1 << 25, "the plant sees them"
    drive.exchange(drive.pack(physical_outputs=0, bit_mask=1 << 25))
    shaft.step()
    assert drive.read(0x2420, 1) == 0
    assert not drive.read(0x60FE, 1) & 1 << 25


def test_f_5_13_functions_above_16_are_festos(shaft):
    if shaft.drive.model.name != "festo_cmmp_as":
        assert answer(shaft, 0x2420, 1, 17) == Abort.VALUE_TOO_HIGH
        return
    dout1, dout2, dout3 = (1 << 25 + n for n in range(3))
    for subindex, function in ((1, 13), (2, 42), (3, 39)):  # common error, STO active, standstill
        shaft.drive.write(0x2420, subindex, function)
    shaft.step()
    assert shaft.drive.read(0x60FE, 1) & (dout1 | dout2 | dout3) == dout3
    shaft.axis.sto_input = 0
    shaft.drive.inject("06-0")
    shaft.step(2)
    assert shaft.drive.read(0x60FE, 1) & (dout1 | dout2) == dout1 | dout2


@pytest.mark.parametrize(("selector", "bit"), [(0, 29), (1, 28)], ids=["DIN9", "DIN8"])
def test_m_6_13_2_2_6_14_f_5_13_5_14_further_inputs_in_bits_16_to_29(shaft, selector, bit):
    shaft.drive.write(0x6510, 0x13, selector)
    shaft.axis.inputs = 0x0FFF_0000  # EA88-0 and DIN0-DIN3
    shaft.step()
    assert shaft.drive.read(0x60FD) == 0x0FFF_0000
    shaft.axis.inputs = 1 << 24
    shaft.axis.home_switch = 1
    shaft.step()
    assert shaft.drive.read(0x60FD) == 1 << 24 | 1 << bit | 4


def rise(shaft, cycles):
    """Change of 606Ch's demand in so many cycles (1/min)."""
    before = shaft.read("velocity_demand_value")
    shaft.step(cycles)
    return shaft.read("velocity_demand_value") - before


def test_m_8_6_f_7_6_each_direction_has_its_ramps(shaft):
    for subindex, rate in ((2, 1000), (3, 2000), (4, 4000), (5, 8000)):
        shaft.drive.write(0x2090, subindex, rate)
    shaft.inertia = 1e-3
    shaft.enable(PV)
    cycles = round(0.05 / shaft.axis.position_period)
    seconds = cycles * shaft.axis.position_period
    for target, rate in ((10_000, 1000), (0, -2000), (-10_000, -4000), (0, 8000)):
        shaft.write(target_velocity=target)
        shaft.step(1)
        assert rise(shaft, cycles) == pytest.approx(rate * seconds, abs=3), target
        shaft.write(target_velocity=0)
        shaft.step(4000)
        if target == 10_000:
            shaft.write(target_velocity=500)
            shaft.step(3000)
        elif target == -10_000:
            shaft.write(target_velocity=-500)
            shaft.step(3000)


def test_m_8_6_f_7_6_profile_acceleration_and_deceleration_set_both_directions(shaft):
    assert [shaft.drive.read(0x2090, n) for n in range(2, 6)] == [14100] * 4
    shaft.write(profile_acceleration=700, profile_deceleration=800)
    assert [shaft.drive.read(0x2090, n) for n in range(2, 6)] == [700, 800, 700, 800]
    shaft.drive.write(0x2090, 4, 900)
    shaft.step(3)
    assert [shaft.drive.read(0x2090, n) for n in range(2, 6)] == [700, 800, 900, 800]
    shaft.drive.map_pdos([["profile_acceleration"]], [])
    shaft.drive.exchange(shaft.drive.pack(profile_acceleration=650))
    shaft.step(2)
    assert [shaft.drive.read(0x2090, n) for n in range(2, 6)] == [650, 800, 650, 800]
    shaft.drive.write(0x6097, 2, 10)  # units of 0.1 1/min per second
    shaft.step(2)
    assert [shaft.drive.read(0x2090, n) for n in range(2, 6)] == [6500, 8000, 6500, 8000]


def test_m_8_6_f_7_6_without_ramps_the_setpoint_jumps_and_a_mode_switches_them_on(shaft):
    shaft.enable(PV)
    shaft.drive.write(0x2090, 1, 0)
    shaft.write(target_velocity=500)
    shaft.step(3)
    assert shaft.read("velocity_demand_value") == 500
    shaft.write(modes_of_operation=1)
    shaft.step(2)
    assert shaft.drive.read(0x2090, 1) == 1


def test_m_6_12_f_5_12_analog_inputs_have_an_offset(shaft):
    shaft.axis.analog_inputs[:] = 5.0, -2.5, 0.0
    shaft.drive.write(0x2401, 1, 500)
    assert [shaft.drive.read(0x2400, n) for n in (1, 2, 3)] == [4500, -2500, 0]


@pytest.mark.parametrize(("channel", "share"), [(1, 0.5), (2, 0.25), (3, 0.0), (4, 1.0)])
def test_m_6_8_1_2_f_5_8_limit_current_by_an_analog_input(shaft, channel, share):
    shaft.axis.analog_inputs[:] = 5.0, 2.5, 0.0
    shaft.write(motor_rated_current=2000)
    shaft.drive.write(0x2415, 2, 1000)
    shaft.drive.write(0x2415, 1, channel)
    shaft.inertia = 1.0
    shaft.enable(PV)
    shaft.write(target_velocity=1000)
    shaft.step(200)
    assert shaft.torque == pytest.approx(share * 1.27 / 2, abs=1e-3)


@pytest.mark.parametrize(("channel", "limit"), [(0, 3000), (1, 300), (4, 600)])
def test_m_6_8_1_3_f_5_8_limit_speed_in_the_torque_mode(shaft, channel, limit):
    shaft.axis.analog_inputs[0] = 5.0
    shaft.write(max_motor_speed=3000)
    shaft.drive.write(0x2416, 2, 600)  # 1/min, or for 10 V
    shaft.drive.write(0x2416, 1, channel)
    shaft.inertia = 2e-4
    shaft.enable(4)
    shaft.write(target_torque=500)
    shaft.step(6000)
    assert shaft.read("velocity_actual_value") == pytest.approx(limit, rel=0.15)


def test_f_5_18_b_3_11_0_homing_starts_only_with_controller_enable(shaft):
    shaft.write(modes_of_operation=HM)
    shaft.control(6)
    before = int(shaft.axis.error_events)
    shaft.control(0x16, 2)
    assert codes(shaft, before) == [0x8A80]
    assert not shaft.axis.homing


def test_f_b_3_34_0_no_sync_on_activating_interpolated_position(shaft):
    before = int(shaft.axis.error_events)
    shaft.enable(7)
    shaft.step(3000)
    assert codes(shaft, before) == [], "not before it is activated"
    shaft.control(0x1F, 3000)
    assert codes(shaft, before) == [0x8780]
    assert shaft.drive.faults


def test_f_b_3_42_0_a_follow_up_positioning_is_missing(shaft):
    shaft.inertia = 1e-4
    shaft.write(profile_velocity=200, end_velocity=100, target_position=20_000)
    shaft.enable(1)
    before = int(shaft.axis.error_events)
    shaft.control(0x1F, 3000)
    assert 0x8680 in codes(shaft, before)
    assert abs(shaft.read("velocity_demand_value")) == 0, "it stops"


@pytest.mark.parametrize(("target", "number"), [(-50_001, "40-2"), (50_001, "40-3")])
def test_f_b_3_40_2_40_3_a_target_behind_a_software_limit_does_not_start(target, number):
    shaft = Shaft("festo_cmmp_as")
    shaft.write(min_position_limit=-50_000, max_position_limit=50_000, homing_method=35)
    shaft.enable(HM)
    shaft.control(0x1F, 30)
    shaft.control(0x0F)
    shaft.write(modes_of_operation=1, target_position=target)
    shaft.step(5)
    before = int(shaft.axis.error_events)
    shaft.control(0x1F, 300)
    assert codes(shaft, before) == [0x8612]
    main, sub = (int(part) for part in number.split("-"))
    assert shaft.drive.read(0x200F) & 0x7FFF == main << 4 | sub
    assert shaft.read("position_demand_value") == 0
    shaft.control(0x0F)
    shaft.write(target_position=-50_000 if target < 0 else 50_000)
    shaft.control(0x1F, 3)
    shaft.step(500)
    assert shaft.read("position_demand_value") != 0


def codes(shaft, since):
    """Error codes entered since so many events."""
    axis = shaft.axis
    return [int(axis.event_code[n % 8]) for n in range(since, int(axis.error_events))]


@pytest.mark.parametrize("every", [1, 3])
@pytest.mark.parametrize("model", ["festo_cmmp_as", "metronix_ars2000", "generic"])
def test_m_5_3_1_f_3_3_1_an_rpdo_of_type_n_is_used_at_every_nth_sync(model, every):
    """The standard's own drive: at the next SYNC, whatever n (CiA 301, RPDO transmission type)."""
    drive = Drive(model, node_id=1)
    node = Node(drive)
    for subindex, value in ((1, 0xC000_0201), (2, every)):
        drive.write(0x1400, subindex, value)
    drive.write(0x1400, 1, 0x4000_0201)
    node.receive(parse("000#0101"), 0)
    used = []
    for n in range(1, 7):
        node.receive(parse(f"201#{n:02X}00"), 1000 * n)
        node.receive(parse("080#"), 1000 * n)
        used.append(drive.read("controlword"))
    last = [n - n % every for n in range(1, 7)] if model != "generic" else [*range(1, 7)]
    assert used == last
