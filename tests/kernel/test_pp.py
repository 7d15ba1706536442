"""Profile position: handshake, buffer, ramps on a real shaft, limits."""

import math

import pytest

from conftest import INCREMENTS, Shaft

ACKNOWLEDGE, REACHED, FOLLOWING_ERROR, INTERNAL_LIMIT = 0x1000, 0x0400, 0x2000, 0x0800
NEW, NOW, RELATIVE, HALT, ON_SET_POINT = 0x10, 0x20, 0x40, 0x100, 0x200


@pytest.fixture
def pp(shaft):
    shaft.write(
        profile_velocity=20_000_000, profile_acceleration=200_000_000,
        profile_deceleration=100_000_000, following_error_window=200_000,
    )
    return shaft.enable(1)


def give(shaft, target, bits=0):
    """One set-point with the handshake up to the fall of new_set_point."""
    shaft.write(target_position=target)
    shaft.control(0x0F | bits | NEW, 1)
    assert shaft.bit(ACKNOWLEDGE)
    shaft.control(0x0F | bits & ~NOW, 1)


def trapezoid(distance, v=20e6, a=200e6, d=100e6):
    peak = min(v, math.sqrt(2 * distance * a * d / (a + d)))
    return peak / a + peak / d + (distance - peak * peak / 2 * (1 / a + 1 / d)) / peak


@pytest.mark.parametrize("distance", [1_000, 500_000, 8_000_000, -8_000_000])
def test_a_move_takes_the_closed_form_time_within_a_cycle(pp, distance):
    start = int(pp.axis.cycle_count)
    done = []
    pp.after = lambda: done.append(int(pp.axis.cycle_count)) if pp.axis.profile_done else None
    give(pp, distance)
    pp.step(3000)
    cycles = done[0] - start
    assert abs(cycles * 5e-4 - trapezoid(abs(distance))) <= 5e-4
    assert pp.read("position_demand_value") == distance
    assert abs(pp.read("position_actual_value") - distance) <= 200
    assert pp.bit(REACHED)


def test_handshake_bits(pp):
    pp.write(target_position=1_000_000)
    assert not pp.bit(ACKNOWLEDGE)
    pp.control(0x1F, 5)
    assert pp.bit(ACKNOWLEDGE), "stays as long as new_set_point does"
    assert not pp.bit(REACHED)
    pp.control(0x0F, 1)
    assert not pp.bit(ACKNOWLEDGE)
    pp.until(lambda: pp.bit(REACHED))
    pp.write(target_position=0)
    pp.step(50)
    assert pp.read("position_demand_value") == 1_000_000, "without an edge nothing starts"


def test_set_points_queue_up_and_a_full_buffer_keeps_the_acknowledge(pp):
    targets = [1_000_000, 3_000_000, 2_000_000, 5_000_000]
    for target in targets[:3]:
        give(pp, target)
        assert not pp.bit(ACKNOWLEDGE)
    give(pp, targets[3])
    assert pp.bit(ACKNOWLEDGE), "four set-points are in: no room"
    pp.write(target_position=-9_000_000)
    pp.control(0x1F, 1)
    pp.control(0x0F, 1)
    turning = []
    pp.after = lambda: turning.append(pp.read("position_demand_value"))
    pp.until(lambda: pp.bit(REACHED))
    assert pp.read("position_demand_value") == 5_000_000, "the fifth was refused"
    assert max(turning[:-1]) <= 5_000_000
    for target in targets:
        assert min(abs(value - target) for value in turning) < 20_000


def test_change_set_immediately_drops_the_running_move(pp):
    give(pp, 20_000_000)
    pp.step(400)
    assert pp.read("velocity_demand_value") == 20_000_000
    give(pp, -1_000_000, NOW)
    pp.until(lambda: pp.bit(REACHED))
    assert pp.read("position_demand_value") == -1_000_000


def test_change_on_set_point_passes_the_target_at_speed(pp):
    give(pp, 8_000_000, ON_SET_POINT)
    give(pp, 20_000_000, ON_SET_POINT)
    speeds = {}
    pp.after = lambda: speeds.__setitem__(
        pp.read("position_demand_value"), pp.read("velocity_demand_value")
    )
    pp.until(lambda: pp.bit(REACHED))
    near = min(speeds, key=lambda place: abs(place - 8_000_000))
    assert speeds[near] == 20_000_000
    assert pp.read("position_demand_value") == 20_000_000


