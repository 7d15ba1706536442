"""Every environment under actions no sensible agent would take: nothing leaves its range."""

import numpy as np
import pytest

from servogym.drive.model.model import model_names
from servogym.envs import TASKS

RANDOMISE = {"friction": (0.0, 10.0), "gains": (0.1, 3.0), "delay": (0, 10), "encoder_noise": 1e-5}


def make(task, *args, **arguments):
    """The environment, or None where the drive lacks something or the task has no such face."""
    try:
        return task(*args, **arguments)
    except ValueError as error:
        if "has no" in str(error) or "action =" in str(error):
            return None
        raise


def wild(generator, shape):
    """Uniform, bang-bang, or held for long."""
    kind = generator.integers(3)
    action = generator.uniform(-1, 1, shape)
    return (np.sign(action) if kind else action).astype(np.float32), generator.integers(1, 30)


def torment(env, seed, steps):
    generator = np.random.default_rng(seed)
    observation, info = env.reset(seed=seed)
    keys = set(info)
    ended = 0
    left = 0
    for _ in range(steps):
        if left == 0:
            action, left = wild(generator, env.action_space.shape)
        left -= 1
        observation, reward, terminated, truncated, info = env.step(action)
        assert env.observation_space.contains(observation)
        assert 0.0 <= reward <= 1.0
        assert not truncated
        assert set(info) == keys
        assert 0.0 <= info["cost"] <= 1.0
        assert all(0.0 <= value <= 1.0 for key, value in info.items() if key.startswith("reward"))
        numbers = [value for value in info.values() if isinstance(value, float)]
        assert np.isfinite(numbers).all(), info
        if terminated:
            ended += 1
            env.reset()
            left = 0
    return ended


@pytest.mark.parametrize("face", ["setpoint", "pdo"])
@pytest.mark.parametrize("task", TASKS, ids=lambda task: task.ID)
def test_wild_actions_stay_in_the_spaces(task, face):
    env = make(task, action=face, randomise=RANDOMISE, history=2, previous_action=True)
    if env is None:
        assert face == "setpoint", "each has the other"
        return
    torment(env, 1, 600)


@pytest.mark.slow
@pytest.mark.parametrize("model", model_names())
@pytest.mark.parametrize("task", TASKS, ids=lambda task: task.ID)
def test_wild_actions_stay_in_the_spaces_with_every_drive(task, model):
    for face in ("setpoint", "pdo"):
        env = make(task, model, action=face, randomise=RANDOMISE)
        for seed in range(3 if env else 0):
            torment(env, seed, 4000)
