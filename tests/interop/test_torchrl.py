"""torchrl steps an environment and a vector of ours, infos and all."""

import gymnasium as gym
import pytest

torchrl = pytest.importorskip("torchrl.envs.libs.gym", reason="needs torchrl, not among our extras")

from servogym.envs.tasks.positioning import LinearAxisEnv  # noqa: E402
from servogym.envs.vector_env import ServoVectorEnv  # noqa: E402

ID = "servogym.envs:servogym/LinearAxis-v0"


def test_an_environment():
    env = torchrl.GymWrapper(gym.make(ID, disable_env_checker=True))
    steps = env.rollout(5)
    assert steps["next", "reward"].shape == (5, 1)


def test_a_vector():
    env = torchrl.GymWrapper(ServoVectorEnv(LinearAxisEnv, 3, autoreset_mode="SameStep"))
    steps = env.rollout(5, break_when_any_done=False)
    assert steps["next", "reward"].shape == (3, 5, 1)
