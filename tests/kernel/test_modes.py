"""pv, vl, tq, csp, csv, cst, ip: what each makes of its set-points, and their status bits."""

import numpy as np
import pytest

from conftest import INCREMENTS, TURN, Shaft
from servogym.drive import Drive, SdoAbort
from servogym.drive.kernel.words import Latched

REACHED, BIT12, BIT13 = 0x0400, 0x1000, 0x2000
LIMIT = 0x0800


@pytest.fixture
def free(shaft):
    shaft.write(following_error_window=0xFFFFFFFF)
    return shaft


def test_pv_ramps_to_the_target_velocity_and_reports_it(free):
    free.write(profile_acceleration=50_000_000, target_velocity=10_000_000)
    free.enable(3)
    assert free.until(lambda: free.read("velocity_demand_value") == 10_000_000) <= 402
    free.until(lambda: free.bit(REACHED))
    assert not free.bit(BIT12)
    free.write(target_velocity=0)
    free.step(600)
    assert free.bit(BIT12), "speed is zero"


def test_pv_is_limited_by_607fh_and_says_so(free):
    free.write(max_profile_velocity=3_000_000, target_velocity=-10_000_000)
    free.enable(3)
    free.step(600)
    assert free.read("velocity_demand_value") == -3_000_000
    assert free.bit(LIMIT)
    assert free.read("active_limits") & 2


def test_pv_brakes_in_front_of_a_software_limit_and_backs_off():
    shaft = Shaft().home_here()
    shaft.write(min_position_limit=-500_000, max_position_limit=2_000_000)
    shaft.write(following_error_window=0xFFFFFFFF, target_velocity=10_000_000)
    shaft.enable(3)
    shaft.step(2000)
    end = shaft.read("position_actual_value")
    assert 1_900_000 < end <= 2_001_000
    assert abs(shaft.speed) < 0.1
    shaft.write(target_velocity=-1_000_000)
    shaft.step(400)
    assert shaft.read("position_actual_value") < end - 100_000


def test_pv_slippage(free):
    free.write(max_slippage=1_000_000, target_velocity=5_000_000)
    free.enable(3)
    free.step(600)
    assert not free.bit(BIT13)
    free.load = -4.5
    free.step(40)
    assert free.bit(BIT13)


def test_csp_interpolates_over_the_period_and_then_holds(free):
    free.write(interpolation_time_period_value=5, interpolation_time_index=-3)
    free.enable(8)
    free.step(5)
    free.write(target_position=1_000)
    demands = []
    free.after = lambda: demands.append(free.read("position_demand_value"))
    free.step(15)
    assert demands == [100 * n for n in range(1, 11)] + [1000] * 5
    assert free.bit(BIT12), "drive follows command"
    free.step(3)
    assert free.read("velocity_demand_value") == 0


def test_csp_adds_the_offsets(free):
    free.enable(8)
    free.write(position_offset=700, target_position=300, velocity_offset=5)
    free.step(10)
    assert free.read("position_demand_value") == 1000
    assert free.axis.velocity_demand == pytest.approx(5 * free.axis.rad_s_per_velocity_unit)


def test_csp_never_asks_for_more_than_the_maximum_speed(free):
    free.write(max_motor_speed=600)
    free.enable(8)
    free.write(target_position=2_000_000_000)
    top = []
    free.after = lambda: top.append(abs(free.axis.velocity_demand))
    free.step(50)
    assert max(top) <= 600 * 2 * np.pi / 60 + 1e-9
    assert max(top) > 60


def test_csp_reaches_a_far_target_written_once_and_says_which_limit_holds_it_back(free):
    free.write(max_motor_speed=3000)
    free.enable(8)
    free.write(target_position=10_000_000)
    cycles = free.until(lambda: free.read("position_demand_value") == 10_000_000, 1000)
    assert cycles * 5e-4 == pytest.approx(10_000_000 / 1_048_576 / 50, abs=2e-3)
    free.step(200)
    assert free.read("active_limits") == 0
    free.write(target_position=0)
    free.step(2)
    for _ in range(100):
        free.step()
        assert free.read("active_limits") & 2, "speed, in every cycle"
        assert free.bit(LIMIT)


