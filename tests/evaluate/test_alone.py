"""An episode depends on its seed alone: not on those before it, beside it, or on who plays it."""

import numpy as np
import pytest

from servogym.envs.environment.registry import task
from servogym.training.evaluate.episodes import Evaluator
from servogym.training.policies.datasheet import datasheet

DRAWN = {"gains": (0.6, 1.5), "friction": (0.5, 2.0)}
CASES = [  # one a law, and those that ask the data sheet most
    "LinearAxis-v0 ruckig", "LinearAxisTracking-v0 adaptive_feed_forward",
    "CompliantAxis-v0 adaptive_lqr", "GantryContour-v0 full_feed", "GantrySync-v0 squaring",
    "Homing-v0 search",
]
ALL = [
    f"{name} {policy}"
    for name in ("LinearAxis-v0", "LinearAxisTracking-v0", "CompliantAxis-v0", "GantryContour-v0",
                 "GantrySync-v0", "GantrySway-v0", "Homing-v0", "Commissioning-v0")
    for policy in ("learned", *task(name).POLICIES) if policy != "bound"
]


def played(evaluator, policy, seeds):
    """By metric, shape ``(trainings, episodes)``."""
    evaluator.seeds = list(seeds)
    values = evaluator.run(policy).values
    return {name: array.reshape(-1, len(seeds)) for name, array in values.items()}


def alone(case):
    name, policy = case.split()
    ranges = dict(task(name)().randomisation.ranges) | DRAWN
    two = Evaluator(name, seeds=[11, 12], randomise=ranges)
    first = played(two, policy, [11, 12])
    turned = played(two, policy, [12, 11])  # after others, and in the other row
    by_itself = played(Evaluator(name, seeds=[12], randomise=ranges), policy, [12])
    for metric, values in first.items():
        np.testing.assert_array_equal(values[:, ::-1], turned[metric], metric)
        np.testing.assert_array_equal(values[:, 1:], by_itself[metric], metric)


@pytest.mark.parametrize("case", CASES)
def test_an_episode_depends_on_its_seed_alone(case):
    alone(case)


@pytest.mark.slow
@pytest.mark.parametrize("case", sorted({*ALL} - {*CASES}))
def test_an_episode_of_any_policy_depends_on_its_seed_alone(case):
    try:
        alone(case)
    except ValueError as error:
        pytest.skip(f"it does not fit: {error}")


@pytest.mark.parametrize("name", ["LinearAxis-v0", "GantryContour-v0"])
def test_the_data_sheet_says_what_was_built_and_an_informed_law_what_was_drawn(name):
    env = task(name)(randomise={"gains": 0.6})
    built = datasheet(env)
    env.reset(seed=1)
    assert datasheet(env) == built
    told = datasheet(env, env.parameters).axes[0].lag
    assert told == pytest.approx(built.axes[0].lag / 0.6)
