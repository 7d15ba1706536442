"""Feed-forward with a disturbance observer for forces outside the nominal model.

The observer (Ohnishi 1987; Sariyildiz, Oboe, Ohnishi 2020) subtracts from the force of the motor
what the nominal mass and friction need for the reference, filters the rest by a first-order
low-pass, and adds it to the command. It knows neither payload nor friction and identifies nothing;
disturbances only have to change slowly compared with the filter. The outer loop on the tracking
error, and the part of the inertia missing in the reported torque, are those of
`adaptive_feed_forward`.
"""

from typing import Any

import numpy as np

from .adaptive_feed_forward import DIFFERENCE, FADING, GAIN, INTEGRAL, REVERSAL, UNSEEN
from .datasheet import Datasheet
from .feed_forward import FeedForward, friction

# Chosen by hand from 0, 0.1, 0.2, 0.35, 0.6 and 1 on 12 episodes of evaluation seed 11: a larger
# share oscillates with the lightest loads, 0 is better if mass and friction are nearly nominal.
SHARE = 0.2  # of the filter, taken from each new value
LIMIT = 0.3  # of the force at the maximum torque, the largest disturbance


class DisturbanceObserver(FeedForward):
    """Follows the observed reference and compensates the estimated disturbance."""

    def __init__(self, datasheet: Datasheet, seed: int = 0):
        super().__init__(datasheet, seed)
        self._mass = self._axis.mass(self._axis.payload)

    def reset(self, observation: np.ndarray, info: dict[str, Any]) -> None:
        """Begin at rest, undisturbed."""
        super().reset(observation, info)
        self.force = 0.0  # disturbance (N)
        self._error = self._sum = 0.0  # of the reference, as seen

    def observe(self, acceleration: float, velocity: float, force: float) -> None:
        """Observe a step: the motion at its end and the force of the motor (m/s², m/s, N)."""
        needed = (1.0 - UNSEEN) * self._mass * acceleration
        needed += friction(self._axis, velocity, REVERSAL)
        self.force += SHARE * (force - needed - self.force)
        most = LIMIT * self._axis.force
        self.force = min(max(self.force, -most), most)

    def act(self, observation: np.ndarray) -> np.ndarray:
        """Act as `feed_forward` does, and compensate the estimated disturbance."""
        seen, axis = self._known.named(observation), self._axis
        self.observe(
            float(seen.reference_acceleration) * axis.profile.acceleration,
            float(seen.reference_velocity) * axis.fastest, float(seen.torque) * axis.force,
        )
        error = float(seen.error)
        self._sum = FADING * self._sum + INTEGRAL * error
        correction = GAIN * error + self._sum + DIFFERENCE * (error - self._error)
        self._error = error
        added = self._known.action(torque=self.force / axis.offset, correction=correction)
        return np.clip(super().act(observation) + added, -1.0, 1.0)
