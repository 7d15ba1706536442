"""Inertia and friction feed-forward on the reference, with the values of the data sheet."""

import math
from typing import Any

import numpy as np

from ...drive.modes.csp import SMOOTHING
from .known import Axis, Known

REVERSAL = 0.02  # m/s, of tanh(v / REVERSAL), by which friction changes its sign without a jump


def friction(axis: Axis, velocity: float) -> float:
    """Coulomb and viscous, of the data sheet (N)."""
    sign = math.tanh(velocity / REVERSAL)
    return axis.coulomb_friction * sign + axis.viscous_friction * velocity


class FeedForward:
    """The force the nominal axis needs, less what the drive feeds forward of its own accord.

    The drive takes the acceleration from the set-points, smoothed, so its own comes late.
    """

    def __init__(self, known: Known, seed: int = 0):
        self._known, self._axis = known, known.axis

    def reset(self, observation: np.ndarray, info: dict[str, Any]) -> None:
        """Begin at rest."""
        self._slope = self._own = 0.0

    def act(self, observation: np.ndarray) -> np.ndarray:
        """Torque in the middle of the step to come."""
        axis, dt = self._axis, self._known.step_time
        velocity = float(observation[2]) * axis.fastest
        acceleration = float(observation[3]) * axis.profile.acceleration
        ahead = float(observation[7]) * axis.fastest  # mean velocity of the next two steps
        rate = (ahead - velocity) / dt  # acceleration in the middle of the step to come
        middle = velocity + 0.5 * rate * dt
        slope = velocity + 0.5 * acceleration * dt
        self._own += SMOOTHING * ((slope - self._slope) / dt - self._own)
        self._slope = slope
        force = axis.mass(axis.payload) * (rate - self._own) + friction(axis, middle)
        action = np.zeros(self._known.actions, np.float32)
        action[1] = min(max(force / axis.offset, -1.0), 1.0)
        return action
