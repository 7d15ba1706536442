"""Commissioning, `bode` and `tune` know a drive's structure: PID, filters, an observer."""

import pytest
from later import only_with
from matrix import in_the_middle

from servogym.drive.master import Master
from servogym.envs import bode, linear_axis, rotary_axis, tune
from servogym.envs.masters.port import MachinePort
from servogym.envs.plants.loops import gains_of
from servogym.envs.plants.shaft import seen

pytestmark = only_with("control", "scipy")
TOML = """based_on = "generic"
title = "a drive with a PID position controller"

[defaults]
control_structure = 1
"""
LIKE = 2.0, 5.0  # dB and degree, of margins measured and of the model


@pytest.fixture
def pid(tmp_path):
    folder = tmp_path / "pid_drive"
    folder.mkdir()
    (folder / "drive.toml").write_text(TOML)
    return folder


@pytest.mark.parametrize("mechanics", ["rigid", "toothed_belt"])
def test_an_axis_with_a_position_pid_is_commissioned_moves_and_is_measured_as_such(pid, mechanics):
    machine = linear_axis(pid, mechanics=mechanics)
    x = machine.drives["x"]
    gains = gains_of(x)
    assert gains.pid is not None
    assert gains.pid[0] > 0.0
    machine.reset(positions={"x": 0.12})
    master = Master(MachinePort(machine), "x")
    master.enable()
    master.home()
    master.move_to(0.3)
    assert not x.fault
    in_the_middle(machine)
    _, (gain, phase, stable) = seen(machine, "x").margins(gains)
    found = bode(machine).position_margins
    assert stable
    assert found.stable
    assert gain >= 6.0
    assert phase >= 35.0
    assert found.phase == pytest.approx(phase, abs=LIKE[1])
    assert min(found.gain, 20.0) == pytest.approx(min(gain, 20.0), abs=LIKE[0])


def test_filters_of_the_torque_command_take_margin_and_bode_says_how_much():
    machine = in_the_middle(linear_axis())
    without = seen(machine, "x").margins(gains_of(machine.drives["x"]))[0]
    machine.drives["x"].commission({"torque_command_filter_time": 1_000, "notch_frequency_1": 3000})
    plant = seen(machine, "x")
    known = plant.margins(gains_of(machine.drives["x"]))[0]
    assert known[1] < without[1] - 15.0
    measured = bode(machine).velocity_margins
    assert measured.phase == pytest.approx(known[1], abs=LIKE[1])
    assert measured.gain == pytest.approx(known[0], abs=LIKE[0])


@pytest.mark.slow
def test_a_position_pid_is_tuned_to_its_margins(pid):
    machine = in_the_middle(linear_axis(pid, mechanics="toothed_belt"))
    tuned = tune(machine)
    assert tuned.reached
    assert {"pid_gain", "pid_integral_gain", "pid_derivative_gain"} <= tuned.objects.keys()


def test_what_a_gear_loses_is_felt_as_inertia_while_the_motor_pushes():
    """A worm gear with an efficiency of 65 % makes its load 1 / 0.65 as heavy."""
    machine = in_the_middle(rotary_axis(mechanics="rotary_table"))
    gains = gains_of(machine.drives["x"])
    pushing, lossless = (seen(machine, "x", pushes=share) for share in (1.0, 0.0))
    motor = 0.6e-4  # kg·m²
    assert pushing.inertia - motor == pytest.approx((lossless.inertia - motor) / 0.65, rel=0.02)
    measured = bode(machine)
    assert measured.inertia == pytest.approx(pushing.inertia, rel=0.02)
    velocity, position = pushing.margins(gains)
    assert measured.velocity_margins.phase == pytest.approx(velocity[1], abs=LIKE[1])
    assert measured.position_margins.phase == pytest.approx(position[1], abs=LIKE[1])
    assert measured.position_margins.gain == pytest.approx(position[0], abs=LIKE[0])


def test_loops_slower_than_the_usual_frequencies_are_measured_below_them():
    """50 kg·m² on a soft gear: the position loop crosses over at half a hertz."""
    machine = in_the_middle(rotary_axis(mechanics="rotary_table", inertia=50.0))
    _, (gain, phase, _) = seen(machine, "x").margins(gains_of(machine.drives["x"]))
    found = bode(machine)
    assert found.frequencies[0] < 0.5
    assert found.position_margins.phase == pytest.approx(phase, abs=LIKE[1])
    assert found.position_margins.gain == pytest.approx(gain, abs=2 * LIKE[0])
