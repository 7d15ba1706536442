"""Baselines that want nothing: hold, and chance."""

from typing import Any

import numpy as np

from .known import Known


class Hold:
    """Action 0: the set-point stays, or the drive's own cascade follows the reference."""

    def __init__(self, known: Known, seed: int = 0):
        self._action = np.zeros(known.actions, np.float32)
        if known.task == "servogym/Homing-v0":
            self._action[1:] = 1.0, -1.0  # with all its torque, and without a reference

    def reset(self, observation: np.ndarray, info: dict[str, Any]) -> None:
        """Begin an episode."""

    def act(self, observation: np.ndarray) -> np.ndarray:
        """The same action always."""
        return self._action


class Chance:
    """Uniform actions from a seed."""

    def __init__(self, known: Known, seed: int = 0):
        self._seed, self._shape = seed, known.actions

    def reset(self, observation: np.ndarray, info: dict[str, Any]) -> None:
        """Begin an episode, each with the same actions."""
        self._generator = np.random.default_rng(self._seed)

    def act(self, observation: np.ndarray) -> np.ndarray:
        """Draw the next."""
        return self._generator.uniform(-1.0, 1.0, self._shape).astype(np.float32)
