"""`servogym train`: PPO or SAC of stable-baselines3 on an environment, to be interrupted at will.

A run has a folder: `progress.csv`, `evaluations.npz` (the same episodes each time), `checkpoints/`
and `best/`, the policy of the best evaluation.
"""

import inspect
import json
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from . import sb3  # first: tells what has to be installed

# isort: split
from stable_baselines3 import PPO, SAC
from stable_baselines3.common.callbacks import ProgressBarCallback
from stable_baselines3.common.logger import Logger, TensorBoardOutputFormat
from stable_baselines3.common.vec_env import VecEnv, VecMonitor, VecNormalize
from torch import no_grad
from torch.optim import Adam, Optimizer

from ...drive.model.names import hint
from ...envs.engine.checks import words
from ...envs.environment.registry import short, task
from ...envs.environment.servo_env import ServoEnv
from ..policies.trained import saved, weights, zipped
from ..report import interrupted
from . import checkpoint, hyperparameters, imitate, state
from .evaluation import EPISODES, EvaluationCallback, HoldStill, Score, score
from .hyperparameters import CONSECUTIVE, INDEPENDENT

ALGORITHMS: dict[str, type[PPO] | type[SAC]] = {"PPO": PPO, "SAC": SAC}


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
        hyperparameters: as in `servogym.training.learn.hyperparameters`.
        residual: a policy whose actions are corrected; none: the actions are the policy's own.
        bounds: the largest correction of each component of an action, 0..1.
        start: what the checkpoint says whose weights it began with; none: random ones.
        demonstrate: a policy that shows what to do, and is imitated; none: rewards are sought.
        device: of warp, on which the environments it learns in are stepped; none: on the cores.

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
    residual: str | None = None
    bounds: list[float] | None = None
    start: dict[str, Any] | None = None
    demonstrate: str | None = None
    device: str | None = None

    def __post_init__(self):
        hyperparameters.counted({"seed": self.seed, "envs": self.envs})
        saved.judged_apart("--seed", self.seed, self.envs)

    def vector(self, envs: int, device: str | None = None, streams: str = CONSECUTIVE) -> VecEnv:
        """Environments of this run. Raises ValueError as the environment does."""
        try:
            made = sb3.make(
                self.env_id, envs, drive=self.drive, residual=self.residual, bounds=self.bounds,
                device=device, **self.arguments,
            )  # fmt: skip
            made.independent = streams == INDEPENDENT
            return VecMonitor(made)
        except TypeError as error:
            raise ValueError(f"arguments of {self.env_id}: {words(error)}") from None


def _run(
    env_id: str | type[ServoEnv], asked: Mapping[str, Any], settings: Mapping[str, Any] | None
) -> Run:
    """A new run of what is asked for, and the defaults."""
    kind = task(env_id)
    algorithm = asked["algorithm"] or "PPO"
    residual = asked["residual"]
    table = hyperparameters.of(kind, algorithm, asked["envs"], residual=bool(residual))
    chosen = hyperparameters.divided(table, settings or {})
    return Run(
        kind.ID, asked["drive"] or "generic", algorithm, asked["seed"] or 0,
        chosen.pop("n_envs"), asked["arguments"] or {}, chosen, residual, asked["bounds"],
        demonstrate=asked["demonstrate"], device=asked["device"],
    )  # fmt: skip


def _started(
    folder: Path,
    env_id: str | type[ServoEnv],
    asked: Mapping[str, Any],
    settings: Mapping[str, Any] | None,
) -> Run:
    """A new run that begins with the weights of a checkpoint: what is not given is as it was there.

    A correction may go on top of another policy than the one it began with, by name.

    Raises ValueError where what the weights mean would be another: task, algorithm, bounds, a
    correction or not.
    """
    about = saved.read(folder)
    wanted = {"env_id": task(env_id).ID, **asked}
    fixed = ["env_id", "algorithm", "bounds", *(["residual"] if not about.get("residual") else [])]
    for name in fixed:
        if wanted[name] is not None and wanted[name] != about.get(name):
            raise ValueError(
                f"--start {folder} has {name} = {about.get(name)!r}, asked for is "
                f"{wanted[name]!r}: leave it out, or start from another checkpoint"
            )
    table = {"n_envs": asked["envs"] or about["envs"]} | about["hyperparameters"]
    table.pop(hyperparameters.COMPILED, None)  # its weights are weights
    chosen = hyperparameters.divided(table, settings or {})
    return Run(
        about["env_id"], asked["drive"] or about["drive"], about["algorithm"], asked["seed"] or 0,
        chosen.pop("n_envs"), about["arguments"] | (asked["arguments"] or {}), chosen,
        asked["residual"] or about.get("residual"), about.get("bounds"), about,
        device=asked["device"],
    )  # fmt: skip


