"""Controllers of the gantry as a motion engineer ships them: squaring, and contouring at full feed.

`Squaring` moves both sides quickly to their home switches and slowly over them, so that the skew is
known to a fifth of a millimetre, and removes it on the way to the goal. `FullFeed` compensates the
lag T of the drives: with the set-point ``path(t - T) + T · path'(t - T)``, a first-order follower
is at the point of the path where the path was T ago. The feed is reduced only at corners, where the
correction would exceed its range.
"""

import math
from typing import Any

import numpy as np

from .datasheet import Datasheet
from .numbers import Range, Tunable

HOME = 0.2  # m, where both home switches lie
ZONE = 4e-3  # m before the switches; the side that starts behind may be off by up to 3 mm
OVER = 0.04  # m/s over the switches; the best of 10, 20 and 40 mm/s on 40 episodes of seed 7
UNTWIST = 0.05  # m/s, of one side relative to the other
CORNER = 0.7  # cosine of a turn within the preview; below it the turn exceeds 45 degrees


class Squaring:
    """Squares the bridge of `GantrySync-v0`; the position of x2 is off by the skew."""

    OVER, SHARE = OVER, 0.4  # speed over the switches (m/s), share of the acceleration
    UNTWIST, ZONE = UNTWIST, ZONE

    def __init__(self, datasheet: Datasheet, seed: int = 0):
        self._known, self._axis = datasheet, datasheet.axis
        self._dt = datasheet.step_time

    def reset(self, observation: np.ndarray, info: dict[str, Any]) -> None:
        """Begin at rest."""
        self._goal = float(info["goal"])
        side = self._known.named_by_axis(observation)[0]
        self._place = self._goal - float(side.distance) * self._axis.stroke
        self._velocity = self._apart = 0.0

    def apart(self, seen: Any) -> float | None:
        """Set-point of x2 minus that of x1 at which the bridge is square (m); None if unknown."""
        return (
            float(seen.switch_difference) * self._known.constant("max_twist")
            if seen.switches_met
            else None
        )

    def act(self, observation: np.ndarray) -> np.ndarray:
        """Velocities of the two set-points."""
        apart, dt, rate = self.apart(self._known.named(observation)), self._dt, self._rate
        way = max(self._goal - self._place, 0.0)
        velocity = min(self._velocity + rate * dt, self._axis.speed, math.sqrt(2.0 * rate * way))
        velocity = min(velocity, way / dt)
        if apart is None:
            way = max(HOME - self.ZONE - self._place, 0.0)
            velocity = min(velocity, math.sqrt(self.OVER**2 + 2.0 * rate * way))
        self._velocity = velocity
        self._place += velocity * dt
        most = self.UNTWIST * dt
        change = 0.0 if apart is None else min(max(apart - self._apart, -most), most)
        self._apart += change
        shares = np.array([velocity, velocity + change / dt]) / self._axis.speed
        return self._known.action(velocity=np.clip(shares, -1.0, 1.0))

    @property
    def _rate(self) -> float:
        return self.SHARE * self._axis.profile.acceleration


class SlowSquaring(Squaring):
    """Squares with a quarter of `Squaring`'s speed over the switches and of its acceleration."""

    OVER, SHARE = 0.25 * OVER, 0.1


class TunedSquaring(Squaring, Tunable):
    """Squares at the speeds found by the tuner."""

    NAME = "tuned_squaring"
    RANGES = {  # noqa: RUF012
        "over": Range(0.01, 0.2, OVER),  # m/s, over the switches
        "share": Range(0.1, 1.0, Squaring.SHARE),  # of the commissioned acceleration
        "untwist": Range(0.01, 0.2, UNTWIST),  # m/s, of one side relative to the other
        "zone": Range(2e-3, 8e-3, ZONE),  # m before the switches in which it is slow
    }

    def __init__(self, datasheet: Datasheet, seed: int = 0):
        super().__init__(datasheet, seed)
        own = self.numbers(datasheet.task)
        self.OVER, self.SHARE, self.UNTWIST, self.ZONE = (own[name] for name in self.RANGES)


class ConstantFeed:
    """Follows the path at full feed; the lag of the drives is not compensated."""

    def __init__(self, datasheet: Datasheet, seed: int = 0):
        self._action = datasheet.action(override=1.0)

    def reset(self, observation: np.ndarray, info: dict[str, Any]) -> None:
        """Do nothing, because this policy has no memory."""

    def act(self, observation: np.ndarray) -> np.ndarray:
        """Return the same action in every step."""
        return self._action


