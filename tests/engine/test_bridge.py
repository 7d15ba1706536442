"""The bridge on two drives and the payload on its cable, against closed forms."""

import math

import mujoco
import numpy as np
import pytest

from servogym.drive.kernel.words import Mode
from servogym.drive.master import Master
from servogym.envs import gantry
from servogym.envs.masters.port import MachinePort
from servogym.envs.variation.randomisation import Randomisation

G = 9.81
SPAN = 0.6  # m between the rails
CARRIAGE, HANGING = 2.0, 6.5  # kg; the latter is slide, gripper and payload
RADIUS = 0.06 / (2 * math.pi)  # m, shaft angle to way
FREE = {"coulomb_friction": 0.0, "viscous_friction": 0.0}


def frequency(signal, period):
    """Of a vibration, from its rising zero crossings (Hz)."""
    signal = np.array(signal) - np.mean(signal)
    rising = np.flatnonzero((signal[:-1] < 0) & (signal[1:] >= 0))
    exact = rising - signal[rising] / (signal[rising + 1] - signal[rising])
    return 1 / (np.mean(np.diff(exact)) * period)


def record(machine, look, cycles):
    seen = []
    for _ in range(cycles):
        machine.step()
        seen.append(look())
    return seen


def skew_modes(machine, coupling, skew):
    """Both frequencies (Hz) of bridge and free carriages about the middle of a centred bridge."""
    beams = 2 * (3 / 12 * (0.04**2 + 0.72**2) + 3 * 0.07**2)
    on_it = 2 / 12 * (0.09**2 + 0.1**2) + 2.5 / 12 * (2 * 0.04**2) + 2 / 12 * (2 * 0.08**2)
    bridge = beams + on_it
    carriages = 2 * (CARRIAGE + rotor(machine)) * 0.3**2
    twist = 2 * coupling * 0.3**2
    # det(K - w² M) = 0 with K = [[skew + twist, -twist], [-twist, twist]]
    a = bridge * carriages
    b = (skew + twist) * carriages + twist * bridge
    root = math.sqrt(b * b - 4 * a * skew * twist)
    return [math.sqrt((b + sign * root) / (2 * a)) / (2 * math.pi) for sign in (-1, 1)]


def rotor(machine, name="x1"):
    """Mass (kg) that the rotor of the drive feels like along its axis."""
    return float(machine.model.dof_armature[machine.model.joint(name).dofadr[0]])


def torque_mode(machine, **per_mille):
    pair = Master(MachinePort(machine), *per_mille)
    pair.enable()
    pair.set_mode(Mode.PROFILE_TORQUE)
    for name, value in per_mille.items():
        machine.drives[name].write("target_torque", value)


def test_the_skew_is_the_difference_of_the_torques_over_the_stiffness():
    stiffness = 2000.0
    machine = gantry(x_drives=2, skew_stiffness=stiffness, skew_damping=90.0, **FREE)
    machine.reset(positions={"x1": 0.4, "x2": 0.4, "y": 0.25})
    torque_mode(machine, x1=-100, x2=100)
    machine.step(4000)
    difference = machine.drives["x2"].axis.torque - machine.drives["x1"].axis.torque
    assert difference == pytest.approx(2 * 0.127, rel=0.01)
    expected = difference / RADIUS * SPAN / 2 / stiffness * SPAN
    assert machine.skew == pytest.approx(expected, rel=0.005)
    assert machine.data.joint("x").qpos[0] == pytest.approx(0.4, abs=1e-3)


@pytest.mark.parametrize("y", [0.05, 0.4])
def test_a_slide_beside_the_middle_skews_an_accelerated_bridge(y):
    stiffness = 2000.0
    machine = gantry(x_drives=2, skew_stiffness=stiffness, skew_damping=90.0, **FREE)
    machine.reset(positions={"x1": 0.1, "x2": 0.1, "y": y})
    torque_mode(machine, x1=150, x2=150)
    machine.step(800)
    force = sum(machine.drives[name].axis.torque for name in ("x1", "x2")) / RADIUS
    acceleration = force / (6.0 + HANGING + 2 * (CARRIAGE + rotor(machine)))
    expected = -HANGING * acceleration * (y - 0.25) / stiffness * SPAN
    assert machine.skew == pytest.approx(expected, rel=0.03)


@pytest.mark.parametrize(("y", "share"), [(0.25, 0.0), (0.45, 2 * 0.2 / SPAN)])
def test_the_place_of_the_slide_shifts_load_from_x1_to_x2(y, share):
    machine = gantry(x_drives=2, max_acceleration=2.0)
    machine.reset(positions={"x1": 0.1, "x2": 0.1, "y": y})
    torques, errors = [], []
    x1, x2 = machine.drives["x1"], machine.drives["x2"]

    def look():
        torques.append(x2.axis.torque - x1.axis.torque)
        errors.append([d.read("following_error_actual_value") for d in (x1, x2)])

    pair = Master(MachinePort(machine, look), "x1", "x2")
    pair.enable()
    for drive in (x1, x2):
        drive.write("homing_method", 37)
    pair.home()
    del torques[:], errors[:]
    pair.move_to(0.3)
    accelerating = slice(250, 450)  # of 500 cycles of 0.5 ms; the first vibration has died out
    difference = np.mean(torques[accelerating]) / RADIUS
    assert difference == pytest.approx(HANGING * 2.0 * share, rel=0.05, abs=0.05)
    apart = np.abs(np.diff(errors, axis=1)).max()
    assert apart <= 1 if share == 0.0 else apart > 10


