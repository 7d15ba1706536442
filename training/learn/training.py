"""What is asked of a training. Checked before stable-baselines3 is loaded, which takes seconds."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

from ...drive.model.model import load
from ...envs.environment.registry import short, task
from ...envs.environment.servo_env import ServoEnv
from . import hyperparameters

# what a run that goes on has to have as well, where it is given
SAME = ("drive", "algorithm", "seed", "envs", "arguments", "residual", "bounds", "demonstrate",
        "device")


@dataclass(frozen=True)
class Training:
    """A training that is asked for.

    What is None is the default in parentheses; in a run that goes on, or that starts with the
    weights of another, it is as it was there.

    Args:
        env: any task, by its id or class, see `servogym.envs.environment.registry.task`.
        steps: of all environments together, from the beginning of the run.
        out: folder of the run; ``out/ENV-DRIVE-ALGORITHM-SEED`` if not given.
        resume: go on from the latest checkpoint.
        drive: drive model (generic).
        algorithm: PPO or SAC (PPO).
        seed: of environments, weights and actions (0).
        envs: number of environments; if not given, that of the hyper-parameters.
        arguments: others of the environment, in JSON's types; `max_episode_steps` too.
        settings: hyper-parameters that differ from the table, for a new run.
        residual: a policy whose actions are corrected by what is learned.
        bounds: the largest correction of each component of an action, 0..1.
        start: a training or a checkpoint whose weights this run begins with; arguments that are not
            given are as they were there, one by one.
        demonstrate: a policy that is imitated in all `steps`; rewards are not looked at.
        device: of warp, on which the environments it learns in are stepped, "cuda" or "cpu"; it is
            judged on the cores.
        checkpoint_every: steps from one to the next.
        evaluate_every: steps from one to the next; a shorter run is evaluated at its end.

    Raises:
        ValueError: naming what is wrong.
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
        """What a checkpoint says too, as far as it is given, in JSON's types."""
        values = {name: getattr(self, name) for name in SAME}
        if self.arguments is not None:
            values["arguments"] = json.loads(json.dumps(dict(self.arguments)))
        if self.bounds is not None:
            values["bounds"] = [float(bound) for bound in self.bounds]
        given = {name: value for name, value in values.items() if value is not None}
        return {"env_id": self.task.ID, **given}

    @property
    def folder(self) -> Path:
        """Of the run."""
        if self.out is not None:
            return self.out
        name, drive = short(self.task.ID).replace("/", "-"), Path(self.drive or "generic").name
        parts = [name, drive, self.algorithm or "PPO", str(self.seed or 0)]
        return Path("out", "-".join(parts if self.residual is None else [*parts, "residual"]))


OPTIONS = tuple(each.name for each in fields(Training) if each.init)
