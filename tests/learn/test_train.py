"""`servogym train`: it learns, it is interrupted and continues, it refuses what is foreign."""

import csv
import io
import itertools
import json
import pickle
import shutil
from pathlib import Path

import numpy as np
import pytest
from later import Later, only_with
from rich.console import Console

from servogym.drive.model import foreign
from servogym.envs import TASKS
from servogym.envs.tasks.homing import HomingEnv
from servogym.envs.tasks.positioning import LinearAxisEnv
from servogym.training import cli
from servogym.training.learn import hyperparameters
from servogym.training.policies import make
from servogym.training.policies.trained import saved, weights

EvalCallback = Later("stable_baselines3.common.callbacks", "EvalCallback")
VecMonitor = Later("stable_baselines3.common.vec_env", "VecMonitor")
VecNormalize = Later("stable_baselines3.common.vec_env", "VecNormalize")
train_bench = Later("servogym.training.bench.train")
checkpoint = Later("servogym.training.learn.checkpoint")
sb3 = Later("servogym.training.learn.sb3")
state = Later("servogym.training.learn.state")
HoldStill = Later("servogym.training.learn.evaluation", "HoldStill")
score = Later("servogym.training.learn.evaluation", "score")
ALGORITHMS = Later("servogym.training.learn.train", "ALGORITHMS")
train = Later("servogym.training.learn.train", "train")
Training = Later("servogym.training.learn.training", "Training")
pytestmark = only_with("stable_baselines3", reason="needs pip install 'servogym[train]'")

ID = "LinearAxis-v0"
SHORT = {"max_episode_steps": 10}
SMALL = {"n_steps": 16, "batch_size": 64, "n_epochs": 1, "policy_kwargs": {"net_arch": [8]}}
SAC_SMALL = {
    "buffer_size": 2000, "learning_starts": 64, "batch_size": 32, "gradient_steps": 1,
    "policy_kwargs": {"net_arch": [8]},
}


def brief(out, steps=256, *, console=None, progress=False, **arguments):
    """A run of a few updates of 128 steps: 8 environments, 16 steps."""
    fresh = {} if arguments.get("resume") else {"envs": 8, "arguments": SHORT, "settings": SMALL}
    every = {"checkpoint_every": 128, "evaluate_every": 128}
    asked = Training(ID, out=out, steps=steps, **(fresh | every | arguments))
    return train(asked, console, progress=progress)


