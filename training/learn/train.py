"""`servogym train`: PPO or SAC of stable-baselines3; a run can be interrupted at any time.

The folder of a run has `progress.csv`, `evaluations.npz` (on the same episodes each time),
`checkpoints/`, and `best/` with the policy of the best evaluation.
"""

import inspect
import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from . import sb3  # first, because it says what has to be installed

# isort: split
from stable_baselines3 import PPO, SAC
from stable_baselines3.common.callbacks import ProgressBarCallback
from stable_baselines3.common.logger import Logger, TensorBoardOutputFormat
from stable_baselines3.common.vec_env import VecEnv, VecMonitor, VecNormalize
from torch import no_grad
from torch.optim import Adam, Optimizer

from ...drive.model.names import hint
from ...envs.engine.checks import words
from ..policies.trained import saved, zipped
from ..report import interrupted
from . import checkpoint, hyperparameters, imitate, state
from .evaluation import EPISODES, EvaluationCallback, HoldStill, Score, score
from .hyperparameters import CONSECUTIVE, INDEPENDENT
from .training import Training

DEFAULTS: dict[str, Any] = {"drive": "generic", "algorithm": "PPO", "seed": 0, "arguments": {}}
ALGORITHMS: dict[str, type[PPO] | type[SAC]] = {"PPO": PPO, "SAC": SAC}


@dataclass(frozen=True)
class Run:
    """The description of a training run, as each of its checkpoints states it.

    Args:
        env_id: id of the environment.
        drive: drive model, by name or folder.
        algorithm: PPO or SAC.
        seed: seed of environments, weights and actions.
        envs: number of environments.
        arguments: further arguments of the environment, in JSON's types.
        hyperparameters: as in `servogym.training.learn.hyperparameters`.
        residual: a policy whose actions are corrected; None if the network acts alone.
        bounds: the largest correction of each component of an action, 0..1.
        start: description of the checkpoint with whose weights it began; None for random weights.
        demonstrate: a policy that is imitated; None to learn from rewards.
        device: warp device on which the training environments are stepped; None for the CPU.

    Raises:
        ValueError: an argument is out of range; the message has its value and range.
    """

    env_id: str
    drive: str
    algorithm: str
    seed: int
    envs: int
    arguments: dict[str, Any]
    hyperparameters: dict[str, Any]
    residual: str | None = None
    bounds: list[float] | None = None
    start: dict[str, Any] | None = None
    demonstrate: str | None = None
    device: str | None = None

    def __post_init__(self):
        hyperparameters.counted({"seed": self.seed, "envs": self.envs})
        saved.judged_apart("--seed", self.seed, self.envs)

    def vector(self, envs: int, device: str | None = None, streams: str = CONSECUTIVE) -> VecEnv:
        """Return environments of this run. Raises ValueError as the environment does."""
        try:
            made = sb3.make(
                self.env_id, envs, drive=self.drive, residual=self.residual, bounds=self.bounds,
                device=device, **self.arguments,
            )
            made.independent = streams == INDEPENDENT
            return VecMonitor(made)
        except TypeError as error:
            raise ValueError(f"arguments of {self.env_id}: {words(error)}") from None


def _run(training: Training) -> Run:
    """Return a new run from the request and the defaults."""
    given, algorithm = training.given, training.algorithm or "PPO"
    residual = bool(training.residual)
    table = hyperparameters.of(training.task, algorithm, training.envs, residual=residual)
    chosen = hyperparameters.divided(table, training.settings or {})
    return Run(**DEFAULTS | given | {"envs": chosen.pop("n_envs"), "hyperparameters": chosen})


def _started(training: Training, folder: Path) -> Run:
    """Return a new run that begins with the weights, and other arguments, of a checkpoint.

    A correction may be put on another policy than before, by name.

    Raises ValueError if the request changes what the weights mean: task, algorithm, bounds, or
    whether they are a correction.
    """
    about, given = saved.read(folder), training.given
    fixed = ["env_id", "algorithm", "bounds", *(["residual"] if not about.get("residual") else [])]
    for name in fixed:
        if name in given and given[name] != about.get(name):
            raise ValueError(
                f"--start {folder} has {name} = {about.get(name)!r}, asked for is "
                f"{given[name]!r}: leave it out, or start from another checkpoint"
            )
    table = {"n_envs": training.envs or about["envs"]} | about["hyperparameters"]
    table.pop(hyperparameters.COMPILED, None)  # the weights can be used all the same
    chosen = hyperparameters.divided(table, training.settings or {})
    kept = "env_id", "drive", "algorithm", "residual", "bounds"
    then = {name: about[name] for name in kept if name in about}
    own: dict[str, Any] = {
        "arguments": about["arguments"] | given.get("arguments", {}), "start": about,
        "envs": chosen.pop("n_envs"), "hyperparameters": chosen,
    }
    return Run(**DEFAULTS | then | given | own)


