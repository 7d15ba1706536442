"""`servogym train`: PPO or SAC of stable-baselines3 on an environment, to be interrupted at will.

A run has a folder: `progress.csv`, `evaluations.npz` (the same episodes each time), `checkpoints/`
and `best/`, the policy of the best evaluation.
"""

import csv
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from rich.console import Console

from . import checkpoint, hyperparameters, sb3  # sb3 first tells what has to be installed

# isort: split
import torch
from stable_baselines3 import PPO, SAC
from stable_baselines3.common.callbacks import BaseCallback, EvalCallback
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.logger import CSVOutputFormat, Logger, TensorBoardOutputFormat
from stable_baselines3.common.vec_env import VecEnv, VecMonitor, VecNormalize

ALGORITHMS = {"PPO": PPO, "SAC": SAC}
EPISODES = 16  # of an evaluation, one in each of as many environments
EPISODES_SEED = 20_000_000  # they are the same for every run
STEPS_COLUMN = "time/total_timesteps"


@dataclass(frozen=True)
class Run:
    """What a training run is; each of its checkpoints says it.

    Args:
        env_id: of the environment.
        drive: drive model, by name or folder.
        algorithm: PPO or SAC.
        seed: of environments, weights and actions.
        envs: number of environments.
        arguments: others of the environment, in JSON's types.
        hyperparameters: as in `servogym.training.hyperparameters`.

    Raises:
        ValueError: naming the argument, its value and what is possible.
    """

    env_id: str
    drive: str
    algorithm: str
    seed: int
    envs: int
    arguments: dict[str, Any]
    hyperparameters: dict[str, Any]

    def __post_init__(self):
        _whole("seed", self.seed, 0, 2**31 - 1)

    def vector(self, envs: int) -> VecEnv:
        """Environments of this run. Raises ValueError as the environment does."""
        try:
            return VecMonitor(sb3.make(self.env_id, envs, drive=self.drive, **self.arguments))
        except TypeError as error:
            raise ValueError(f"arguments of {self.env_id}: {error}") from None


def _whole(name: str, value: int, low: int, high: int = 10**12) -> None:
    if value != int(value) or not low <= value <= high:
        raise ValueError(f"{name} = {value!r} must be a whole number {low}..{high}")


class Score(NamedTuple):
    """Of the fixed episodes: mean return, its standard deviation, mean length (steps)."""

    reward: float
    deviation: float
    length: float

    def __str__(self) -> str:
        """``"87.2 ± 4.1 in 200 steps"``."""
        return f"{self.reward:.1f} ± {self.deviation:.1f} in {self.length:.0f} steps"


class HoldStill:
    """The policy every other one has to beat: actions of 0."""

    def __init__(self, actions: int):
        self.actions = actions

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        """Actions, shape ``(num_envs, actions)``, and no state."""
        return np.zeros((len(observation), self.actions), np.float32), None


def score(policy, env: VecEnv) -> Score:
    """Play the fixed episodes in `EPISODES` environments."""
    env.seed(EPISODES_SEED)
    rewards, lengths = evaluate_policy(policy, env, EPISODES, return_episode_rewards=True)
    return Score(float(np.mean(rewards)), float(np.std(rewards)), float(np.mean(lengths)))


