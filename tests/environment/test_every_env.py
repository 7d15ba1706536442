"""What holds for each registered environment."""

import multiprocessing
import pickle
import re

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.utils.env_checker import check_env

from servogym.envs import TASKS, ServoEnv, register
from servogym.envs.environment.vector_env import ServoVectorEnv
from servogym.envs.tasks.positioning import LinearAxisEnv

IDS = [task.ID for task in TASKS]


def rollout(name, seed=3, steps=40):
    import servogym.envs  # noqa: F401, also in a spawned process

    env = gym.make(name)
    observation, _ = env.reset(seed=seed)
    env.action_space.seed(seed)
    seen = [observation.tobytes()]
    for _ in range(steps):
        observation, reward, terminated, *_ = env.step(0.3 * env.action_space.sample())
        seen.append(observation.tobytes() + np.float64(reward).tobytes())
        if terminated:
            break
    return b"".join(seen)


def rollouts():
    return [rollout(name) for name in IDS]


@pytest.mark.parametrize("task", TASKS, ids=IDS)
def test_gymnasiums_checker_is_content(task):
    check_env(gym.make(task.ID).unwrapped, skip_render_check=True)
    assert gym.spec(task.ID).max_episode_steps == task.STEPS


class OwnEnv(LinearAxisEnv):
    ID = "saved/Own-v0"


def test_the_specification_of_every_environment_can_be_saved():
    register(OwnEnv)
    for name in (*IDS, "servogym/Robot-v0", OwnEnv.ID):
        spec = EnvSpec.from_json(gym.spec(name).to_json())
        vector = gym.make_vec(spec, 2, vectorization_mode="vector_entry_point")
        assert isinstance(vector.envs[0], ServoEnv)
        assert vector.envs[0].ID == name


@pytest.mark.parametrize("task", TASKS, ids=IDS)
def test_the_page_tells_the_spaces_and_every_term_of_the_reward(task):
    env, page = task(), task.__doc__
    for heading, space in (("Action", env.action_space), ("Observation", env.observation_space)):
        told = re.search(rf"## {heading} space\n\s*`Box\(-1, 1, \((\d+),\), float32\)`", page)
        assert told, heading
        assert int(told[1]) == space.shape[0], heading
    for heading in ("Reward", "Episode", "Arguments", "Version history"):
        assert f"## {heading}\n" in page
    assert task.EPISODE.names
    terms = [name for name in task.EPISODE.names if name.startswith("reward_")]
    assert terms


def test_one_seed_is_one_rollout_also_in_a_spawned_process():
    here = rollouts()
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        assert pool.apply(rollouts) == here
    assert here != [rollout(name, seed=4) for name in IDS]


@pytest.mark.parametrize("task", TASKS, ids=IDS)
def test_it_is_pickled_in_mid_episode(task):
    env = task()
    env.reset(seed=5)
    generator = np.random.default_rng(1)
    actions = generator.uniform(-0.3, 0.3, (40, *env.action_space.shape)).astype(np.float32)
    for action in actions[:20]:
        env.step(action)
    again = pickle.loads(pickle.dumps(env))
    for action in actions[20:]:
        one, other = env.step(action), again.step(action)
        np.testing.assert_array_equal(one[0], other[0])
        np.testing.assert_equal(one[1:], other[1:])


@pytest.mark.parametrize("name", IDS)
def test_the_vector_is_bit_for_bit_the_synchronous_one(name):
    ours = gym.make_vec(name, 3, threads=2)
    theirs = gym.make_vec(name, 3, vectorization_mode="sync")
    assert isinstance(ours.unwrapped, ServoVectorEnv)
    np.testing.assert_array_equal(ours.reset(seed=2)[0], theirs.reset(seed=2)[0])
    ours.action_space.seed(3)
    for _ in range(30):
        actions = 0.3 * ours.action_space.sample()
        for one, other in zip(ours.step(actions)[:4], theirs.step(actions)[:4], strict=True):
            np.testing.assert_array_equal(one, other)
    ours.close()
    theirs.close()


def test_asynchronous_vectors_step_in_processes_of_their_own():
    envs = gym.make_vec(IDS[0], 2, vectorization_mode="async")
    sync = gym.make_vec(IDS[0], 2, vectorization_mode="sync")
    np.testing.assert_array_equal(envs.reset(seed=2)[0], sync.reset(seed=2)[0])
    actions = np.full(envs.action_space.shape, 0.1, np.float32)
    np.testing.assert_array_equal(envs.step(actions)[0], sync.step(actions)[0])
    envs.close()
    sync.close()
