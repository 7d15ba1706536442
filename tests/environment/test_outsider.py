"""What strangers do to environments: copies of wrappers, other models beside, use after the end."""

import copy
import pickle
import threading

import gymnasium as gym
import numpy as np
import pytest

from servogym.envs.environment.vector_env import ServoVectorEnv
from servogym.envs.tasks.positioning import LinearAxisEnv
from servogym.envs.tasks.rotary import RotaryAxisEnv
from servogym.training.policies.trained.residual import ResidualVectorEnv

MADE = {
    "wrapped environment": lambda: gym.make("servogym/RotaryAxis-v0"),
    "wrapped vector": lambda: gym.wrappers.vector.RecordEpisodeStatistics(
        gym.make_vec("servogym/RotaryAxis-v0", 3)
    ),
}


def steps(env, count=5):
    action = np.full(env.action_space.shape, 0.1, np.float32)
    return [env.step(action)[0] for _ in range(count)]


@pytest.mark.parametrize("again", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])
@pytest.mark.parametrize("made", MADE)
def test_a_wrapper_is_copied_in_mid_episode_with_what_is_in_it(made, again):
    env = MADE[made]()
    env.reset(seed=1)
    steps(env)
    other = again(env)
    np.testing.assert_array_equal(steps(env), steps(other))


def test_a_snapshot_continues_alike_each_time_also_with_what_is_drawn_later():
    env = RotaryAxisEnv(randomise={"friction": (0.5, 2.0)})
    env.reset(seed=1)
    steps(env)
    snapshot, runs = env.snapshot(), []
    for other in (env, env, copy.deepcopy(env)):
        other.restore(snapshot)
        observations = steps(other)
        later, info = other.reset()
        runs.append(np.concatenate([*observations, later, [*info["parameters"].values()]]))
        assert other.np_random_seed == 1
    np.testing.assert_array_equal(runs[0], runs[1])
    np.testing.assert_array_equal(runs[0], runs[2])


@pytest.mark.parametrize("again", [copy.deepcopy, pickle.dumps])
def test_what_a_policy_remembers_is_not_copied_and_says_so(again):
    vector = ResidualVectorEnv(LinearAxisEnv, 3, residual="ruckig", bounds=[0.1], threads=2)
    vector.reset(seed=1)
    with pytest.raises(TypeError, match="cannot be copied or pickled in mid-episode"):
        again(vector)
    steps(vector)


def test_vectors_of_different_models_step_at_once_as_alone():
    vectors = [
        ServoVectorEnv(LinearAxisEnv, 4, threads=2),
        ServoVectorEnv(LinearAxisEnv, 4, threads=2, drive="kollmorgen_akd"),
        ServoVectorEnv(RotaryAxisEnv, 4, threads=2),
    ]
    alone, together = [], {}
    for vector in vectors:
        vector.reset(seed=3)
        alone.append(steps(vector, 20))
        vector.reset(seed=3)

    def run(i):
        together[i] = steps(vectors[i], 20)

    threads = [threading.Thread(target=run, args=(i,)) for i in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for i, expected in enumerate(alone):
        np.testing.assert_array_equal(together[i], expected)


def test_closing_twice_and_stepping_a_closed_one_does_no_harm():
    env, vector = LinearAxisEnv(), ServoVectorEnv(LinearAxisEnv, 4, threads=2)
    env.close()
    for each in (env, vector):
        each.reset(seed=1)
        steps(each)
        each.close()
        each.close()
        steps(each)


@pytest.mark.parametrize("wrong", [np.nan, np.inf, 2.0])
def test_an_action_that_is_none_moves_nothing_in_a_vector(wrong):
    vector = ServoVectorEnv(LinearAxisEnv, 3)
    vector.reset(seed=1)
    before = [env.machine.snapshot() for env in vector.envs]
    actions = np.full(vector.action_space.shape, 0.1)
    actions[1] = wrong
    with pytest.raises(ValueError, match="clip them"):
        vector.step(actions)
    assert [env.machine.snapshot() for env in vector.envs] == before
