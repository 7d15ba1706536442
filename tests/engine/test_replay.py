"""Set-points in rows are those of a loop in Python, bit by bit; parameters are set in place."""

import math

import numpy as np
import pytest

from servogym.drive.kernel.words import Mode
from servogym.drive.master import Master
from servogym.envs import linear_axis, rotary_axis
from servogym.envs.engine import parameters
from servogym.envs.engine.replay import Replay
from servogym.envs.masters.port import MachinePort
from servogym.envs.variation.randomisation import KNOBS, Randomisation


def enabled(machine, mode=Mode.CYCLIC_SYNC_POSITION):
    master = Master(MachinePort(machine), "x")
    machine.reset({"x": 0.2})
    master.set_mode(mode)
    master.enable()
    return machine


def sine(count, here):
    return here + np.round(5000 * (1 - np.cos(0.05 * np.arange(count)))).astype(int)


def test_replay_is_what_rpdos_cycle_by_cycle_are():
    machine = enabled(linear_axis())
    drive = machine.drives["x"]
    targets = sine(200, drive.read("position_actual_value"))
    begin, expected = machine.snapshot(), []
    drive.map_pdos([["target_position"]], None)
    begin = machine.snapshot()
    for n, target in enumerate(targets):
        if n % 2 == 0:
            drive.latch(int(target).to_bytes(4, "little", signed=True))
        machine.step()
        expected.append((float(drive.axis.position), float(drive.axis.torque)))
    machine.restore(begin)
    found = machine.replay(
        {"target_position": targets}, ("position", "torque"), arrives=np.arange(200) % 2 == 0
    )
    np.testing.assert_array_equal(np.transpose([found["position"], found["torque"]]), expected)
    assert np.ptp(found["position"]) * 0.06 / (2 * math.pi) > 5e-3


def test_candidates_side_by_side_do_what_each_does_alone():
    machines = [enabled(linear_axis(payload=mass)) for mass in (2.0, 8.0)]
    targets = sine(100, 0)
    layout = Replay("x", ["target_position"], ["position"])
    rows = np.zeros(100, layout.written)
    rows["target_position"] = targets
    alone = []
    for machine in machines:
        kept = machine.snapshot()
        alone.append(machine.replay({"target_position": targets}, ("position",))["position"])
        machine.restore(kept)
    together = layout.run(machines, rows)["position"]
    np.testing.assert_array_equal(together, alone)
    assert np.ptp(together[0] - together[1]) > 0


@pytest.mark.parametrize(
    ("rows", "read", "said"),
    [
        ({"target_positon": [0]}, ("position",), "target_positon"),
        ({"target_position": [0]}, ("positon",), "positon"),
        ({"target_position": [0], "controlword": [1, 2]}, ("position",), "one length"),
    ],
)
def test_replay_refuses_what_is_no_field(rows, read, said):
    with pytest.raises(ValueError, match=said):
        linear_axis().replay(rows, read)


MACHINES = {
    "rigid": linear_axis,
    "belt": lambda: linear_axis(mechanics="toothed_belt", stiffness=4e4, structural_damping=20.0),
    "rotary": rotary_axis,
}


@pytest.mark.parametrize("make", MACHINES.values(), ids=MACHINES)
def test_every_parameter_that_is_there_reads_back_what_was_set(make):
    machine = make()
    joint = parameters.Joint(machine)
    for name, row in parameters.PARAMETERS.items():
        if not row.there(joint):
            continue
        before = parameters.get(machine, [name])[name]
        wanted = min(max(1.25 * before, row.low), row.high) or min(0.01, row.high)
        wanted = 2.0 if name == "delay" else wanted
        if name == "static_friction":
            wanted = max(wanted, 1.1 * parameters.get(machine, ["coulomb_friction"])[
                "coulomb_friction"])
        parameters.apply(machine, {name: wanted})
        assert parameters.get(machine, [name])[name] == pytest.approx(wanted, rel=1e-4), name
    machine.step(10)


def test_what_is_set_is_what_would_have_been_built():
    """Oracle: the builder, which compiles the same values into MuJoCo's model."""
    values = {
        "payload": 2.5, "carriage_mass": 2.0, "coulomb_friction": 30.0, "viscous_friction": 70.0,
        "rotor_inertia": 1e-4, "inclination": 20.0, "cogging_torque": 0.02, "cogging_order": 12.0,
        "torque_ripple": 0.01, "static_friction": 33.0, "stribeck_velocity": 0.02,
    }
    built, turned = linear_axis(**values), linear_axis(static_friction=12.5)
    gains = {
        name: parameters.get(built, [name])[name]
        for name in ("velocity_gain", "integral_time", "position_gain", "acceleration_feed_forward")
    }
    parameters.apply(turned, values | gains)
    tracks = []
    for machine in (built, turned):
        rows = {"target_position": sine(300, 200_000)}
        machine.reset({"x": 0.2})
        tracks.append(enabled(machine).replay(rows, ("position", "torque")))
    np.testing.assert_allclose(tracks[1]["position"], tracks[0]["position"], atol=2e-5)
    np.testing.assert_allclose(tracks[1]["torque"], tracks[0]["torque"], atol=2e-3)


def test_setting_a_mass_leaves_a_machine_where_it_is():
    machine = enabled(linear_axis())
    parameters.apply(machine, {"payload": 3.0})
    assert machine.data.qpos[0] == pytest.approx(0.2, abs=1e-4)


def test_a_load_force_is_carried_by_the_motor():
    """Closed form: force over gear, at rest without friction."""
    machine = linear_axis(coulomb_friction=0.0, viscous_friction=0.0)
    parameters.apply(machine, {"load_force": -30.0})
    enabled(machine)
    machine.step(2000)
    gear, _ = machine.joint("x")
    assert machine.drives["x"].axis.torque == pytest.approx(30.0 / gear, rel=1e-3)


def test_torque_constant_scales_what_the_motor_gives():
    machine = linear_axis(inclination=90.0, coulomb_friction=0.0, payload=3.5)
    parameters.apply(machine, {"torque_constant": 0.8})
    enabled(machine)
    machine.step(2000)
    gear, _ = machine.joint("x")
    assert machine.drives["x"].axis.torque == pytest.approx(5 * 9.81 / gear / 0.8, rel=1e-3)


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"paylod": 1.0}, "payload"),
        ({"load_stiffness": 1e4}, "cannot act"),
        ({"viscous_friction": -1.0}, "out of range"),
    ],
)
def test_a_parameter_that_is_not_there_is_refused(values, said):
    with pytest.raises(ValueError, match=said):
        parameters.apply(linear_axis(), values)


def test_coulomb_and_viscous_friction_are_drawn_apart():
    machine = linear_axis()
    ranges = {"coulomb_friction": (5.0, 20.0), "viscous_friction": 33.0}
    Randomisation(machine, ranges, 10).draw(np.random.default_rng(1))
    found = parameters.get(machine, ["coulomb_friction", "viscous_friction"])
    assert found["viscous_friction"] == 33.0
    assert 5.0 < found["coulomb_friction"] < 20.0 != 12.0


def test_every_parameter_can_be_drawn():
    assert set(parameters.PARAMETERS) < set(KNOBS)
    with pytest.raises(ValueError, match="load_stiffness"):
        Randomisation(linear_axis(), {"load_stiffness": 1e4}, 10)
