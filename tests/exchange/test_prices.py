"""Torque and jerk may be priced in the reward of every task."""

import numpy as np
import pytest

from servogym.envs import TASKS
from servogym.envs.environment.vector_env import ServoVectorEnv
from servogym.envs.tasks.positioning import LinearAxisEnv

PRICES = {"torque": 0.5, "jerk": 2.0}


def torque(env):
    return 1e-3 * env._part.tpdos["torque_actual_value"][0].astype(float)


@pytest.mark.parametrize("task", TASKS, ids=lambda task: task.ID)
def test_a_price_is_taken_off_and_nothing_else_changes(task):
    plain, priced = task(), task(prices=PRICES)
    plain.action_space.seed(1)
    one, _ = plain.reset(seed=1)
    other, _ = priced.reset(seed=1)
    for _ in range(4):
        action, before = plain.action_space.sample(), torque(priced)
        one, full, *_ = plain.step(action)
        other, reward, *_ = priced.step(action)
        now = torque(priced)
        cost = 0.5 * np.mean(now**2) + 2.0 * np.mean((now - before) ** 2)
        assert reward == pytest.approx(full - cost, abs=1e-12)
        np.testing.assert_array_equal(one, other)


def test_a_vector_charges_as_one_environment_does_and_not_for_a_reset():
    vector = ServoVectorEnv(LinearAxisEnv, 2, prices=PRICES, max_episode_steps=2)
    alone = LinearAxisEnv(prices=PRICES)
    vector.reset(seed=[5, 6])
    alone.reset(seed=6)
    actions = np.ones((2, 1))
    for _ in range(2):
        _, rewards, *_ = vector.step(actions)
        assert rewards[1] == alone.step(actions[1])[1]
    assert (vector.step(actions)[1] == 0.0).all(), "the step that resets"


@pytest.mark.parametrize(
    ("prices", "says"),
    [
        ({"torqe": 1.0}, "there is none of 'torqe': did you mean torque"),
        ({"jerk": -1.0}, "prices\\['jerk'\\] = -1.0 .*is out of range"),
        (0.1, "prices = 0.1: give values by name"),
    ],
)
def test_a_wrong_price_is_told(prices, says):
    with pytest.raises(ValueError, match=says):
        LinearAxisEnv(prices=prices)
