"""Friction, cogging, backlash, impacts and switch tolerance against their closed forms."""

import math

import numpy as np
import pytest

from servogym.drive.master import Master
from servogym.envs import FAMILY, Machine, linear_axis
from servogym.envs.masters.port import MachinePort

BARE = {"coulomb_friction": 0.0, "viscous_friction": 0.0}


def force_on(machine, force):
    """Pull at the payload along the axis (N)."""
    machine.data.body("payload").xfrc_applied[0] = force


def inertia(machine):
    """All that the drive moves (kg)."""
    return float(machine.data.M[int(machine.mechanics[0].inertia_at)])


def resistance(machine, position, velocity):
    """Force against a motion (N), from what the speed loses in a machine cycle."""
    machine.reset(positions={"x": position})
    machine.data.qvel[0] = velocity
    machine.step()
    return (velocity - machine.data.qvel[0]) * inertia(machine) / machine.cycle_time


@pytest.mark.parametrize("brake", [0.0, 0.5])
def test_it_breaks_away_at_the_static_friction_and_the_brake(brake):
    machine = linear_axis(coulomb_friction=10, static_friction=20, brake_torque=brake)
    expected = 20.0 + brake * machine.couplings[0].gear
    force_on(machine, 0.995 * expected)
    machine.step(1000)
    assert abs(machine.data.qvel[0]) < 1e-4
    force_on(machine, 1.005 * expected)
    machine.step(1000)
    assert machine.data.qvel[0] > 0.01


@pytest.mark.parametrize("velocity", [0.002, 0.005, 0.01, 0.02, 0.1])
def test_friction_falls_with_the_speed_as_stribeck_says(velocity):
    machine = linear_axis(
        payload=100, coulomb_friction=10, static_friction=20, viscous_friction=0,
        stribeck_velocity=0.01,
    )
    expected = 10 + 10 * math.exp(-((velocity / 0.01) ** 2))
    assert resistance(machine, 0.2, velocity) == pytest.approx(expected, rel=0.02)
    assert resistance(machine, 0.2, -velocity) == pytest.approx(-expected, rel=0.02)


@pytest.mark.parametrize("position", [0.0, 0.25, 0.5])
def test_the_cable_chain_drags_more_with_the_travel(position):
    machine = linear_axis(
        payload=100, coulomb_friction=5, viscous_friction=0, chain_drag=3, chain_drag_growth=20
    )
    expected = 5 + 3 + 20 * (position + 0.02)
    for sign in (-1, 1):
        assert sign * resistance(machine, position, sign * 0.1) == pytest.approx(expected, rel=0.01)


def test_cogging_has_its_amplitude_and_its_period():
    order, turn, amplitude, places = 6, 0.06, 0.2, 48
    machine = linear_axis(payload=100, cogging_torque=amplitude, cogging_order=order, **BARE)
    gear = machine.couplings[0].gear
    torques = [-resistance(machine, turn * i / places, 0.0) / gear for i in range(places)]
    spectrum = np.abs(np.fft.rfft(torques)) / (places / 2)
    assert spectrum[order] == pytest.approx(amplitude, rel=0.01)
    assert np.delete(spectrum, order).max() < 0.01 * amplitude


def test_an_axis_without_power_rests_in_a_detent():
    machine = linear_axis(cogging_torque=0.5, cogging_order=6, coulomb_friction=0)
    machine.reset(positions={"x": 0.121})
    machine.model.dof_damping[0] = 200
    machine.step(20_000)
    detents = machine.data.qpos[0] / 0.01 - 0.5
    assert detents == pytest.approx(round(detents), abs=0.01)


def test_torque_ripple_is_a_share_of_the_torque():
    machine = linear_axis(torque_ripple=0.05, ripple_order=6, **BARE)
    machine.reset(positions={"x": 0.05})
    x = machine.drives["x"]
    shares = []

    def look():
        torque = float(x.axis.torque)
        if abs(torque) > 0.5:
            rippled = machine.data.qfrc_passive[0] / machine.couplings[0].gear
            shares.append(rippled / torque)

    master = Master(MachinePort(machine, look), "x")
    master.enable()
    master.home(37)
    master.move_to(0.3)
    assert max(shares) == pytest.approx(0.05, rel=0.05)
    assert min(shares) == pytest.approx(-0.05, rel=0.05)


def test_a_held_motor_lets_the_carriage_move_by_the_gap_and_the_spring():
    gap, stiffness, force = 100e-6, 1e6, 50.0
    machine = linear_axis(
        transmission_stiffness=stiffness, transmission_damping=2000, backlash=gap,
        brake_torque=100, **BARE,
    )
    places = []
    for sign in (-1, 1):
        force_on(machine, sign * force)
        machine.step(2000)
        places.append(machine.data.qpos[1])
    assert places[1] - places[0] == pytest.approx(gap + 2 * force / stiffness, rel=0.01)