@pytest.mark.parametrize("side", [1, -1])
def test_csp_counts_on_over_the_ends_of_an_integer32(side):
    shaft = Shaft().home_here(side * (2**31 - 5_000))
    shaft.write(following_error_window=0xFFFFFFFF, min_position_limit=0, max_position_limit=0)
    shaft.enable(8)
    shaft.write(target_position=shaft.read("position_demand_value"))
    before = shaft.angle
    place = shaft.read("position_actual_value")
    for n in range(1, 101):
        wrapped = (place + side * 100 * n + 2**31) % 2**32 - 2**31
        shaft.write(target_position=wrapped)
        shaft.step(2)
        assert abs(shaft.axis.velocity_demand) <= 110 / 5e-4 * TURN / INCREMENTS
        assert shaft.axis.velocity_demand * side >= 0
    shaft.step(50)
    assert shaft.read("position_demand_value") == wrapped
    assert (shaft.angle - before) * side == pytest.approx(10_000 * TURN / INCREMENTS, rel=0.02)


def test_csp_beyond_the_last_count_is_refused_by_a_software_limit():
    shaft = Shaft().home_here(2**31 - 5_000)
    shaft.write(following_error_window=0xFFFFFFFF)
    shaft.write(min_position_limit=-(2**31), max_position_limit=2**31 - 1)
    shaft.enable(8)
    shaft.write(target_position=-(2**31) + 5_000)
    shaft.step(60)
    assert shaft.read("active_limits") & 8
    assert shaft.read("position_demand_value") == 2**31 - 1


def frames(free, positions, cycles=4):
    """Targets that come with process data every `cycles`; None is a lost frame -> demands."""
    demands = []
    for position in positions:
        if position is not None:
            free.drive.latch(free.drive.pack(controlword=0x1F, target_position=position))
        for _ in range(cycles):
            free.step()
            demands.append(free.read("position_demand_value"))
    return demands


@pytest.mark.parametrize(
    ("allowed", "expected"),
    [(0, [1200] * 12), (2, [*range(1300, 2001, 100), *[2000] * 4])],
)
def test_csp_bridges_as_many_lost_frames_as_2019h_lets_be_missing(free, allowed, expected):
    free.write(interpolation_time_period_value=2, interpolation_time_index=-3)
    free.write(set_point_loss_limit=allowed, reaction_to_set_point_loss=1)
    free.drive.map_pdos([["controlword", "target_position"]])
    free.enable(8)
    frames(free, [0, 0])
    demands = frames(free, [400, 800, 1200, None, None, None])
    assert demands[:12] == [100 * n for n in range(1, 13)]
    assert demands[12:] == expected
    assert frames(free, [2800])[-1] == 2800


def test_csp_frames_that_come_more_seldom_than_60c2h_are_not_lost_ones(free):
    free.write(interpolation_time_period_value=2, interpolation_time_index=-3)
    free.write(set_point_loss_limit=7)
    free.drive.map_pdos([["controlword", "target_position"]])
    free.enable(8)
    demands = frames(free, [0, 800, 1600, 2400], cycles=8)
    assert demands[8:16] == [*range(200, 801, 200), *[800] * 4]
    assert demands[-1] == 2400


def test_csp_does_not_jump_to_an_old_target_when_enabled(free):
    free.write(target_position=1_000_000)
    free.enable(8)
    free.step(50)
    assert abs(free.read("position_demand_value")) < 10


def alone(free, **values):
    """Objects in an RPDO of type 255: it acts when it comes, and no next one is due."""
    free.drive.latch(free.drive.pack(**values))
    free.drive.axis.sync = Latched.ALONE


def test_csp_makes_the_same_of_set_points_that_rest_with_process_data_and_in_an_rpdo_alone():
    positions = [0, 300, 900, 1200, 1200, 1200, 1200, 1000, 1000, 1000]
    said = []
    for latched in (Latched.CYCLIC, Latched.ALONE):
        shaft = Shaft()
        shaft.write(
            interpolation_time_period_value=2, interpolation_time_index=-3,
            following_error_window=0xFFFFFFFF,
        )
        shaft.drive.map_pdos([["controlword", "target_position"]])
        shaft.enable(8)
        said.append([])
        for position in positions:
            alone(shaft, controlword=0x0F, target_position=position)
            shaft.drive.axis.sync = latched
            for _ in range(4):
                shaft.step()
                axis = shaft.drive.axis
                said[-1].append(
                    (axis.position_demand, axis.velocity_demand, axis.acceleration_demand)
                )
    assert said[0] == said[1]


def test_csp_goes_on_with_its_period_where_an_rpdo_alone_repeats_the_set_point(free):
    free.write(interpolation_time_period_value=4, interpolation_time_index=-3)
    free.drive.map_pdos([["controlword", "target_position"]])
    free.enable(8)
    free.step(5)
    demands = []
    for _ in range(4):
        alone(free, controlword=0x0F, target_position=800)
        for _ in range(2):
            free.step()
            demands.append(free.read("position_demand_value"))
    assert demands == [*range(100, 801, 100)]


