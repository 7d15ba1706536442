"""`model.zip` as stable-baselines3 saves it: its own actions, and none of its pickles."""

import base64
import contextlib
import io
import json
import pickle
import shutil
import warnings
import zipfile
from pathlib import Path

import numpy as np
import pytest
from later import Later, only_with

from servogym.envs.tasks.positioning import LinearAxisEnv
from servogym.training import cli
from servogym.training.policies import make

library = Later("stable_baselines3")
torch = Later("torch")
sb3 = Later("servogym.training.learn.sb3")
VecNormalize = Later("stable_baselines3.common.vec_env", "VecNormalize")
pytestmark = only_with("stable_baselines3", reason="needs pip install 'servogym[train]'")

CASES = {
    "PPO": {}, "A2C": {}, "SAC": {}, "TD3": {}, "DDPG": {},
    "PPO ReLU": {"policy_kwargs": lambda: {"activation_fn": torch.nn.ReLU, "net_arch": [8]}},
    "SAC Tanh": {"policy_kwargs": lambda: {"activation_fn": torch.nn.Tanh, "net_arch": [9, 7]}},
    "PPO use_sde": {"use_sde": True},
    "PPO deep": {"policy_kwargs": lambda: {"net_arch": {"pi": [8, 8, 8], "vf": [4]}}},
    "PPO flat": {"policy_kwargs": lambda: {"net_arch": []}},
}


def saved(folder, name, settings, *, normalised=False):
    """-> the model, which has learned a little, and its file."""
    env = sb3.make("LinearAxis-v0", 2)
    if normalised:
        env = VecNormalize(env)
    given = {key: value() if callable(value) else value for key, value in settings.items()}
    kind = getattr(library, name.partition(" ")[0])
    few = {"n_steps": 16} if name.startswith(("PPO", "A2C")) else {"learning_starts": 8}
    few |= {"batch_size": 16} if not name.startswith("A2C") else {}
    model = kind("MlpPolicy", env, device="cpu", seed=1, **few, **given)
    model.learn(64)
    folder.mkdir(exist_ok=True)
    model.save(folder / "model.zip")
    if normalised:
        env.save(str(folder / "vecnormalize.pkl"))
    return model, folder / "model.zip"


@pytest.fixture(scope="module")
def one(tmp_path_factory):
    return saved(tmp_path_factory.mktemp("zipped"), "PPO", {}, normalised=True)


@pytest.mark.parametrize("name", CASES)
def test_the_actions_are_those_of_the_library(name, tmp_path):
    model, file = saved(tmp_path, name, CASES[name])
    policy = make(str(file), LinearAxisEnv())
    generator = np.random.default_rng(1)
    for _ in range(50):
        seen = generator.uniform(-1, 1, model.observation_space.shape).astype(np.float32)
        expected, _ = model.predict(seen, deterministic=True)
        assert policy.act(seen) == pytest.approx(expected, abs=2e-6)


def test_its_running_means_lie_beside_it(one):
    model, file = one
    policy = make(str(file), LinearAxisEnv())
    generator = np.random.default_rng(2)
    for _ in range(50):
        seen = generator.uniform(-1, 1, model.observation_space.shape).astype(np.float32)
        normal = model.get_vec_normalize_env().normalize_obs(seen)
        expected, _ = model.predict(normal, deterministic=True)
        assert policy.act(seen) == pytest.approx(expected, abs=2e-6)


def test_every_command_takes_it(one, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    words = ["compare", "LinearAxis-v0", "--policies", f"hold,{one[1]}", "--episodes", "2"]
    assert cli.main([*words, "--out", "out"]) == 0
    assert cli.main(["eval", "Homing-v0", "--policy", str(one[1])]) == 2
    assert "this environment shows" in capsys.readouterr().err


class Payload:
    def __reduce__(self):
        return Path.touch, (Path("ran.txt"),)


def changed(file, **parts):
    with zipfile.ZipFile(file) as packed:
        kept = {name: packed.read(name) for name in packed.namelist()}
    with zipfile.ZipFile(file, "w") as packed:
        for name, data in (kept | parts).items():
            packed.writestr(name, data)


def poisoned(data):
    """Every pickle in the settings is a program."""
    found = json.loads(data)
    evil = base64.b64encode(pickle.dumps(Payload())).decode()

    def walk(value):
        if isinstance(value, dict):
            return {k: evil if k == ":serialized:" else walk(v) for k, v in value.items()}
        return value

    return json.dumps(walk(found)).encode()


def tensors_of_a_program():
    file = io.BytesIO()
    torch.save({"action_net.weight": Payload()}, file)
    return file.getvalue()


@pytest.fixture
def copied(one, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for file in one[1].parent.iterdir():
        shutil.copy(file, tmp_path)
    return tmp_path / "model.zip"


def test_the_pickles_of_its_settings_are_not_looked_at(copied):
    """Oracle: the library's own loader runs them."""
    with zipfile.ZipFile(copied) as packed:
        data = poisoned(packed.read("data"))
    changed(copied, data=data)
    make(str(copied), LinearAxisEnv())
    assert not Path("ran.txt").exists()
    with warnings.catch_warnings(), contextlib.suppress(Exception):
        warnings.simplefilter("ignore")
        library.PPO.load(copied)
    assert Path("ran.txt").exists()


@pytest.mark.parametrize("protocol", range(2, 6))
@pytest.mark.parametrize("wrapped", [False, True])
def test_running_means_that_are_a_program_run_nothing(copied, protocol, wrapped):
    evil = {"obs_rms": Payload(), "clip_obs": Payload()} if wrapped else Payload()
    copied.with_name("vecnormalize.pkl").write_bytes(pickle.dumps(evil, protocol))
    with pytest.raises(ValueError, match="holds no running means that can be read"):
        make(str(copied), LinearAxisEnv())
    assert not Path("ran.txt").exists()


def test_weights_that_are_a_program_run_nothing(copied):
    changed(copied, **{"policy.pth": tensors_of_a_program()})
    with pytest.raises(ValueError, match="holds no weights that can be read alone"):
        make(str(copied), LinearAxisEnv())
    assert not Path("ran.txt").exists()


@pytest.mark.parametrize(
    ("name", "settings", "says"),
    [
        ("SAC use_sde", {"use_sde": True}, "none of the networks that are known"),
        ("PPO", {"policy_kwargs": lambda: {"activation_fn": torch.nn.ELU}}, "is not known here"),
    ],
)
def test_a_network_that_is_not_known_is_told_with_the_next_step(name, settings, says, tmp_path):
    _, file = saved(tmp_path, name, settings)
    with pytest.raises(ValueError, match=f"{says}.*a class in a file"):
        make(str(file), LinearAxisEnv())


@pytest.mark.parametrize("size", [0, 10, 1000, 5000, -1, -100])
def test_a_file_that_was_cut_off_is_told(copied, size):
    copied.write_bytes(copied.read_bytes()[:size])
    with pytest.raises(ValueError, match=r"model\.zip"):
        make(str(copied), LinearAxisEnv())
