"""The setup of an environment: a task, a drive model and arguments.

The task is looked up by its id once, when a command or a user's function names it. All other code
gets a `Setup`.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from ..envs.engine.checks import words
from ..envs.environment.registry import short, task
from ..envs.environment.servo_env import ServoEnv


class ArgumentError(ValueError):
    """An unknown argument of a task."""


@dataclass(frozen=True)
class Setup:
    """A task with the drive and arguments of its environments; `Setup.of` looks up an id.

    Args:
        task: class of the task.
        drive: drive model, by name or folder.
        arguments: further arguments of the environment.
        name: the task's id as the user wrote it, for pages, commands and other processes.
        parameter_file: stored parameters that the drive of a linear axis loads.
    """

    task: type[ServoEnv]
    drive: str = "generic"
    arguments: Mapping[str, Any] = field(default_factory=dict)
    name: str = ""
    parameter_file: str | None = None

    @classmethod
    def of(
        cls, env: str | type[ServoEnv], drive: str = "generic",
        arguments: Mapping[str, Any] | None = None,
    ) -> "Setup":
        """The setup of a task by its id or class. Raises ValueError for an unknown id."""
        kind = task(env)
        name = env if isinstance(env, str) else short(kind.ID)
        return cls(kind, drive, dict(arguments or {}), name)

    def __str__(self) -> str:
        """``"LinearAxis-v0, drive generic"``."""
        return f"{self.name}, drive {self.drive}"

    @property
    def stem(self) -> str:
        """Task and drive as a part of the name of a file or folder."""
        return f"{short(self.task.ID).replace('/', '-')}-{Path(self.drive).name}"

    def having(self, arguments: Mapping[str, Any], drive: str = "") -> "Setup":
        """Return a copy with other arguments of the environment, and another drive if given."""
        return replace(self, arguments=dict(arguments), drive=drive or self.drive)

    def make(self) -> ServoEnv:
        """Make an environment. Raises ValueError for an argument that the task refuses."""
        try:
            env = self.task(drive=self.drive, **self.arguments)
        except TypeError as error:
            raise ArgumentError(f"--argument: {words(error)}") from None
        self.prepare(env)
        return env

    def prepare(self, env: ServoEnv) -> None:
        """Have the drives of an environment load the stored parameters, if there are any."""
        if self.parameter_file is not None:
            env.use_parameter_file(self.parameter_file)

    @cached_property
    def ranges(self) -> Mapping[str, Any]:
        """The parameters that the task draws at random for an episode: value or range by name."""
        env = self.make()
        env.close()
        return dict(env.randomisation.ranges)