def test_csp_does_not_jump_to_an_old_target_for_a_controlword_in_an_rpdo_alone(free):
    free.drive.map_pdos([["controlword"]])
    free.write(target_position=1_000_000)
    free.enable(8)
    for _ in range(10):
        alone(free, controlword=0x0F)
        free.step(10)
    assert abs(free.read("position_demand_value")) < 10


def test_csp_misses_set_points_it_was_promised(free):
    free.write(set_point_loss_limit=3)
    free.drive.map_pdos([["controlword", "target_position"]])
    free.enable(8)
    for _ in range(20):
        free.drive.latch(free.drive.pack(controlword=0x0F, target_position=0))
        free.step(2)
    assert free.read("error_code") == 0
    free.step(12)
    assert free.read("error_code") == 0x8700


def test_csv_interpolates_and_follows(free):
    free.write(interpolation_time_period_value=4, interpolation_time_index=-3)
    free.enable(9)
    free.write(target_velocity=800_000)
    seen = []
    free.after = lambda: seen.append(free.read("velocity_demand_value"))
    free.step(10)
    assert seen == [100_000 * n for n in range(1, 9)] + [800_000] * 2
    free.step(300)
    assert free.read("velocity_actual_value") == pytest.approx(800_000, rel=0.02)
    assert free.bit(BIT12)


def test_csv_brakes_at_a_limit_switch_with_the_quick_stop_ramp(free):
    free.enable(9)
    free.write(target_velocity=10_000_000, quick_stop_deceleration=100_000_000)
    free.step(400)
    free.axis.positive_limit_switch = 1
    free.step(1)
    before = free.axis.velocity_demand
    free.step(10)
    rate = (before - free.axis.velocity_demand) / 10 / 5e-4
    assert rate == pytest.approx(100e6 * free.axis.rad_s2_per_acceleration_unit)
    free.step(600)
    assert abs(free.speed) < 0.1


def test_tq_ramps_with_the_torque_slope(free):
    free.blocked = 0.0
    free.write(torque_slope=1_000, target_torque=500)
    free.enable(4)
    cycles = free.until(lambda: free.bit(REACHED))
    assert 990 <= cycles <= 1002
    free.step(20)
    assert free.torque == pytest.approx(0.5 * 1.27, rel=1e-3)
    assert free.read("torque_actual_value") == 500


@pytest.mark.parametrize("mode", [4, 10])
def test_torque_modes_do_not_run_away(free, mode):
    free.write(target_torque=1000, torque_slope=100_000, max_motor_speed=1000)
    free.enable(mode)
    free.step(4000)
    assert free.speed <= 1000 * 2 * np.pi / 60 * 1.02
    assert free.read("active_limits") & 2


def test_cst_passes_target_and_offset_through(free):
    free.blocked = 0.0
    free.enable(10)
    free.write(target_torque=200, torque_offset=100)
    free.step(20)
    assert free.torque == pytest.approx(0.3 * 1.27, rel=1e-3)


def test_max_torque_and_its_directions_limit_the_shaft(free):
    free.blocked = 0.0
    free.write(positive_torque_limit=300, target_torque=2000)
    free.enable(10)
    free.step(40)
    assert free.torque == pytest.approx(0.3 * 1.27, rel=1e-3)
    assert free.read("active_limits") & 1


RAMP, UNLOCK, REFERENCE = 0x10, 0x20, 0x40


def test_vl_ramps_in_speed_over_time(free):
    free.write(vl_velocity_acceleration_delta_speed=600, vl_velocity_acceleration_delta_time=2)
    free.write(vl_target_velocity=300)
    free.enable(2)
    free.control(0x0F | RAMP | UNLOCK | REFERENCE, 1)
    assert 1990 <= free.until(lambda: free.read("vl_velocity_demand") == 300) <= 2002
    free.step(100)
    assert abs(free.read("vl_velocity_actual_value") - 300) <= 2
    assert free.bit(REACHED)


