"""607Dh in every mode: where the axis comes to rest, on which ramp, what shows it; closed forms."""

import numpy as np
import pytest

from conftest import INCREMENTS, TURN, Shaft

LIMIT, FOLLOWS = 0x0800, 0x1000
UNIT = TURN / INCREMENTS  # rad
MIN, MAX = -300_000, 2_000_000
RATE = 60_000_000  # 6085h
BRAKE = RATE * UNIT  # rad/s²


@pytest.fixture
def homed():
    shaft = Shaft().home_here()
    shaft.write(
        min_position_limit=MIN, max_position_limit=MAX, quick_stop_deceleration=RATE,
        following_error_window=0xFFFFFFFF, torque_slope=1_000_000,
    )
    return shaft


def record(shaft, cycles, before=lambda n: None):
    """Demand position (rad), velocity of the shaft, statusword of each cycle."""
    rows = []
    for n in range(cycles):
        before(n)
        shaft.step()
        rows.append((shaft.axis.position_demand, shaft.speed, int(shaft.axis.od.statusword)))
    return np.array(rows)


@pytest.mark.parametrize("mode", [4, 10])
@pytest.mark.parametrize(("push", "limit"), [(200, MAX), (-200, MIN)])
def test_a_torque_mode_brakes_on_the_quick_stop_ramp_and_stands_at_the_limit(
    homed, mode, push, limit
):
    homed.write(target_torque=push)
    homed.enable(mode)
    rows = record(homed, 4000)
    top = np.abs(rows[:, 1]).max()
    assert top > 20, "it was fast"
    # two cycles pass until it brakes, in which it may still accelerate
    late = 2 * 5e-4 * abs(push) * 1.27e-3 / homed.inertia
    early = ((top + late) ** 2 - top**2) / 2 / BRAKE + (top + late) * 2 * 5e-4
    end = np.sign(push) * (homed.angle - limit * UNIT)
    assert -early <= end <= 0.01 * TURN
    assert abs(homed.speed) < 0.05
    # the way from the fastest place to rest is that of a constant deceleration, v² / 2a
    fastest = int(np.abs(rows[:, 1]).argmax())
    cycles = np.flatnonzero(np.abs(rows[fastest:, 1]) < 0.05)[0]
    assert cycles * 5e-4 == pytest.approx(top / BRAKE, rel=0.15)
    assert homed.bit(LIMIT)
    assert mode != 10 or not homed.bit(FOLLOWS), "the torque is not followed"


@pytest.mark.parametrize("mode", [4, 10])
def test_at_the_limit_a_torque_away_from_it_acts_again(homed, mode):
    homed.write(target_torque=150)
    homed.enable(mode)
    homed.step(4000)
    homed.write(target_torque=-100)
    homed.step(2)
    before = homed.speed
    homed.step(40)
    assert not homed.bit(LIMIT)
    acceleration = (homed.speed - before) / (40 * 5e-4)
    assert acceleration == pytest.approx(-0.1 * 1.27 / homed.inertia, rel=0.05)


@pytest.mark.parametrize("mode", [4, 10])
def test_a_torque_mode_counts_on_the_masters_own_braking(homed, mode):
    """The master brakes harder than 6085h, in time: the drive must not interfere before."""
    homed.write(target_torque=200)
    homed.enable(mode)
    homed.until(lambda: homed.angle / UNIT > 0.02 * MAX)
    homed.write(target_torque=-1000)
    bits = [homed.step() or homed.bit(LIMIT) for _ in range(4)]
    assert not any(bits)


@pytest.mark.parametrize("mode", [4, 10])
def test_a_coasting_axis_is_stopped_before_the_limit(homed, mode):
    homed.write(target_torque=200)
    homed.enable(mode)
    homed.until(lambda: homed.angle / UNIT > 0.02 * MAX)
    homed.write(target_torque=0)
    homed.step(4000)
    assert homed.angle / UNIT == pytest.approx(MAX, abs=0.01 * INCREMENTS)
    assert abs(homed.speed) < 0.05


