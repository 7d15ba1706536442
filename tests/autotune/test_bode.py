"""Measured loops against the mechanics of the model, and margins against what oscillates."""

import math
import sys

import mujoco
import numpy as np
import pytest
from later import Later, only_with
from matrix import Case, in_the_middle, margins_of_model

from servogym.drive.kernel.words import Mode
from servogym.drive.master import Master
from servogym.envs import Machine, bode, commission_joint, gantry, linear_axis, rotary_axis, tune
from servogym.envs.autotune import needs
from servogym.envs.autotune.margins import UNSURE, Margins, margins
from servogym.envs.autotune.stand import detune
from servogym.envs.masters.port import MachinePort
from servogym.training.cli import main

control = Later("control")
pytestmark = only_with("control", "scipy")
SLOW = pytest.mark.slow


def inertia_of(machine, number=0):
    """Of the whole load at the shaft (kg·m²), from MuJoCo's own mass matrix."""
    mass = np.zeros((machine.model.nv, machine.model.nv))
    mujoco.mj_fullM(machine.model, machine.data, mass)
    coupling = machine.couplings[number]
    return mass[coupling.dof, coupling.dof] / float(coupling.gear) ** 2


@pytest.mark.parametrize(
    ("make", "arguments"),
    [
        (linear_axis, {"drive": "metronix_ars2000", "mechanics": "linear_motor"}),
        pytest.param(linear_axis, {"drive": "kollmorgen_akd", "mechanics": "vertical"}, marks=SLOW),
        pytest.param(rotary_axis, {"drive": "festo_cmmp_as", "mechanics": "conveyor"}, marks=SLOW),
    ],
)
def test_the_inertia_is_that_of_the_mechanics(make, arguments):
    machine = in_the_middle(make(**arguments))
    response = bode(machine)
    assert response.fitted.inertia == pytest.approx(inertia_of(machine), rel=0.05)
    assert np.mean(response.coherence > 0.9) > 0.9


def test_antiresonance_and_resonance_are_those_of_two_masses_on_a_spring():
    machine = in_the_middle(linear_axis(mechanics="toothed_belt"))
    gear = 2 * math.pi / 0.06
    load, motor, stiffness = 6.5, (0.6e-4 + 0.1e-4) * gear**2, 4e5
    expected = [
        math.sqrt(stiffness / load) / (2 * math.pi),
        math.sqrt(stiffness * (1 / load + 1 / motor)) / (2 * math.pi),
    ]
    (found,) = bode(machine).fitted.resonances
    assert [found.antiresonance, found.resonance] == pytest.approx(expected, rel=0.03)


@pytest.mark.parametrize(
    ("case", "factor"),
    [
        (Case("rigid", "generic", 1.0), 16.0),  # position loop unstable
        (Case("linear_motor", "20 Hz", 1.0), 3.0),
        pytest.param(Case("toothed_belt", "80 Hz", 1.0), 8.0, marks=SLOW),
        pytest.param(Case("conveyor", "20 Hz", 1.0), 3.0, marks=SLOW),
        pytest.param(Case("rigid", "kollmorgen_akd", 1.0), 3.0, marks=SLOW),
        pytest.param(Case("gantry 2", "x1 x2", 1.0), 3.0, marks=SLOW),
    ],
    ids=str,
)
def test_the_margins_are_those_of_the_known_plant(case, factor):
    machine = case.machine()
    movers = case.variant.split() if "gantry" in case.axis else [next(iter(machine.drives))]
    for name in movers:
        detune(machine.drives[name], factor)
    response = bode(machine, movers[0])
    measured = response.velocity_margins, response.position_margins
    for found, (gain, phase, stable) in zip(
        measured, margins_of_model(machine, movers), strict=True
    ):
        assert found.gain == pytest.approx(gain, abs=1.5)
        assert found.phase == pytest.approx(phase, abs=2.5)
        assert found.stable == stable


def as_python_control(frequencies, loop, stable):
    data = control.frd(loop, 2 * np.pi * frequencies, smooth=True)
    gains, phases, _, at_phase, at_gain, _ = control.stability_margins(data, returnall=True)
    decibel = abs(20 * np.log10(gains))
    worst = (min(decibel), at_phase[np.argmin(decibel)]) if len(gains) else (math.inf, math.nan)
    return Margins(
        worst[0], min(abs(phases)), max(at_gain) / (2 * np.pi), worst[1] / (2 * np.pi), stable
    )