@pytest.mark.parametrize(("option", "expected"), [(0, 3_000_000), (1, None), (2, None)])
def test_relative_counts_from_what_60f2h_says(pp, option, expected):
    pp.write(positioning_option_code=option)
    give(pp, 2_000_000)
    pp.step(100)
    demand = pp.read("position_demand_value")
    give(pp, 1_000_000, RELATIVE | NOW)
    pp.until(lambda: pp.bit(REACHED))
    target = pp.read("position_demand_value")
    if expected is not None:
        assert target == expected
    else:
        assert abs(target - (demand + 1_000_000)) < 40_000


def test_halt_stops_and_its_end_resumes(pp):
    give(pp, 10_000_000)
    pp.step(300)
    pp.control(0x0F | HALT, 800)
    assert pp.bit(REACHED)
    resting = pp.read("position_demand_value")
    assert 0 < resting < 10_000_000
    pp.control(0x0F, 1)
    assert not pp.bit(REACHED)
    pp.until(lambda: pp.bit(REACHED))
    assert pp.read("position_demand_value") == 10_000_000


def test_end_velocity_without_a_successor_ends_in_rest_behind_the_target(pp):
    pp.write(end_velocity=5_000_000)
    give(pp, 4_000_000)
    pp.step(3000)
    assert pp.read("velocity_demand_value") == 0
    assert pp.read("position_demand_value") == pytest.approx(4e6 + 5e6**2 / 2 / 100e6, rel=0.01)


@pytest.mark.parametrize(
    ("use", "expected"), [(1, [1, 1, 1, 1]), (2, [1, 2, 1, 2]), (4, [1, 2, 3, 4])]
)
def test_jerk_use_says_which_jerk_limits_which_phase(pp, use, expected):
    jerks = {f"profile_jerk_{n}": n * 1_000_000 for n in (1, 2, 3, 4)}
    pp.write(motion_profile_type=3, profile_jerk_use=use, **jerks)
    pp.step()
    unit = pp.axis.rad_s2_per_acceleration_unit
    assert (pp.axis.jerk / unit / 1e6).tolist() == pytest.approx(expected)


def test_jerk_limited_profile_is_gentler(pp):
    pp.write(motion_profile_type=3, profile_jerk_1=4_000_000_000)
    bends = []
    last = [0.0]

    def bend():
        unit = pp.axis.rad_s2_per_acceleration_unit
        bends.append((pp.axis.acceleration_demand - last[0]) / unit / 5e-4)
        last[0] = pp.axis.acceleration_demand

    pp.after = bend
    give(pp, 6_000_000)
    pp.until(lambda: pp.bit(REACHED))
    assert max(map(abs, bends)) <= 4_000_000_000 * (1 + 1e-6)


def test_target_reached_waits_for_the_window_time(pp):
    pp.write(position_window=0xFFFFFFFF, position_window_time=50)
    give(pp, 100_000)
    pp.until(lambda: pp.axis.profile_done)
    assert not pp.bit(REACHED)
    assert 98 <= pp.until(lambda: pp.bit(REACHED)) <= 102


def test_software_limits_bound_targets_of_a_referenced_axis():
    shaft = Shaft().home_here()
    shaft.write(min_position_limit=-100_000, max_position_limit=200_000)
    shaft.enable(1)
    give(shaft, 5_000_000)
    assert shaft.read("active_limits") & 8
    assert shaft.bit(INTERNAL_LIMIT)
    shaft.until(lambda: shaft.bit(REACHED))
    assert shaft.read("position_demand_value") == 200_000
    give(shaft, -5_000_000)
    shaft.until(lambda: shaft.bit(REACHED))
    assert shaft.read("position_demand_value") == -100_000