@pytest.mark.parametrize("mode", [4, 10])
def test_an_axis_that_is_not_homed_has_no_software_limit(mode):
    shaft = Shaft()
    shaft.write(min_position_limit=MIN, max_position_limit=MAX, target_torque=200)
    shaft.write(torque_slope=1_000_000)
    shaft.enable(mode)
    shaft.step(4000)
    assert shaft.angle / UNIT > 2 * MAX


@pytest.mark.parametrize("mode", [4, 10])
def test_a_limit_switch_brakes_a_torque_mode(homed, mode):
    homed.write(min_position_limit=0, max_position_limit=0, target_torque=60)
    homed.enable(mode)
    homed.step(60)
    top = homed.speed
    homed.axis.positive_limit_switch = 1
    homed.step(1)
    place = homed.angle
    homed.step(1000)
    assert abs(homed.speed) < 0.05
    assert homed.angle - place == pytest.approx(top * top / 2 / BRAKE, rel=0.15)


def cyclic(shaft, mode, positions):
    """Set-points in process data, one a period of 2 ms (4 cycles)."""
    name = "target_position" if mode == 8 else "interpolation_data"
    shaft.write(interpolation_time_period_value=2, interpolation_time_index=-3)
    if mode == 7:
        shaft.write(interpolation_sub_mode_select=-2, buffer_clear=1)
    shaft.drive.map_pdos([["controlword", name]])
    shaft.enable(mode)
    word = 0x1F if mode == 7 else 0x0F

    def send(n):
        if n % 4 == 0 and n // 4 < len(positions):
            target = int(positions[n // 4])
            shaft.drive.latch(shaft.drive.pack(controlword=word, **{name: target}))

    return record(shaft, 4 * len(positions) + 400, send)


@pytest.mark.parametrize("mode", [7, 8])
@pytest.mark.parametrize(("step", "limit"), [(8_000, MAX), (-8_000, MIN)])
def test_set_points_that_run_into_the_limit_end_there_on_the_quick_stop_ramp(
    homed, mode, step, limit
):
    period = 4 * 5e-4
    count = abs(limit // step) + 60
    rows = cyclic(homed, mode, [n * step for n in range(count)])
    demand = rows[:, 0]
    assert demand[-1] == pytest.approx(limit * UNIT, abs=UNIT)
    sign = np.sign(step)
    assert (sign * demand).max() <= sign * limit * UNIT + 1e-9
    speed = sign * np.diff(demand)[3::4] / 5e-4  # of each period
    full = abs(step) * UNIT / period
    assert speed.max() == pytest.approx(full, rel=1e-6)
    assert -np.diff(speed).min() / period <= BRAKE * (1 + 1e-6), "not steeper than 6085h"
    # and not earlier than it must: v² / 2a before the limit, within two periods' way
    last = np.flatnonzero(speed > full * 0.999)[-1]
    way = abs(limit * UNIT) - sign * demand[4 * last + 4]
    assert full**2 / 2 / BRAKE <= way + 2 * full * period
    assert way <= full**2 / 2 / BRAKE + 2 * full * period
    assert int(rows[-1, 2]) & LIMIT


@pytest.mark.parametrize("mode", [7, 8])
def test_set_points_that_stop_in_time_are_followed_exactly(homed, mode):
    """A path to the limit itself at 0.9 times 6085h: nothing is held back, no limit shows."""
    period = 4 * 5e-4
    rate, top = 0.9 * BRAKE, 40.0
    end = MAX * UNIT
    t = np.arange(0, end / top + top / rate + 0.1, period)
    begin = end - top * top / 2 / rate
    t1 = begin / top
    path = np.where(t < t1, top * t, begin + top * (t - t1) - rate * (t - t1) ** 2 / 2)
    path[t > t1 + top / rate] = end
    counts = np.rint(path / UNIT)
    rows = cyclic(homed, mode, counts)
    demand = rows[3::4, 0][: len(counts)] / UNIT
    assert np.abs(demand - counts)[2:].max() < 1e-3
    assert not (rows[:, 2].astype(int) & LIMIT)[: 4 * len(counts)].any()


def test_bridged_set_points_do_not_pass_the_limit_either(homed):
    homed.write(set_point_loss_limit=200, reaction_to_set_point_loss=1)
    step = 8_000
    lost = MAX // step - 20  # from there on frames are missing
    rows = cyclic(homed, 8, [n * step for n in range(lost)])
    assert rows[-1, 0] == pytest.approx(MAX * UNIT, abs=UNIT)
    speed = np.diff(rows[:, 0]) / 5e-4
    assert -np.diff(speed).min() / 5e-4 <= BRAKE * (1 + 1e-3)


@pytest.mark.parametrize("mode", [2, 3, 9])
def test_a_velocity_mode_shows_the_limit_as_long_as_it_stands_there(homed, mode):
    homed.write(target_velocity=10_000_000, vl_target_velocity=500)
    homed.enable(mode)
    if mode == 2:
        homed.control(0x7F)
    homed.step(3000)
    assert abs(homed.speed) < 0.1
    assert all(homed.step() or homed.bit(LIMIT) for _ in range(200))
    assert homed.read("active_limits") & 8
    homed.write(target_velocity=-1_000_000, vl_target_velocity=-50)
    homed.step(20)
    assert not homed.bit(LIMIT)


@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize("step", [5_000, 2_000_000_000])
def test_absolute_moves_count_on_over_the_ends_of_an_integer32(side, step):
    """Where nothing bounds the travel the way is the difference of two INTEGER32, in 32 bits."""
    shaft = Shaft().home_here(side * (2**31 - 2_000))
    shaft.write(
        min_position_limit=0, max_position_limit=0, profile_velocity=0xFFFFFFFF,
        profile_acceleration=0xFFFFFFFF, following_error_window=0xFFFFFFFF,
    )
    shaft.enable(1)
    shown = shaft.read("position_demand_value")
    target = (shown + side * step + 2**31) % 2**32 - 2**31
    assert (target - shown) * side < 0, "as whole numbers it lies behind"
    begin = shaft.axis.position_demand
    shaft.write(target_position=target)
    shaft.control(0x1F, 40)
    way = shaft.axis.target - begin
    assert way / UNIT == pytest.approx(side * step, abs=1)
    assert shaft.axis.position_demand * side >= begin * side


def test_between_software_limits_an_absolute_move_never_leaves_them(homed):
    """4e9 increments the long way: over the ends of INTEGER32 it would be the other direction."""
    homed.write(min_position_limit=-(2**31), max_position_limit=2**31 - 1)
    homed.write(profile_velocity=0xFFFFFFFF, profile_acceleration=0xFFFFFFFF)
    for target in (2_000_000_000, -2_000_000_000):
        homed.axis.position_demand = homed.axis.position = 0.0
        homed.enable(1)
        homed.write(target_position=target)
        homed.control(0x1F)
        homed.control(0x0F)
        assert homed.axis.target == pytest.approx(target * UNIT)


@pytest.mark.parametrize("model", ["festo_cmmp_as", "metronix_ars2000"])
def test_models_whose_limit_is_of_the_set_point_have_none_in_torque_mode(model):
    shaft = Shaft(model)
    axis = shaft.axis
    axis.homed, axis.sto_input, axis.enable_input = 1, 1, 1
    shaft.write(min_position_limit=-1000, max_position_limit=1000, target_torque=100)
    shaft.drive.commission({"enable_logic": 2})
    shaft.enable(4)
    shaft.step(2000)
    assert shaft.read("position_actual_value") > 10_000
