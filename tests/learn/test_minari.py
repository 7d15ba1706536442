"""A task under a policy, recorded into a dataset of Minari: the page's own lines, read again."""

import re
import subprocess
import sys
from pathlib import Path

import gymnasium as gym
import pytest
from later import Later

from servogym.training.policies import make

minari = Later("minari")
PAGE = Path(__file__).parents[2] / "docs" / "how-to" / "offline.md"
ID = "servogym.envs:servogym/LinearAxisTracking-v0"
DATASET = "servogym/tracking/feed_forward-v0"


@pytest.fixture
def recorded(tmp_path, monkeypatch):
    pytest.importorskip("minari", reason="needs pip install 'minari[create,hdf5]'")
    pytest.importorskip("h5py", reason="needs pip install 'minari[create,hdf5]'")
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    code = re.search(r":caption: record\.py\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.S)[1]
    (tmp_path / "record.py").write_text(code.replace("range(100)", "range(3)"), encoding="utf-8")
    subprocess.run([sys.executable, tmp_path / "record.py"], check=True, timeout=300)
    return minari.load_dataset(DATASET)


@pytest.mark.filterwarnings("ignore")
def test_an_episode_played_again_from_its_seed_is_what_was_recorded(recorded):
    """The oracle is the environment itself: same seed, recorded actions, same bits."""
    assert recorded.total_episodes == 3
    env = gym.make(ID)
    policy = make("feed_forward", env.unwrapped)
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
