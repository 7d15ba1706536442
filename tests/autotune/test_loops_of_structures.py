"""Commissioning, `bode` and `tune` know a drive's structure: PID, filters, an observer."""

import numpy as np
import pytest
from later import only_with
from matrix import in_the_middle

from servogym.drive.master import Master
from servogym.envs import bode, linear_axis, rotary_axis, tune
from servogym.envs.autotune.stand import detune
from servogym.envs.masters.port import MachinePort
from servogym.envs.plants.loops import gains_of
from servogym.envs.plants.shaft import plant_at_shaft

pytestmark = only_with("control", "scipy")
TOML = """based_on = "generic"
title = "a drive with other loops than a cascade"

[defaults]
{}
"""
STRUCTURES = {
    "pid": "control_structure = 1",
    "notch": "notch_frequency_1 = 1210",
    "low_pass": "torque_command_filter_time = 400",
    "observer": "observer_bandwidth = 2000",
    "pid_observer": "control_structure = 1\nobserver_bandwidth = 3000",
}
LIKE = 2.0, 5.0  # dB and degree, of margins measured and of the model


def drive(folder, structure):
    """The folder of a drive model with such loops."""
    made = folder / f"{structure}_drive"
    made.mkdir()
    (made / "drive.toml").write_text(TOML.format(STRUCTURES[structure]))
    return made


@pytest.mark.parametrize(
    ("structure", "mechanics"),
    [
        ("pid", "rigid"), ("pid", "toothed_belt"), ("observer", "toothed_belt"),
        *(pytest.param(s, m, marks=pytest.mark.slow) for s, m in (
            ("notch", "toothed_belt"), ("low_pass", "toothed_belt"), ("observer", "rigid"),
            ("pid_observer", "rigid"), ("pid_observer", "toothed_belt"),
        )),
    ],
)
def test_an_axis_with_other_loops_is_commissioned_moves_and_is_measured_as_such(
    structure, mechanics, tmp_path
):
    """It powers on away from zero, where an observer has to begin as well."""
    machine = linear_axis(drive(tmp_path, structure), mechanics=mechanics)
    x = machine.drives["x"]
    gains = gains_of(x)
    assert (gains.pid is not None) == structure.startswith("pid")
    machine.reset(positions={"x": 0.12})
    master = Master(MachinePort(machine), "x")
    master.enable()
    master.home()
    master.move_to(0.3)
    assert not x.fault
    in_the_middle(machine)
    velocity, (gain, phase, stable) = plant_at_shaft(machine, "x").margins(gains)
    response = bode(machine)
    found = response.position_margins
    assert stable
    assert found.stable
    assert min(gain, found.gain) >= 6.0
    assert min(phase, found.phase) >= 35.0
    assert found.phase == pytest.approx(phase, abs=LIKE[1])
    assert min(found.gain, 20.0) == pytest.approx(min(gain, 20.0), abs=1.5 * LIKE[0])
    if gains.pid is None:
        assert response.velocity_margins.phase == pytest.approx(velocity[1], abs=LIKE[1])
        assert min(response.velocity_margins.gain, velocity[0]) >= 6.0


def test_filters_of_the_torque_command_take_margin_and_bode_says_how_much():
    machine = in_the_middle(linear_axis())
    without = plant_at_shaft(machine, "x").margins(gains_of(machine.drives["x"]))[0]
    machine.drives["x"].commission({"torque_command_filter_time": 1_000, "notch_frequency_1": 3000})
    plant = plant_at_shaft(machine, "x")
    known = plant.margins(gains_of(machine.drives["x"]))[0]
    assert known[1] < without[1] - 15.0
    measured = bode(machine).velocity_margins
    assert measured.phase == pytest.approx(known[1], abs=LIKE[1])
    assert measured.gain == pytest.approx(known[0], abs=LIKE[0])


@pytest.mark.parametrize(
    "factor", [0.3, *(pytest.param(f, marks=pytest.mark.slow) for f in (1.0, 3.0))]
)
def test_a_position_pid_is_tuned_to_its_margins(factor, tmp_path):
    """With 0.3 of the gains its loops are so soft that it takes long to come to speed."""
    machine = in_the_middle(linear_axis(drive(tmp_path, "pid"), mechanics="toothed_belt"))
    detune(machine.drives["x"], factor)
    tuned = tune(machine)
    assert tuned.reached
    assert tuned.after.inertia == pytest.approx(plant_at_shaft(machine, "x").inertia, rel=0.1)
    assert np.isfinite(tuned.trial_after.following_error)
    assert all(gain >= 6.0 and phase >= 33.0 and stable for gain, phase, stable in
               plant_at_shaft(machine, "x").margins(gains_of(machine.drives["x"])))
    assert {"pid_gain", "pid_integral_gain", "pid_derivative_gain"} <= tuned.objects.keys()


def test_what_a_gear_loses_is_felt_as_inertia_while_the_motor_pushes():
    """A worm gear with an efficiency of 65 % makes its load 1 / 0.65 as heavy."""
    machine = in_the_middle(rotary_axis(mechanics="rotary_table"))
    gains = gains_of(machine.drives["x"])
    pushing, lossless = (plant_at_shaft(machine, "x", pushes=share) for share in (1.0, 0.0))
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
    _, (gain, phase, _) = plant_at_shaft(machine, "x").margins(gains_of(machine.drives["x"]))
    found = bode(machine)
    assert found.frequencies[0] < 0.5
    assert found.position_margins.phase == pytest.approx(phase, abs=LIKE[1])
    assert found.position_margins.gain == pytest.approx(gain, abs=2 * LIKE[0])
