"""Feed-forward that identifies mass and friction, and an outer loop on the tracking error.

Recursive least squares fit the torque to acceleration and friction of the reference while the axis
moves: two unknowns, the mass and a share of the friction of the data sheet (Slotine, Li 1991,
chapter 8). The drive interpolates linearly between set-points, so the acceleration is largest at
the beginning of a step, and the torque reported at its end lacks a part of the inertia: `UNSEEN` of
the nominal mass, tuned with the gains. The outer loop moves the set-point by `GAIN` of the error,
`INTEGRAL` of its fading sum and `DIFFERENCE` of its change.

The eight numbers were tuned by the cross-entropy method: four generations of 16 laws, on
64 episodes of evaluation seed 11, for the least interquartile mean of the error at the load.

`LeadingFeedForward` also identifies the delay of the set-points: an error in proportion to the
velocity is a lag, whose ratio to the velocity is the time by which the set-point has to lead. Two
of its three numbers were chosen by hand from seven pairs, on 24 episodes of the same seed, nominal
and in nine conditions. Up to a lag of `SURE` it equals `AdaptiveFeedForward`, bit for bit.
"""

import math
from typing import Any

import numpy as np

from .datasheet import Datasheet
from .feed_forward import FeedForward, friction

GAIN, INTEGRAL, DIFFERENCE = 0.52, 0.014, 0.14
FADING = 0.98  # factor of the sum in each step
REVERSAL = 0.0143  # m/s, of tanh(v / REVERSAL)
LEAD = 0.585  # share of the next step after which its velocity is taken
UNSEEN = 0.655  # of the nominal mass
DOUBT = (4.5, 0.25)  # variances of the first guess: kg², share²
NOISE = 3.7  # N, standard deviation of the force
MOVING = 0.04  # m/s, below which friction cannot be identified
LEAST, MOST = 0.3, 3.0  # limits of the friction, as shares of the data sheet's
SPARE = 2.0  # kg by which a payload may exceed the heaviest one declared
RATE = 0.2  # share by which the lag follows a new estimate in a step
SURE = 0.06  # steps; a smaller lag counts as none
SLOW = 0.1  # m/s, below which an error says little about a lag
LONGEST = 1.2  # steps, of the lag


class AdaptiveFeedForward(FeedForward):
    """Follows the observed reference with identified mass and friction."""

    loop = 1.0  # share of the gains of the outer loop

    def __init__(self, datasheet: Datasheet, seed: int = 0):
        super().__init__(datasheet, seed)
        axis = datasheet.axis
        self._nominal = axis.mass(axis.payload)
        self._range = datasheet.constant("correction")
        self._bounds = np.array([[axis.mass(0.0), LEAST], [axis.mass(axis.heaviest + SPARE), MOST]])

    def reset(self, observation: np.ndarray, info: dict[str, Any]) -> None:
        """Begin at rest with the values of the data sheet."""
        super().reset(observation, info)
        self.found = np.array([self._nominal, 1.0])  # mass (kg), share of the friction
        self._doubt = np.diag(DOUBT)
        self._error = self._sum = 0.0

    def identify(self, acceleration: float, velocity: float, force: float) -> None:
        """Take a step of the recursive least squares (m/s², m/s, N)."""
        if abs(velocity) < MOVING:
            return
        known = np.array([acceleration, friction(self._axis, velocity, REVERSAL)])
        seen = self.found - [UNSEEN * self._nominal, 0.0]
        gain = self._doubt @ known / (NOISE**2 + known @ self._doubt @ known)
        self.found = np.clip(self.found + gain * (force - known @ seen), *self._bounds)
        self._doubt -= np.outer(gain, known) @ self._doubt

    def ahead(self, error: float, velocity: float, rate: float) -> float:
        """Return the lead of the set-point (m) from error (m) and motion (m/s, m/s²): 0 here."""
        return 0.0

    def fed(self) -> float:
        """Return a further correction of the set-point (m): 0 here."""
        return 0.0

    def act(self, observation: np.ndarray) -> np.ndarray:
        """Return the torque in the middle of the next step, and the correction of the set-point."""
        axis, dt = self._axis, self._known.step_time
        seen = self._known.named(observation)
        velocity = float(seen.reference_velocity) * axis.fastest
        acceleration = float(seen.reference_acceleration) * axis.profile.acceleration
        self.identify(acceleration, velocity, float(seen.torque) * axis.force)
        ahead = float(seen.preview[0]) * axis.fastest  # mean velocity of the next two steps
        rate = (ahead - velocity) / dt
        mass, share = self.found
        force = mass * rate + share * friction(axis, velocity + LEAD * rate * dt, REVERSAL)
        force -= self._nominal * self._torque.own(velocity + 0.5 * acceleration * dt)
        error = float(seen.error) * self._range
        self._sum = FADING * self._sum + INTEGRAL * error
        correction = self.loop * (GAIN * error + self._sum + DIFFERENCE * (error - self._error))
        correction += self.ahead(error, velocity, rate) + self.fed()
        self._error = error
        return self._known.action(
            torque=min(max(force / axis.offset, -1.0), 1.0),
            correction=min(max(correction / self._range, -1.0), 1.0),
        )


class LeadingFeedForward(AdaptiveFeedForward):
    """Adaptive feed-forward with a set-point that leads by the identified lag."""

    def reset(self, observation: np.ndarray, info: dict[str, Any]) -> None:
        """Begin with no lag."""
        super().reset(observation, info)
        self.lag = 0.0  # steps

    def ahead(self, error: float, velocity: float, rate: float) -> float:
        """Return the distance covered in the identified lag, at this velocity and acceleration."""
        dt = self._known.step_time
        self.lag += RATE * error * velocity / (velocity**2 + SLOW**2) / dt
        self.lag = min(max(self.lag, -LONGEST), LONGEST)
        time = math.copysign(max(abs(self.lag) - SURE, 0.0), self.lag) * dt
        return (velocity + 0.5 * rate * time) * time
