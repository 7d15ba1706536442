"""Weights as arrays: the actions of the network, and no code in the file."""

import pickle
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from later import Later, only_with

from servogym.envs.tasks.compliant import CompliantAxisEnv
from servogym.training.policies import SHIPPED
from servogym.training.policies.trained import saved, weights, zipped
from servogym.training.policies.trained.learned import Learned

stable_baselines3 = Later("stable_baselines3")
PPO = Later("stable_baselines3", "PPO")
VecNormalize = Later("stable_baselines3.common.vec_env", "VecNormalize")
checkpoint = Later("servogym.training.learn.checkpoint")
sb3 = Later("servogym.training.learn.sb3")
pytestmark = only_with("stable_baselines3")
FOLDERS = sorted(SHIPPED.glob("*/seed_*"))
GOLDEN = Path(__file__).parent / "learned_actions.npz"  # as played from SB3's own files
ABOUT = {
    "env_id": CompliantAxisEnv.ID, "algorithm": "PPO", "hyperparameters": {}, "arguments": {},
}


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """A network, and the checkpoint of it."""
    folder = tmp_path_factory.mktemp("run") / "checkpoint"
    env = VecNormalize(sb3.make("CompliantAxis-v0", 2))
    model = PPO("MlpPolicy", env, n_steps=16, batch_size=16, device="cpu", seed=1)
    model.learn(64)
    checkpoint.save(model, ABOUT, folder)
    return model, folder


@pytest.mark.parametrize("algorithm", ["PPO", "A2C", "SAC", "TD3"])
def test_the_actions_are_those_of_the_algorithm(trained, tmp_path, algorithm):
    model, folder = trained
    if algorithm != "PPO":
        model = getattr(stable_baselines3, algorithm)("MlpPolicy", model.get_env(), seed=1)
        folder = tmp_path / "checkpoint"
        checkpoint.save(model, ABOUT | {"algorithm": algorithm}, folder, resumable=False)
    policy = Learned(folder, CompliantAxisEnv())
    generator = np.random.default_rng(1)
    for _ in range(100):
        seen = generator.uniform(-1, 1, model.observation_space.shape).astype(np.float32)
        normal = model.get_vec_normalize_env().normalize_obs(seen)
        expected, _ = model.predict(normal, deterministic=True)
        assert policy.act(seen) == pytest.approx(expected, abs=1e-6)


def test_what_comes_with_the_laboratory_acts_without_torch():
    code = """
from servogym.training.policies import SHIPPED
from servogym.training.policies.trained import learned
from servogym.envs.tasks.compliant import CompliantAxisEnv
env = CompliantAxisEnv()
seen, info = env.reset(seed=1)
policy = learned.Learned(SHIPPED / "CompliantAxis-v0" / "seed_1", env)
policy.reset(seen, info)
policy.act(seen)
import sys
assert not {"torch", "stable_baselines3", "matplotlib.axes"} & set(sys.modules)
"""
    subprocess.run([sys.executable, "-c", code], check=True, timeout=120)


@pytest.mark.parametrize("folder", FOLDERS, ids=lambda path: f"{path.parent.name}/{path.name}")
def test_what_comes_with_the_laboratory_acts_as_it_was_trained(folder):
    found = weights.load(folder)
    act = found.actor(saved.read(folder))
    with np.load(GOLDEN) as golden:
        name = f"{folder.parent.name}/{folder.name}"
        for seen, action in zip(golden[f"{name}/seen"], golden[f"{name}/actions"], strict=True):
            assert act(seen) == pytest.approx(action, abs=1e-6)


def test_nothing_that_is_unpickled_comes_with_the_laboratory():
    assert not [*SHIPPED.rglob("*.pkl"), *SHIPPED.rglob("*.zip"), *SHIPPED.rglob("*.pth")]


class Payload:
    def __reduce__(self):
        return Path.touch, (Path("ran.txt"),)


@pytest.mark.parametrize("name", ["vecnormalize.pkl", "model.zip", "weights.npz"])
def test_a_folder_with_a_program_in_it_runs_nothing(trained, tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    folder = tmp_path / "checkpoint"
    shutil.copytree(trained[1], folder)
    (folder / name).write_bytes(pickle.dumps(Payload()))
    if name == "weights.npz":
        with pytest.raises(ValueError, match="holds no arrays"):
            Learned(folder, CompliantAxisEnv())
    else:
        Learned(folder, CompliantAxisEnv())
    assert not Path("ran.txt").exists()


def test_an_array_of_objects_is_refused(trained, tmp_path):
    np.savez(tmp_path / "weights.npz", shape=np.array([Payload()], object))
    with pytest.raises(ValueError, match="holds no arrays"):
        weights.load(tmp_path)


def test_arrays_that_do_not_fit_are_refused(trained, tmp_path):
    found = weights.load(trained[1])
    with pytest.raises(ValueError, match="does not fit the network"):
        found._replace(network={}).policy(saved.read(trained[1]))
    with pytest.raises(ValueError, match="does not fit the network"):
        found._replace(shape=(3, 1)).actor(saved.read(trained[1]))


def test_an_older_checkpoint_is_played_from_its_zip_without_its_pickles(trained, tmp_path):
    folder = tmp_path / "checkpoint"
    shutil.copytree(trained[1], folder)
    expected = weights.load(folder)
    (folder / weights.WEIGHTS).unlink()
    trained[0].save(folder / "model.zip")
    trained[0].get_vec_normalize_env().save(str(folder / "vecnormalize.pkl"))
    again = zipped.of(folder)
    assert again.network.keys() == expected.network.keys()
    assert all(np.array_equal(again.network[n], expected.network[n]) for n in again.network)
    assert np.array_equal(again.mean, expected.mean)
    assert np.array_equal(again.variance, expected.variance)
    assert again.limits == expected.limits
    Learned(folder, CompliantAxisEnv())
