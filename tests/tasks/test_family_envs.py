"""The tasks on every member of the family of linear axes."""

import gymnasium as gym
import numpy as np
import pytest

from servogym.envs import FAMILY
from servogym.envs.environment.vector_env import ServoVectorEnv
from servogym.envs.tasks.homing import HomingEnv
from servogym.envs.tasks.positioning import LinearAxisEnv


@pytest.mark.parametrize("name", FAMILY)
def test_a_careful_policy_positions_it(name):
    env = LinearAxisEnv(parameters=name)
    observation, _ = env.reset(seed=2, options={"start": 0.2, "goal": 0.22})
    for _ in range(400):
        speed = np.clip(4 * observation[:1], -0.05, 0.05)
        observation, *_, terminated, _, info = env.step(speed)
        assert not terminated, info["fault"]
    assert info["is_success"]


@pytest.mark.parametrize("name", [name for name in FAMILY if name != "vertical"])
def test_a_built_in_method_homes_it(name):
    env = HomingEnv(parameters=name, reference="negative_limit_switch")
    env.reset(seed=5, options={"start": 0.1})
    figures = env.built_in(17)
    assert figures.attained
    assert abs(figures.error) < 200e-6, "within switch scatter and backlash"


def test_where_switches_answer_comes_from_the_seed():
    def shift(seed):
        env = LinearAxisEnv(parameters="toothed_belt")
        env.reset(seed=seed)
        return env.machine.mechanics["switch_shift"].tolist()

    assert shift(1) == shift(1)
    assert shift(1) != shift(2)


def test_a_vector_of_belts_is_bit_for_bit_the_belts_one_by_one():
    make = {"parameters": "toothed_belt", "randomise": {"backlash": (0, 1e-4), "gains": (0.8, 1)}}
    peers = gym.vector.SyncVectorEnv([lambda: LinearAxisEnv(**make) for _ in range(3)])
    ours = ServoVectorEnv(LinearAxisEnv, 3, threads=2, **make)
    np.testing.assert_array_equal(peers.reset(seed=3)[0], ours.reset(seed=3)[0])
    generator = np.random.default_rng(0)
    for _ in range(30):
        actions = generator.uniform(-0.2, 0.2, (3, 1)).astype(np.float32)
        for one, other in zip(peers.step(actions)[:4], ours.step(actions)[:4], strict=True):
            np.testing.assert_array_equal(one, other)


def test_an_unknown_member_is_named():
    with pytest.raises(ValueError, match="rigid, toothed_belt, ball_screw, linear_motor, vertical"):
        LinearAxisEnv(parameters="rubber_band")


def test_a_share_of_a_range_leaves_the_other_episodes_nominal():
    """With share 0.25 as many of 400 as a binomial distribution allows, 5 standard deviations."""
    env = LinearAxisEnv(
        payload=4.0, randomise={"delay": (1.0, 3.0, 0.25), "payload": (6.0, 8.0, 0.0), "gains": 0.9}
    )
    generator = np.random.default_rng(5)
    drawn = [env.randomisation.draw(generator) for _ in range(400)]
    delays = np.array([values["delay"] for values in drawn])
    assert abs((delays > 0.0).sum() - 100) < 5 * (400 * 0.25 * 0.75) ** 0.5
    assert ((delays == 0.0) | ((delays >= 1.0) & (delays <= 3.0))).all()
    assert {(values["payload"], values["gains"]) for values in drawn} == {(4.0, 0.9)}
    assert env.machine.model.body("payload").mass[0] == 4.0
    assert env.machine.world["delay"][0] == round(delays[-1] * env.machine.physics_steps)


@pytest.mark.parametrize("given", [(1.0, 2.0, 1.5), (1.0, 2.0, 0.5, 0.5), (1.0, 2.0, "half")])
def test_a_share_that_is_none_is_named(given):
    with pytest.raises(ValueError, match=r"randomise\['delay'\] = "):
        LinearAxisEnv(randomise={"delay": given})


def test_a_delay_is_a_whole_number_of_physics_steps():
    """A cycle has a few steps of physics: 1.3 cycles are none of them, 1 and 2 are drawn."""
    with pytest.raises(ValueError, match=r"randomise\['delay'\] = 1.3: 1.3 position cycles are no"):
        LinearAxisEnv(randomise={"delay": 1.3})
    env = LinearAxisEnv(randomise={"delay": (0, 3)})
    for seed in range(9):
        said = env.randomisation.draw(np.random.default_rng(seed))["delay"]
        assert said * env.machine.physics_steps == env.machine.world["delay"][0]