def test_vl_bits_freeze_zero_and_stop_the_ramp(free):
    free.write(vl_target_velocity=1000)
    free.enable(2)
    free.control(0x0F | RAMP | UNLOCK | REFERENCE, 400)
    frozen = free.axis.velocity_demand
    assert frozen > 0
    free.control(0x0F | RAMP | REFERENCE, 100)
    assert free.axis.velocity_demand == pytest.approx(frozen, rel=0.02)
    free.control(0x0F | RAMP | UNLOCK, 50)
    rate = -(free.axis.velocity_demand - frozen) / 50 / 5e-4
    assert rate == pytest.approx(1000 * 2 * np.pi / 60, rel=0.1)
    free.control(0x0F | RAMP | UNLOCK | REFERENCE, 3000)
    before = free.axis.velocity_demand
    free.control(0x0F, 20)
    assert (before - free.axis.velocity_demand) / 20 / 5e-4 == pytest.approx(5000 * np.pi / 30)


def test_vl_amounts_and_set_point_factor(free):
    free.write(vl_velocity_min_amount=100, vl_velocity_max_amount=500)
    free.write(vl_set_point_factor_numerator=2, vl_target_velocity=10)
    free.enable(2)
    free.control(0x7F, 1000)
    assert free.read("vl_velocity_demand") == 100
    free.write(vl_target_velocity=-400)
    free.step(3000)
    assert free.read("vl_velocity_demand") == -500


def test_ip_takes_one_record_a_period_from_the_buffer(free):
    free.write(interpolation_time_period_value=2, interpolation_time_index=-3)
    free.write(buffer_clear=1)
    free.enable(7)
    for position in (400, 800, 1200):
        free.write(interpolation_data=position)
        free.step()
    assert free.read("buffer_position") == 3
    assert free.read("position_demand_value") == 0
    assert not free.bit(BIT12)
    demands = []
    free.after = lambda: demands.append(free.read("position_demand_value"))
    free.control(0x1F, 15)
    assert demands == [100 * n for n in range(1, 13)] + [1200] * 3
    assert free.bit(BIT12)
    assert free.bit(REACHED)
    assert free.read("buffer_position") == 0


@pytest.mark.parametrize(("ring", "kept"), [(0, [100, 200, 300]), (1, [300, 400, 500])])
def test_ip_fifo_refuses_and_ring_overwrites_when_full(free, ring, kept):
    free.write(actual_buffer_size=3, buffer_organization=ring, buffer_clear=1)
    free.enable(7)
    for position in (100, 200, 300, 400, 500):
        free.write(interpolation_data=position)
        free.step()
    seen = []
    free.after = lambda: seen.append(free.read("position_demand_value"))
    free.control(0x1F, 10)
    assert [p for p in seen if p % 100 == 0 and p][:1] == [kept[0]] or kept[0] in seen
    assert seen[-1] == kept[-1]


def records(free, positions, enabled=True):
    """Records 60C1h in process data, one a period of 4 cycles; None: a lost frame -> demands."""
    demands = []
    for position in positions:
        if position is not None:
            word = 0x1F if enabled else 0x0F
            free.drive.latch(free.drive.pack(controlword=word, interpolation_data=position))
        for _ in range(4):
            free.step()
            demands.append(free.read("position_demand_value"))
    return demands


@pytest.fixture
def buffered(free):
    free.write(interpolation_time_period_value=2, interpolation_time_index=-3, buffer_clear=1)
    free.write(set_point_loss_limit=7, reaction_to_set_point_loss=1)
    free.drive.map_pdos([["controlword", "interpolation_data"]])
    return free.enable(7)


@pytest.mark.parametrize("ahead", [1, 3])
def test_ip_records_in_the_buffer_bridge_as_many_lost_frames(buffered, ahead):
    path = [400 * n for n in range(1, 16)]
    records(buffered, path[:ahead], enabled=False)
    lost = path[ahead:]
    lost[2 : 2 + ahead] = [None] * ahead
    demands = records(buffered, lost)
    assert demands[: 4 * (2 + ahead)] == [100 * n for n in range(1, 4 * (2 + ahead) + 1)]


def test_ip_without_a_record_holds_the_last_one_and_does_not_extrapolate(buffered):
    """Outside sub mode -2 an empty buffer holds, whatever 2019h says; the next record goes on."""
    demands = records(buffered, [400, 800, None, None, 1200])
    assert demands[:8] == [100 * n for n in range(1, 9)]
    assert demands[8:16] == [800] * 8
    assert demands[16:] == [900, 1000, 1100, 1200]
    assert buffered.read("velocity_demand_value") != 0
    buffered.step()
    assert buffered.read("velocity_demand_value") == 0