def test_a_limit_switch_stops_the_move_and_leaves_the_way_back_open(pp):
    give(pp, 50_000_000)
    pp.step(400)
    pp.axis.positive_limit_switch = 1
    pp.step(2000)
    stopped = pp.read("position_actual_value")
    assert stopped < 12_000_000
    assert abs(pp.speed) < 0.1
    give(pp, 50_000_000)
    pp.step(100)
    assert abs(pp.read("position_actual_value") - stopped) < 1000, "that way is locked"
    give(pp, stopped - 1_000_000)
    pp.until(lambda: pp.bit(REACHED))
    assert pp.read("position_demand_value") == stopped - 1_000_000


def test_following_error_raises_8611h_after_its_time_out(pp):
    pp.write(following_error_window=10_000, following_error_time_out=20)
    assert INCREMENTS > 10_000
    pp.load = 4.5  # Nm, more than the drive can hold
    pp.until(lambda: abs(pp.read("following_error_actual_value")) > 10_000)
    cycles = pp.until(lambda: pp.read("error_code") == 0x8611)
    assert 38 <= cycles <= 42
    assert pp.bit(FOLLOWING_ERROR)
    pp.load = 0.0
    pp.step(3000)
    assert pp.drive.state.name == "FAULT"
    pp.control(0x00)
    pp.control(0x80)
    assert pp.drive.state.name == "SWITCH_ON_DISABLED"


@pytest.mark.parametrize("jerk", [0, 4_000_000_000])
@pytest.mark.parametrize("way", [1, -1])
@pytest.mark.parametrize("bit", [0, ON_SET_POINT])
def test_a_short_move_with_an_end_velocity_takes_no_run_up(pp, bit, way, jerk):
    """6082h or bit 9 ask for 20 M units/s at a target that 20 000 units lie before."""
    pp.write(end_velocity=0 if bit else 20_000_000, motion_profile_type=3 if jerk else 0)
    pp.write(profile_jerk_1=max(jerk, 1))
    places, speeds = [], []
    pp.after = lambda: (
        places.append(pp.axis.position_demand * way),
        speeds.append(pp.axis.velocity_demand * way),
    )
    give(pp, way * 20_000, bit)
    give(pp, way * 8_000_000, bit)
    pp.until(lambda: pp.axis.velocity_demand == 0 and pp.axis.set_points == 0)
    assert max(places) > 7_999_999 * pp.axis.rad_per_position_unit
    assert min(places) >= 0
    assert min(speeds) >= 0


@pytest.mark.parametrize("jerk", [0, 2_000_000_000])
@pytest.mark.parametrize("far", [100_000, 195_000, 199_000, 200_000])
def test_an_end_velocity_leaves_room_to_stop_before_the_software_limit(far, jerk):
    shaft = Shaft().home_here()
    shaft.write(
        min_position_limit=-100_000, max_position_limit=200_000, end_velocity=15_000_000,
        profile_velocity=20_000_000, profile_acceleration=200_000_000,
        profile_deceleration=100_000_000, motion_profile_type=3 if jerk else 0,
        profile_jerk_1=max(jerk, 1),
    )
    shaft.enable(1)
    places = []
    shaft.after = lambda: places.append(shaft.read("position_demand_value"))
    give(shaft, far)
    shaft.step(1500)
    assert max(places) <= 200_000
    assert places[-1] >= far
    assert shaft.axis.velocity_demand == 0


def test_a_new_target_near_the_software_limit_brakes_with_all_the_deceleration_there_is():
    shaft = Shaft().home_here()
    shaft.write(
        min_position_limit=-100_000, max_position_limit=3_000_000, profile_velocity=20_000_000,
        profile_acceleration=50_000_000, profile_deceleration=100_000_000,
        motion_profile_type=3, profile_jerk_1=4_000_000_000,
    )
    shaft.enable(1)
    give(shaft, 3_000_000)
    places = []
    shaft.after = lambda: places.append(shaft.read("position_demand_value"))
    shaft.until(lambda: shaft.axis.velocity_demand * INCREMENTS / 2 / math.pi > 12_000_000)
    speed = shaft.axis.velocity_demand * INCREMENTS / 2 / math.pi
    begin = shaft.read("position_demand_value")
    give(shaft, 0, NOW)
    shaft.step(2000)
    brakes = speed * (50e6 / 4e9) + speed**2 / 2 / 100e6 + speed * 100e6 / 4e9
    assert max(places) <= begin + 1.05 * brakes
    assert max(places) < 3_000_000
    assert places[-1] == 0
