"""Inertia and friction feed-forward on a reference or a path, with the values of the data sheet."""

import math
from typing import Any

import numpy as np

from ...drive.kernel.modes.csp import SMOOTHING
from .datasheet import Axis, Datasheet
from .profiles import Profile

REVERSAL = 0.02  # m/s, of tanh(v / REVERSAL), with which friction reverses without a jump


def friction(axis: Axis, velocity: float, reversal: float = REVERSAL) -> float:
    """Return Coulomb and viscous friction of the data sheet (N), with ``tanh(v / reversal)``."""
    sign = math.tanh(velocity / reversal)
    return axis.coulomb_friction * sign + axis.viscous_friction * velocity


class Torque:
    """The torque action of the nominal axis, less the drive's own feed-forward.

    The drive derives the acceleration from smoothed set-points, so its own feed-forward lags.
    """

    def __init__(self, datasheet: Datasheet):
        self._axis, self._dt = datasheet.axis, datasheet.step_time
        self._slope = self._own = 0.0

    def own(self, slope: float) -> float:
        """Return the acceleration (m/s²) that the drive feeds forward at a slope (m/s)."""
        self._own += SMOOTHING * ((slope - self._slope) / self._dt - self._own)
        self._slope = slope
        return self._own

    def __call__(self, slope: float, middle: float, rate: float) -> float:
        """Return the feed-forward for the next step, in -1..1 of the torque offset.

        Args:
            slope: of the set-points (m/s).
            middle: velocity in the middle of the step (m/s).
            rate: acceleration there (m/s²).
        """
        axis = self._axis
        force = axis.mass(axis.payload) * (rate - self.own(slope)) + friction(axis, middle)
        return min(max(force / axis.offset, -1.0), 1.0)


class FeedForward:
    """Follows the observed reference with nominal feed-forward."""

    def __init__(self, datasheet: Datasheet, seed: int = 0):
        self._known, self._axis = datasheet, datasheet.axis

    def reset(self, observation: np.ndarray, info: dict[str, Any]) -> None:
        """Begin at rest."""
        self._torque = Torque(self._known)

    def act(self, observation: np.ndarray) -> np.ndarray:
        """Return the torque in the middle of the next step."""
        axis, dt = self._axis, self._known.step_time
        seen = self._known.named(observation)
        velocity = float(seen.reference_velocity) * axis.fastest
        acceleration = float(seen.reference_acceleration) * axis.profile.acceleration
        ahead = float(seen.preview[0]) * axis.fastest  # mean velocity of the next two steps
        rate = (ahead - velocity) / dt  # acceleration in the middle of the step to come
        middle = velocity + 0.5 * rate * dt
        slope = velocity + 0.5 * acceleration * dt
        return self._known.action(torque=self._torque(slope, middle, rate))


class RuckigFeedForward(Profile):
    """Follows a time-optimal path at the drive's limits.

    Raises:
        ValueError: the environment has no torque to command.
    """

    def __init__(self, datasheet: Datasheet, seed: int = 0):
        super().__init__(datasheet)
        if datasheet.axis.offset <= 0.0:
            raise ValueError(
                f"policy 'ruckig+ff' commands torque: make {datasheet.task} with a torque_range "
                "above 0"
            )

    def reset(self, observation: np.ndarray, info: dict[str, Any]) -> None:
        """Plan the path and begin at rest."""
        super().reset(observation, info)
        self._torque = Torque(self._known)
        places = np.pad(self._places[0], (1, 2), "edge")  # at rest before and after
        self._velocities = np.diff(places) / self._known.step_time

    def act(self, observation: np.ndarray) -> np.ndarray:
        """Return the velocity of the set-point and the torque for it."""
        velocity = super().act(observation)
        before, now, after = self._velocities[self._step - 1 : self._step + 2]
        rate = (after - before) / (2.0 * self._known.step_time)
        return velocity + self._known.action(torque=self._torque(now, now, rate))