def _continued(
    folder: Path, env_id: str | type[ServoEnv], asked: Mapping[str, Any], console: Console
) -> Run:
    """The run of a checkpoint. Raises ValueError where something else is asked for."""
    about = saved.read(folder)
    for name, value in {"env_id": task(env_id).ID, **asked}.items():
        if value is not None and value != about.get(name):
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
    env_id: str | type[ServoEnv],
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
    residual: str | None = None,
    bounds: Sequence[float] | None = None,
    start: Path | None = None,
    demonstrate: str | None = None,
    device: str | None = None,
    checkpoint_every: int = 50_000,
    evaluate_every: int = 25_000,
    progress: bool = False,
    console: Console | None = None,
) -> tuple[Score, Score]:
    """Train a policy -> score of it and of actions of 0, on the fixed episodes.

    Args:
        env_id: of any task, see `servogym.envs.environment.registry.task`, or its class.
        steps: of all environments together, from the beginning of the run.
        out: folder of the run; ``out/ENV-DRIVE-ALGORITHM-SEED`` if not given.
        resume: go on from the latest checkpoint; what is not given is as it was.
        drive: drive model (generic).
        algorithm: PPO or SAC (PPO).
        seed: of environments, weights and actions (0).
        envs: number of environments; if not given, that of the hyper-parameters.
        arguments: others of the environment, in JSON's types; `max_episode_steps` too.
        settings: hyper-parameters that differ from the table, for a new run.
        residual: a policy whose actions are corrected by what is learned.
        bounds: the largest correction of each component of an action, 0..1.
        start: a training or a checkpoint whose weights this run begins with; what is not given is
            as it was there, arguments one by one.
        demonstrate: a policy that is imitated in all `steps`; rewards are not looked at.
        device: of warp, on which the environments it learns in are stepped, "cuda" or "cpu"; it is
            judged on the cores.
        checkpoint_every: steps from one to the next.
        evaluate_every: steps from one to the next; a shorter run is evaluated at its end.
        progress: show a bar, where tqdm is installed.
        console: where to tell.

    Raises:
        ValueError: naming what is wrong; where `out` has a run already, or another one.
    """
    console = console or Console(quiet=True)
    hyperparameters.counted({
        "steps": steps, "checkpoint_every": checkpoint_every, "evaluate_every": evaluate_every,
        "envs": envs, "seed": seed,
    })  # fmt: skip
    arguments = None if arguments is None else json.loads(json.dumps(dict(arguments)))
    asked = {"drive": drive, "algorithm": algorithm, "seed": seed, "envs": envs,
             "arguments": arguments, "residual": residual,
             "bounds": None if bounds is None else [float(bound) for bound in bounds],
             "demonstrate": demonstrate, "device": device,
    }  # fmt: skip
    if out is None:
        name = short(task(env_id).ID).replace("/", "-")
        parts = [name, Path(drive or "generic").name, algorithm or "PPO", str(seed or 0)]
        out = Path("out", "-".join(parts if residual is None else [*parts, "residual"]))
    found = checkpoint.numbered(out)
    if resume and not found:
        raise ValueError(f"no checkpoint in {out}: leave out --resume to begin there")
    if found and not resume:
        raise ValueError(
            f"{out} has a run already: --resume continues it, another --out begins a new one"
        )
    if resume and start is not None:
        raise ValueError("--start is for a new run, --resume goes on with one: give one of them")
    if demonstrate and (resume or start or residual or device or algorithm not in (None, "PPO")):
        raise ValueError(
            f"--demonstrate {demonstrate} is for a new run of PPO, done in one go, on the cores: "
            "leave out --resume, --start, --residual, --device and --algorithm"
        )
    if resume and settings:
        raise ValueError(
            f"{', '.join(settings)}: the hyper-parameters of a run stay as they are, leave out "
            "--setting, or begin a new run with --start"
        )
    last = found[-1] if found else None
    if last:
        run, first = _continued(last, env_id, asked, console), None
    elif start is not None:
        start = saved.folder(start)
        run, first = _started(start, env_id, asked, settings), zipped.of(start)
    else:
        run, first = _run(env_id, asked, settings), None
    with checkpoint.alone(out), sb3.one_thread():
        return _train(run, last, out, int(steps), checkpoint_every, evaluate_every, progress,
                      console, first)  # fmt: skip