def _continued(training: Training, folder: Path, console: Console) -> Run:
    """Return the run of a checkpoint. Raises ValueError if the request differs from it."""
    about = saved.read(folder)
    for name, value in training.given.items():
        if value != about.get(name):
            raise ValueError(
                f"checkpoint {folder} has {name} = {about.get(name)!r}, asked for is {value!r}: "
                "leave it out, or begin a new run with another --out"
            )
    for name, present in checkpoint.versions().items():
        then = about["versions"].get(name)
        if then == present:
            continue
        if name in checkpoint.DECIDING:
            raise ValueError(
                f"checkpoint {folder} was made with {name} {then}, this is {present}: "
                "go on with that version, or begin a new run with another --out"
            )
        console.print(f"note: the checkpoint was made with {name} {then}, this is {present}")
    kept = {name: about[name] for name in Run.__dataclass_fields__ if name in about}
    if about["hyperparameters"].get(hyperparameters.COMPILED):
        raise ValueError(
            f"checkpoint {folder} was trained by the compiled PPO of an earlier version: begin a "
            "new run with --start, which takes its weights"
        )
    plain = {n: v for n, v in about["hyperparameters"].items() if n != hyperparameters.COMPILED}
    return Run(**kept | {"hyperparameters": plain})


def train(
    training: Training, console: Console | None = None, *, progress: bool = False
) -> tuple[Score, Score]:
    """Train a policy -> score of it and of actions of 0, on the fixed episodes.

    Args:
        training: what is asked for.
        console: where to report.
        progress: show a bar, where tqdm is installed.

    Raises:
        ValueError: naming what is wrong; where the folder has a run already, or another one.
    """
    console, out = console or Console(quiet=True), training.folder
    found = checkpoint.numbered(out)
    if training.resume and not found:
        raise ValueError(f"no checkpoint in {out}: leave out --resume to begin there")
    if found and not training.resume:
        raise ValueError(
            f"{out} has a run already: --resume continues it, another --out begins a new one"
        )
    last, start = found[-1] if found else None, training.start and saved.folder(training.start)
    if last:
        run = _continued(training, last, console)
    elif start:
        run = _started(training, start)
    else:
        run = _run(training)
    with checkpoint.alone(out), sb3.one_thread():
        env, judged, settings = _environments(run)
        model = _model(run, env, settings)
        if start and run.start:
            state.begin(model, zipped.of(start), run.start["steps"])
        evaluation = EvaluationCallback(judged, asdict(run), out, training.evaluate_every, console)
        if last:
            _go_on(run, model, evaluation, last, console)
        model.cpu_begin = time.process_time() - (saved.read(last)["cpu_seconds"] if last else 0.0)
        out.mkdir(parents=True, exist_ok=True)
        model.set_logger(_logger(out, model.num_timesteps))
        try:
            if training.steps > model.num_timesteps:
                if run.demonstrate:
                    _imitate(run, model, evaluation, training)
                else:
                    _learn(run, model, evaluation, training, console, progress)
            if isinstance(judged, VecNormalize) and isinstance(env, VecNormalize):
                judged.obs_rms = env.obs_rms
            scores = score(model, judged), score(HoldStill(env.action_space), judged)
            best = saved.read(out / "best") if (out / "best").is_dir() else {}
            if best and best["steps"] < model.num_timesteps:
                console.print(
                    f"{out} plays the best evaluated, {best['mean_reward']:.1f} after "
                    f"{best['steps']} steps; the last is {checkpoint.numbered(out)[-1]}"
                )
        finally:
            model.logger.close()
            env.close()
            judged.close()
    return scores


def _environments(run: Run) -> tuple[VecEnv, VecEnv, dict[str, Any]]:
    """Return environments for training and evaluation, and the settings of the algorithm."""
    settings = dict(run.hyperparameters)
    streams = settings.pop("streams", CONSECUTIVE)  # older checkpoints lack it
    env, judged = run.vector(run.envs, run.device, streams), run.vector(EPISODES)
    settings["learning_rate"] = sb3.learning_rate(settings["learning_rate"])
    if settings.pop("normalize"):
        judged = VecNormalize(judged, training=False, norm_reward=False)
        env = VecNormalize(env, gamma=settings["gamma"])
    return env, judged, settings