@pytest.mark.parametrize("skew", [2000.0, 20_000.0])
def test_a_skewed_bridge_with_free_drives_vibrates_at_its_resonance(skew):
    machine = gantry(
        x_drives=2, skew_stiffness=skew, skew_damping=0.0, coupling_damping=0.0, **FREE
    )
    machine.reset(positions={"x1": 0.399, "x2": 0.401, "y": 0.25})
    assert machine.skew == pytest.approx(2e-3)
    low, _ = skew_modes(machine, 4e6, skew)
    seen = record(machine, lambda: machine.skew, 2000)
    assert frequency(seen, machine.cycle_time) == pytest.approx(low, rel=0.01)


def test_the_bridge_vibrates_against_its_carriages_at_the_second_resonance():
    machine = gantry(
        x_drives=2, coupling_stiffness=1e6, coupling_damping=0.0, skew_damping=0.0,
        timestep=62.5e-6, **FREE,
    )
    machine.reset(positions={"x1": 0.4, "x2": 0.4, "y": 0.25})
    _, high = skew_modes(machine, 1e6, 2000.0)
    machine.data.joint("skew").qpos[0] = 1e-4
    x1, x2 = machine.data.joint("x1").qpos, machine.data.joint("x2").qpos
    seen = record(machine, lambda: machine.skew - (x2[0] - x1[0]), 2000)
    assert frequency(seen, machine.cycle_time) == pytest.approx(high, rel=0.01)


def pendulum(machine, length, mass):
    """Of the payload, a box of 80 x 80 x 60 mm, on a pivot that stands still (rad²/s²)."""
    inertia = mass / 12 * (0.08**2 + 0.06**2)
    return mass * G * length / (mass * length**2 + inertia)


@pytest.mark.parametrize("joint", ["sway_x", "sway_y"])
@pytest.mark.parametrize(("x_drives", "length"), [(1, 0.5), (2, 1.0)])
def test_the_load_swings_like_a_pendulum_where_friction_holds_the_axes(x_drives, length, joint):
    machine = gantry(x_drives=x_drives, cable_length=length, sway_damping=0.0)
    machine.data.joint(joint).qpos[0] = 0.03
    seen = record(machine, lambda: machine.sway, 16_000)
    expected = math.sqrt(pendulum(machine, length, 2.0)) / (2 * math.pi)
    axis = 0 if joint == "sway_x" else 1
    found = frequency(np.array(seen)[:, axis], machine.cycle_time)
    assert found == pytest.approx(expected, rel=0.002)
    assert np.abs(np.array(seen)[:, 1 - axis]).max() < 1e-4


@pytest.mark.parametrize(
    ("joint", "axis", "carried"), [("sway_x", "x", 10.5), ("sway_y", "y", 4.5)]
)
def test_on_a_free_axis_the_load_swings_faster_as_two_masses_do(joint, axis, carried):
    machine = gantry(cable_length=0.5, sway_damping=0.0, **FREE)
    machine.reset(positions={"x": 0.4, "y": 0.25})
    machine.data.joint(joint).qpos[0] = 0.03
    sway = machine.data.joint(joint).qpos
    seen = record(machine, lambda: float(sway[0]), 12_000)
    moved = carried + rotor(machine, axis)
    about_pivot = 2.0 * 0.5**2 + 2.0 / 12 * (0.08**2 + 0.06**2)
    rate = 2.0 * G * 0.5 / (about_pivot - (2.0 * 0.5) ** 2 / (moved + 2.0))
    assert frequency(seen, machine.cycle_time) == pytest.approx(
        math.sqrt(rate) / (2 * math.pi), rel=0.002
    )


def test_sway_dies_out_as_its_damping_says():
    damping, length, mass = 0.2, 0.5, 2.0
    machine = gantry(cable_length=length, sway_damping=damping)
    machine.data.joint("sway_y").qpos[0] = 0.03
    machine.step(8000)
    inertia = mass * length**2 + mass / 12 * (0.08**2 + 0.06**2)
    rate = math.sqrt(pendulum(machine, length, mass))
    speed = machine.data.joint("sway_y").qvel[0]
    amplitude = math.hypot(machine.sway[1], speed / rate)
    expected = 0.03 * math.exp(-damping / (2 * inertia) * machine.time)
    assert amplitude == pytest.approx(expected, rel=0.03)


