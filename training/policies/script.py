"""A policy written as a generator: observations in, actions out, one step after the other."""

from collections.abc import Callable, Generator
from typing import Any

import numpy as np

Steps = Generator[np.ndarray, np.ndarray, None]


class Script:
    """Runs a script anew in every episode.

    Args:
        steps: makes the generator. Its first action answers the observation of the reset; after its
            end the last action is repeated.
    """

    def __init__(self, steps: Callable[[], Steps]):
        self._steps = steps

    def reset(self, observation: np.ndarray, info: dict[str, Any]) -> None:
        """Begin the script."""
        self._running, self._begun = self._steps(), False

    def act(self, observation: np.ndarray) -> np.ndarray:
        """Return the next action."""
        try:
            self._action = self._running.send(observation) if self._begun else next(self._running)
            self._begun = True
        except StopIteration:
            pass
        return self._action
