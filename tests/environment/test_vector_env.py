"""servogym/LinearAxis-v0 as a vector: bit for bit the single environments, both autoresets."""

import pickle

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv

import servogym.envs
from servogym.envs.environment.vector_env import ServoVectorEnv
from servogym.envs.tasks.positioning import LinearAxisEnv

ID = "servogym/LinearAxis-v0"
assert servogym.envs


def actions(generator, n):
    return generator.uniform(-1, 1, (n, 1)).astype(np.float32) * 0.3


def single(**arguments):
    return gym.wrappers.TimeLimit(LinearAxisEnv(**arguments), 25)


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
@pytest.mark.parametrize("randomise", [{}, {"payload": (1, 9), "encoder_noise": (0, 1e-6)}])
def test_it_is_bit_for_bit_the_environments_one_by_one(mode, threads, randomise):
    arguments = {
        "faults": {"encoder_loss": 0.02}, "following_error_window": 0.005, "randomise": randomise,
    }
    peers = SyncVectorEnv([lambda: single(**arguments) for _ in range(4)], autoreset_mode=mode)
    vector = ServoVectorEnv(
        LinearAxisEnv, 4, autoreset_mode=mode, threads=threads, max_episode_steps=25, **arguments
    )
    one, _ = peers.reset(seed=7)
    other, _ = vector.reset(seed=7)
    np.testing.assert_array_equal(one, other)
    generator = np.random.default_rng(1)
    ends = 0
    for _ in range(80):
        action = actions(generator, 4)
        expected, got = peers.step(action), vector.step(action)
        for a, b in zip(expected[:4], got[:4], strict=True):
            np.testing.assert_array_equal(a, b)
        ended = got[2] | got[3]
        ends += ended.sum()
        if mode == AutoresetMode.SAME_STEP and ended.any():
            np.testing.assert_array_equal(
                np.stack(expected[4]["final_obs"][ended]), got[4]["final_obs"][ended]
            )
    assert ends > 6
    peers.close()
    vector.close()


def test_gymnasium_makes_it_and_random_actions_never_leave_the_space():
    vector = gym.make_vec(ID, num_envs=3)
    assert isinstance(vector.unwrapped, ServoVectorEnv)
    observations, infos = vector.reset(seed=1)
    assert set(infos) >= {"distance", "_distance", "goal", "is_success"}
    for _ in range(210):
        observations, rewards, *_ = vector.step(vector.action_space.sample())
        assert vector.observation_space.contains(observations)
        assert ((rewards >= 0) & (rewards <= 1)).all()
    vector.close()


def test_a_fault_is_told_and_ends_the_episode():
    faults = {"short_circuit": 1.0}
    vector = ServoVectorEnv(LinearAxisEnv, 2, faults=faults, autoreset_mode="Disabled")
    vector.reset(seed=1)
    _, _, terminated, truncated, infos = vector.step(np.zeros((2, 1)))
    assert terminated.all()
    assert not truncated.any()
    assert infos["fault"][0].startswith("2320h")
    _, rewards, terminated, *_ = vector.step(np.zeros((2, 1)))
    assert not terminated.any(), "told once; it rests until it is reset"
    assert not rewards.any()
    vector.reset(options={"reset_mask": np.array([True, False])})
    vector.close()


def test_part_of_it_is_reset_by_a_mask():
    vector = ServoVectorEnv(LinearAxisEnv, 3)
    with pytest.raises(ValueError, match="reset_mask"):
        vector.reset(options={"reset_mask": np.array([True, False, False])})
    before, _ = vector.reset(seed=5)
    after, _ = vector.reset(options={"reset_mask": np.array([False, True, False])})
    assert (before[[0, 2]] == after[[0, 2]]).all()
    assert (before[1] != after[1]).any()
    vector.close()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [({"num_envs": 0}, "num_envs"), ({"threads": 0}, "threads"), ({"drive": "acme"}, "unknown")],
)
def test_bad_arguments_are_named(arguments, message):
    with pytest.raises(ValueError, match=message):
        ServoVectorEnv(LinearAxisEnv, **arguments)


@pytest.mark.parametrize(
    ("wrong", "told"),
    [
        (np.zeros(2), r"actions of shape \(2,\) are not in"),
        ([[0.0], [np.nan]], r"actions\[1, 0\] = nan is not in -1\.\.1: clip them"),
        (np.full((2, 1), 1.1), r"actions\[0, 0\] = 1\.1 is not in -1\.\.1"),
        ([[0.0], [-np.inf]], r"actions\[1, 0\] = -inf is not in"),
    ],
)
def test_wrong_actions_are_refused(wrong, told):
    vector = ServoVectorEnv(LinearAxisEnv, 2)
    vector.reset(seed=1)
    with pytest.raises(ValueError, match=told):
        vector.step(wrong)
    vector.close()


def test_a_closed_one_begins_again():
    vector = ServoVectorEnv(LinearAxisEnv, 2, threads=2)
    vector.reset(seed=1)
    vector.step(np.zeros((2, 1)))
    vector.close_extras()
    vector.step(np.zeros((2, 1)))
    vector.close()
    assert pickle.dumps(vector.autoreset_mode)