class FullFeed:
    """Commands X and Y of `GantryContour-v0` from the part of the path observed so far."""

    def __init__(self, datasheet: Datasheet, seed: int = 0):
        self._known, self._dt = datasheet, datasheet.step_time
        self._range = datasheet.constant("correction")
        self._step = datasheet.constant("feed") * self._dt  # way at full feed (m)
        self._lag = datasheet.axis.lag
        self._slowest = datasheet.constant("SLOWEST")
        most = 0.9 * self._range * self._dt
        lost = self._lag * self._step
        self._corner = min(1.0, max(self._slowest, most / lost)) if lost > 0.0 else 1.0

    def reset(self, observation: np.ndarray, info: dict[str, Any]) -> None:
        """Begin at rest on the path, whose first point is the origin here."""
        self._ways, self._places = [0.0], [np.zeros(2)]  # of the observed path (m)
        self.lead = np.zeros(2)  # of the path over the wanted positions of the axes (m)

    def act(self, observation: np.ndarray) -> np.ndarray:
        """Return corrections and feed override."""
        path = np.asarray(self._known.named(observation).path, float)
        ahead = 2.0 ** np.arange(len(path)) * self._step  # of its points (m)
        points = path * ahead[:, None]
        legs = np.diff(points, axis=0, prepend=np.zeros((1, 2)))
        along = legs / np.linalg.norm(legs, axis=1, keepdims=True)
        turning = (along @ along[0]).min()  # cosine of the sharpest turn ahead
        override = self._corner if turning < CORNER else 1.0
        way, place = self._ways[-1], self._places[-1]
        xs = np.array([*self._ways, *(way + ahead)])
        ys = np.array([*self._places, *(place + points)])

        def at(ways: np.ndarray) -> np.ndarray:
            return np.stack([np.interp(ways, xs, ys[:, d]) for d in range(2)], axis=-1)

        self._ways.append(way + override * self._step)
        self._places.append(at(np.array(self._ways[-1])))
        late = len(self._ways) - 1 - self._lag / self._dt
        if late <= 0.0:
            self.lead = self._places[-1]
            return self._known.action(override=self._override(override))
        times = np.clip(late + np.array([-0.5, 0.0, 0.5]), 0.0, None)
        before, then, after = at(np.interp(times, np.arange(len(self._ways)), self._ways))
        self.lead = self._places[-1] - then
        target = then + self._lag * (after - before) / (times[2] - times[0]) / self._dt
        wanted = target - self._places[-1] + self.outer(observation)
        share = np.clip(wanted / self._range, -1.0, 1.0)
        return self._known.action(correction=share, override=self._override(override))

    def outer(self, observation: np.ndarray) -> np.ndarray | float:
        """Return the correction of the contour lag of the axes (m): 0 here."""
        return 0.0

    def _override(self, feed: float) -> float:
        """The action for a feed override."""
        return 2.0 * (feed - self._slowest) / (1.0 - self._slowest) - 1.0


class TunedFullFeed(FullFeed, Tunable):
    """Full feed with a tuned lag and an outer loop on the positions."""

    NAME, FADING = "tuned_full_feed", 0.98
    RANGES = {  # noqa: RUF012
        "lag": Range(0.8, 1.25, 1.0),  # of the lag by the commissioned gains
        "gain": Range(0.02, 1.0, 0.02),  # of the distance by which the axes lag
        "integral": Range(0.002, 0.2, 0.002),  # of its decaying sum
    }

    def __init__(self, datasheet: Datasheet, seed: int = 0):
        super().__init__(datasheet, seed)
        own = self.numbers(datasheet.task)
        self._lag *= own["lag"]
        self._gain, self._integral = own["gain"], own["integral"]
        self._window = datasheet.constant("following_error_window")

    def reset(self, observation: np.ndarray, info: dict[str, Any]) -> None:
        """Begin at rest on the path."""
        super().reset(observation, info)
        self._sum = np.zeros(2)

    def act(self, observation: np.ndarray) -> np.ndarray:
        """Return corrections and feed override."""
        self._wanted = self.lead.copy()  # of the step before, whose end is observed
        return super().act(observation)

    def outer(self, observation: np.ndarray) -> np.ndarray:
        """Return a share of the contour lag plus its decaying sum (m)."""
        axes = self._known.named_by_axis(observation)
        behind = self._window * np.array([float(axis.distance) for axis in axes]) - self._wanted
        self._sum = self.FADING * self._sum + self._integral * behind
        return self._gain * behind + self._sum