def test_nothing_acts_within_the_gap():
    machine = linear_axis(
        transmission_stiffness=1e6, transmission_damping=100, backlash=1e-3, brake_torque=100,
        **BARE,
    )
    machine.data.qvel[1] = 0.01
    machine.step(80)
    assert machine.data.qpos[1] == pytest.approx(0.01 * machine.time, rel=1e-3)
    assert machine.data.qvel[1] == pytest.approx(0.01, rel=1e-3)


def test_a_target_reached_from_both_sides_leaves_the_carriage_a_backlash_apart():
    gap, friction, stiffness = 50e-6, 40.0, 3e7
    machine = linear_axis(mechanics="ball_screw", backlash=gap, cogging_torque=0)
    machine.reset(positions={"x": 0.1})
    master = Master(MachinePort(machine), "x")
    master.enable()
    machine.drives["x"].write("home_offset", 0)
    master.home(37)
    places = {}
    for start in (-5_000, 5_000):
        master.move_to((20_000 + start) * 1e-6)
        master.move_to(0.02)
        machine.step(400)
        motor = machine.data.qpos[0] - 0.1
        assert motor == pytest.approx(0.02, abs=2e-6), "the encoder sees none of it"
        places[start] = machine.data.qpos.sum()
    lost = places[5_000] - places[-5_000]
    assert 0.9 * gap < lost < 1.1 * gap + 2 * friction / stiffness


@pytest.mark.parametrize("mechanics", ["rigid", "toothed_belt", "ball_screw", "linear_motor"])
def test_the_end_stop_takes_the_kinetic_energy(mechanics):
    machine = linear_axis(
        mechanics=mechanics, static_friction=0, chain_drag=0, chain_drag_growth=0,
        cogging_torque=0, **BARE,
    )
    m = machine.mechanics[0]
    machine.reset(positions={"x": 0.5})
    machine.data.qvel[0] = 0.4
    if machine.model.nv > 1:
        machine.data.qvel[1] = 0.0
    machine.step(200)
    p = FAMILY[mechanics]
    rotor = machine.model.dof_armature[0]
    energy = 0.5 * (p.payload + p.carriage_mass + rotor) * 0.4**2
    assert m.impacts >= 1
    assert m.impact_largest == pytest.approx(energy, rel=0.02)


def test_impacts_are_counted_summed_kept_in_snapshots_and_cleared_by_a_reset():
    machine = linear_axis(**BARE)
    m, energies = machine.mechanics[0], []
    for position, velocity in ((0.5, 0.6), (0.0, -0.3)):
        machine.data.qpos[0], machine.data.qvel[0] = position, velocity
        before = m.impacts.copy()
        while m.impacts == before:
            machine.step()
        energies.append(0.5 * (6.5 + machine.model.dof_armature[0]) * velocity**2)
        assert m.impact_last == pytest.approx(energies[-1], rel=0.01)
    assert m.impacts == 2
    assert m.impact_sum == pytest.approx(sum(energies), rel=0.01)
    assert m.impact_largest == pytest.approx(energies[0], rel=0.01)
    snapshot = machine.snapshot()
    machine.reset()
    assert m.impacts == m.impact_sum == m.impact_largest == m.impact_last == 0
    machine.restore(snapshot)
    assert m.impacts == 2
    assert machine.snapshot() == snapshot


def edges(machine, count, reach):
    """Where the home switch goes on, approached from the left `count` times (m)."""
    found = []
    for _ in range(count):
        machine.data.qpos[0] = 0.15
        machine.step()
        position = 0.2 - reach
        while not machine.drives["x"].axis.home_switch:
            position += reach / 40
            machine.data.qpos[0] = position
            machine.step()
        found.append(position)
    return np.array(found)


def test_a_switch_answers_where_its_offset_and_its_scatter_put_it():
    machine = linear_axis(switch_offset=2e-3, switch_scatter=100e-6)
    machine.reset(positions={"x": 0.15})
    found = edges(machine, 100, 1e-3)
    assert found.mean() == pytest.approx(0.202, abs=50e-6)
    assert found.std() == pytest.approx(100e-6, rel=0.25)
    machine.reset(positions={"x": 0.15})
    assert np.array_equal(edges(machine, 5, 1e-3), found[:5]), "a reset repeats the draws"


