"""`examples/learning/ppo.py`: the lesson in one file trains, and is the same every time."""

import csv
import importlib.util
import sys
from pathlib import Path

import numpy as np
import pytest
from later import Later

from servogym.drive.model import foreign

torch = Later("torch")
FILE = Path(__file__).parents[2] / "examples" / "learning" / "ppo.py"


@pytest.fixture
def ppo(monkeypatch):
    spec = importlib.util.spec_from_file_location("ppo", FILE)
    module = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, "ppo", module)
    spec.loader.exec_module(module)
    return module


SMALL = {"steps": 64, "envs": 4, "rollout": 8, "batch": 16, "epochs": 1, "evaluate": 32}


def test_it_trains_twice_alike_and_keeps_curve_and_weights(ppo, tmp_path):
    curves = [ppo.train(ppo.Arguments(out=str(tmp_path / n), **SMALL)) for n in ("a", "b")]
    assert curves[0] == curves[1]
    assert [steps for steps, _ in curves[0]] == [0, 32, 64]
    with (tmp_path / "a" / "curve.csv").open(encoding="utf-8") as file:
        assert [float(row[1]) for row in [*csv.reader(file)][1:]] == [r for _, r in curves[0]]
    one, other = (foreign.arrays(tmp_path / n / "weights.npz") for n in ("a", "b"))
    assert one.keys() == other.keys()
    for name in one:
        np.testing.assert_array_equal(one[name], other[name])
    assert one["mean"].shape == (8,), "seven of the task and the last action"
    assert (tmp_path / "a" / "curve.png").read_bytes()[:4] == b"\x89PNG"


@pytest.mark.slow
@pytest.mark.skipif(
    importlib.util.find_spec("mujoco_warp") is None,
    reason="no mujoco-warp: pip install 'servogym[gpu]'",
)
def test_it_trains_on_a_device_with_tensors_that_stay_there(ppo, tmp_path, monkeypatch):
    from servogym.envs.environment.device_env import DeviceVectorEnv

    given, step = [], DeviceVectorEnv.step
    monkeypatch.setattr(
        DeviceVectorEnv, "step", lambda env, actions: given.append(actions) or step(env, actions)
    )
    small = SMALL | {"device": "cpu", "out": str(tmp_path)}
    curve = ppo.train(ppo.Arguments(**small))
    assert [steps for steps, _ in curve] == [0, 32, 64]
    assert {type(actions).__name__ for actions in given} == {"Tensor"}


def test_the_running_mean_and_variance_are_those_of_all_that_was_seen(ppo):
    running, rows = ppo.Running((2,)), np.random.default_rng(1).normal(3.0, 2.0, (90, 2))
    for part in np.array_split(rows, 7):
        running.update(torch.as_tensor(part))
    np.testing.assert_allclose(running.mean, rows.mean(axis=0), rtol=1e-4)
    np.testing.assert_allclose(running.variance, rows.var(axis=0), rtol=1e-3)
