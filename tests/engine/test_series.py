"""Cycles with a value for each are those of a loop in Python, bit for bit."""

import numpy as np
import pytest

from servogym.drive.kernel.record import AXIS
from servogym.drive.kernel.words import Mode
from servogym.drive.master import Master
from servogym.envs import gantry, linear_axis
from servogym.envs.engine.replay import Replay
from servogym.envs.engine.residence import Residence
from servogym.envs.masters.port import MachinePort

READ = ("torque_command", "velocity", "position", "limits", "torque_offset")


def travelling(machine, drives):
    """All of them enabled, at a speed; the others hold their position."""
    master = Master(MachinePort(machine), *machine.drives)
    for name in machine.drives:
        master[name].set_mode(Mode.PROFILE_VELOCITY if name in drives else Mode.PROFILE_POSITION)
    master.enable()
    for name in drives:
        master[name].write("target_velocity", 20_000)
    return machine


def played(machine, drives, values):
    return Replay(drives, ["torque_offset"], READ).run([machine], values, delay=0)[0]


def by_hand(machine, drives, values):
    rows = np.zeros((len(values), len(drives)), [(name, AXIS[name]) for name in READ])
    for n, row in enumerate(values):
        for k, name in enumerate(drives):
            drive = machine.drives[name]
            drive.axes["od"]["torque_offset"][drive.index] = row[k]
            drive.axes["parameters_changed"][drive.index] = 1
        machine.step()
        for k, name in enumerate(drives):
            drive = machine.drives[name]
            rows[n, k] = drive.axes[list(READ)][drive.index]
    return rows


@pytest.mark.parametrize(
    ("make", "drives"),
    [
        (lambda: linear_axis("generic"), ("x",)),
        (lambda: linear_axis("kollmorgen_akd"), ("x",)),  # PDOs that cannot be mapped
        (lambda: linear_axis("festo_cmmp_as"), ("x",)),  # without the object 60B2h
        (lambda: gantry(x_drives=2), ("x1", "x2")),
        (lambda: gantry(), ("y",)),
    ],
)
def test_it_is_what_steps_in_python_are(make, drives):
    machine = travelling(make(), drives)
    values = np.random.default_rng(1).integers(-80, 81, (300, len(drives)))
    begin, images = machine.snapshot(), {n: d.rpdos.copy() for n, d in machine.drives.items()}
    expected, end = by_hand(machine, drives, values), machine.time
    machine.restore(begin)
    rows = played(machine, drives, values)
    np.testing.assert_array_equal(rows, expected)
    assert abs(rows["torque_command"]).max() > 0
    assert machine.time == end
    for name, drive in machine.drives.items():
        np.testing.assert_array_equal(drive.rpdos, images[name])
    machine.restore(begin)  # and the machine goes on with the PDOs it had
    np.testing.assert_array_equal(by_hand(machine, drives, values), expected)


def test_a_machine_that_shares_its_memory_with_others_is_as_alone():
    machine, other = (travelling(linear_axis("generic"), ("x",)) for _ in range(2))
    values = np.full((50, 1), 100)
    expected = played(machine, ("x",), values)
    machine.reset()
    residence = Residence(machine.model, machine.data)
    for each in (machine, other):
        each.share(residence)
    np.testing.assert_array_equal(played(other, ("x",), values), expected)


def test_the_mapping_and_the_delay_are_put_back_also_where_it_failed():
    machine = travelling(linear_axis("generic"), ("x",))
    machine.world["delay"] = 3
    before = {name: machine.world[name].copy() for name in ("pdos", "delay")}
    assert played(machine, ("x",), np.zeros((0, 1))).shape == (0, 1)
    machine.couplings["qpos"] = 99
    with pytest.raises(ValueError, match="couplings"):
        played(machine, ("x",), np.zeros((5, 1)))
    assert {name: machine.world[name].copy() for name in before} == before
