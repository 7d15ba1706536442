"""A request for a training, checked before stable-baselines3 is loaded, which takes seconds."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

from ...drive.model.model import load
from ...envs.environment.registry import short, task
from ...envs.environment.servo_env import ServoEnv
from . import hyperparameters

# Arguments that, if given, must equal those of the run that is continued.
SAME = ("drive", "algorithm", "seed", "envs", "arguments", "residual", "bounds", "demonstrate",
        "device")


@dataclass(frozen=True)
class Training:
    """A request for a training.

    An argument of None takes the default in parentheses. A run that is resumed, or starts from the
    weights of another, takes it from there.

    Args:
        env: any task, by its id or class, see `servogym.envs.environment.registry.task`.
        steps: total steps of all environments from the beginning of the run.
        out: folder of the run; by default ``out/ENV-DRIVE-ALGORITHM-SEED``.
        resume: whether to continue from the latest checkpoint.
        drive: drive model (generic).
        algorithm: PPO or SAC (PPO).
        seed: seed of environments, weights and actions (0).
        envs: number of environments; by default that of the hyper-parameters.
        arguments: further arguments of the environment in JSON's types, with `max_episode_steps`.
        settings: hyper-parameters of a new run that differ from the table.
        residual: a policy whose actions are corrected.
        bounds: the largest correction of each component of an action, 0..1.
        start: a training or a checkpoint with whose weights this run begins; it also gives every
            argument that is None here.
        demonstrate: a policy that is imitated in all `steps`, without rewards.
        device: warp device on which the training environments are stepped, "cuda" or "cpu";
            evaluations stay on the CPU.
        checkpoint_every: steps between checkpoints.
        evaluate_every: steps between evaluations; a shorter run is evaluated at its end.

    Raises:
        ValueError: an argument is invalid; the message names it.
    """

    env: str | type[ServoEnv]
    steps: int = hyperparameters.STEPS
    out: Path | None = None
    resume: bool = False
    drive: str | None = None
    algorithm: str | None = None
    seed: int | None = None
    envs: int | None = None
    arguments: Mapping[str, Any] | None = None
    settings: Mapping[str, Any] | None = None
    residual: str | None = None
    bounds: Sequence[float] | None = None
    start: Path | None = None
    demonstrate: str | None = None
    device: str | None = None
    checkpoint_every: int = 50_000
    evaluate_every: int = 25_000
    task: type[ServoEnv] = field(init=False, repr=False)

    def __post_init__(self):
        object.__setattr__(self, "task", task(self.env))
        if self.drive is not None:
            load(self.drive)
        hyperparameters.counted({n: getattr(self, n) for n in hyperparameters.OF_A_RUN})
        if self.resume and self.start is not None:
            raise ValueError(
                "--start is for a new run, --resume goes on with one: give one of them"
            )
        others = (
            self.resume,
            self.start,
            self.residual,
            self.device,
            self.algorithm not in (None, "PPO"),
        )
        if self.demonstrate and any(others):
            raise ValueError(
                f"--demonstrate {self.demonstrate} is for a new run of PPO, done in one go, on the "
                "cores: leave out --resume, --start, --residual, --device and --algorithm"
            )
        if self.resume and self.settings:
            raise ValueError(
                f"{', '.join(self.settings)}: the hyper-parameters of a run stay as they are, "
                "leave out --setting, or begin a new run with --start"
            )

    @property
    def given(self) -> dict[str, Any]:
        """Return the given arguments that a checkpoint also states, in JSON's types."""
        values = {name: getattr(self, name) for name in SAME}
        if self.arguments is not None:
            values["arguments"] = json.loads(json.dumps(dict(self.arguments)))
        if self.bounds is not None:
            values["bounds"] = [float(bound) for bound in self.bounds]
        given = {name: value for name, value in values.items() if value is not None}
        return {"env_id": self.task.ID, **given}

    @property
    def folder(self) -> Path:
        """Return the folder of the run."""
        if self.out is not None:
            return self.out
        name, drive = short(self.task.ID).replace("/", "-"), Path(self.drive or "generic").name
        parts = [name, drive, self.algorithm or "PPO", str(self.seed or 0)]
        return Path("out", "-".join(parts if self.residual is None else [*parts, "residual"]))


OPTIONS = tuple(each.name for each in fields(Training) if each.init)