def _train(
    run: Run, last: Path | None, out: Path, steps: int, checkpoint_every: int,
    evaluate_every: int, progress: bool, console: Console, first: weights.Weights | None,
) -> tuple[Score, Score]:  # fmt: skip
    settings = dict(run.hyperparameters)
    streams = settings.pop("streams", CONSECUTIVE)  # an older one does not say it
    env, judged = run.vector(run.envs, run.device, streams), run.vector(EPISODES)
    settings["learning_rate"] = sb3.learning_rate(settings["learning_rate"])
    if settings.pop("normalize"):
        judged = VecNormalize(judged, training=False, norm_reward=False)
        env = VecNormalize(env, gamma=settings["gamma"])
    kind = ALGORITHMS[run.algorithm]
    model: Any
    try:
        model = kind("MlpPolicy", env, seed=run.seed, device="cpu", **settings)
    except Exception as error:  # SB3 and torch raise anything
        known = inspect.signature(kind).parameters
        for name in settings.keys() - known.keys():
            raise ValueError(
                f"{run.algorithm} has no hyper-parameter {name!r}: {hint(name, known)}"
            ) from None
        raise ValueError(f"hyper-parameters of {run.algorithm}: {error}") from None
    if first and run.start:
        state.begin(model, first, run.start["steps"])
    evaluation = EvaluationCallback(judged, asdict(run), out, evaluate_every, console)
    if last:
        state.load(model, last)
        # not the episodes of the beginning once more
        seeds = np.random.SeedSequence([run.seed, model.num_timesteps])
        model.set_random_seed(int(seeds.generate_state(1)[0]) % 2**31)
        if isinstance(model, SAC):
            if (last / state.REPLAY).is_file():
                state.load_replay(model, last)
            else:  # only the latest checkpoint had it
                console.print(f"note: {last} has no {state.REPLAY}, it is filled anew")
        evaluation.go_on(model.num_timesteps)
        checkpoint.tidy(out)
        console.print(f"{run.env_id}: from step {model.num_timesteps} on")
    model.cpu_begin = time.process_time() - (saved.read(last)["cpu_seconds"] if last else 0.0)
    out.mkdir(parents=True, exist_ok=True)
    model.set_logger(_logger(out, model.num_timesteps))
    callbacks = [evaluation, checkpoint.Checkpoints(asdict(run), out, checkpoint_every)]
    bar = ProgressBarCallback() if progress and find_spec("tqdm") is not None else None
    remaining = steps - model.num_timesteps
    try:
        if remaining > 0 and run.demonstrate:
            if last:
                raise ValueError(
                    f"{out} was learned from demonstrations, in one go: --start {out} goes on by "
                    "rewards, in another --out"
                )
            for _ in imitate.learn(
                model,
                run.demonstrate,
                steps,
                run.seed,
                previous_action=bool(run.arguments.get("previous_action")),
            ):
                evaluation.now(model)  # fmt: skip
            checkpoint.save_numbered(model, asdict(run), out)
        elif remaining > 0:
            try:
                model.learn(
                    remaining, [*callbacks, *([bar] if bar else [])], reset_num_timesteps=not last
                )
            except BaseException as error:
                if bar and hasattr(bar, "pbar"):  # or it may wait at the end, for ever
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
        if isinstance(judged, VecNormalize) and isinstance(env, VecNormalize):
            judged.obs_rms = env.obs_rms
        scores = score(model, judged), score(HoldStill(env.action_space), judged)
        best = saved.read(out / "best") if (out / "best").is_dir() else {}
        if best and best["steps"] < model.num_timesteps:
            console.print(
                f"{out} plays the best evaluated, {best['mean_reward']:.1f} after {best['steps']} "
                f"steps; the last is {checkpoint.numbered(out)[-1]}"
            )
    finally:
        model.logger.close()
        env.close()
        judged.close()
    return scores


def _logger(out: Path, steps: int) -> Logger:
    formats: list[Any] = [checkpoint.ContinuedCsv(out / "progress.csv", steps)]
    if find_spec("tensorboard") is not None:
        formats.append(TensorBoardOutputFormat(str(out)))
    return Logger(str(out), formats)


def _without_compiler() -> None:
    """Spare optimizers torch's compiler, which they import only to say that they are not compiled.

    That took 1.7 s of each command. Not done to who calls `train`, and may compile with torch.
    Adam's own step, which PPO takes, is unwrapped to what it computes, without gradients.
    """
    Adam.step = no_grad()(inspect.unwrap(Adam.step))
    for name in ("add_param_group", "zero_grad", "state_dict", "load_state_dict"):
        plain = getattr(getattr(Optimizer, name), "__wrapped__", None)
        if plain is not None:
            vars(plain).setdefault("__dynamo_disable", plain)


def run(env_id: str, out: Path | None, console: Console, **options: Any) -> int:
    """The command; -> exit status."""
    _without_compiler()
    scores = train(env_id, out=out, console=console, **options)
    still = f"{options['residual']} alone" if options.get("residual") else "holding still"
    console.print(f"trained policy: {scores[0]}; {still}: {scores[1]}")
    return 0