def test_of_several_crossings_the_smallest_margins_count_and_nyquist_decides():
    """Random loops with resonances, against closed poles and a fine grid."""
    random = np.random.default_rng(1)
    s, unstable = control.tf("s"), 0
    for k in range(25):
        loop = 10 ** random.uniform(0.5, 3.2) * (1 + random.uniform(2, 60) / s) / s
        for lag in random.uniform(900, 5000, 2):
            loop = loop / (1 + s / lag)
        narrow = []
        for a in 2 * math.pi * 10 ** random.uniform(1, 2.5, 2):
            r, damping = a * random.uniform(1.1, 2.5), random.uniform(0.01, 0.1)
            loop = loop * (s * s / a / a + 2 * damping * s / a + 1)
            loop = loop / (s * s / r / r + 2 * damping * s / r + 1)
            narrow += [f / (2 * math.pi) * (1 + 0.05 * np.linspace(-6, 6, 25)) for f in (a, r)]
        grid = np.unique(np.concatenate([np.geomspace(0.1, 5000, 300), *narrow]))
        found = margins(grid, loop(2j * np.pi * grid))
        assert found.stable == bool((control.feedback(loop, 1).poles().real < 0).all())
        unstable += not found.stable
        if k < 5:
            assert found == as_python_control(grid, loop(2j * np.pi * grid), found.stable)
        value = loop(2j * np.pi * np.geomspace(0.1, 5000, 20_000))
        turns = np.floor((np.unwrap(np.angle(value)) / np.pi - 1) / 2)
        gains = abs(20 * np.log10(abs(value[np.flatnonzero(np.diff(turns))])))
        phases = 180 - abs(np.degrees(np.angle(value[np.flatnonzero(np.diff(abs(value) > 1))])))
        assert found.gain == pytest.approx(min(gains, default=math.inf), abs=1.0)
        assert found.phase == pytest.approx(min(phases), abs=1.5)
    assert 3 < unstable < 20


@pytest.mark.parametrize(("short", "told"), [(0.6 * UNSURE, True), (1.5 * UNSURE, False)])
def test_a_loop_that_nearly_crosses_has_a_doubtful_gain_margin(short, told):
    """K/s and a notch, (iu + 1/m) / (iu + 1) at its place, which turns by asin((m - 1) / (m + 1)).

    By 82° and more it turns from tan 82° = u (m - 1) / (1 + m u²) on; the larger u has more gain.
    """
    sine = math.sin(math.radians(90.0 - short))
    m = (1 + sine) / (1 - sine)
    wide, below = 0.02, 9.0  # damping, dB
    narrow = 10.0 * (1 + 0.2 * np.linspace(-1, 1, 20_001))
    frequencies = np.unique(np.concatenate([np.geomspace(0.1, 1000.0, 300), narrow]))
    s = 1j * frequencies / 10.0
    notch = (s * s + 2 * wide / m * s + 1) / (s * s + 2 * wide * s + 1)
    found = margins(frequencies, 10 ** (-below / 20) / abs(s) / 1j * notch)
    assert found.gain == math.inf
    assert (f"within {UNSURE:g}° of a crossing" in str(found)) == told
    if told:
        t = math.tan(math.radians(90.0 - UNSURE))
        u = (m - 1 + math.sqrt((m - 1) ** 2 - 4 * t * t * m)) / (2 * t * m)
        gain = math.sqrt((u * u + 1 / m**2) / (1 + u * u))
        assert found.doubtful == pytest.approx(below - 20 * math.log10(gain), abs=0.1)
    else:
        assert found.doubtful == math.inf


def ripple(machine, gain):
    """Standard deviation of the torque (Nm) at a constant speed with so much velocity gain."""
    x = machine.drives["x"]
    kept = machine.snapshot()
    x.write("velocity_control_gain", round(x.read("velocity_control_gain") * gain))
    master = Master(MachinePort(machine), "x")
    master.set_mode(Mode.PROFILE_VELOCITY)
    master.write("target_velocity", 50_000)
    master.enable()
    machine.step(400)
    torques = []
    for _ in range(200):
        machine.step()
        torques.append(float(x.axis.torque_command))
    machine.restore(kept)
    return np.std(torques)


@pytest.mark.parametrize("mechanics", ["rigid", pytest.param("toothed_belt", marks=SLOW)])
def test_the_loop_oscillates_where_its_gain_margin_says(mechanics):
    machine = in_the_middle(linear_axis(mechanics=mechanics))
    margin = bode(machine).velocity_margins
    assert margin.stable
    calm, wild = (ripple(machine, 10 ** ((margin.gain + x) / 20)) for x in (-3.0, 6.0))
    assert calm < 1.0 < wild  # Nm


