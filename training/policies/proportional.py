"""A proportional controller from the position that is seen, within the limits of the profile."""

from typing import Any

import numpy as np

from .datasheet import Datasheet

GAIN = 15.0  # 1/s


class Proportional:
    """Velocity of the set-point = gain × distance, with 6081h and 6083h as its limits."""

    def __init__(self, datasheet: Datasheet, seed: int = 0):
        self._known, self._axis = datasheet, datasheet.axis
        self._velocity_limit = datasheet.axis.profile.velocity
        self._change = datasheet.axis.profile.acceleration * datasheet.step_time

    def reset(self, observation: np.ndarray, info: dict[str, Any]) -> None:
        """Begin at rest."""
        self._velocity = 0.0

    def act(self, observation: np.ndarray) -> np.ndarray:
        """From the distance."""
        wanted = GAIN * float(self._known.seen(observation).distance) * self._axis.stroke
        wanted = min(max(wanted, -self._velocity_limit), self._velocity_limit)
        low, high = self._velocity - self._change, self._velocity + self._change
        self._velocity = min(max(wanted, low), high)
        share = self._velocity / self._axis.speed
        return self._known.action(velocity=min(max(share, -1.0), 1.0))
