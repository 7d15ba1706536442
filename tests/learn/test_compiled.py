"""PPO compiled: SB3's own is the oracle, and what it is where it is asked for more."""

import copy
import itertools
import json

import numpy as np
import pytest
from later import Later, only_with

from servogym.training.policies.trained import weights

PPO = Later("stable_baselines3", "PPO")
VecMonitor = Later("stable_baselines3.common.vec_env", "VecMonitor")
CompiledPPO = Later("servogym.training.learn.compiled", "CompiledPPO")
compiled = Later("servogym.training.learn.compiled")
checkpoint = Later("servogym.training.learn.checkpoint")
sb3 = Later("servogym.training.learn.sb3")
state = Later("servogym.training.learn.state")
torch = Later("torch")
train = Later("servogym.training.learn.train", "train")
pytestmark = only_with("stable_baselines3", reason="needs pip install 'servogym[train]'")

ONE, TWO = "LinearAxis-v0", "LinearAxisTracking-v0"  # actions
SMALL = {"n_steps": 32, "batch_size": 64, "n_epochs": 3}
ROLLOUT = 8 * SMALL["n_steps"]


@pytest.fixture(autouse=True)
def one_thread():
    with sb3.one_thread():
        yield


def learner(kind, env_id=ONE, seed=1, **settings):
    """8 environments, after one rollout and update."""
    env = VecMonitor(sb3.make(env_id, 8, max_episode_steps=20))
    model = kind("MlpPolicy", env, seed=seed, device="cpu", **(SMALL | settings))
    model.learn(ROLLOUT)
    return model


def numbers(model):
    """Its weights by name, and the state of its optimizer."""
    found = {name: tensor.numpy().copy() for name, tensor in model.policy.state_dict().items()}
    for i, moments in model.policy.optimizer.state_dict()["state"].items():
        found |= {f"{i}/{name}": tensor.numpy().copy() for name, tensor in moments.items()}
    return found


def same(one, other):
    return all((one[name] == other[name]).all() for name in one)


def start_of(model):
    """Weights, optimizer, rollout and count of a learner, copied."""
    parts = model.policy.state_dict(), model.policy.optimizer.state_dict(), model.rollout_buffer
    return *copy.deepcopy(parts), model._n_updates


def updated(model, start):
    """What an update makes of that start: numbers, and what is logged."""
    network, optimizer, buffer, model._n_updates = start
    model.policy.load_state_dict(network)
    model.policy.optimizer.load_state_dict(copy.deepcopy(optimizer))
    model.rollout_buffer = copy.deepcopy(buffer)
    model.set_random_seed(5)
    model.train()
    return numbers(model), dict(model.logger.name_to_value)


@pytest.mark.filterwarnings("ignore:You have specified a mini-batch size")
@pytest.mark.parametrize(
    ("env_id", "settings"),
    [
        (ONE, {}),
        (TWO, {"ent_coef": 0.01, "batch_size": 256}),
        (TWO, {"batch_size": 50, "max_grad_norm": 0.05}),  # the last one is smaller
        (ONE, {"batch_size": 85}),  # the last one is a single row
        (ONE, {"policy_kwargs": {"net_arch": []}}),
        (TWO, {"policy_kwargs": {"net_arch": {"pi": [7], "vf": [33, 10, 5]}}}),
    ],
)
def test_an_update_is_that_of_stable_baselines3(env_id, settings):
    theirs, ours = (learner(kind, env_id, **settings) for kind in (PPO, CompiledPPO))
    assert ours._plain()
    before, start = numbers(theirs), start_of(theirs)
    found, told = updated(ours, start)
    expected, said = updated(theirs, start)
    assert found.keys() == expected.keys()
    moved = max(np.abs(expected[name] - before[name]).max() for name in expected)
    assert moved > 1e-3
    for name, array in expected.items():
        np.testing.assert_allclose(found[name], array, rtol=1e-4, atol=1e-5, err_msg=name)
    assert told.keys() == said.keys()
    for name in said.keys() - {"train/entropy_loss", "train/loss"}:  # theirs is a mean of batches
        assert told[name] == pytest.approx(said[name], rel=1e-3, abs=1e-5), name


