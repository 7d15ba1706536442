"""A policy that was trained: the folder of a checkpoint, or of a run of `servogym train`."""

import pickle
from pathlib import Path
from typing import Any

import numpy as np

from ...envs.servo_env import ServoEnv

BEST = "best"


class Learned:
    """The best policy of a run, or that of a checkpoint, without exploration.

    One that was trained with a history keeps it itself where the environment shows none.

    Args:
        folder: of a run, with `best/`, or of one checkpoint.
        env: which it shall serve.

    Raises:
        ValueError: no checkpoint, or one of another environment or with other spaces.
        ImportError: stable-baselines3 is missing; the message has the command.
    """

    def __init__(self, folder: Path, env: ServoEnv):
        from .. import sb3  # noqa: F401, says what is missing
        from .. import checkpoint  # isort: skip
        import stable_baselines3

        if not (folder / checkpoint.ABOUT).is_file():
            folder = folder / BEST
        about = checkpoint.read(folder)
        if about["env_id"] != env.ID:
            raise ValueError(
                f"checkpoint {folder} was trained for {about['env_id']}, not for {env.ID}: "
                "take it to that environment, or train one"
            )
        algorithm = getattr(stable_baselines3, about["algorithm"])
        self._model = algorithm.load(folder / checkpoint.MODEL, device="cpu")
        arguments = about["arguments"]
        self._history = int(arguments.get("history", 1))
        self._previous_action = bool(arguments.get("previous_action", False))
        (wanted,), (shown,) = self._model.observation_space.shape, env.observation_space.shape  # type: ignore[misc]
        if wanted == shown:  # as the environment shows it
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
        self._statistics: Any = None
        if (folder / checkpoint.STATISTICS).is_file():
            with (folder / checkpoint.STATISTICS).open("rb") as file:
                self._statistics = pickle.load(file)

    def reset(self, observation: np.ndarray, info: dict[str, Any]) -> None:
        """Begin its history, if it has one."""
        self._frames = [observation] * self._history
        self._action = np.zeros_like(self._action)

    def act(self, observation: np.ndarray) -> np.ndarray:
        """The mean action."""
        self._frames = [observation, *self._frames[: self._history - 1]]
        seen = np.concatenate([*self._frames, self._action[: self._seen_actions]])
        if self._statistics is not None:
            seen = self._statistics.normalize_obs(seen)
        self._action, _ = self._model.predict(seen, deterministic=True)
        return self._action