@pytest.mark.parametrize("mechanics", ["toothed_belt", "ball_screw", "vertical"])
def test_a_preset_vibrates_at_its_two_mass_resonance(mechanics):
    machine = linear_axis(
        mechanics=mechanics, timestep=0.00025 / 8, static_friction=0, chain_drag=0,
        chain_drag_growth=0, cogging_torque=0, backlash=0, brake_torque=0,
        transmission_damping=0, **BARE,
    )
    p = FAMILY[mechanics]
    machine.reset(positions={"x": 0.4})
    machine.data.qpos[1] = 1e-4
    signal = []
    for _ in range(2000):
        machine.step()
        signal.append(machine.data.qpos[1])
    signal = np.array(signal) - np.mean(signal)
    rising = np.flatnonzero((signal[:-1] < 0) & (signal[1:] >= 0))
    at = rising - signal[rising] / (signal[rising + 1] - signal[rising])
    frequency = (len(at) - 1) / (at[-1] - at[0]) / machine.cycle_time
    motor, load = machine.model.dof_armature[0], p.payload + p.carriage_mass
    rate = math.sqrt(p.transmission_stiffness * (1 / motor + 1 / load))
    assert frequency == pytest.approx(rate / (2 * math.pi), rel=0.01)


@pytest.mark.parametrize("mechanics", FAMILY)
def test_every_preset_homes_and_moves(mechanics):
    machine = linear_axis(mechanics=mechanics)
    machine.reset(positions={"x": 0.1})
    master = Master(MachinePort(machine), "x")
    master.enable()
    master.home()
    master.move_to(0.25)
    machine.step(200)
    carriage = machine.data.qpos[:2].sum()
    assert carriage == pytest.approx(0.25, abs=0.45e-3), "the switch has 0.3 mm hysteresis"
    assert abs(machine.drives["x"].read("position_actual_value") - 250_000) <= 25


def test_the_linear_motor_needs_its_torque_for_the_carriage_alone():
    machine = linear_axis(mechanics="linear_motor")
    assert machine.model.dof_armature[0] == 0.0
    assert inertia(machine) == pytest.approx(8.5)
    assert machine.couplings[0].gear == pytest.approx(2 * math.pi / 0.03)


def test_a_machine_stays_below_100_kb():
    machine = linear_axis(mechanics="toothed_belt")
    records = machine.axes.nbytes + machine.mechanics.nbytes + machine.couplings.nbytes
    data = machine.data.nbuffer + machine.data.narena
    assert machine.model.nbuffer + data + records < 100_000


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"mechanics": "rack"}, "mechanics = 'rack' is unknown: choose one of rigid, toothed_belt"),
        ({"backlash": 1e-5}, "backlash = 1e-05 m needs a transmission_stiffness"),
        ({"static_friction": 5}, "static_friction = 5 N needs a coulomb_friction"),
        ({"torque_ripple": 2}, r"torque_ripple = 2 is out of range 0..0.5 share"),
        ({"transmission_stiffness": 1e9}, r"too fast for a timestep of 250 µs: at most \d+ µs"),
        ({"stiffness": 1e8, "timestep": 250e-6}, r"stiffness = 1e\+08 N/m between .* too fast"),
        ({"stiffness": 1e8, "payload": 0.05}, r"stiffness = 1e\+08 N/m between .* at most 33 µs"),
    ],
)
def test_what_does_not_fit_is_named(values, message):
    with pytest.raises(ValueError, match=message):
        linear_axis(**values)


def test_the_timestep_is_as_short_as_a_stiff_spring_needs_it():
    assert linear_axis().model.opt.timestep == 250e-6
    assert linear_axis(stiffness=1e8).model.opt.timestep == 125e-6


@pytest.mark.parametrize(
    ("numeric", "message"),
    [
        ('"a.backlash" data="1e-5"', "elastic transmission"),
        ('"a.stribeck" data="5 0.01"', "Coulomb friction 0 N"),
        ('"a.cogging" data="-1 6"', r"'a.cogging': -1 is out of range 0..10000 \(Nm"),
        ('"a.cogging" data="1"', "needs 2 finite numbers"),
        ('"a.cable_chain" data="1 1"', "needs the joint's range"),
    ],
)
def test_effects_of_an_mjcf_are_checked(numeric, message):
    text = f"""
    <mujoco><option timestep="0.00025"/><custom><numeric name={numeric}/></custom>
     <worldbody><body><joint name="j" type="slide"/><geom size=".1" mass="2"/></body></worldbody>
     <actuator><motor name="a" joint="j" gear="100"/></actuator></mujoco>"""
    with pytest.raises(ValueError, match=message):
        Machine.from_mjcf(text, {"a": "generic"})