def _model(run: Run, env: VecEnv, settings: Mapping[str, Any]) -> Any:
    """Return the algorithm. Raises ValueError for settings that it does not take."""
    kind = ALGORITHMS[run.algorithm]
    try:
        return kind("MlpPolicy", env, seed=run.seed, device="cpu", **settings)
    except Exception as error:  # SB3 and torch raise anything
        known = inspect.signature(kind).parameters
        for name in settings.keys() - known.keys():
            raise ValueError(
                f"{run.algorithm} has no hyper-parameter {name!r}: {hint(name, known)}"
            ) from None
        raise ValueError(f"hyper-parameters of {run.algorithm}: {error}") from None


def _go_on(
    run: Run, model: Any, evaluation: EvaluationCallback, last: Path, console: Console
) -> None:
    """Restore the run at its last checkpoint."""
    state.load(model, last)
    # new seeds, so that the first episodes are not repeated
    seeds = np.random.SeedSequence([run.seed, model.num_timesteps])
    model.set_random_seed(int(seeds.generate_state(1)[0]) % 2**31)
    if isinstance(model, SAC):
        if (last / state.REPLAY).is_file():
            state.load_replay(model, last)
        else:  # only the latest checkpoint had it
            console.print(f"note: {last} has no {state.REPLAY}, it is filled anew")
    evaluation.go_on(model.num_timesteps)
    checkpoint.tidy(evaluation.out)
    console.print(f"{run.env_id}: from step {model.num_timesteps} on")


def _imitate(run: Run, model: Any, evaluation: EvaluationCallback, training: Training) -> None:
    """Learn from demonstrations in one go. Raises ValueError for a run that is resumed."""
    if training.resume:
        raise ValueError(
            f"{training.folder} was learned from demonstrations, in one go: --start "
            f"{training.folder} goes on by rewards, in another --out"
        )
    shown = bool(run.arguments.get("previous_action"))
    given = model, str(run.demonstrate), training.steps - model.num_timesteps, run.seed
    for _ in imitate.learn(*given, previous_action=shown):
        evaluation.now(model)
    checkpoint.save_numbered(model, asdict(run), training.folder)


def _learn(
    run: Run, model: Any, evaluation: EvaluationCallback, training: Training, console: Console,
    progress: bool,
) -> None:
    """Learn from rewards; Ctrl-C leaves a checkpoint."""
    out, every = training.folder, training.checkpoint_every
    callbacks: list[Any] = [evaluation, checkpoint.Checkpoints(asdict(run), out, every)]
    bar = ProgressBarCallback() if progress and find_spec("tqdm") is not None else None
    callbacks += [bar] if bar else []
    try:
        model.learn(
            training.steps - model.num_timesteps, callbacks, reset_num_timesteps=not training.resume
        )
    except BaseException as error:
        if bar and hasattr(bar, "pbar"):  # without this it may wait for ever at the end
            bar.pbar.close()
        if not interrupted(error):
            raise
        checkpoint.save_numbered(model, asdict(run), out)
        console.print(
            f"a checkpoint of {model.num_timesteps} steps is kept in {out}: "
            "the same command with --resume goes on from there"
        )
        raise KeyboardInterrupt from None
    checkpoint.save_numbered(model, asdict(run), out)


def _logger(out: Path, steps: int) -> Logger:
    formats: list[Any] = [checkpoint.ContinuedCsv(out / "progress.csv", steps)]
    if find_spec("tensorboard") is not None:
        formats.append(TensorBoardOutputFormat(str(out)))
    return Logger(str(out), formats)


def _without_compiler() -> None:
    """Keep optimizers from importing torch's compiler, which takes 1.7 s of each command.

    They import it only to mark methods as not compiled. Callers of `train` are not affected,
    because they may use the compiler. Adam's step, which PPO uses, is unwrapped and runs without
    gradients.
    """
    Adam.step = no_grad()(inspect.unwrap(Adam.step))
    for name in ("add_param_group", "zero_grad", "state_dict", "load_state_dict"):
        plain = getattr(getattr(Optimizer, name), "__wrapped__", None)
        if plain is not None:
            vars(plain).setdefault("__dynamo_disable", plain)


def run(training: Training, console: Console, *, progress: bool = False) -> int:
    """Run the command; -> exit status."""
    _without_compiler()
    scores = train(training, console, progress=progress)
    still = f"{training.residual} alone" if training.residual else "holding still"
    console.print(f"trained policy: {scores[0]}; {still}: {scores[1]}")
    return 0
