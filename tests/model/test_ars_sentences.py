"""Sentences of the ARS family's manuals, named by section: m Metronix, f Festo CMMP-AS."""

import pytest

from conftest import Shaft
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
    assert shaft.drive.read(0x60FE, 1) == dout1 | dout2
    shaft.control(0)
    shaft.step(5)
    assert shaft.drive.read(0x60FE, 1) == brake


def test_m_6_13_2_4_f_5_13_direct_switching_makes_the_function_off_or_on(shaft):
    dout1, dout2, extra = 1 << 25, 1 << 26, 1 << 21
    shaft.drive.write(0x2420, 1, 11)
    shaft.drive.write(0x2420, 2, 16)
    shaft.drive.write(0x60FE, 2, dout1 | extra)
    assert [shaft.drive.read(0x2420, n) for n in (1, 2)] == [0, 16]
    shaft.drive.write(0x60FE, 1, dout1 | dout2 | extra)
    assert [shaft.drive.read(0x2420, n) for n in (1, 2)] == [12, 16]
    assert shaft.drive.read(0x2420, 0x12) == 12 << 8
    assert shaft.drive.read(0x60FE, 1) == dout1 | extra


def test_m_6_13_2_4_f_5_13_functions_of_the_outputs_follow_homing(shaft):
    active, valid = 1 << 25, 1 << 26
    shaft.drive.write(0x2420, 1, 5)
    shaft.drive.write(0x2420, 2, 16)
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