def test_it_acts_as_the_policy_says():
    model = learner(CompiledPPO, TWO)
    seen = torch.randn(77, model.observation_space.shape[0], generator=torch.manual_seed(0)) * 3
    with torch.no_grad():
        actions, values, chances = model.policy(seen)
        again = model.policy.evaluate_actions(seen, actions)
        spread = (actions - model.policy.get_distribution(seen).mode()) / model.policy.log_std.exp()
    np.testing.assert_allclose(values, again[0].ravel(), atol=1e-5)
    np.testing.assert_allclose(chances, again[1], atol=1e-4)
    assert abs(float(spread.mean())) < 0.3
    assert float(spread.std()) == pytest.approx(1.0, abs=0.2)


def test_the_compiled_tanh_is_tanh():
    x = np.linspace(-12, 12, 100_001, dtype=np.float32)
    from servogym.training.policies.trained.network import tanh

    told = x.copy()
    tanh(told)
    np.testing.assert_allclose(told, np.tanh(x.astype(float)), rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize(
    "settings",
    [
        {"use_sde": True},
        {"target_kl": 0.01},
        {"clip_range_vf": 0.2},
        {"normalize_advantage": False},
        {"policy_kwargs": {"optimizer_kwargs": {"weight_decay": 0.01}}},
    ],
    ids=str,
)
def test_what_is_not_compiled_is_updated_by_stable_baselines3(settings):
    theirs, ours = (learner(kind, **settings) for kind in (PPO, CompiledPPO))
    start = start_of(theirs)
    (expected, _), (found, _) = updated(theirs, start), updated(ours, start)
    assert same(expected, found)


def test_without_compiled_code_it_is_stable_baselines3(monkeypatch):
    expected = numbers(learner(PPO))
    monkeypatch.setattr(compiled, "DISABLED", True)
    assert same(expected, numbers(learner(CompiledPPO)))


def test_one_seed_makes_one_policy_and_a_checkpoint_goes_on_bit_for_bit(tmp_path):
    one, other = learner(CompiledPPO), learner(CompiledPPO)
    first = numbers(one)
    assert same(first, numbers(other))
    weights.save(one, tmp_path)
    state.save(one, tmp_path)
    restored = learner(CompiledPPO, seed=2)
    state.load(restored, tmp_path)
    assert same(first, numbers(restored))
    buffer, *_ = start_of(one)[2:]
    for model in (other, restored):
        model.rollout_buffer = copy.deepcopy(buffer)
        model.set_random_seed(5)
        model.train()
    assert same(numbers(other), numbers(restored))


def run(out, steps, **settings):
    """-> the weights that `servogym train` leaves, and its last checkpoint."""
    small = SMALL | {"policy_kwargs": {"net_arch": [8]}} | settings
    new = {"envs": 8, "arguments": {"max_episode_steps": 20}, "settings": small}
    resumed = bool(checkpoint.numbered(out))
    train(ONE, out=out, steps=steps, resume=resumed, **({} if resumed else new))
    last = checkpoint.numbered(out)[-1]
    return weights.load(last).network, last


def test_a_run_is_compiled_unless_it_says_otherwise(tmp_path):
    runs = itertools.count()
    theirs, default, asked = (
        run(tmp_path / str(next(runs)), ROLLOUT, **settings)[0]
        for settings in ({"compiled": False}, {}, {"compiled": True})
    )
    assert same(default, asked)
    assert not same(default, theirs)


def test_a_run_begun_by_an_earlier_version_goes_on_without(tmp_path):
    """What it learned is to be had once more, bit for bit."""
    run(tmp_path / "now", ROLLOUT, compiled=False)
    _, earlier = run(tmp_path / "then", ROLLOUT, compiled=False)
    about = json.loads((earlier / "checkpoint.json").read_text())
    del about["hyperparameters"]["compiled"]
    (earlier / "checkpoint.json").write_text(json.dumps(about))
    assert same(run(tmp_path / "now", 2 * ROLLOUT)[0], run(tmp_path / "then", 2 * ROLLOUT)[0])
