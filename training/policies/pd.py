"""Position controllers in the master: velocity in proportion to the distance, or torque by PD.

Torque by proportional and differential action:

    force = mass · (ω² · distance - 2 ω · velocity) + weight + friction

Both poles lie at -ω: critically damped. The distance is limited to 2 / ω · the maximum velocity, at
which both actions cancel, so the axis does not exceed that velocity. Braking from there needs a
deceleration of at most ω · velocity / e; the available torque thus determines ω. Weight and Coulomb
friction of the data sheet are added, the friction towards the goal and reduced within the
tolerance; without it the axis would stick at a distance of up to friction / (mass · ω²). There is
no integral action, so cogging and static friction above the Coulomb friction are not compensated.
"""

import math
from typing import Any

import numpy as np

from .datasheet import Datasheet
from .profiles import of_the_drive

GAIN = 15.0  # 1/s, of `Proportional`


class ProportionalDifferential:
    """One axis in cyclic synchronous torque."""

    def __init__(self, datasheet: Datasheet, seed: int = 0):
        axis = self._axis = datasheet.axis
        self._known = datasheet
        self._tolerance = datasheet.tolerance
        bounds = of_the_drive(axis)
        self._rate = math.e * bounds.acceleration / bounds.velocity  # ω (rad/s)
        self._farthest = 2.0 * bounds.velocity / self._rate
        self._mass = axis.mass(axis.payload)

    def reset(self, observation: np.ndarray, info: dict[str, Any]) -> None:
        """Do nothing, because this law has no memory."""

    def act(self, observation: np.ndarray) -> np.ndarray:
        """Torque as a share of the maximum."""
        axis, rate = self._axis, self._rate
        seen = self._known.named(observation)
        distance = float(seen.distance) * axis.stroke
        velocity = float(seen.velocity) * axis.fastest
        near = min(max(distance, -self._farthest), self._farthest)
        towards = min(max(distance / self._tolerance, -1.0), 1.0)
        force = self._mass * (rate**2 * near - 2.0 * rate * velocity)
        force += axis.weight + axis.coulomb_friction * towards
        return self._known.action(torque=min(max(force / axis.force, -1.0), 1.0))


class Proportional:
    """Velocity of each set-point = gain × distance, with 6081h and 6083h as its limits."""

    def __init__(self, datasheet: Datasheet, seed: int = 0):
        self._known = datasheet
        self._axes = (datasheet.axis, *datasheet.axes[1:])
        self._change = [axis.profile.acceleration * datasheet.step_time for axis in self._axes]

    def reset(self, observation: np.ndarray, info: dict[str, Any]) -> None:
        """Begin at rest."""
        self._velocities = [0.0] * len(self._axes)

    def act(self, observation: np.ndarray) -> np.ndarray:
        """Return torque or velocity from distance and velocity."""
        shares = np.zeros(len(self._axes), np.float32)
        named_by_axis = self._known.named_by_axis(observation)
        for d, (axis, seen) in enumerate(zip(self._axes, named_by_axis, strict=True)):
            limit, before, change = axis.profile.velocity, self._velocities[d], self._change[d]
            wanted = GAIN * float(seen.distance) * axis.stroke
            wanted = min(max(wanted, -limit), limit)
            self._velocities[d] = min(max(wanted, before - change), before + change)
            shares[d] = min(max(self._velocities[d] / axis.speed, -1.0), 1.0)
        return self._known.action(velocity=shares)
