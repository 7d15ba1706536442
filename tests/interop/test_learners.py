"""Libraries of learning as they come from PyPI, each some updates on environments of ours.

None is among our extras, and none of this is part of `make test`: in an environment of its own,
with this package and the library, `pytest -m interop tests/interop/test_learners.py -rs`. Passed so
far: torchrl 0.14.1 with tensordict 0.15.3, and the script as CleanRL's; the others have not been
run to their end.
"""

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

import servogym.envs  # noqa: F401, registers
from servogym.envs.tasks.positioning import LinearAxisEnv
from servogym.envs.vector_env import ServoVectorEnv

pytestmark = [pytest.mark.interop, pytest.mark.filterwarnings("default")]

ID = "servogym/LinearAxis-v0"


def library(name):
    return pytest.importorskip(name, reason=f"needs {name}, which is not among our extras")


def test_torchrl_steps_an_environment_and_a_vector():
    wrappers = library("torchrl.envs.libs.gym")
    one = wrappers.GymWrapper(gym.make(ID, disable_env_checker=True))
    assert one.rollout(5)["next", "reward"].shape == (5, 1)
    many = wrappers.GymWrapper(ServoVectorEnv(LinearAxisEnv, 3, autoreset_mode="SameStep"))
    steps = many.rollout(5, break_when_any_done=False)
    assert steps["next", "reward"].shape == (3, 5, 1)


def test_tianshou_collects_from_environments_of_ours():
    library("tianshou")
    from tianshou.env import DummyVectorEnv

    envs = DummyVectorEnv([lambda: gym.make(ID) for _ in range(2)])
    observations, _ = envs.reset()
    assert observations.shape == (2, 7)
    observations, rewards, *_ = envs.step(np.zeros((2, 1), np.float32))
    assert observations.shape == (2, 7)
    assert (rewards >= 0.0).all()


def test_sbx_learns_on_our_vector():
    sbx = library("sbx")
    from servogym.training.learn.sb3 import make

    envs = make("LinearAxis-v0", 4)
    model = sbx.PPO("MlpPolicy", envs, n_steps=16, batch_size=32, n_epochs=1, seed=1)
    model.learn(128)
    assert model.num_timesteps >= 128


def test_rllib_learns_on_an_environment_of_ours():
    library("ray.rllib")
    from ray.rllib.algorithms.ppo import PPOConfig
    from ray.tune.registry import register_env

    register_env("servogym", lambda _: gym.make(ID))
    config = PPOConfig().environment("servogym").env_runners(num_env_runners=0)
    config = config.training(train_batch_size_per_learner=256, minibatch_size=64, num_epochs=1)
    algorithm = config.build_algo()
    found = algorithm.train()
    algorithm.stop()
    assert found["num_env_steps_sampled_lifetime"] >= 256


def test_a_script_in_the_habit_of_cleanrl_finds_its_episodes_in_the_infos():
    """Of gym's own wrapper around our vector, as its scripts have it."""
    envs = gym.make_vec(
        ID, 3, vectorization_mode="vector_entry_point", autoreset_mode=AutoresetMode.SAME_STEP,
        max_episode_steps=4,
    )  # fmt: skip
    envs = gym.wrappers.vector.RecordEpisodeStatistics(envs)
    envs.reset(seed=1)
    total = np.zeros(3)
    for _ in range(4):
        _, rewards, _, truncations, infos = envs.step(np.zeros((3, 1), np.float32))
        total += rewards
    assert truncations.all()
    np.testing.assert_allclose(infos["episode"]["r"], total, rtol=1e-5)
    assert (infos["episode"]["l"] == 4).all()
