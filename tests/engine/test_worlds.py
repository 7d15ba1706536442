"""Machines stepped together by mujoco-warp on its CPU device: each as if alone in the loop.

With ``SERVOGYM_TEST_DEVICE=cuda`` they are stepped on a GPU instead.
mujoco-warp computes in single precision: 6e-8 of 0.5 m are 30 nm, of 0.5 m/s 30 nm/s a step.
"""

import copy
import importlib.util
import os

import numpy as np
import pytest

from servogym.drive.kernel.words import Mode
from servogym.drive.master import Master
from servogym.envs import gantry, linear_axis
from servogym.envs.engine import loop
from servogym.envs.engine.machine import NO_IMAGES
from servogym.envs.masters.port import MachinePort

pytestmark = [
    pytest.mark.slow,  # warp compiles its kernels for a CPU, the first time for minutes
    pytest.mark.skipif(
        importlib.util.find_spec("mujoco_warp") is None,
        reason="no mujoco-warp: pip install 'servogym[gpu]'",
    ),
]
DEVICE = os.environ.get("SERVOGYM_TEST_DEVICE", "cpu")
POSITION, VELOCITY, TORQUE = 2e-7, 2e-4, 0.02  # m, m/s, Nm; half of it is what was measured
HERE = 35  # homing method: the present position becomes the zero
NEW_SET_POINT = 0x1F
MOVES = {"z": -4_000}  # µm; all others go the other way


def moving(machine):
    """Homed where it stands, at the beginning of a move by all its drives."""
    machine.reset()
    for drive in machine.drives.values():
        drive.write("homing_method", HERE)
    master = Master(MachinePort(machine))
    master.enable()
    master.home()
    master.set_mode(Mode.PROFILE_POSITION)
    machine.step(5)
    for name, drive in machine.drives.items():
        away = MOVES.get(name, 4_000)
        drive.write("target_position", drive.read("position_actual_value") + away)
        drive.write("controlword", NEW_SET_POINT)
    return machine


@pytest.mark.parametrize(
    "build",
    [
        lambda payload: linear_axis(payload=payload),
        lambda payload: linear_axis("kollmorgen_akd", mechanics="toothed_belt", payload=payload),
        lambda payload: gantry(payload=payload),
        lambda payload: gantry(payload=payload, x_drives=2),
    ],
    ids=["linear axis", "elastic, with backlash", "gantry", "gantry on two drives"],
)
def test_a_move_is_the_same_within_single_precision_at_every_physics_step(build):
    from servogym.envs.engine.worlds import Worlds

    machines = [moving(build(payload)) for payload in (2.0, 6.0)]
    begun = [machine.data.qpos.copy() for machine in machines]
    twins = copy.deepcopy(machines)
    worlds = Worlds(machines, DEVICE)
    for _ in range(700):
        worlds.step(1)
        for row, twin in enumerate(twins):
            loop.run(twin.addresses, 1, NO_IMAGES, NO_IMAGES)
            for own, its, most in (
                (worlds.qpos, twin.data.qpos, POSITION),
                (worlds.qvel, twin.data.qvel, VELOCITY),
                (worlds.ctrl, twin.data.ctrl, TORQUE),
            ):
                np.testing.assert_allclose(own[row], its, rtol=0, atol=most)
    worlds.fetch(range(2))
    for machine, twin, begin in zip(machines, twins, begun, strict=True):
        assert np.abs(twin.data.qpos - begin).max() > 3e-3, "it has moved"
        assert machine.time == twin.time
        for drive, its in zip(machine.drives.values(), twin.drives.values(), strict=True):
            assert drive.read("statusword") == its.read("statusword")
            assert abs(drive.read("position_actual_value") - its.read("position_actual_value")) <= 1


def test_who_is_left_out_stands_still_and_who_is_not_finite_faults_as_in_the_loop():
    from servogym.envs.engine.worlds import Worlds

    machines = [moving(linear_axis()) for _ in range(3)]
    machines[2].data.qpos[0] = np.nan
    twin = copy.deepcopy(machines[2])
    kept = copy.deepcopy(machines[1])
    worlds = Worlds(machines, DEVICE)
    worlds.leave_out(np.array([False, True, False]))
    worlds.step(20)
    twin.step(10)
    worlds.fetch(range(3))
    assert machines[0].data.qvel[0] > 1e-3
    assert machines[1].axes.tobytes() == kept.axes.tobytes()
    assert (machines[1].data.qpos, machines[1].time) == (kept.data.qpos, kept.time)
    assert np.isnan(machines[2].data.qpos[0])
    assert machines[2].drives["x"].fault == twin.drives["x"].fault != ""


def test_a_device_that_is_not_there_is_refused_with_the_next_step():
    from servogym.envs.engine.worlds import Worlds

    with pytest.raises(
        ValueError, match=r"^device = 'cuda:7'.* this machine has cpu.*leave device"
    ):
        Worlds([linear_axis()], "cuda:7")


def test_a_device_without_room_says_for_how_many(monkeypatch):
    from servogym.envs.engine import worlds

    def full(*_, **__):
        raise RuntimeError("Failed to allocate 9728 bytes on it\nand more")

    monkeypatch.setattr(worlds.packages()[0], "clone", full)
    with pytest.raises(MemoryError, match=r"^\S+ has no room for 2 machines \(.*9728.*\): take"):
        worlds.Worlds([linear_axis(), linear_axis()], DEVICE)
