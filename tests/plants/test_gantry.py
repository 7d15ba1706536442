"""The gantry and the vertical axis: three drives, gravity and holding brakes."""

import math

import pytest

from servogym.drive.kernel.words import State
from servogym.drive.master import Master
from servogym.envs import gantry, linear_axis
from servogym.envs.masters.port import MachinePort
from servogym.envs.plants.catalogue import axis_for
from servogym.envs.serve.description import nodes

G = 9.81


@pytest.mark.parametrize("drive", ["generic", "festo_cmmp_as"])
def test_three_axes_home_and_move_and_the_brake_holds_z(drive):
    machine = gantry(drive)
    machine.reset(positions={"x": 0.1, "y": 0.1, "z": -0.1})
    machine.step(400)
    assert abs(machine.data.qpos[2] + 0.1) < 20e-6
    for name, target in (("x", 0.4), ("y", 0.25), ("z", -0.15)):
        master = Master(MachinePort(machine), name)
        master.enable()
        master.home()
        master.move_to(target)
    for joint, target in zip(machine.data.qpos, (0.4, 0.25, -0.15), strict=True):
        assert joint == pytest.approx(target, abs=0.4e-3), "the switches have 0.3 mm hysteresis"
    master.control(0)
    machine.step(1000)
    assert machine.drives["z"].state == State.SWITCH_ON_DISABLED
    assert machine.data.qpos[2] == pytest.approx(-0.15, abs=1e-3), "the power went off at once"


def test_z_carries_its_weight():
    machine = gantry(payload=3.0)
    machine.reset(positions={"x": 0.1, "y": 0.1, "z": -0.1})
    Master(MachinePort(machine), "z").enable()
    machine.step(1000)
    friction = 12.0
    for sign in (-1, 1):
        bound = (5.5 * G + sign * friction) * 0.06 / (2 * math.pi)
        assert sign * machine.drives["z"].axis.torque <= sign * bound + 0.01


def test_a_vertical_axis_without_brake_falls_as_gravity_says():
    machine = linear_axis(inclination=90, payload=5.0, coulomb_friction=0, viscous_friction=0)
    machine.reset(positions={"x": 0.4})
    machine.step(200)
    mass, rotor = 6.5, machine.model.dof_armature[0]
    expected = 0.5 * mass * G / (mass + rotor) * machine.time**2
    assert 0.4 - machine.data.qpos[0] == pytest.approx(expected, rel=0.02)


def test_a_vertical_axis_does_not_sag_when_it_is_enabled_and_disabled():
    machine = linear_axis(inclination=90, brake_torque=4.0)
    machine.reset(positions={"x": 0.2})
    lowest = [0.2]

    def look():
        lowest[0] = min(lowest[0], machine.data.qpos[0])

    master = Master(MachinePort(machine, look), "x")
    master.wait(200 * machine.cycle_time)
    master.enable()
    master.wait(400 * machine.cycle_time)
    master.control(0x07)  # disable operation
    master.wait_until(lambda word: word & 0x6F == 0x23, 2.0, "disable operation")
    master.wait(400 * machine.cycle_time)
    assert 0.2 - lowest[0] < 200e-6


def test_parameters_out_of_range_are_named():
    with pytest.raises(ValueError, match="payload"):
        gantry(payload=11)
    with pytest.raises(ValueError, match=r"inclination = 91 is out of range -90..90 degree"):
        linear_axis(inclination=91)


def test_node_ids_run_through_axes_and_machines():
    machine = axis_for("generic", 5, "gantry")
    assert [drive.node_id for drive in machine.drives.values()] == [5, 6, 7]
    assert machine.drives["y"].read(0x1014) == 0x86
    two = axis_for("generic", 5, "gantry-x1x2")
    assert {x: d.node_id for x, d in two.drives.items()} == {"x1": 5, "x2": 6, "y": 7, "z": 8}
    assert [row.node_id for row in nodes("festo_cmmd", [10], "vertical")] == [10, 11]
    assert [row.node_id for row in nodes("generic", [5, 9], "gantry-x1x2")] == [5, 9]
    with pytest.raises(ValueError, match="some twice"):
        nodes("festo_cmmd", [10, 11], "linear")
    with pytest.raises(ValueError, match=r"126..128 is out of range"):
        axis_for("generic", 126, "gantry")
    with pytest.raises(ValueError, match="linear, vertical, rotary-table, conveyor, gantry"):
        axis_for("generic", 1, "rotary")
