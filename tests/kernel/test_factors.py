"""Drive units against exact fractions."""

import math
from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st

from conftest import TURN, Shaft
from servogym.drive.drive import Drive
from servogym.drive.kernel import factors, jit, record
from servogym.drive.objects.abort import Abort, SdoAbort


@jit.entry
def units_of(axis, increments):
    factors.receive(axis)
    return factors.increments_to_units(axis, increments)


factor = st.integers(1, 1000)


@given(factor, factor, factor, factor, factor, factor, st.integers(-(2**31), 2**31))
def test_position_units_are_the_exact_fraction_rounded_half_up(ei, er, gm, gs, f, fs, counts):
    drive = Drive()
    od = drive.axis.od
    od.position_encoder_resolution[:] = ei, er
    od.gear_ratio[:] = gm, gs
    od.feed_constant[:] = f, fs
    exact = Fraction(counts * er * gs * f, ei * gm * fs)
    assert units_of(drive.axes[0], counts) == math.floor(exact + Fraction(1, 2))


def test_a_fraction_that_cannot_be_computed_exactly_is_refused():
    drive = Drive()
    drive.write("feed", 2**31 - 1)
    before = drive.snapshot()
    with pytest.raises(SdoAbort) as error:
        drive.write("gear_motor_revolutions", 2**32 - 5)
    assert error.value.code == Abort.INTERNAL_INCOMPATIBLE
    assert drive.snapshot() == before


def test_si_parameters_follow_gear_feed_and_factors():
    shaft = Shaft()
    shaft.write(gear_motor_revolutions=5, gear_shaft_revolutions=2, feed=10_000)
    shaft.write(velocity_factor_numerator=3, acceleration_factor_divisor=4)
    shaft.write(target_position=10_000, target_velocity=10_000, profile_acceleration=10_000)
    shaft.step()
    a = shaft.axis
    assert a.target_position == pytest.approx(2.5 * TURN)
    assert a.target_velocity == pytest.approx(3 * 2.5 * TURN)
    assert a.acceleration == pytest.approx(2.5 * TURN / 4)


@pytest.mark.parametrize("polarity", [0, 0x80, 0x40, 0xC0])
def test_polarity_turns_targets_and_actual_values_alike(polarity):
    shaft = Shaft()
    shaft.write(polarity=polarity, following_error_window=0xFFFFFFFF)
    shaft.enable(3)
    shaft.write(target_velocity=2_000_000)
    shaft.step(600)
    way = -1 if polarity & 0x40 else 1
    assert shaft.speed * way > 1
    assert shaft.read("velocity_actual_value") == pytest.approx(2_000_000, rel=0.02)
    sign = -1 if polarity & 0x80 else 1
    assert math.copysign(1, shaft.read("position_actual_value")) == sign * way
    shaft.control(0x0F | 0x100, 800)
    here = shaft.read("position_actual_value")
    shaft.write(modes_of_operation=1, target_position=here + 100_000)
    shaft.control(0x0F, 2)
    shaft.control(0x1F, 1500)
    assert shaft.read("position_actual_value") == pytest.approx(here + 100_000, abs=300)


def test_software_limits_keep_their_order_under_polarity():
    shaft = Shaft()
    shaft.write(polarity=0x80, min_position_limit=-100, max_position_limit=300)
    shaft.step()
    unit = abs(shaft.axis.rad_per_position_unit)
    assert shaft.axis.position_limit_min == pytest.approx(-300 * unit)
    assert shaft.axis.position_limit_max == pytest.approx(100 * unit)


def test_integer32_positions_wrap_and_other_values_saturate():
    shaft = Shaft()
    turns = 2**31 / 2**20
    shaft.angle = TURN * 0.5
    shaft.step()
    shaft.drive.cycle((turns + 0.25) * TURN)
    assert shaft.read("position_actual_value") == pytest.approx(-(2**31) + 2**18, abs=2)
    assert shaft.read("velocity_actual_value") == 2**31 - 1


def test_windows_of_ffffffff_are_off():
    shaft = Shaft()
    shaft.write(following_error_window=0xFFFFFFFF, position_window=0xFFFFFFFF)
    shaft.step()
    assert math.isinf(shaft.axis.following_error_window)
    assert math.isinf(shaft.axis.position_window)


def test_every_field_of_the_record_has_a_unit_entry():
    names = set(record.AXIS.names) - {"od"} | {f"od.{name}" for name in record.OD.names}
    assert names == set(record.UNITS)


@pytest.mark.parametrize(
    ("name", "factor", "units", "rad"),
    [
        # results printed for the Festo CMMP-AS, section 5.3: one revolution, 1 1/min, 1 (1/min)/s
        ("position_factor", (1, 1), 65536, TURN),
        ("position_factor", (4096, 225), 3600, TURN),  # 1/10 degree
        ("position_factor", (16384, 25), 100, TURN),  # 1/100 revolution
        ("position_factor", (524288, 6315), 63.15 * 10, TURN * 4 / 5),  # 1/10 mm, gear 4/5
        ("velocity_encoder_factor", (4096, 1), 60, TURN),
        ("velocity_encoder_factor", (1024, 15), 3600, TURN),  # 1/10 degree per s
        ("acceleration_factor", (256, 1), 60, TURN),
        ("acceleration_factor", (64, 15), 3600, TURN),
    ],
)
def test_the_older_factor_group_gives_the_results_printed_in_a_manual(name, factor, units, rad):
    drive = Drive()
    axis = drive.axis
    axis.older_factor_group = 1
    axis.od.position_factor[:] = 1, 1
    axis.od.velocity_encoder_factor[:] = 4096, 1
    axis.od.acceleration_factor[:] = 256, 1
    getattr(axis.od, name)[:] = factor
    drive.cycle(0.0)
    unit = {
        "position_factor": axis.rad_per_position_unit,
        "velocity_encoder_factor": axis.rad_s_per_velocity_unit,
        "acceleration_factor": axis.rad_s2_per_acceleration_unit,
    }[name]
    assert units * unit == pytest.approx(rad, rel=1e-12)


@pytest.mark.parametrize(
    ("bits", "way"), [(0x000, -0.5), (0x040, -0.5), (0x080, 0.5), (0x0C0, -0.5)]
)
def test_a_rotary_axis_shows_one_turn_and_chooses_its_direction(bits, way):
    shaft = Shaft()
    shaft.write(min_position_range_limit=0, max_position_range_limit=1_000_000, feed=1_000_000)
    shaft.write(following_error_window=0xFFFFFFFF, position_window=2000)
    shaft.enable(1)
    shaft.write(target_position=750_000)
    shaft.control(0x1F)
    shaft.control(0x0F, 1200)
    assert shaft.read("position_actual_value") == pytest.approx(750_000, abs=50)
    start = shaft.angle / TURN
    shaft.write(positioning_option_code=bits, target_position=260_000)
    shaft.control(0x1F)
    shaft.control(0x0F, 1200)
    assert shaft.read("position_actual_value") == pytest.approx(260_000, abs=50)
    assert shaft.angle / TURN - start == pytest.approx(way + 0.01, abs=1e-3)