def counts(out):
    with (out / "progress.csv").open() as file:
        return [int(row["time/total_timesteps"]) for row in csv.DictReader(file)]


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A finished brief run."""
    out = tmp_path_factory.mktemp("run")
    brief(out)
    return out


def test_ppo_brings_the_axis_to_its_goal_far_better_than_holding_still(tmp_path):
    coarse = {"policy_kwargs": {"log_std_init": -1.0, "net_arch": [64, 64]}}  # finds the way soon
    policy, still = train(
        Training(ID, out=tmp_path, steps=60_000, seed=1, evaluate_every=60_000, settings=coarse)
    )
    assert policy.length > 180, "hardly a fault, so short a training as it is"
    assert policy.reward > 2 * still.reward


def test_holding_still_is_no_motion(made):
    env = VecMonitor(sb3.make(ID, 16, max_episode_steps=10))
    assert score(HoldStill(env.action_space), env).length == 10
    assert score(HoldStill(env.action_space), env) == score(HoldStill(env.action_space), env), (
        "the same episodes each time"
    )
    env.close()


def test_a_run_leaves_checkpoints_evaluations_and_the_best_policy(made):
    assert [folder.name for folder in checkpoint.numbered(made)] == ["0000000128", "0000000256"]
    for folder in (*checkpoint.numbered(made), made / "best"):
        about = saved.read(folder)
        assert about["env_id"] == "servogym/LinearAxis-v0"
        assert about["drive"] == "generic"
        assert about["arguments"] == SHORT
        assert set(about["versions"]) == set(checkpoint.VERSIONED)
        env = sb3.make(about["env_id"], 2, drive=about["drive"], **about["arguments"])
        policy = weights.load(folder).policy(about)
        assert policy.observation_space.shape == env.observation_space.shape
        env.close()
        if folder.name != "best":
            assert foreign.arrays(folder / "state.npz")["num_timesteps"] == about["steps"]
    found = foreign.arrays(made / "evaluations.npz")
    assert found["timesteps"].tolist() == [128, 256]
    assert found["results"].shape == (2, 16)
    assert not list(made.glob("**/.*")), "nothing half written"


def network(folder):
    """The arrays of its policy."""
    return weights.load(folder).network


def test_the_same_seed_makes_the_same_policy(made, tmp_path):
    brief(tmp_path)
    one, other = (network(checkpoint.numbered(out)[-1]) for out in (made, tmp_path))
    assert all((one[name] == other[name]).all() for name in one)


@pytest.mark.parametrize("algorithm", ["PPO", "SAC"])
def test_it_continues_without_losing_count(algorithm, tmp_path):
    settings = SMALL if algorithm == "PPO" else SAC_SMALL
    brief(tmp_path, algorithm=algorithm, settings=settings)
    before = foreign.arrays(checkpoint.numbered(tmp_path)[-1] / "state.npz")
    brief(tmp_path, 512, resume=True)
    last = checkpoint.numbered(tmp_path)[-1]
    after = foreign.arrays(last / "state.npz")
    assert (before["num_timesteps"], after["num_timesteps"]) == (256, 512)
    updates = {"PPO": (2, 4), "SAC": (24, 56)}[algorithm]  # SAC: one for 8 steps after the first 64
    assert (before["_n_updates"], after["_n_updates"]) == updates
    assert after["_episode_num"] >= before["_episode_num"]
    evaluated = foreign.arrays(tmp_path / "evaluations.npz")["timesteps"]
    assert evaluated.tolist() == [128, 256, 384, 512]
    seen = counts(tmp_path)
    assert seen == sorted(seen)
    assert {128, 256, 384, 512} <= set(seen)
    buffers = [f.parent for f in tmp_path.glob("checkpoints/*/replay.npz")]
    assert buffers == ([last] if algorithm == "SAC" else [])
    if algorithm == "SAC":
        assert foreign.arrays(last / "replay.npz")["pos"] == 512 // 8


@pytest.fixture(scope="module")
def learners():
    """What SB3 itself trained, and its maker, by algorithm."""
    made = {}
    for name, settings in (("PPO", {"n_steps": 16, "batch_size": 64, "n_epochs": 1}), ("SAC", {
        "buffer_size": 400, "learning_starts": 64, "batch_size": 32})):

        def fresh(name=name, settings=settings):
            env = VecNormalize(VecMonitor(sb3.make(ID, 8, **SHORT)))
            more = settings | {"policy_kwargs": {"net_arch": [16]}}
            return ALGORITHMS[name]("MlpPolicy", env, seed=1, device="cpu", **more)

        made[name] = fresh(), fresh
        with sb3.one_thread():
            made[name][0].learn(512)  # more than the buffer of SAC holds
    return made


@pytest.mark.parametrize("name", ["PPO", "SAC"])
def test_what_goes_on_is_what_sb3_itself_would_have_loaded(name, learners, tmp_path):
    model, fresh = learners[name]
    about = {"env_id": ID, "algorithm": name, "hyperparameters": {}, "arguments": {}}
    checkpoint.save(model, about, tmp_path / "one")
    again = fresh()
    state.load(again, tmp_path / "one")
    model.save(tmp_path / "model.zip")
    oracle = ALGORITHMS[name].load(tmp_path / "model.zip", fresh().env, device="cpu")

    def same(one, other):
        if isinstance(one, dict):
            assert one.keys() == other.keys()
            for key in one:
                same(one[key], other[key])
        elif isinstance(one, (list, tuple)):
            for a, b in zip(one, other, strict=True):
                same(a, b)
        else:
            one, other = (x.numpy() if hasattr(x, "numpy") else x for x in (one, other))
            assert np.array_equal(one, other)

    same(again.get_parameters(), oracle.get_parameters())
    for counter in state.COUNTERS:
        assert getattr(again, counter) == getattr(oracle, counter)
    for variable in model._get_torch_save_params()[1]:
        assert (getattr(again, variable) == getattr(oracle, variable)).all()
    assert [e["r"] for e in again.ep_info_buffer] == [e["r"] for e in oracle.ep_info_buffer]
    means, expected = again.get_vec_normalize_env(), model.get_vec_normalize_env()
    for each in state.MEANS:
        same(vars(getattr(means, each)), vars(getattr(expected, each)))
    if name == "SAC":
        state.load_replay(again, tmp_path / "one")
        for array in ("observations", "next_observations", "actions", "rewards", "dones"):
            same(getattr(again.replay_buffer, array), getattr(model.replay_buffer, array))
        assert again.replay_buffer.pos == model.replay_buffer.pos
        assert again.replay_buffer.full


def test_no_file_of_a_run_is_a_pickle(made, learners, tmp_path):
    checkpoint.save(learners["SAC"][0], {}, tmp_path / "sac")
    files = [f for folder in (made, tmp_path) for f in folder.rglob("*") if f.is_file()]
    assert {"state.npz", "replay.npz", "weights.npz"} <= {f.name for f in files}
    for file in files:
        assert file.suffix not in (".pkl", ".zip", ".pth")
        if file.suffix == ".npz":
            assert all(array.dtype.kind in "fiub" for array in foreign.arrays(file).values())


class Payload:
    def __reduce__(self):
        return Path.touch, (Path("ran.txt"),)


@pytest.mark.parametrize(
    ("file", "content", "says"),
    [
        ("state.npz", pickle.dumps(Payload()), "state.npz holds no arrays"),
        ("state.npz", {"num_timesteps": np.array([Payload()], object)}, "holds no arrays"),
        ("state.npz", {"num_timesteps": np.array(1)}, "does not fit the network"),
        ("state.npz", None, "pickles that can run any program when they are read"),
        ("weights.npz", pickle.dumps(Payload()), "weights.npz holds no arrays"),
    ],
)
def test_a_run_goes_on_from_no_program(made, tmp_path, monkeypatch, file, content, says):
    monkeypatch.chdir(tmp_path)
    shutil.copytree(made, tmp_path / "run")
    last = checkpoint.numbered(tmp_path / "run")[-1]
    for name in ("model.zip", "vecnormalize.pkl", "replay_buffer.pkl"):  # as an earlier version
        (last / name).write_bytes(pickle.dumps(Payload()))
    if content is None:
        (last / file).unlink()
    elif isinstance(content, bytes):
        (last / file).write_bytes(content)
    else:
        np.savez(last / file, **content)
    with pytest.raises(ValueError, match=says):
        brief(tmp_path / "run", 512, resume=True)
    assert not Path("ran.txt").exists()


def test_the_state_of_another_network_is_refused(learners, tmp_path):
    checkpoint.save(learners["SAC"][0], {}, tmp_path / "sac")
    model = learners["PPO"][1]()
    with pytest.raises(ValueError, match="does not fit the network"):
        state.load(model, tmp_path / "sac")
    other = learners["SAC"][1]()
    other.replay_buffer.observations = other.replay_buffer.observations[..., :1]
    with pytest.raises(ValueError, match=r"replay.npz is not of this run"):
        state.load_replay(other, tmp_path / "sac")


@pytest.mark.parametrize(
    ("env_id", "arguments", "says"),
    [
        ("LinearAxisTracking-v0", {}, "'servogym/LinearAxis-v0', asked for is 'servogym/LinearAxi"
         "sTracking-v0'"),
        (ID, {"drive": "kollmorgen_akd"}, "drive = 'generic', asked for is 'kollmorgen_akd'"),
        (ID, {"algorithm": "SAC"}, "algorithm = 'PPO', asked for is 'SAC'"),
        (ID, {"seed": 3}, "seed = 0, asked for is 3"),
        (ID, {"envs": 9}, "envs = 8, asked for is 9"),
        (ID, {"arguments": {}}, "asked for is {}"),
    ],
)
def test_a_checkpoint_of_something_else_is_refused_naming_both(made, env_id, arguments, says):
    with pytest.raises(ValueError, match=r"checkpoint .*another --out") as refusal:
        train(Training(env_id, out=made, resume=True, **arguments))
    assert says in str(refusal.value)


def resume_with_another(package, made, monkeypatch, capsys):
    """Exit status, and what was said of the version the checkpoint has and the present one."""
    real = checkpoint.version
    monkeypatch.setattr(checkpoint, "version", lambda n: "99.1" if n == package else real(n))
    then = saved.read(checkpoint.numbered(made)[-1])["versions"][package]
    status = cli.main(["train", ID, "--out", str(made), "--resume", "--steps", "256"])
    said = " ".join("".join(capsys.readouterr()).split())
    return status, f"made with {package} {then}, this is 99.1" in said


@pytest.mark.parametrize("package", ["servogym", "mujoco"])
def test_another_version_of_the_environment_is_refused_naming_both(
    package, made, monkeypatch, capsys
):
    assert resume_with_another(package, made, monkeypatch, capsys) == (2, True)


def test_another_version_of_the_learner_is_told_with_both(made, monkeypatch, capsys):
    assert resume_with_another("torch", made, monkeypatch, capsys) == (0, True)


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["Pole-v0"], "unknown environment 'Pole-v0'"),
        ([ID, "--drive", "nothing"], "unknown drive model 'nothing'"),
        ([ID, "--drive", "bonfiglioli_act"], "has no mode cyclic_sync_position"),
        ([ID, "--steps", "0"], "--steps: 0 is out of range"),
        ([ID, "--seed", "-1"], "--seed: -1 is out of range"),
        ([ID, "--envs", "0"], "--envs: 0 is out of range"),
        ([ID, "--argument", "payloads=3"], "arguments of servogym/LinearAxis-v0:"),
        ([ID, "--argument", "payload=-3"], "payload"),
        ([ID, "--resume"], "leave out --resume"),
    ],
)
def test_a_mistake_is_one_line_and_status_2_and_leaves_nothing(refused, tmp_path, options, says):
    out = tmp_path / "out"
    assert says in refused(["train", *options, "--out", str(out)])
    assert not out.exists()


def test_a_folder_with_a_run_is_not_overwritten(made):
    with pytest.raises(ValueError, match="has a run already: --resume continues it"):
        brief(made)


def test_a_broken_checkpoint_says_what_to_do(made, tmp_path):
    folder = tmp_path / "checkpoints" / "0000000128"
    folder.mkdir(parents=True)
    (folder / "checkpoint.json").write_text("{", encoding="utf-8")
    with pytest.raises(ValueError, match="remove its folder, and the one before is taken"):
        brief(tmp_path, resume=True)


def test_a_run_shorter_than_the_way_to_an_evaluation_has_a_best_policy_all_the_same(tmp_path):
    brief(tmp_path, steps=128, evaluate_every=10**6)
    assert foreign.arrays(tmp_path / "evaluations.npz")["timesteps"].tolist() == [128]
    assert saved.read(tmp_path / "best")["steps"] == 128


def test_a_run_that_was_never_evaluated_says_what_there_is(tmp_path):
    with pytest.raises(ValueError, match=r"has no best/, .*: go on with --resume, or give one of"):
        make(str(tmp_path), LinearAxisEnv())


def test_a_wrong_hyper_parameter_is_named(tmp_path):
    with pytest.raises(ValueError, match="'learning_speed': did you mean learning_rate"):
        brief(tmp_path, settings=SMALL | {"learning_speed": 1})


def test_a_learning_rate_of_two_numbers_falls_also_where_a_run_is_continued(tmp_path):
    falling = SMALL | {"learning_rate": [1e-3, 0.0]}
    brief(tmp_path / "run", steps=512, settings=falling)
    brief(tmp_path / "run", steps=1024, resume=True)
    with (tmp_path / "run" / "progress.csv").open() as file:
        seen = [row["train/learning_rate"] for row in csv.DictReader(file)]
    rates = [float(rate) for rate in seen if rate]
    assert rates[0] == pytest.approx(1e-3 * (1 - 128 / 512))
    assert rates[-1] < 0.2 * rates[0]
    with pytest.raises(ValueError, match=r"learning_rate = \[0.1\]: give one number, or"):
        brief(tmp_path / "other", settings=SMALL | {"learning_rate": [0.1]})


@pytest.mark.parametrize(("envs", "batch"), [(64, 512), (4, 256), (12, 384), (1, 64)])
def test_the_rollout_is_a_multiple_of_the_batch(envs, batch):
    settings = hyperparameters.of(TASKS[0], "PPO", envs)
    assert settings["batch_size"] == batch
    assert settings["n_steps"] * envs % batch == 0


def test_the_table_names_what_exists():
    for task in TASKS:
        for algorithm in task.HYPERPARAMETERS:
            assert json.dumps(hyperparameters.of(task, algorithm))
            assert hyperparameters.of(task, algorithm) != hyperparameters.COMMON[algorithm]
    with pytest.raises(ValueError, match="algorithm = 'DQN', use one of PPO, SAC"):
        hyperparameters.of(TASKS[0], "DQN")


def test_the_bench_trains_both_on_the_same(monkeypatch):
    monkeypatch.setattr(train_bench, "ROLLOUT", 512)
    with sb3.one_thread():
        rows = train_bench.measure("generic", 1, (8,))
    assert [row["environments"] for row in rows] == ["DummyVecEnv of 8", "ServoVecEnv of 8"]
    assert rows[0]["ratio"] == 1.0
    assert all(row["rollout_us"] > 0 and row["update_us"] > 0 for row in rows)


def test_a_trained_policy_comes_through_the_same_door(tmp_path):
    brief(tmp_path / "run")
    env = LinearAxisEnv()
    policy = make(str(tmp_path / "run"), env)
    observation, info = env.reset(seed=1)
    policy.reset(observation, info)
    action = policy.act(observation)
    assert env.action_space.contains(action)
    assert (action == make(str(tmp_path / "run"), env).act(observation)).all()
    with pytest.raises(ValueError, match="was trained for servogym/LinearAxis-v0, not for"):
        make(str(tmp_path / "run"), HomingEnv())
    with pytest.raises(ValueError, match="make it with the arguments"):
        make(str(tmp_path / "run"), LinearAxisEnv(history=3))
    seeing = SHORT | {"history": 2, "previous_action": True}
    brief(tmp_path / "seeing", arguments=seeing)
    plain, shown = LinearAxisEnv(), LinearAxisEnv(history=2, previous_action=True)
    one, other = (make(str(tmp_path / "seeing"), e) for e in (plain, shown))
    observations = [e.reset(seed=2)[0] for e in (plain, shown)]
    one.reset(observations[0], {})
    other.reset(observations[1], {})
    for _ in range(5):
        actions = one.act(observations[0]), other.act(observations[1])
        np.testing.assert_array_equal(*actions)
        observations = [e.step(a)[0] for e, a in zip((plain, shown), actions, strict=True)]
    (tmp_path / "empty").mkdir()
    with pytest.raises(ValueError, match="is not a checkpoint and has no best/"):
        make(str(tmp_path / "empty"), env)


def test_a_run_keeps_its_scalars_for_tensorboard(tmp_path):
    pytest.importorskip("tensorboard")
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    brief(tmp_path)
    (file,) = tmp_path.glob("events.out.tfevents.*")
    kept = EventAccumulator(str(file)).Reload()
    assert {"rollout/ep_rew_mean", "train/loss", "eval/mean_reward"} <= set(kept.Tags()["scalars"])
    assert [row.step for row in kept.Scalars("eval/mean_reward")] == [128, 256]
    found = foreign.arrays(tmp_path / "evaluations.npz")["results"].mean(axis=1)
    told = [row.value for row in kept.Scalars("eval/mean_reward")]
    assert told == pytest.approx(found.tolist(), rel=1e-6)


@pytest.mark.filterwarnings("ignore:rich is experimental")  # stable-baselines3 does it as well
def test_a_bar_counts_the_steps_where_it_is_asked_for(tmp_path, capfd):
    pytest.importorskip("tqdm")
    brief(tmp_path / "without")
    assert "256/256" not in "".join(capfd.readouterr())
    brief(tmp_path / "with", progress=True)
    assert "256/256" in "".join(capfd.readouterr())


def test_ctrl_c_while_a_checkpoint_is_written_leaves_that_checkpoint(tmp_path, monkeypatch):
    write, written = weights.save, []

    def cut_off(model, folder):
        write(model, folder)
        written.append(folder)
        if len(written) == 2:  # the first is of the best policy
            raise KeyboardInterrupt

    monkeypatch.setattr(weights, "save", cut_off)
    with pytest.raises(KeyboardInterrupt):
        brief(tmp_path)
    (only,) = checkpoint.numbered(tmp_path)
    assert foreign.arrays(only / "state.npz")["num_timesteps"] == 128
    assert written[1] == written[2], "in the same place"
    assert not list(tmp_path.glob("checkpoints/.*"))


def test_a_training_that_has_fallen_for_good_stops_and_says_where_the_best_is(
    tmp_path, monkeypatch
):
    rewards = itertools.chain([100.0], itertools.repeat(80.0))

    def judged(self):
        self.last_mean_reward = next(rewards)
        self.best_mean_reward = max(self.best_mean_reward, self.last_mean_reward)
        return True

    monkeypatch.setattr(EvalCallback, "_on_step", judged)
    told = io.StringIO()
    brief(tmp_path, steps=4096, console=Console(file=told, width=300))
    assert "15 % below the best, 100.0, whose policy is in" in told.getvalue()
    assert saved.read(checkpoint.numbered(tmp_path)[-1])["steps"] < 2048
    assert saved.read(tmp_path / "best")["steps"] <= 128


def test_a_folder_is_one_training_s(tmp_path):
    with (
        checkpoint.alone(tmp_path),
        pytest.raises(ValueError, match="another process is training there"),
        checkpoint.alone(tmp_path),
    ):
        pass


def at_once(self):
    raise KeyboardInterrupt


def within_the_closing_of_a_file(self):
    """As `zipfile` where a member is open."""
    try:
        raise KeyboardInterrupt
    finally:
        raise ValueError("Can't close the ZIP file while there is an open writing handle on it.")


@pytest.mark.parametrize("interrupted", [at_once, within_the_closing_of_a_file])
def test_ctrl_c_before_the_first_checkpoint_keeps_one(tmp_path, monkeypatch, interrupted):
    with monkeypatch.context() as patched:
        patched.setattr(checkpoint.Checkpoints, "_on_step", interrupted)
        with pytest.raises(KeyboardInterrupt):
            brief(tmp_path)
    assert len(checkpoint.numbered(tmp_path)) == 1
    brief(tmp_path, resume=True)
    assert saved.read(checkpoint.numbered(tmp_path)[-1])["steps"] >= 256


def test_where_the_last_policy_is_not_the_one_that_is_played_both_are_named(tmp_path):
    told = io.StringIO()
    brief(tmp_path, steps=384, evaluate_every=256, console=Console(file=told, width=300))
    best = saved.read(tmp_path / "best")
    assert best["steps"] == 256
    assert (
        f"{tmp_path} plays the best evaluated, {best['mean_reward']:.1f} after 256 steps; "
        f"the last is {tmp_path / 'checkpoints' / '0000000384'}\n"
    ) in told.getvalue()


def test_trainings_of_different_seeds_share_no_episode():
    """SB3 gives environment k of seed s the stream s + k."""
    env = sb3.make(ID, 64)
    env.seed(1)
    consecutive = env._seeds
    assert consecutive == list(range(1, 65))
    env.independent = True
    seeds = {seed: env.seed(seed) for seed in (0, 1, 2, 3, 2**31 - 1)}
    drawn = [one for each in seeds.values() for one in each]
    assert len(set(drawn)) == len(drawn) == 5 * 64
    assert min(drawn) > 10**9 + 10**6, "nor one of an evaluation"
    assert env.seed(1) == seeds[1]
    first = env.reset()
    env.seed(2)
    assert not (env.reset() == first).all()
    env.close()


def test_a_run_has_streams_of_its_own_unless_it_says_otherwise(tmp_path):
    runs = {}
    for name, more in (("own", {}), ("same", {"streams": "independent"}),
                       ("theirs", {"streams": "consecutive"})):
        brief(tmp_path / name, 128, settings=SMALL | more)
        runs[name] = weights.load(checkpoint.numbered(tmp_path / name)[-1]).network
    assert all((runs["own"][n] == runs["same"][n]).all() for n in runs["own"])
    assert any((runs["own"][n] != runs["theirs"][n]).any() for n in runs["own"])
    with pytest.raises(ValueError, match="streams = 'parallel'"):
        brief(tmp_path / "other", settings=SMALL | {"streams": "parallel"})


def test_a_run_of_an_earlier_version_goes_on_as_it_began(tmp_path):
    """It says nothing of streams, and perhaps that its PPO was not compiled."""
    old = SMALL | {"streams": "consecutive"}
    brief(tmp_path / "now", 128, settings=old)
    brief(tmp_path / "then", 128, settings=old | {"compiled": False})
    (last,) = checkpoint.numbered(tmp_path / "then")
    about = json.loads((last / "checkpoint.json").read_text())
    assert "compiled" not in about["hyperparameters"]
    del about["hyperparameters"]["streams"]
    about["hyperparameters"]["compiled"] = False
    (last / "checkpoint.json").write_text(json.dumps(about))
    for name in ("now", "then"):
        brief(tmp_path / name, 256, resume=True)
    now, then = (
        weights.load(checkpoint.numbered(tmp_path / name)[-1]).network for name in ("now", "then")
    )
    assert all((now[name] == then[name]).all() for name in now)
    last = checkpoint.numbered(tmp_path / "then")[-1]
    about["hyperparameters"]["compiled"] = True
    about["steps"] = 256
    (last / "checkpoint.json").write_text(json.dumps(about | {"sha256": ""}))
    with pytest.raises(ValueError, match="was trained by the compiled PPO of an earlier version"):
        brief(tmp_path / "then", 384, resume=True)
    with pytest.raises(ValueError, match="compiled = True: PPO is that of stable-baselines3"):
        brief(tmp_path / "new", settings=SMALL | {"compiled": True})
    brief(tmp_path / "new", 128, start=last, settings=SMALL)
