"""Residual learning: bounded corrections of a policy, through every door."""

import json

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode
from later import Later, only_with

from servogym.envs.environment.registry import task
from servogym.envs.environment.vector_env import ServoVectorEnv
from servogym.training.evaluate import comparison
from servogym.training.policies import make
from servogym.training.policies.trained.residual import ResidualVectorEnv, corrected

sb3 = Later("servogym.training.learn.sb3")
train = Later("servogym.training.learn.train", "train")
Training = Later("servogym.training.learn.training", "Training")
pytestmark = only_with("stable_baselines3", reason="needs pip install 'servogym[train]'")
ID = "LinearAxisTracking-v0"
BOUNDS = [0.05, 0.02]
SMALL = {"n_steps": 16, "batch_size": 64, "n_epochs": 1, "policy_kwargs": {"net_arch": [8]}}


def residual(n, mode="SameStep", **arguments):
    kind = task(ID)
    return ResidualVectorEnv(
        kind, n, residual="feed_forward", bounds=BOUNDS, autoreset_mode=mode, **arguments
    )


@pytest.mark.parametrize("mode", ["SameStep", "NextStep", "Disabled"])
def test_a_correction_of_0_is_the_baseline_bit_for_bit(mode):
    """Over the ends of episodes, as each autoreset has it."""
    steps, n = 30, 3
    env = residual(n, mode, max_episode_steps=12)
    plain = ServoVectorEnv(task(ID), n, autoreset_mode=mode, max_episode_steps=12)
    seen, _ = plain.reset(seed=3)
    assert env.reset(seed=3)[0].tobytes() == seen.tobytes()
    policies = [make("feed_forward", one) for one in plain.envs]
    fresh = [True] * n
    for _ in range(steps):
        for i, policy in enumerate(policies):
            if fresh[i]:
                policy.reset(seen[i], {})
        actions = np.array([p.act(row) for p, row in zip(policies, seen, strict=True)])
        here, there = env.step(np.zeros((n, 2))), plain.step(actions)
        for a, b in zip(here[:4], there[:4], strict=True):
            assert a.tobytes() == b.tobytes()
        seen, ended = there[0], there[2] | there[3]
        fresh = ended.tolist() if mode == "SameStep" else [False] * n
        if mode == "NextStep" and ended.any():  # the next step resets and takes no action
            zeros, fresh = np.zeros((n, 2)), [True] * n
            seen = plain.step(zeros)[0]
            assert env.step(zeros)[0].tobytes() == seen.tobytes()
        if mode == "Disabled" and ended.any():
            options, fresh = {"reset_mask": np.ones(n, bool)}, [True] * n
            seen, _ = plain.reset(options=options)
            assert env.reset(options=options)[0].tobytes() == seen.tobytes()


def test_a_correction_is_bounded_and_clipped():
    base = np.array([0.5, -0.999], np.float32)
    bounds = np.array(BOUNDS, np.float32)
    assert corrected(base, bounds, [1.0, -1.0]).tolist() == pytest.approx([0.55, -1.0])
    assert corrected(base, bounds, [0.0, 0.0]).tobytes() == base.tobytes()
    env = residual(1, "Disabled")
    env.reset(seed=1)
    base = env._bases[0].copy()
    env.step(np.ones((1, 2)))
    assert env._batch.actions[0] == pytest.approx(base + bounds)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    out = tmp_path_factory.mktemp("residual")
    train(Training(
        ID, out=out, steps=256, envs=8, residual="feed_forward", bounds=BOUNDS, settings=SMALL,
        arguments={"max_episode_steps": 10, "previous_action": True}, checkpoint_every=128,
        evaluate_every=128,
    ))
    return out


def test_a_trained_correction_brings_its_baseline_along(made):
    about = json.loads((made / "best" / "checkpoint.json").read_text(encoding="utf-8"))
    assert (about["residual"], about["bounds"]) == ("feed_forward", BOUNDS)
    assert about["cpu_seconds"] > 0.0
    for shown in (True, False):
        env = task(ID)(previous_action=shown)
        policy, plain = make(str(made), env), make("feed_forward", env)
        seen, info = env.reset(seed=1)
        policy.reset(seen, info)
        plain.reset(seen, info)
        apart = []
        for _ in range(20):
            action = policy.act(seen)
            apart.append(np.abs(action - plain.act(seen)))
            seen, *_ = env.step(action)
        assert (np.array(apart) <= np.array(BOUNDS) + 1e-6).all()
        assert np.any(apart)


def test_it_is_evaluated_as_it_was_trained(made):
    """Through the door of policies, and as corrections in the vector it was trained in."""
    learned, base = comparison.evaluate(ID, [str(made), "feed_forward"], "generic", 2, 0)
    policy = make(str(made), task(ID)())
    inner = policy._actor
    env = residual(2, "Disabled", previous_action=True)
    seen, _ = env.reset(seed=learned.seeds)
    total = np.zeros(2)
    for _ in range(400):
        actions = [inner(row) for row in seen]
        seen, rewards, *_ = env.step(np.array(actions))
        total += rewards
    assert total == pytest.approx(learned.values["episode_return"], rel=1e-6)
    assert (total != base.values["episode_return"]).all()


def test_a_run_goes_on_with_its_residual(made, tmp_path):
    with pytest.raises(ValueError, match="has residual = 'feed_forward', asked for is 'hold'"):
        train(Training(ID, out=made, resume=True, residual="hold", bounds=BOUNDS))
    train(Training(ID, out=made, resume=True, steps=384))
    latest = sorted((made / "checkpoints").iterdir())[-1]
    about = json.loads((latest / "checkpoint.json").read_text(encoding="utf-8"))
    assert about["residual"] == "feed_forward"
    assert about["steps"] == 384


def test_sb3_corrects_with_the_same_arguments():
    env = sb3.make(ID, 2, residual="feed_forward", bounds=BOUNDS)
    env.seed(4)
    other = residual(2, AutoresetMode.SAME_STEP)
    assert env.reset().tobytes() == other.reset(seed=4)[0].tobytes()
    actions = np.full((2, 2), 0.3, np.float32)
    assert env.step(actions)[0].tobytes() == other.step(actions)[0].tobytes()
    with pytest.raises(ValueError, match="belong together"):
        sb3.make(ID, 2, residual="feed_forward")


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ("--residual feed_forward --bounds 0.1", "1 given, servogym/LinearAxisTracking-v0 has 2 "
         "actions: correction, torque"),
        ("--residual feed_forward --bounds 0.1,2", "each is a share of an action, 0..1"),
        ("--residual feed_forward --bounds 0.1,nan", "--bounds: 'nan' is not a finite number"),
        ("--residual feed_forward", "belong together"),
        ("--bounds 0.1,0.1", "belong together"),
        ("--residual lqr --bounds 0.1,0.1", "policy 'lqr' is for"),
        ("--residual nobody --bounds 0.1,0.1", "'nobody', which is not a registered policy"),
    ],
)
def test_a_residual_that_does_not_fit_is_one_line(arguments, says, tmp_path, refused):
    assert says in refused(["train", ID, *arguments.split(), "--out", str(tmp_path / "run")])


def test_what_runs_in_the_drive_cannot_be_corrected():
    with pytest.raises(ValueError, match="gives no actions"):
        sb3.make("Homing-v0", 1, residual="built_in", bounds=[0.1] * 3)
