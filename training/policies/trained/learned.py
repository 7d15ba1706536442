"""A trained policy, from the folder of a checkpoint or of a run of `servogym train`."""

from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from ....envs.environment.servo_env import ServoEnv
from . import saved, weights, zipped
from .residual import baseline, checked, corrected
from .saved import ABOUT, STATISTICS, ZIP, read


@lru_cache(maxsize=32)
def _opened(place: Path, stamp: tuple[int, ...]) -> tuple[Any, weights.Weights, Any]:
    """Return the description, weights and network of a checkpoint, shared by all its players."""
    if place.suffix == ZIP:
        arrays, kind = zipped.read(place)
        return {"arguments": {}}, arrays, arrays.played(kind)
    about, arrays = read(place), zipped.of(place)
    return about, arrays, arrays.actor(about)


def _stamp(place: Path) -> tuple[int, ...]:
    """Return the modification time by which a rewritten checkpoint is recognised (ns)."""
    files = (place / ABOUT, place / weights.WEIGHTS, place, place.with_name(STATISTICS))
    return tuple(file.stat().st_mtime_ns for file in files if file.is_file())


class Learned:
    """The best policy of a run, or that of a checkpoint, without exploration.

    A policy that was trained with a history keeps the history itself if the environment has none. A
    correction of another policy (`servogym train --residual`) makes that policy as well.

    Args:
        folder: folder of a run, with `best/`, or of one checkpoint; or `model.zip` of
            stable-baselines3, which does not state its environment.
        env: environment in which it acts.
        seed: seed of the policy that it corrects.

    Raises:
        ValueError: there is no checkpoint, or it is of another environment or has other spaces.
        ImportError: its network needs stable-baselines3; the message has the command.
    """

    def __init__(self, folder: Path, env: ServoEnv, seed: int = 0):
        folder = folder if folder.suffix == ZIP else saved.folder(folder)
        about, self._weights, self._actor = _opened(folder, _stamp(folder))
        if about.get("env_id", env.ID) != env.ID:
            raise ValueError(
                f"checkpoint {folder} was trained for {about['env_id']}, not for {env.ID}: "
                "play it there, or train one for this environment"
            )
        arguments = about["arguments"]
        self._history = int(arguments.get("history", 1))
        self._previous_action = bool(arguments.get("previous_action", False))
        (shown,) = env.observation_space.shape  # type: ignore[misc]
        wanted, _ = self._weights.shape
        if wanted == shown:  # the environment keeps the history
            self._history, self._previous_action = 1, False
        actions = env.action_space.shape[0]  # type: ignore[index]
        if wanted != self._history * shown + self._previous_action * actions:
            raise ValueError(
                f"checkpoint {folder} sees {wanted} numbers, this environment shows {shown}: "
                f"make it with the arguments {arguments}"
            )
        self._seen_actions = actions if self._previous_action else 0
        self._action = np.zeros(actions, np.float32)
        self._frames: list[np.ndarray] = []
        residual = about.get("residual")
        self._base = baseline(residual, env, seed) if residual else None
        self._bounds = checked(about["bounds"], env) if residual else np.ones(actions, np.float32)

    def reset(self, observation: np.ndarray, info: dict[str, Any]) -> None:
        """Begin an episode with the first observation as its history."""
        self._frames = [observation] * self._history
        self._action = np.zeros_like(self._action)
        if self._base is not None:
            self._base.reset(observation, info)

    def act(self, observation: np.ndarray) -> np.ndarray:
        """Return the mean action."""
        self._frames = [observation, *self._frames[: self._history - 1]]
        seen = np.concatenate([*self._frames, self._action[: self._seen_actions]])
        self._action = self._actor(seen)
        if self._base is not None:
            self._action = corrected(self._base.act(observation), self._bounds, self._action)
        return self._action
