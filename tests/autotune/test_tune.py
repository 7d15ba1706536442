"""Tuning from detuned gains: margins, following error, and a parameter set that drives take."""

import math
import time

import pytest

from servogym.drive.drive import Drive
from servogym.drive.model.model import load
from servogym.envs import (
    FAMILY,
    ROTARY_FAMILY,
    Machine,
    bode,
    commission_joint,
    gantry,
    linear_axis,
    rotary_axis,
    tune,
)
from servogym.envs.autotune.fit import Asked, fit, why_not
from servogym.envs.autotune.stand import Stand, detune
from servogym.envs.autotune.trial import trial
from servogym.training.cli import main

pytest.importorskip("control")
pytest.importorskip("scipy")
SERVOS = ("generic", "metronix_ars2000", "festo_cmmp_as", "festo_cmms", "kollmorgen_akd")
CPU = 10.0  # s, of a tuning on a quiet machine


def in_the_middle(machine):
    ends = [(float(m["low"]), float(m["high"])) for m in machine.mechanics]
    machine.reset(
        positions={
            name: (low + high) / 2
            for name, (low, high) in zip(machine.drives, ends, strict=True)
            if high - low < 1e6
        }
    )
    return machine


def made(name, drive="generic", **values):
    make = rotary_axis if name in ROTARY_FAMILY else linear_axis
    return in_the_middle(make(drive, mechanics=name, **values))


def springy(name, frequency, drive="generic"):
    """A member of the family whose payload swings on a spring, so that it resonates there."""
    if name in ROTARY_FAMILY:
        p = ROTARY_FAMILY[name]
        rotor = load(drive).rotor_inertia * p.gear_ratio**2
        reduced = 1 / (1 / p.inertia + 1 / rotor)
        stiffness = (2 * math.pi * frequency) ** 2 * reduced
        damping = 2 * 0.02 * math.sqrt(stiffness * reduced)
        return made(name, drive, transmission_stiffness=stiffness, transmission_damping=damping)
    p = FAMILY[name]
    rotor = p.rotor_inertia if p.rotor_inertia is not None else load(drive).rotor_inertia
    gear = 2 * math.pi / p.feed_constant
    rest = p.carriage_mass + (rotor + p.transmission_inertia) * gear**2
    reduced = 1 / (1 / p.payload + 1 / rest)
    stiffness = (2 * math.pi * frequency) ** 2 * reduced
    damping = 2 * 0.02 * math.sqrt(stiffness * reduced)
    return made(name, drive, stiffness=stiffness, structural_damping=damping)


def judged(machine, name=None, factor=1.0):
    """Tune from detuned gains; -> what was found, following error with commissioned gains, CPU."""
    stand = Stand(machine, name)
    commissioned = trial(stand, None).following_error
    stand.put_back()
    detune(stand.drive, factor)
    begin = time.process_time()
    tuned = tune(machine, name)
    return tuned, commissioned, time.process_time() - begin


def holds(tuned, commissioned):
    """Margins as python-control tells them of the loops measured afterwards, or the reason."""
    for found in (tuned.after.velocity_margins, tuned.after.position_margins):
        if tuned.reached:
            assert found.stable
            assert found.gain >= 6.0
            assert found.phase >= 35.0
    assert tuned.reached or tuned.reason
    assert tuned.trial_after.following_error <= 1.1 * commissioned + 2e-6


@pytest.mark.parametrize(
    ("name", "drive", "factor"),
    [
        ("toothed_belt", "generic", 3.0),
        pytest.param("vertical", "festo_cmms", 0.3, marks=pytest.mark.slow),
    ],
)
def test_detuned_gains_come_back_to_margins_and_following_error(name, drive, factor):
    tuned, commissioned, _ = judged(made(name, drive), factor=factor)
    assert tuned.reached
    holds(tuned, commissioned)


CASES = [
    *((name, drive, factor) for name in (*FAMILY, *ROTARY_FAMILY) for drive in SERVOS
      for factor in (0.3, 3.0)),
]  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize(("name", "drive", "factor"), CASES)
def test_every_member_of_the_family_with_every_servo_drive(name, drive, factor):
    tuned, commissioned, cpu = judged(made(name, drive), factor=factor)
    report(name, drive, f"x{factor:g}", tuned, commissioned, cpu)
    holds(tuned, commissioned)
    assert cpu < CPU


@pytest.mark.slow
@pytest.mark.parametrize("factor", [0.3, 1.0, 3.0])
@pytest.mark.parametrize("frequency", [20.0, 45.0, 80.0])
@pytest.mark.parametrize("name", [*FAMILY, *ROTARY_FAMILY])
def test_every_member_with_a_resonance(name, frequency, factor):
    tuned, commissioned, cpu = judged(springy(name, frequency), factor=factor)
    report(name, f"{frequency:g} Hz", f"x{factor:g}", tuned, commissioned, cpu)
    holds(tuned, commissioned)
    assert cpu < CPU


@pytest.mark.slow
@pytest.mark.parametrize("factor", [0.3, 3.0])
@pytest.mark.parametrize(("drives", "name"), [(1, "x"), (1, "y"), (1, "z"), (2, "x1"), (2, "x2")])
def test_every_drive_of_a_gantry(drives, name, factor):
    tuned, commissioned, cpu = judged(in_the_middle(gantry(x_drives=drives)), name, factor)
    report(f"gantry {drives}", name, f"x{factor:g}", tuned, commissioned, cpu)
    if drives == 2 and not tuned.reached:  # the other drive holds the beam: one alone is no guide
        assert tuned.reason
        assert tuned.trial_after.following_error <= 1.1 * tuned.trial_before.following_error
        return
    holds(tuned, commissioned)


def report(*what):
    *names, tuned, commissioned, cpu = what
    v, p = tuned.after.velocity_margins, tuned.after.position_margins
    print(
        f"| {' | '.join(names)} | {v.gain:.1f} dB {v.phase:.0f}° | {p.gain:.1f} dB {p.phase:.0f}° |"
        f" {commissioned * 1e6:.0f} | {tuned.trial_before.following_error * 1e6:.0f} |"
        f" {tuned.trial_after.following_error * 1e6:.0f} | {cpu:.1f} |"
        f" {'yes' if tuned.reached else tuned.reason} |"
    )


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
    asked = Asked(gain=90.0, phase=80.0)
    assert fit(response, asked) is None
    reason = why_not(response, asked)
    assert reason.startswith("no gains give 90 dB and 80°")
    assert str(response.fitted.resonances[0]) in reason


ARM = """<mujoco><worldbody><body>
<joint name="elbow" type="hinge" axis="0 1 0" range="-2 2" limited="true"/>
<geom type="capsule" size="0.03" fromto="0 0 0 0.3 0 0" mass="1.5"/></body></worldbody></mujoco>"""


@pytest.mark.slow
def test_a_joint_of_an_own_mjcf():
    machine = Machine.from_mjcf(ARM, {"elbow": "generic"})
    commission_joint(machine, "elbow")
    tuned, commissioned, _ = judged(machine, factor=3.0)
    assert tuned.reached
    holds(tuned, commissioned)


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
