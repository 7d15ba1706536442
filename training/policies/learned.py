"""A policy that was trained: the folder of a checkpoint, or of a run of `servogym train`."""

import pickle
from pathlib import Path
from typing import Any

import numpy as np

from ...envs.servo_env import ServoEnv

BEST = "best"


class Learned:
    """The best policy of a run, or that of a checkpoint, without exploration.

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
        if self._model.observation_space.shape != env.observation_space.shape:
            raise ValueError(
                f"checkpoint {folder} sees {self._model.observation_space.shape}, this environment "
                f"shows {env.observation_space.shape}: make it with the arguments "
                f"{about['arguments']}"
            )
        self._statistics: Any = None
        if (folder / checkpoint.STATISTICS).is_file():
            with (folder / checkpoint.STATISTICS).open("rb") as file:
                self._statistics = pickle.load(file)

    def reset(self, observation: np.ndarray, info: dict[str, Any]) -> None:
        """A net without recurrence remembers nothing."""

    def act(self, observation: np.ndarray) -> np.ndarray:
        """The mean action."""
        if self._statistics is not None:
            observation = self._statistics.normalize_obs(observation)
        action, _ = self._model.predict(observation, deterministic=True)
        return action
