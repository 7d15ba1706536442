"""The linear axis: homing on the real switches, moves, and the following error in csp."""

import numpy as np
import pytest
import ruckig

from servogym.drive.kernel.words import ENABLED, Mode
from servogym.drive.master import DriveFault, Master
from servogym.envs import LinearAxisParameters, linear_axis
from servogym.envs.masters.port import MachinePort

CRAWL_STEP = 10_000 * 250e-6  # µm in a velocity cycle at 10 mm/s


@pytest.mark.parametrize(
    ("name", "value", "unit"),
    [
        ("payload", float("nan"), "kg"),
        ("payload", -1, "kg"),
        ("payload", "heavy", "kg"),
        ("feed_constant", 0, "m per motor revolution"),
        ("max_velocity", float("inf"), "m/s"),
    ],
)
def test_a_wrong_parameter_names_field_value_range_and_unit(name, value, unit):
    with pytest.raises(ValueError, match=rf"{name} = .* is out of range .*{unit}"):
        LinearAxisParameters(**{name: value})


@pytest.mark.parametrize("timestep", [0.0, -1.0, float("nan"), 1.0, "fast"])
def test_a_wrong_timestep(timestep):
    with pytest.raises(ValueError, match="timestep"):
        linear_axis(timestep=timestep)


def test_parameters_come_one_way():
    with pytest.raises(ValueError, match="choose one way"):
        linear_axis(parameters=LinearAxisParameters(), payload=1.0)


def homed(start, method):
    machine = linear_axis()
    machine.reset(positions={"x": start})
    master = Master(MachinePort(machine), "x")
    master.enable()
    master.home(method)
    axis = machine.drives["x"].axis
    offset = round(float(axis.home_offset / axis.rad_per_increment))
    return (int(axis.zero_counts) - offset) * axis.rad_per_increment / machine.couplings[0].gear


@pytest.mark.parametrize(("method", "edge"), [(17, -0.0047), (18, 0.5047)])
def test_homing_on_a_switch_repeats_within_a_velocity_cycle_of_crawl(method, edge):
    homes = [homed(start, method) for start in (0.03, 0.123456, 0.31, 0.4777)]
    assert np.ptp(homes) * 1e6 <= CRAWL_STEP + 0.1
    assert max(abs(home - edge) for home in homes) * 1e6 <= CRAWL_STEP + 0.1


@pytest.mark.parametrize("method", [1, 2, 33, 34])
def test_homing_on_the_index_repeats_within_an_increment(method):
    homes = np.array([homed(start, method) for start in (0.131, 0.142, 0.1666)])
    turn = 0.06
    increment = turn / 2**20
    assert np.ptp(homes) <= increment
    assert abs(homes[0] / turn - round(homes[0] / turn)) * turn <= increment


def test_a_pp_move_ends_where_it_should_with_both_profiles():
    machine = linear_axis()
    machine.reset(positions={"x": 0.12})
    master = Master(MachinePort(machine), "x")
    master.enable()
    master.home(17)
    x = machine.drives["x"]
    for profile in (0, 3):
        x.write("motion_profile_type", profile)
        for target in (400_000, 100_000):
            master.move_to(target * 1e-6)
            machine.step(200)
            assert abs(x.read("position_actual_value") - target) <= 20
            assert abs(machine.data.qpos[0] * 1e6 - 300 - target) < 25


def following_error(feed_forward, period_ms=1, **parameters):
    """Peak following error (m) on a ruckig move streamed through the RPDO, and v / Kv (m)."""
    machine = linear_axis(**parameters)
    machine.reset(positions={"x": 0.05})
    x = machine.drives["x"]
    if not feed_forward:
        x.write("velocity_feed_forward", 0)
        x.write("acceleration_feed_forward", 0)
        x.write("following_error_window", 50_000)
    master = Master(MachinePort(machine), "x")
    master.enable()
    x.write("home_offset", -50_000)
    master.home(37)
    x.map_pdos([["controlword", "target_position"]], [["statusword"]])
    x.write("interpolation_time_period_value", period_ms)
    x.latch(x.pack(controlword=ENABLED, target_position=x.read("position_actual_value")))
    master.set_mode(Mode.CYCLIC_SYNC_POSITION)
    generator = ruckig.Ruckig(1, period_ms * 1e-3)
    wanted, now = ruckig.InputParameter(1), ruckig.OutputParameter(1)
    wanted.current_position, wanted.target_position = [0.05], [0.45]
    wanted.max_velocity, wanted.max_acceleration, wanted.max_jerk = [1.0], [10.0], [500.0]
    errors = []
    master.port.on_step = lambda: errors.append(abs(float(x.axis.following_error)))
    result = ruckig.Result.Working
    while result == ruckig.Result.Working:
        result = generator.update(wanted, now)
        x.latch(x.pack(target_position=round(now.new_position[0] * 1e6)))
        master.wait(period_ms * 1e-3)
        now.pass_to_input(wanted)
    return max(errors) / machine.couplings[0].gear, 1.0 / float(x.axis.position_gain)


@pytest.mark.parametrize("period_ms", [1, 5])
def test_feed_forward_leaves_less_than_a_hundredth_of_the_velocity_lag(period_ms):
    rigid = {"coulomb_friction": 0.0, "viscous_friction": 0.0}
    error, lag = following_error(True, period_ms, **rigid)
    assert error < 0.01 * lag
    error, lag = following_error(True, period_ms)
    assert error < 0.01 * lag


def test_without_feed_forward_the_error_is_the_velocity_lag():
    error, lag = following_error(False)
    assert error == pytest.approx(lag, rel=0.01)


def test_the_end_stop_is_hard_and_the_axis_survives_it():
    machine = linear_axis()
    machine.reset(positions={"x": 0.4})
    x = machine.drives["x"]
    machine.couplings[0].switch_from[1] = 9.0  # no positive limit switch
    machine.couplings[0].switch_to[1] = 10.0
    x.write("target_velocity", 800_000)
    x.write("following_error_window", 0xFFFFFFFF)
    master = Master(MachinePort(machine), "x")
    master.enable()
    master.set_mode(Mode.PROFILE_VELOCITY)
    machine.step(2000)
    assert machine.data.qpos[0] == pytest.approx(0.52, abs=1e-3)
    assert x.read("active_limits") & 1, "it pushes with the torque limit"


def test_the_master_says_what_it_waited_for():
    machine = linear_axis()
    master = Master(MachinePort(machine), "x")
    with pytest.raises(TimeoutError, match=r"a miracle: not within 0.01 s; x: statusword 0250h"):
        master.wait_until(lambda word: False, 0.01, "a miracle")
    master.enable()
    machine.drives["x"].inject("short_circuit")
    with pytest.raises(DriveFault, match="FAULT, error code 2320h"):
        master.move_to(0.001)
    machine.drives["x"].clear_injected()
    master.reset_fault()
    master.enable()
