"""Baselines without a goal: holding still and random actions."""

from typing import Any

import numpy as np

from .datasheet import Datasheet


class Hold:
    """Action 0, or ``HOLD`` of the task: the set-point stays, or the drive follows a reference."""

    def __init__(self, datasheet: Datasheet, seed: int = 0):
        self._action = datasheet.action(**dict(datasheet.hold))

    def reset(self, observation: np.ndarray, info: dict[str, Any]) -> None:
        """Begin an episode."""

    def act(self, observation: np.ndarray) -> np.ndarray:
        """Return the same action in every step."""
        return self._action


class Chance:
    """Uniform actions from a seed."""

    def __init__(self, datasheet: Datasheet, seed: int = 0):
        self._seed, self._shape = seed, datasheet.actions

    def reset(self, observation: np.ndarray, info: dict[str, Any]) -> None:
        """Begin an episode, each with the same actions."""
        self._generator = np.random.default_rng(self._seed)

    def act(self, observation: np.ndarray) -> np.ndarray:
        """Draw the next action."""
        return self._generator.uniform(-1.0, 1.0, self._shape).astype(np.float32)