def test_a_loop_that_oscillates_is_measured_with_less_gain_and_told():
    machine = in_the_middle(linear_axis())
    x = machine.drives["x"]
    before = bode(machine)
    x.write("velocity_control_gain", 100 * x.read("velocity_control_gain"))
    response = bode(machine)
    assert not response.velocity_margins.stable
    assert not response.position_margins.stable
    assert "oscillates" in response.note
    assert response.fitted.inertia == pytest.approx(before.fitted.inertia, rel=0.05)


def push(machine, seconds):
    """Against the upper end with all the torque there is, then home again by hand."""
    x = machine.drives["x"]
    master = Master(MachinePort(machine), "x")
    for name in ("following_error_window", "position_error_limit"):
        x.commission({name: 0xFFFFFFFF})
    master.set_mode(Mode.PROFILE_TORQUE)
    master.write("target_torque", x.read("max_torque"))
    master.enable()
    machine.step(round(seconds / machine.cycle_time))


@pytest.mark.parametrize("measure", [bode, tune])
def test_a_motor_that_is_too_hot_is_told_as_such(measure):
    """What I²t leaves is no measure of the loop, and more amplitude would be the wrong advice."""
    machine = in_the_middle(linear_axis())
    x = machine.drives["x"]
    push(machine, 1.5 * x.read("i2t_time") * 1e-3)
    assert x.read("i2t_level") > 900
    kept = machine.snapshot()
    with pytest.raises(RuntimeError, match=r"I²t limits the torque of drive 'x', 9\d.* used up"):
        measure(machine)
    assert machine.snapshot() == kept


def test_afterwards_the_machine_is_bit_by_bit_as_before():
    machine = in_the_middle(linear_axis())
    before = machine.snapshot()
    bode(machine)
    assert machine.snapshot() == before


def test_each_drive_of_a_gantry_is_measured_while_the_others_hold():
    machine = in_the_middle(gantry(x_drives=2))
    places = machine.data.qpos.copy()
    assert bode(machine, "x2").velocity_margins.stable
    np.testing.assert_array_equal(machine.data.qpos, places)


ARM = """<mujoco><worldbody><body>
<joint name="elbow" type="hinge" axis="0 1 0" range="-2 2" limited="true"/>
<geom type="capsule" size="0.03" fromto="0 0 0 0.3 0 0" mass="1.5"/></body></worldbody></mujoco>"""


def test_a_joint_of_an_own_mjcf():
    machine = Machine.from_mjcf(ARM, {"elbow": "generic"})
    commission_joint(machine, "elbow")
    response = bode(machine)
    assert response.unit == "rad"
    assert response.fitted.inertia == pytest.approx(inertia_of(machine), rel=0.06)


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ({"drive": "y"}, "there is no drive 'y'"),
        ({"amplitude": 2.0}, "amplitude = 2.0 is out of range"),
        ({"highest": 5000.0}, "highest = 5000.0 is out of range"),
        ({"lowest": 0.1}, "lowest = 0.1 is out of range"),
        ({"speed": -1.0}, "speed = -1.0 is out of range"),
    ],
)
def test_what_cannot_be_measured_is_refused(arguments, text):
    with pytest.raises(ValueError, match=text):
        bode(in_the_middle(linear_axis()), **arguments)


def test_an_inverter_has_nothing_to_tune():
    with pytest.raises(ValueError, match="bonfiglioli_act"):
        bode(linear_axis("bonfiglioli_act"))


def test_the_command_writes_picture_and_numbers(tmp_path, capsys):
    assert main(["bode", "ball_screw", "--set", "payload=2", "--out", str(tmp_path)]) == 0
    assert "velocity loop: " in capsys.readouterr().out
    rows = (tmp_path / "bode.csv").read_text(encoding="utf-8").splitlines()
    assert rows[0].startswith("frequency (Hz),coherence,plant (rad/s/Nm) (dB)")
    assert len(rows) > 80
    assert (tmp_path / "bode.png").read_bytes()[:4] == b"\x89PNG"


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["bode", "nix"], "machine 'nix' is unknown"),
        (["bode", "--set", "payloud=3"], "payloud"),
        (["bode", "--axis", "q"], "the machine has x"),
        (["bode", "--parameter-file", "nowhere.json"], "there is no such file"),
    ],
)
def test_a_wrong_command_is_one_line(arguments, text, refused):
    assert text in refused(arguments)


def test_without_the_extra_the_command_to_install_it_is_told(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "scipy.interpolate", None)
    needs.scipy.cache_clear()
    try:
        assert main(["bode"]) == 2
    finally:
        needs.scipy.cache_clear()
    assert capsys.readouterr().err.endswith("pip install 'servogym[tune]'\n")
