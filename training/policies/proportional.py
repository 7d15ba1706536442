"""A proportional controller from the position that is seen, within the limits of the profile."""

from typing import Any

import numpy as np

from .known import Known

GAIN = 15.0  # 1/s


class Proportional:
    """Velocity of the set-point = gain × distance, with 6081h and 6083h as its limits."""

    def __init__(self, known: Known, seed: int = 0):
        self._axis, self._actions = known.axis, known.actions
        self._velocity_limit = known.axis.profile.velocity
        self._change = known.axis.profile.acceleration * known.step_time

    def reset(self, observation: np.ndarray, info: dict[str, Any]) -> None:
        """Begin at rest."""
        self._velocity = 0.0

    def act(self, observation: np.ndarray) -> np.ndarray:
        """From the distance."""
        wanted = GAIN * float(observation[0]) * self._axis.stroke
        wanted = min(max(wanted, -self._velocity_limit), self._velocity_limit)
        low, high = self._velocity - self._change, self._velocity + self._change
        self._velocity = min(max(wanted, low), high)
        action = np.zeros(self._actions, np.float32)
        action[0] = min(max(self._velocity / self._axis.speed, -1.0), 1.0)
        return action
