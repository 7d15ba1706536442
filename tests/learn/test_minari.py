"""A task under a policy, recorded into a dataset of Minari: the page's own lines, read again."""

import os
import re
import subprocess
import sys
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from later import Later

from servogym.training.policies import make

minari = Later("minari")
PAGE = Path(__file__).parents[2] / "docs" / "how-to" / "offline.md"
ID = "servogym.envs:servogym/LinearAxisTracking-v0"
DATASET = "servogym/tracking/basis-v0"


def run(folder, name, change):
    """Run a program of the page, with less to do."""
    code = re.search(rf":caption: {name}\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.S)[1]
    assert change[0] in code
    (folder / name).write_text(code.replace(*change), encoding="utf-8")
    own = os.environ | {"OMP_NUM_THREADS": "1"}  # beside other tests
    subprocess.run([sys.executable, folder / name], check=True, timeout=300, env=own)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    pytest.importorskip("minari", reason="needs pip install 'minari[create,hdf5]'")
    pytest.importorskip("h5py", reason="needs pip install 'minari[create,hdf5]'")
    folder = tmp_path_factory.mktemp("recorded")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("MINARI_DATASETS_PATH", str(folder))
        run(folder, "record.py", ("range(100)", "range(3)"))
        yield minari.load_dataset(DATASET)


@pytest.mark.filterwarnings("ignore")
def test_an_episode_played_again_from_its_seed_is_what_was_recorded(recorded):
    """The oracle is the environment itself: same seed, recorded actions, same bits."""
    assert recorded.total_episodes == 3
    env = gym.make(ID)
    policy = make("basis_feed_forward", env.unwrapped)
    for episode in recorded.iterate_episodes():
        seen, info = env.reset(seed=int(episode.id))
        policy.reset(seen, info)
        for step, action in enumerate(episode.actions):
            assert seen.tobytes() == episode.observations[step].tobytes()
            assert policy.act(seen).tobytes() == action.tobytes()
            seen, reward, *_ = env.step(action)
            assert reward == episode.rewards[step]
        assert seen.tobytes() == episode.observations[-1].tobytes()
        assert episode.truncations[-1]


@pytest.mark.filterwarnings("ignore")
def test_what_was_drawn_is_kept_apart_from_what_is_observed(recorded):
    """A learner is not told; who judges it can look it up."""
    for episode in recorded.storage.get_episode_metadata(range(3)):
        assert 1.0 <= episode["payload"] <= 10.0
        assert 0.5 <= episode["friction"] <= 2.0
    episode = next(iter(recorded.iterate_episodes()))
    assert not {"payload", "friction", "parameters"} & {*(episode.infos or {})}


@pytest.mark.filterwarnings("ignore")
def test_the_clone_acts_as_was_recorded_and_plays_as_any_policy(recorded, tmp_path):
    """Of the recorded actions it explains most, and more than their mean does: nothing."""
    pytest.importorskip("torch", reason="needs pip install 'servogym[train]'")
    run(tmp_path, "clone.py", ("128, 6000", "32, 800"))
    env = gym.make(ID)
    policy = make(f"{tmp_path / 'clone.py'}:Cloned", env.unwrapped)
    wanted, given = [], []
    for episode in recorded.iterate_episodes():
        policy.reset(episode.observations[0], {})
        given += [policy.act(seen) for seen in episode.observations[:-1]]
        wanted += [*episode.actions]
    wanted, given = np.array(wanted), np.array(given)
    left = ((given - wanted) ** 2).sum(axis=0) / ((wanted - wanted.mean(axis=0)) ** 2).sum(axis=0)
    assert (left < 0.3).all()
    seen, info = env.reset(seed=1)
    policy.reset(seen, info)
    assert env.action_space.contains(policy.act(seen))
