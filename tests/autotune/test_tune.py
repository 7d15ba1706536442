"""Tuning from detuned gains: margins, following error, and a parameter set that drives take."""

import math
from dataclasses import replace

import pytest
from later import only_with
from matrix import CASES, WORSE, Case, in_the_middle, made, play

from servogym.drive.drive import Drive
from servogym.envs import Machine, bode, commission_joint, gantry, linear_axis, tune
from servogym.envs.autotune.fit import Requirements, fit, why_not
from servogym.envs.autotune.stand import detune, gains_of
from servogym.training.cli import main

pytestmark = only_with("control", "scipy")
CPU = 10.0  # s, of a tuning on a quiet machine
LIKE_KNOWN = 1.5, 2.5  # dB and degree, of margins up to twice those asked for


def holds(played):
    """Margins, also as python-control tells them of the known plant, or the reason."""
    tuned = played.tuned
    after = tuned.after.velocity_margins, tuned.after.position_margins
    for found, (gain, phase, stable) in zip(after, played.known, strict=True):
        if tuned.reached:
            assert math.isfinite(tuned.trial_after.following_error), "a move that is not made"
            assert found.stable
            assert found.sure >= 6.0
            assert found.phase >= 35.0
        if tuned.reached and played.case.linear:
            assert stable
            assert gain >= min(found.sure, 12.0) - LIKE_KNOWN[0]
            assert phase >= min(found.phase, 70.0) - LIKE_KNOWN[1]
    assert tuned.reached or tuned.reason
    # soft gains that settle sooner than any stiffer ones are kept
    assert played.follows or tuned.trial_after.settling <= played.commissioned.settling
    assert played.cpu < CPU


@pytest.mark.parametrize(
    "case",
    [
        Case("toothed_belt", "generic", 3.0),
        pytest.param(Case("vertical", "festo_cmms", 0.3), marks=pytest.mark.slow),
        pytest.param(Case("gantry 2", "x1", 0.3), marks=pytest.mark.slow),
    ],
    ids=str,
)
def test_detuned_gains_come_back_to_margins_and_following_error(case):
    played = play(case)
    assert played.tuned.reached
    holds(played)


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES, ids=str)
def test_every_case_of_the_table(case):
    """docs/results/tuning.md has what `matrix.py` has made of them."""
    holds(play(case))


def test_both_drives_of_a_beam_get_the_gains_and_are_named():
    machine = in_the_middle(gantry(x_drives=2))
    detune(machine.drives["x2"], 0.3)
    tuned = tune(machine, "x2")
    assert tuned.reached
    assert tuned.together == ("x1", "x2")
    assert str(tuned).startswith("drive x1 and x2 (generic): ")
    gains = [gains_of(machine.drives[name]) for name in tuned.together]
    assert gains[0] == gains[1] == tuned.after.gains


def test_the_parameter_set_is_what_an_axis_takes_and_only_the_gains_changed(tmp_path):
    machine = made("rigid")
    x = machine.drives["x"]
    place, feed = machine.data.qpos.copy(), x.read("feed")
    detune(x, 0.3)
    tuned = tune(machine, move=0.05)
    assert (machine.data.qpos, x.read("feed")) == (place, feed)
    assert {name: x.read(name) for name in tuned.objects} == tuned.objects
    radius = 0.06 / (2 * math.pi)
    assert tuned.friction.coulomb == pytest.approx(12.0 * radius, rel=0.1)
    assert tuned.friction.viscous == pytest.approx(20.0 * radius**2, rel=0.3)
    assert tuned.trial_after.demand[-1] == pytest.approx(0.05, abs=1e-4)
    tuned.save(tmp_path / "axis.json")
    again = linear_axis(parameter_file=tmp_path / "axis.json").drives["x"]
    assert {name: again.read(name) for name in tuned.objects} == tuned.objects


def test_margins_that_no_gains_give_are_told_in_words():
    response = bode(made("rack_pinion"))
    asked = Requirements(gain=90.0, phase=80.0)
    assert fit(response, asked) is None
    reason = why_not(response, asked)
    assert reason.startswith("no gains give 90 dB and 80°")
    assert str(response.fitted.resonances[0]) in reason


def test_margins_of_a_position_loop_that_crosses_over_below_what_is_measured_are_not_reached():
    """With no crossover its phase margin was infinite, and counted as reached."""
    response = bode(made("rigid"))
    slow = response.with_gains(replace(response.gains, position_gain=0.1))
    asked = Requirements()
    assert asked.kept(response)
    assert not asked.kept(slow)
    assert str(slow.position_margins).endswith(" dB, no crossover measured")
    assert why_not(slow, asked).startswith("the position loop crosses over below 0.2 Hz")


ARM = """<mujoco><worldbody><body>
<joint name="elbow" type="hinge" axis="0 1 0" range="-2 2" limited="true"/>
<geom type="capsule" size="0.03" fromto="0 0 0 0.3 0 0" mass="1.5"/></body></worldbody></mujoco>"""


@pytest.mark.slow
def test_a_joint_of_an_own_mjcf():
    machine = Machine.from_mjcf(ARM, {"elbow": "generic"})
    commission_joint(machine, "elbow")
    detune(machine.drives["elbow"], 3.0)
    tuned = tune(machine)
    assert tuned.reached
    assert tuned.trial_after.following_error <= WORSE * tuned.trial_before.following_error


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ({"drive": "y"}, "there is no drive 'y'"),
        ({"gain_margin": 1.0}, "gain_margin = 1.0 is out of range 2..40 dB"),
        ({"phase_margin": 90.0}, "phase_margin = 90.0 is out of range 10..80 degree"),
        ({"move": 7.0}, "move = 7.0 is out of range"),
    ],
)
def test_what_cannot_be_tuned_is_refused(arguments, text):
    with pytest.raises(ValueError, match=text):
        tune(made("rigid"), **arguments)


def test_the_command_writes_picture_and_parameters_that_a_node_takes(tmp_path, capsys):
    assert main(["tune", "ball_screw", "--detuned", "0.3", "--out", str(tmp_path)]) == 0
    told = capsys.readouterr().out
    assert "60FBh:01" in told
    assert "margins reached" in told
    assert (tmp_path / "tune.png").read_bytes()[:4] == b"\x89PNG"
    stored = Drive("generic", parameter_file=tmp_path / "parameters.json")
    assert f"= {stored.read('position_control_gain')} " in told
