"""A training that begins with the weights of another one: what is carried over, what is refused."""

import json

import pytest
from later import Later, only_with

from servogym.training import cli
from servogym.training.policies.trained import weights

train = Later("servogym.training.learn.train", "train")
Training = Later("servogym.training.learn.training", "Training")
pytestmark = only_with("stable_baselines3", reason="needs pip install 'servogym[train]'")
ID, BASE = "LinearAxisTracking-v0", "feed_forward"
SMALL = {"n_steps": 16, "batch_size": 64, "n_epochs": 1, "policy_kwargs": {"net_arch": [8]}}
SHORT = {"max_episode_steps": 10, "history": 2}
EVERY = {"checkpoint_every": 128, "evaluate_every": 128}


@pytest.fixture(scope="module")
def first(tmp_path_factory):
    out = tmp_path_factory.mktemp("first")
    train(Training(
        ID, out=out, steps=128, envs=8, residual=BASE, bounds=[0.05, 0.02],
        arguments=SHORT, settings=SMALL, **EVERY,
    ))
    return out


def test_it_begins_with_these_weights_and_what_is_not_given_is_as_it_was(first, tmp_path):
    """With a rate of learning of 0 they stay."""
    train(Training(
        ID, out=tmp_path, steps=128, start=first, settings={"learning_rate": 0.0},
        arguments={"randomise": {"delay": [0, 1, 0.5]}}, residual="leading_feed_forward", **EVERY,
    ))
    before, after = weights.load(first / "best"), weights.load(tmp_path / "best")
    for name, array in before.network.items():
        assert array.tobytes() == after.network[name].tobytes()
    about = json.loads((tmp_path / "best" / "checkpoint.json").read_text(encoding="utf-8"))
    assert (about["bounds"], about["envs"]) == ([0.05, 0.02], 8)
    assert (about["residual"], about["start"]["residual"]) == ("leading_feed_forward", BASE)
    assert about["arguments"] == SHORT | {"randomise": {"delay": [0, 1, 0.5]}}
    assert about["hyperparameters"]["n_steps"] == SMALL["n_steps"]
    assert about["start"]["arguments"] == SHORT
    assert about["start"]["cpu_seconds"] > 0.0
    train(Training(ID, out=tmp_path, resume=True, steps=256))
    latest = tmp_path / "checkpoints" / "0000000256" / "checkpoint.json"
    assert json.loads(latest.read_text(encoding="utf-8"))["start"] == about["start"]


def test_the_number_of_environments_is_a_setting_here_too(first, tmp_path):
    for name, given in (("a", {"settings": {"n_envs": 4}}), ("b", {"envs": 4})):
        train(Training(ID, out=tmp_path / name, steps=128, start=first, **given, **EVERY))
        about = json.loads((tmp_path / name / "best" / "checkpoint.json").read_text("utf-8"))
        assert about["envs"] == 4
        assert "n_envs" not in about["hyperparameters"]


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["LinearAxis-v0"], "has env_id = 'servogym/LinearAxisTracking-v0', asked for is"),
        ([ID, "--bounds", "0.1,0.1"], "has bounds = [0.05, 0.02], asked for is [0.1, 0.1]"),
        ([ID, "--argument", "history=3"], "history and previous_action have to be those"),
        ([ID, "--setting", 'policy_kwargs={"net_arch": [9]}'], "are of another network"),
        ([ID, "--setting", "rate"], "is not NAME=VALUE"),
        ([ID, "--setting", "n_envs=0"], "n_envs = 0 must be a whole number 1..100000"),
    ],
)
def test_a_start_that_does_not_fit_is_told(first, tmp_path, capsys, options, says):
    out = tmp_path / "run"
    try:
        status = cli.main(["train", *options, "--start", str(first), "--out", str(out)])
    except SystemExit as end:  # of argparse
        status = end.code
    assert status == 2
    assert says in capsys.readouterr().err
    assert not out.exists()


def test_a_start_that_is_none_says_so(tmp_path):
    with pytest.raises(ValueError, match="is not a checkpoint and has no best/"):
        train(Training(ID, out=tmp_path / "run", start=tmp_path))