class Evaluation(EvalCallback):
    """SB3's evaluation on fixed episodes, going on where a checkpoint was made; keeps the best."""

    def __init__(self, env: VecEnv, run: Run, out: Path, every: int, console: Console):
        freq = max(every // run.envs, 1)
        super().__init__(
            env, n_eval_episodes=EPISODES, eval_freq=freq, log_path=str(out), verbose=0
        )
        self.run, self.out, self.console = run, out, console

    def go_on(self, steps: int) -> None:
        """Recover what was found up to `steps`."""
        self.n_calls = steps // self.run.envs
        file = self.out / "evaluations.npz"
        if not file.is_file():
            return
        with np.load(file) as found:
            kept = found["timesteps"] <= steps
            self.evaluations_timesteps = found["timesteps"][kept].tolist()
            self.evaluations_results = found["results"][kept].tolist()
            self.evaluations_length = found["ep_lengths"][kept].tolist()
            if "successes" in found:
                self.evaluations_successes = found["successes"][kept].tolist()
        self.best_mean_reward = max(map(np.mean, self.evaluations_results), default=-np.inf)

    def _on_step(self) -> bool:
        if self.n_calls % self.eval_freq:
            return True
        self.eval_env.seed(EPISODES_SEED)
        best = self.best_mean_reward
        super()._on_step()
        better = self.best_mean_reward > best
        if better:
            about = asdict(self.run) | {"mean_reward": self.best_mean_reward}
            checkpoint.save(self.model, about, self.out / "best", replay=False)
        self.console.print(
            f"{self.num_timesteps:>10} steps: reward of an episode {self.last_mean_reward:.1f}"
            + (", the best so far" if better else "")
        )
        return True


class Checkpoints(BaseCallback):
    """A checkpoint every `every` steps, where all that was counted has been learned from."""

    def __init__(self, run: Run, out: Path, every: int):
        super().__init__()
        self.run, self.out, self.every = run, out, every

    def _on_training_start(self) -> None:
        self.last = self.model.num_timesteps

    def _on_rollout_start(self) -> None:
        if self.model.num_timesteps - self.last >= self.every:
            self.last = self.model.num_timesteps
            checkpoint.save_numbered(self.model, asdict(self.run), self.out)

    def _on_step(self) -> bool:
        return True


class ContinuedCsv(CSVOutputFormat):
    """SB3's CSV file, with the rows of an earlier session up to `steps`."""

    def __init__(self, file: Path, steps: int):
        rows = []
        if steps and file.is_file():
            with file.open(newline="", encoding="utf-8") as earlier:
                rows = list(csv.DictReader(earlier))
        super().__init__(str(file))
        for row in rows:
            count = row.get(STEPS_COLUMN) or ""  # a row may have been cut off
            whole = None not in row and None not in row.values()
            if whole and count.isdigit() and int(count) <= steps:
                self.write(row, dict.fromkeys(row, ()))

    def write(self, key_values, key_excluded, step=0) -> None:
        """A row; what was read from the file is text, and stays unquoted."""
        numbers = {
            key: _number(value) if isinstance(value, str) else value
            for key, value in key_values.items()
        }
        super().write(numbers, key_excluded, step)


def _number(text: str) -> float | int | None:
    return None if not text else int(text) if text.lstrip("-").isdigit() else float(text)


def _run(env_id: str, asked: Mapping[str, Any], settings: Mapping[str, Any] | None) -> Run:
    """A new run of what is asked for, and the defaults."""
    env_id = sb3.task(env_id).ID
    algorithm = asked["algorithm"] or "PPO"
    chosen = hyperparameters.of(env_id, algorithm, asked["envs"]) | dict(settings or {})
    return Run(
        env_id, asked["drive"] or "generic", algorithm, asked["seed"] or 0,
        chosen.pop("n_envs"), asked["arguments"] or {}, chosen,
    )  # fmt: skip


def _continued(folder: Path, env_id: str, asked: Mapping[str, Any], console: Console) -> Run:
    """The run of a checkpoint. Raises ValueError where something else is asked for."""
    about = checkpoint.read(folder)
    for name, value in {"env_id": sb3.task(env_id).ID, **asked}.items():
        if value is not None and value != about.get(name):
            raise ValueError(
                f"checkpoint {folder} has {name} = {about.get(name)!r}, asked for is {value!r}: "
                "leave it out, or begin a new run with another --out"
            )
    for name, present in checkpoint.versions().items():
        if (then := about["versions"].get(name)) != present:
            console.print(f"note: the checkpoint was made with {name} {then}, this is {present}")
    return Run(**{name: about[name] for name in Run.__dataclass_fields__})


def train(
    env_id: str,
    *,
    steps: int = hyperparameters.STEPS,
    out: Path | None = None,
    resume: bool = False,
    drive: str | None = None,
    algorithm: str | None = None,
    seed: int | None = None,
    envs: int | None = None,
    arguments: Mapping[str, Any] | None = None,
    settings: Mapping[str, Any] | None = None,
    checkpoint_every: int = 50_000,
    evaluate_every: int = 25_000,
    progress: bool = False,
    console: Console | None = None,
) -> tuple[Score, Score]:
    """Train a policy -> score of it and of holding still, on the fixed episodes.

    Args:
        env_id: with or without ``servogym/``.
        steps: of all environments together, from the beginning of the run.
        out: folder of the run; ``out/ENV-DRIVE-ALGORITHM-SEED`` if not given.
        resume: go on from the latest checkpoint; what is not given is as it was.
        drive: drive model (generic).
        algorithm: PPO or SAC (PPO).
        seed: of environments, weights and actions (0).
        envs: number of environments; if not given, that of the hyper-parameters.
        arguments: others of the environment, in JSON's types; `max_episode_steps` too.
        settings: hyper-parameters that differ from the table, for a new run.
        checkpoint_every: steps from one to the next.
        evaluate_every: steps from one to the next.
        progress: show a bar, where tqdm is installed.
        console: where to tell.

    Raises:
        ValueError: naming what is wrong; where `out` has a run already, or another one.
    """
    console = console or Console(quiet=True)
    _whole("steps", steps, 1)
    _whole("checkpoint_every", checkpoint_every, 1)
    _whole("evaluate_every", evaluate_every, 1)
    _whole("envs", 1 if envs is None else envs, 1, 100_000)
    arguments = None if arguments is None else json.loads(json.dumps(dict(arguments)))
    asked = {"drive": drive, "algorithm": algorithm, "seed": seed, "envs": envs,
             "arguments": arguments}  # fmt: skip
    if out is None:
        name = sb3.task(env_id).ID.removeprefix(sb3.NAMESPACE)
        model_name = Path(drive or "generic").name
        out = Path("out", f"{name}-{model_name}-{algorithm or 'PPO'}-{seed or 0}")
    found = checkpoint.numbered(out)
    if resume and not found:
        raise ValueError(f"no checkpoint in {out}: leave out --resume to begin there")
    if found and not resume:
        raise ValueError(
            f"{out} has a run already: --resume continues it, another --out begins a new one"
        )
    last = found[-1] if found else None
    run = _continued(last, env_id, asked, console) if last else _run(env_id, asked, settings)
    with _OneThread():
        return _train(run, last, out, int(steps), checkpoint_every, evaluate_every, progress,
                      console)  # fmt: skip


class _OneThread:
    """For nets as small as these, a second thread of torch costs more than it brings."""

    def __enter__(self):
        self.before = torch.get_num_threads()
        torch.set_num_threads(1)

    def __exit__(self, *_):
        torch.set_num_threads(self.before)


def _train(
    run: Run, last: Path | None, out: Path, steps: int, checkpoint_every: int,
    evaluate_every: int, progress: bool, console: Console,
) -> tuple[Score, Score]:  # fmt: skip
    env, judged = run.vector(run.envs), run.vector(EPISODES)
    settings = dict(run.hyperparameters)
    if settings.pop("normalize"):
        judged = VecNormalize(judged, training=False, norm_reward=False)
        env = (
            VecNormalize.load(str(last / checkpoint.STATISTICS), env)
            if last
            else VecNormalize(env, gamma=settings["gamma"])
        )
    kind = ALGORITHMS[run.algorithm]
    evaluation = Evaluation(judged, run, out, evaluate_every, console)
    if last:
        model = kind.load(last / checkpoint.MODEL, env, device="cpu")
        # not the episodes of the beginning once more
        seeds = np.random.SeedSequence([run.seed, model.num_timesteps])
        model.set_random_seed(int(seeds.generate_state(1)[0]) % 2**31)
        if (last / checkpoint.REPLAY).is_file():
            model.load_replay_buffer(last / checkpoint.REPLAY)
        evaluation.go_on(model.num_timesteps)
        checkpoint.tidy(out)
        console.print(f"{run.env_id}: from step {model.num_timesteps} on")
    else:
        try:
            model = kind("MlpPolicy", env, seed=run.seed, device="cpu", **settings)
        except TypeError as error:
            raise ValueError(f"hyper-parameters of {run.algorithm}: {error}") from None
    out.mkdir(parents=True, exist_ok=True)
    model.set_logger(_logger(out, model.num_timesteps))
    callbacks = [evaluation, Checkpoints(run, out, checkpoint_every)]
    remaining = steps - model.num_timesteps
    try:
        if remaining > 0:
            model.learn(
                remaining, callbacks, reset_num_timesteps=not last,
                progress_bar=progress and find_spec("tqdm") is not None,
            )  # fmt: skip
            checkpoint.save_numbered(model, asdict(run), out)
        if isinstance(judged, VecNormalize):
            judged.obs_rms = env.obs_rms
        scores = score(model, judged), score(HoldStill(env.action_space.shape[0]), judged)
    finally:
        model.logger.close()
        env.close()
        judged.close()
    return scores


def _logger(out: Path, steps: int) -> Logger:
    formats: list[Any] = [ContinuedCsv(out / "progress.csv", steps)]
    if find_spec("tensorboard") is not None:
        formats.append(TensorBoardOutputFormat(str(out)))
    return Logger(str(out), formats)


def run(env_id: str, out: Path | None, console: Console, **options: Any) -> int:
    """The command; -> exit status."""
    try:
        scores = train(env_id, out=out, console=console, **options)
    except KeyboardInterrupt:
        console.print("the same command with --resume continues from the last checkpoint")
        raise
    console.print(f"trained policy: {scores[0]}; holding still: {scores[1]}")
    return 0