def test_ip_sub_mode_minus_2_extrapolates_as_many_lost_frames_as_2019h_lets_be_missing(buffered):
    buffered.write(set_point_loss_limit=2, interpolation_sub_mode_select=-2)
    demands = records(buffered, [0, 400, 800, None, None, None])
    assert demands[4:] == [*range(100, 1601, 100), *[1600] * 4]


def test_ip_sub_mode_minus_2_takes_the_newest_record_at_once(free):
    free.write(interpolation_sub_mode_select=-2, buffer_clear=1)
    free.write(interpolation_time_period_value=10, interpolation_time_index=-3)
    free.enable(7)
    free.control(0x1F, 2)
    free.write(interpolation_data=2000)
    free.step(10)
    assert free.read("position_demand_value") == 1000, "half of the way"
    free.write(interpolation_data=0)
    free.step(20)
    assert free.read("position_demand_value") == 0, "the old record was dropped"


@pytest.mark.parametrize("mode", [1, 2, 3, 4, 7, 8, 9, 10])
def test_halt_brings_every_mode_to_rest(mode, free):
    free.write(target_velocity=3_000_000, vl_target_velocity=200, target_torque=50)
    free.write(buffer_clear=1)
    free.enable(mode)
    free.write(target_position=4_000_000, interpolation_data=3_000)
    free.control(0x7F, 120)
    free.control(0x17F, 1500)
    assert free.drive.state.name == "OPERATION_ENABLED"
    assert abs(free.speed) < 0.15
    place = free.angle
    free.step(200)
    assert abs(free.angle - place) < 0.02


def test_ip_buffer_clear_locks_the_buffer(free):
    free.write(buffer_clear=0)
    free.enable(7)
    free.write(interpolation_data=1000)
    free.control(0x1F, 20)
    assert free.read("position_demand_value") == 0


@pytest.mark.parametrize("mode", [5, 11, *range(33, 43), *range(65, 75), 127, -1, -63])
def test_an_unsupported_mode_by_pdo_leaves_the_old_one(free, mode):
    free.enable(3)
    free.axis.od.modes_of_operation = mode
    free.step(2)
    assert free.read("modes_of_operation_display") == 3


@pytest.mark.parametrize("first", [1, 2, 3, 4, 6, 7, 8, 9, 10])
@pytest.mark.parametrize("second", [1, 3, 6, 8])
def test_modes_can_be_switched_in_motion_without_a_jump_of_torque(free, first, second):
    free.write(target_velocity=2_000_000, vl_target_velocity=100, target_torque=20)
    free.enable(first)
    free.control(0x7F, 200)
    free.write(modes_of_operation=second, target_torque=0)
    free.control(0x0F, 1)
    assert free.read("modes_of_operation_display") == second
    free.step(3)
    assert free.drive.state.name == "OPERATION_ENABLED"
    assert abs(free.torque) < 3.0


@pytest.mark.parametrize("way", ["position_offset", "target_position"])
def test_a_csp_set_point_acts_when_it_comes_by_sdo(free, way):
    """CiA 402-2, csp: the demand is 607Ah + 60B0h, whichever of them changes, by whatever way."""
    free.enable(8)
    free.step(50)
    before = free.read("position_demand_value")
    free.drive.write(way, free.read(way) + 1000)
    free.step(50)
    assert free.read("position_demand_value") - before == 1000


@pytest.mark.parametrize(("model", "possible"), [("generic", True), ("metronix_ars2000", False)])
def test_no_homing_method_is_a_value_of_the_standard(model, possible):
    """CiA 402-2, 6098h: 0 assigns none; Metronix 8.2.2.4 lists its values, without 0."""
    drive = Drive(model)
    if possible:
        drive.write("homing_method", 0)
        assert drive.read("homing_method") == 0
    else:
        with pytest.raises(SdoAbort):
            drive.write("homing_method", 0)


def test_a_start_without_a_homing_method_ends_in_error(free):
    free.enable(6)
    free.write(homing_method=0)
    free.control(0x1F, 5)
    assert free.axis.mode_bit13
    assert not free.axis.homed


@pytest.mark.parametrize("model", ["metronix_ars2000", "festo_cmmp_as", "festo_cmms"])
def test_the_size_of_a_buffer_is_at_most_its_largest_one(model):
    """Metronix 8.4.2.7, Festo 7.4.2: 60C4h:01 is 0, and the maximum of 60C4h:02."""
    drive = Drive(model)
    assert drive.read(0x60C4, 1) == 0
    drive.write(0x60C4, 2, 0)
    with pytest.raises(SdoAbort, match="too high"):
        drive.write(0x60C4, 2, 1)
