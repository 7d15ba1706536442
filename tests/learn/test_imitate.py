"""Demonstrations: what is learned acts as the policy that showed it, and what is refused."""

import json

import numpy as np
import pytest
from later import Later, only_with

from servogym.envs.tasks.positioning import LinearAxisEnv
from servogym.training.policies import make

imitate = Later("servogym.training.learn.imitate")
train = Later("servogym.training.learn.train", "train")
Training = Later("servogym.training.learn.training", "Training")
pytestmark = only_with("stable_baselines3", reason="needs pip install 'servogym[train]'")
ID = "LinearAxis-v0"
SHORT = {"max_episode_steps": 50, "mode": "cst"}


def test_it_acts_as_the_policy_did_in_episodes_it_has_not_seen(tmp_path, monkeypatch):
    monkeypatch.setattr(imitate, "UPDATES", 500)
    train(Training(ID, out=tmp_path, steps=3200, envs=16, arguments=SHORT, demonstrate="pd"))
    about = json.loads((tmp_path / "best" / "checkpoint.json").read_text(encoding="utf-8"))
    assert about["demonstrate"] == "pd"
    env = LinearAxisEnv(mode="cst")
    own, shown = make(str(tmp_path), env), make("pd", env)
    off, size = [], []
    for seed in range(5):
        seen, info = env.reset(seed=seed)
        own.reset(seen, info)
        shown.reset(seen, info)
        for _ in range(50):
            one, other = own.act(seen), shown.act(seen)
            off.append(one - other)
            size.append(other)
            seen, *_ = env.step(one)
    assert np.std(off) < 0.4 * np.std(size)
    with pytest.raises(ValueError, match="in one go: --start"):
        train(Training(ID, out=tmp_path, steps=6400, resume=True))


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["--demonstrate", "plc"], "plc"),
        (["--demonstrate", "bound"], "gives no actions"),
        (["--demonstrate", "hold", "--algorithm", "SAC"], "leave out"),
        (["--demonstrate", "hold", "--residual", "hold", "--bounds", "0.1"], "leave out"),
    ],
)
def test_what_cannot_be_demonstrated_is_told_in_a_line(tmp_path, refused, options, says):
    assert says in refused(["train", ID, *options, "--steps", "64", "--out", str(tmp_path / "run")])
    assert not (tmp_path / "run" / "best").exists()