@pytest.mark.parametrize("mass", [0.5, 2.0])
def test_cable_length_and_payload_drawn_make_the_pendulum_they_say(mass):
    machine = gantry(cable_length=0.5, sway_damping=0.0)
    drawing = Randomisation(machine, {"cable_length": (0.2, 0.8), "payload": mass}, 10)
    for seed in (1, 2):
        machine.reset()
        length = drawing.draw(np.random.default_rng(seed))["cable_length"]
        machine.data.joint("sway_x").qpos[0] = 0.03
        seen = record(machine, lambda: machine.sway[0], 8_000)
        expected = math.sqrt(pendulum(machine, length, mass)) / (2 * math.pi)
        # the box keeps the inertia of its size, which is in `pendulum`
        assert frequency(seen, machine.cycle_time) == pytest.approx(expected, rel=0.002)
        middle = machine.data.body("payload").xpos[2] - machine.data.geom("payload").xpos[2]
        assert middle == pytest.approx(length * math.cos(machine.sway[0]), rel=1e-3)


@pytest.mark.parametrize(
    ("built", "ranges", "text"),
    [
        ({}, {"cable_length": 0.3}, "does not hang, build it with cable_length"),
        ({"payload": 0.0}, {"payload": 1.0}, "no body 'payload' with a mass"),
        ({"cable_length": 0.5}, {"cable_length": (0.01, 0.5)}, r"within 0.05..10 m"),
    ],
)
def test_a_range_without_effect_on_this_gantry_is_refused(built, ranges, text):
    with pytest.raises(ValueError, match=text):
        Randomisation(gantry(**built), ranges, 10)


@pytest.mark.parametrize("built", [{}, {"cable_length": 0.5}, {"x_drives": 2}])
def test_the_payload_is_a_body_whose_mass_the_gantry_carries(built):
    machine = gantry(**built)
    drawing = Randomisation(machine, {"payload": 5.0}, 10)
    bridge = machine.model.body("bridge").id
    before = machine.model.body_subtreemass[bridge]
    drawing.draw(np.random.default_rng(1))
    assert machine.model.body_subtreemass[bridge] == pytest.approx(before + 3.0)


def test_an_accelerated_gripper_leaves_the_load_behind():
    machine = gantry(cable_length=0.5, **FREE)
    machine.reset(positions={"x": 0.1, "y": 0.1})
    torque_mode(machine, x=100)
    machine.step(100)
    assert machine.sway[0] < -1e-4
    assert abs(machine.sway[1]) < 1e-6


@pytest.mark.parametrize("values", [{}, {"x_drives": 2}, {"x_drives": 2, "cable_length": 0.5}])
def test_a_gantry_is_small_in_memory(values):
    machine = gantry(**values)
    size = mujoco.mj_sizeModel(machine.model) + machine.data.nbuffer + machine.data.narena
    size += machine.axes.nbytes + machine.couplings.nbytes
    assert size < 102_000  # 8.4 kB of it each drive


@pytest.mark.parametrize(
    ("values", "text"),
    [
        ({"x_drives": 3}, "x_drives = 3 is out of range 1..2"),
        ({"x_drives": 1.5}, "x_drives = 1.5: use 1 or 2 drives"),
        ({"coupling_stiffness": 1.0}, r"coupling_stiffness = 1.0 .* N/m"),
        ({"skew_stiffness": -1.0}, r"skew_stiffness = -1.0 .* Nm/rad"),
        ({"cable_length": math.nan}, "cable_length = nan"),
        ({"cable_length": 0.01}, "too short to swing"),
        ({"cable_length": 0.5, "payload": 0.0}, "payload = 0.0 kg cannot hang"),
        ({"squaring_offset": 0.01}, "squaring_offset"),
        ({"payload": "2"}, "payload = '2'"),
        ({"timestep": math.nan}, "timestep = nan"),
        (
            {"x_drives": 2, "drive": "bonfiglioli_act", "coupling_stiffness": 2e7},
            r"coupling_stiffness = 2e\+07 N/m is too stiff for timestep = 0.0005 s: use 9e\+06",
        ),
    ],
)
def test_a_gantry_that_cannot_be_is_refused_by_name(values, text):
    with pytest.raises(ValueError, match=text):
        gantry(**values)


def test_carriages_that_would_tear_the_bridge_are_refused():
    machine = gantry(x_drives=2)
    with pytest.raises(ValueError, match=r"x1 = 0.3 m and x2 = 0.0 m would tear .* give both"):
        machine.reset(positions={"x1": 0.3})


def test_the_stiffest_bridge_is_stable_at_the_longest_timestep():
    machine = gantry("bonfiglioli_act", x_drives=2, coupling_stiffness=9e6, coupling_damping=0.0)
    machine.reset(positions={"x1": 0.3, "x2": 0.3, "y": 0.25})
    machine.data.joint("skew").qpos[0] = 1e-4
    seen = record(machine, lambda: machine.skew, 1000)
    assert np.abs(seen).max() < 2e-4 * SPAN, "an unstable one grows without bound"
    assert np.abs(seen[-100:]).max() < 1e-4 * SPAN
