"""Inertia and friction feed-forward on the reference, with the values of the data sheet."""

import math
from typing import Any

import numpy as np

from ...drive.modes.csp import SMOOTHING
from .known import Known

REVERSAL = 0.02  # m/s, of tanh(v / REVERSAL), by which friction changes its sign without a jump


class FeedForward:
    """The force the nominal axis needs, less what the drive feeds forward of its own accord.

    The drive takes the acceleration from the set-points, smoothed, so its own comes late.
    """

    def __init__(self, known: Known, seed: int = 0):
        self._known = known

    def reset(self, observation: np.ndarray, info: dict[str, Any]) -> None:
        """Begin at rest."""
        self._slope = self._own = 0.0

    def act(self, observation: np.ndarray) -> np.ndarray:
        """Torque in the middle of the step to come."""
        known, p = self._known, self._known.nominal
        dt = known.step_time
        velocity = float(observation[2]) * known.speed
        acceleration = float(observation[3]) * p.max_acceleration
        ahead = float(observation[7]) * known.speed  # mean velocity of the next two steps
        rate = (ahead - velocity) / dt  # acceleration in the middle of the step to come
        middle = velocity + 0.5 * rate * dt
        slope = velocity + 0.5 * acceleration * dt
        self._own += SMOOTHING * ((slope - self._slope) / dt - self._own)
        self._slope = slope
        mass = known.mass(p.payload)
        friction = p.coulomb_friction * math.tanh(middle / REVERSAL) + p.viscous_friction * middle
        force = mass * (rate - self._own) + friction
        action = np.zeros(known.actions, np.float32)
        action[1] = min(max(force / known.force, -1.0), 1.0)
        return action
