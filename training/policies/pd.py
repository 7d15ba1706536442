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

from .datasheet import Axis, Datasheet
from .numbers import Range, Tunable
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

    GAIN, ACCELERATION = GAIN, 1.0  # 1/s, and a share of 6083h

    def __init__(self, datasheet: Datasheet, seed: int = 0):
        self._known = datasheet
        self._axes = (datasheet.axis, *datasheet.axes[1:])

    def reset(self, observation: np.ndarray, info: dict[str, Any]) -> None:
        """Begin at rest."""
        self._velocities = [0.0] * len(self._axes)

    def act(self, observation: np.ndarray) -> np.ndarray:
        """Return the velocities of the set-points for the distances observed."""
        shares = np.zeros(len(self._axes), np.float32)
        named_by_axis = self._known.named_by_axis(observation)
        for d, (axis, seen) in enumerate(zip(self._axes, named_by_axis, strict=True)):
            limit, before = self.limit(axis), self._velocities[d]
            change = self.ACCELERATION * axis.profile.acceleration * self._known.step_time
            wanted = self.wanted(float(seen.distance) * axis.stroke, axis)
            wanted = min(max(wanted, -limit), limit)
            self._velocities[d] = min(max(wanted, before - change), before + change)
            shares[d] = min(max(self._velocities[d] / axis.speed, -1.0), 1.0)
        return self._known.action(velocity=shares)

    def limit(self, axis: Axis) -> float:
        """Return the largest velocity."""
        return axis.profile.velocity

    def wanted(self, distance: float, axis: Axis) -> float:
        """Return the velocity for a distance before it is limited."""
        return self.GAIN * distance


class TunedProportional(Proportional, Tunable):
    """The same with numbers of the tuner, and from afar along a braking curve.

    The velocity is at most that from which the axis stops at its goal with a constant deceleration,
    and that of an action of 1.
    """

    NAME = "tuned_proportional"
    RANGES = {  # noqa: RUF012
        "gain": Range(10.0, 120.0, GAIN),  # 1/s
        "acceleration": Range(1.0, 10.0, 1.0),  # of 6083h
        "brake": Range(0.5, 10.0, 1.0),  # of 6083h, along the curve
    }

    def __init__(self, datasheet: Datasheet, seed: int = 0):
        super().__init__(datasheet, seed)
        own = self.numbers(datasheet.task)
        self.GAIN, self.ACCELERATION, self._brake = (own[name] for name in self.RANGES)

    def limit(self, axis: Axis) -> float:
        """Return the velocity of an action of 1."""
        return axis.speed

    def wanted(self, distance: float, axis: Axis) -> float:
        """Return the velocity in proportion to the distance, or by the braking curve if less."""
        curve = math.sqrt(2.0 * self._brake * axis.profile.acceleration * abs(distance))
        return math.copysign(min(self.GAIN * abs(distance), curve), distance)
