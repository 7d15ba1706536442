"""Laws that are given the randomly drawn parameters, which no controller can know.

The difference between such a law and the same law without this information is what identification
can gain. An informed law is not a limit: other laws may be better, and some that know less are.
"""

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from ...envs.environment.servo_env import ServoEnv
from .adaptive_feed_forward import AdaptiveFeedForward
from .datasheet import Datasheet, datasheet
from .gantry import Squaring
from .lqr import Lqr
from .plc import chain
from .profiles import Profile, Trapezoid, of_the_drive, of_the_profile, time_optimal
from .script import Script

SPARE = 0.95  # of the top speed of a homing; the rest lets the controller hold the path


class InformedPolicy:
    """A policy rebuilt for each episode from a data sheet with the true parameters."""

    def __init__(self, make: Callable[[Datasheet, int], Any], env: ServoEnv, seed: int):
        self._make, self._env, self._seed = make, env, seed

    def reset(self, observation: np.ndarray, info: dict[str, Any]) -> None:
        """Build the policy for the machine as drawn."""
        self._policy = self._make(datasheet(self._env, self._env.parameters), self._seed)
        self._policy.reset(observation, info)

    def act(self, observation: np.ndarray) -> np.ndarray:
        """Return the action of the informed law."""
        return self._policy.act(observation)


class KnownMass(AdaptiveFeedForward):
    """A law given mass and friction; the drive's own feed-forward stays nominal."""

    def __init__(self, env: ServoEnv, seed: int):
        super().__init__(datasheet(env), seed)
        self._env = env

    def reset(self, observation: np.ndarray, info: dict[str, Any]) -> None:
        """Take over mass and friction."""
        super().reset(observation, info)
        payload = self._env.parameters.get("payload", self._axis.payload)
        self.found = np.array([self._axis.mass(payload), self._env.parameters.get("friction", 1.0)])

    def identify(self, acceleration: float, velocity: float, force: float) -> None:
        """Identify nothing, because mass and friction are given."""


class KnownSkew(Squaring):
    """A law that is given the skew at the beginning."""

    def __init__(self, env: ServoEnv, seed: int):
        super().__init__(datasheet(env), seed)
        self._env = env

    def reset(self, observation: np.ndarray, info: dict[str, Any]) -> None:
        """Take over the skew."""
        super().reset(observation, info)
        self._square = -float(self._env.episode.skew)

    def apart(self, seen: Any) -> float:
        """Return the initial skew (m)."""
        return self._square


class KnownHome:
    """Homing with the true home given: move there as fast as the task allows and declare it."""

    STIFF = 80.0  # 1/s, gain of the position loop
    NEAR, SLOW = 0.3, 3e-3  # share of the tolerance and m/s within which it declares home

    def __init__(self, env: ServoEnv, seed: int):
        self._env, self._known = env, datasheet(env)
        axis = self._known.axis
        top = self._known.constant("max_velocity")
        bounds = of_the_drive(axis)
        self._top, self._stroke = top, axis.stroke
        self._bounds = bounds._replace(velocity=SPARE * top)
        self._times = np.arange(self._known.steps + 1) * self._known.step_time

    def reset(self, observation: np.ndarray, info: dict[str, Any]) -> None:
        """Plan the path to the true home."""
        episode = self._env.episode
        self._way = float(episode._home - episode.start)
        self._path = time_optimal(self._way, self._bounds)(self._times)
        self._step = 0

    def act(self, observation: np.ndarray) -> np.ndarray:
        """Return the velocity along the path; at its end, declare home."""
        seen, known = self._known.named(observation), self._known
        place = float(seen.displacement) * self._stroke
        near = abs(self._way - place) <= self.NEAR * known.tolerance
        standing = abs(float(seen.velocity)) * self._top <= self.SLOW
        now = min(self._step, len(self._path) - 2)
        self._step += 1
        slope = (self._path[now + 1] - self._path[now]) / known.step_time
        velocity = (slope + self.STIFF * (self._path[now] - place)) / self._top
        there = near and standing and self._path[now] == self._path[-1]
        return known.action(
            velocity=0.0 if there else min(max(velocity, -1.0), 1.0),
            torque_limit=1.0, reference=1.0 if there else -1.0,
        )


INFORMED: dict[str, Callable[[ServoEnv, int], Any]] = {  # by the policy that is informed
    "adaptive_feed_forward": KnownMass,
    "squaring": KnownSkew,
    "lqr": partial(InformedPolicy, Lqr),
    "trapezoid": partial(InformedPolicy, partial(Trapezoid, bounds=of_the_profile)),
    "ruckig": partial(InformedPolicy, Profile),
    "ruckig+zv": partial(InformedPolicy, partial(Profile, shapers=1)),
    "ruckig+zvd": partial(InformedPolicy, partial(Profile, shapers=2)),
    "search": KnownHome,
    "plc": lambda env, seed: Script(  # knows when the cause clears, and resets in that very step
        lambda: chain(datasheet(env), gone=int(env.episode.outage) - 1)
    ),
}
PREFIX = "informed_"  # of their names
