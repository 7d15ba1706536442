"""What is told of a step is told of all of it, and a step lasts the same time with every drive."""

import numpy as np
import pytest

from servogym.drive.kernel.words import Mode
from servogym.drive.model.model import load, model_names
from servogym.envs import TASKS, task
from servogym.envs.engine import probe
from servogym.envs.tasks.positioning import LinearAxisEnv
from servogym.envs.view.channels import drives
from servogym.training.policies import make

TAKEN = {  # by a library that merges infos with what else a step gives
    "reward", "rewards", "observation", "obs", "next_obs", "next", "action", "terminated",
    "truncated", "done", "episode", "final_obs", "final_info", "TimeLimit.truncated",
    "terminal_observation",
}


def ruckig(env, seed=0):
    """Each step of an episode under ruckig; -> infos of the steps."""
    policy = make("ruckig", env)
    observation, info = env.reset(seed=seed)
    probe.begin(env.machine, 1.0)
    policy.reset(observation, info)
    for _ in range(env.STEPS):
        observation, *_, info = env.step(policy.act(observation))
        yield info


def test_peaks_of_the_steps_are_those_of_the_physics_and_pictures_show_them():
    env = LinearAxisEnv(payload=20.0)
    env.machine.probe()
    error, torque = drives(False)
    shown, at_ends, cost = [], [], 0.0
    for info in ruckig(env):
        shown.append([abs(error.value(env)), abs(torque.value(env))])
        at_ends.append(abs(env.machine.axes["torque"][0]))
        cost += info["cost"]
    measured, rated = env.machine.probes[0], env.machine.axes["rated_torque"][0]
    assert np.max(shown, axis=0) == pytest.approx(
        [measured.error_peak * 1e6, measured.torque_peak / rated], rel=1e-12
    )
    assert max(at_ends) < measured.torque_peak  # a look at the ends misses it
    ticks = env.cycles_per_step * env.machine.physics_steps
    assert cost * ticks == pytest.approx(measured.limited, abs=1e-6)


def test_the_way_of_the_images_does_not_matter():
    def costs(**faults):
        env = LinearAxisEnv(drive="kollmorgen_akd", payload=20.0, **faults)
        env.reset(seed=1)
        return [env.step(np.array([(-1.0) ** (i // 7)]))[-1]["cost"] for i in range(40)]

    assert costs() == costs(faults={"drop": 0.0})  # on EtherCAT, where no frame is lost


@pytest.mark.parametrize("name", model_names())
def test_an_episode_lasts_the_same_time_with_every_drive(name):
    model = load(name)
    for each in TASKS:
        if Mode.CYCLIC_SYNC_POSITION in each.MODES and name == "kollmorgen_akd":
            assert each(drive=model).step_time == pytest.approx(each.STEP_TIME)
    if Mode.PROFILE_VELOCITY in model.modes and Mode.HOMING in model.modes:
        env = task("Homing-v0")(drive=model)
        assert env.STEPS * env.step_time == pytest.approx(10.0, rel=3e-3)


def test_no_info_has_a_name_that_a_library_takes():
    for each in TASKS:
        env = each()
        _, info = env.reset(seed=0)
        assert not TAKEN & info.keys()
        assert not TAKEN & env.step(env.action_space.sample())[-1].keys()
