"""servogym/RotaryAxis-v0: over the ends of 607Bh, the shorter way; the oracle is MuJoCo's angle."""

import math

import numpy as np
import pytest

from servogym.envs.plants.rotary_parameters import ROTARY_FAMILY
from servogym.envs.tasks.rotary import RotaryAxisEnv
from servogym.training import cli
from servogym.training.evaluate.episodes import Evaluator
from servogym.training.policies import make


def shorter(way, period):
    return math.remainder(way, period)


def angle(env):
    """Of the table, by MuJoCo, counted on over the turns (rad)."""
    return float(env.machine.data.qpos.sum())


@pytest.mark.parametrize("mechanics", ROTARY_FAMILY)
@pytest.mark.parametrize(("start", "goal"), [(0.1, 0.95), (0.95, 0.1), (0.2, 0.6), (0.6, 0.2)])
def test_ruckig_takes_the_shorter_way_over_the_end_of_the_range(mechanics, start, goal):
    env = RotaryAxisEnv(mechanics=mechanics)
    period = ROTARY_FAMILY[mechanics].period
    policy = make("ruckig", env)
    options = {"start": start * period, "goal": goal * period}
    observation, info = env.reset(seed=1, options=options)
    begin = angle(env)
    policy.reset(observation, info)
    settled = False
    for _ in range(env.STEPS):
        observation, _, terminated, _, info = env.step(policy.act(observation))
        assert not terminated, info["fault"]
        settled = info["is_success"]
    assert settled
    way = shorter((goal - start) * period, period)
    assert angle(env) - begin == pytest.approx(way, abs=3 * env.tolerance + 6e-4)
    assert abs(info["distance"]) <= env.tolerance


@pytest.mark.parametrize("action", [1.0, -1.0])
def test_a_set_point_goes_on_over_many_turns_without_a_step(action):
    env = RotaryAxisEnv()
    env.reset(seed=1, options={"start": 0.1, "goal": 3.0})
    begin, speeds = angle(env), []
    target = np.full(1, 0.5 * action)
    for _ in range(900):
        _, _, terminated, _, info = env.step(target)
        assert not terminated, info["fault"]
        speeds.append(float(env.machine.data.qvel[0]))
    turned = (angle(env) - begin) * action
    assert turned > 2 * env.datasheet.period
    fast = np.array(speeds[100:]) * action
    full = 0.5 * env.drive.read("max_profile_velocity") / env.units
    assert fast.min() > 0.97 * full
    assert fast.max() < 1.03 * full
    shown = env.drive.read("position_actual_value") / env.units
    assert 0.0 <= shown <= env.datasheet.period
    assert shorter(shown - angle(env), 2 * math.pi) == pytest.approx(0.0, abs=2e-3)


def test_what_is_seen_of_the_position_is_the_same_a_turn_later():
    env = RotaryAxisEnv()
    seen = []
    for start in (0.0, 2 * math.pi):
        observation, _ = env.reset(seed=1, options={"start": start, "goal": 1.0})
        seen.append(observation)
    np.testing.assert_allclose(seen[0], seen[1], atol=1e-4)
    assert env.named(seen[0]).distance == pytest.approx(1.0 / math.pi, abs=1e-4)


def test_the_reference_is_better_than_the_profile_and_that_better_than_holding():
    evaluator = Evaluator("RotaryAxis-v0", episodes=6)
    returns = [
        np.mean(evaluator.run(name).values["episode_return"])
        for name in ("hold", "trapezoid", "ruckig")
    ]
    assert returns == sorted(returns)
    assert returns[2] > 1.5 * returns[0]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"mechanics": "moon"}, "mechanics = 'moon', use one of rotary_table, conveyor"),
        ({"tolerance": 0.0}, "tolerance = 0.0 is out of range"),
        ({"drive": "festo_cmmp_as"}, "has no mode cyclic_sync_position"),
    ],
)
def test_wrong_arguments_are_named(arguments, words):
    with pytest.raises(ValueError, match=words):
        RotaryAxisEnv(**arguments)


def test_watch_records_it(tmp_path, gl):
    out = tmp_path / "run"
    arguments = ["watch", "RotaryAxis-v0", "--policy", "trapezoid", "--record", str(out)]
    assert cli.main([*arguments, "--speed", "20"]) == 0
    assert sorted(out.iterdir())


def test_the_following_error_is_told_in_radians():
    """Table, picture and drive agree; a position unit is a thousandth of a degree."""
    evaluator = Evaluator("RotaryAxis-v0", episodes=1)
    result = evaluator.run("ruckig")
    labels = [channel.label.replace("\n", " ") for channel in result.trace.channels]
    shown = result.trace.samples[:, labels.index("following error (µrad)"), 0]
    peak = result.values["peak_error"][0]
    assert np.abs(shown).max() == pytest.approx(peak, rel=1e-6)
    assert evaluator.metrics["peak_error"].heading == "peak following error (µrad)"
    unit = 1.0 / evaluator.env.units
    assert peak / (1e6 * unit) == pytest.approx(round(peak / (1e6 * unit)), abs=1e-6)
    assert peak > 1000
