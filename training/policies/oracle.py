"""Upper limits: the best law of a task, told what was drawn at random. No controller knows that.

What lies between an oracle and the best baseline is what identifying, adapting or learning can
gain with the same law; a law of another kind may still be better.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from ...envs.servo_env import ServoEnv
from .adaptive_feed_forward import AdaptiveFeedForward
from .datasheet import Datasheet, datasheet
from .gantry import Squaring
from .lqr import Lqr
from .profiles import ruckig_policy


class Told:
    """A policy that is made anew for each episode, from a data sheet that tells the truth."""

    def __init__(self, make: Callable[[Datasheet, int], Any], env: ServoEnv, seed: int):
        self._make, self._env, self._seed = make, env, seed

    def reset(self, observation: np.ndarray, info: dict[str, Any]) -> None:
        """Make it for the machine as it was drawn."""
        self._policy = self._make(datasheet(self._env, self._env.parameters), self._seed)
        self._policy.reset(observation, info)

    def act(self, observation: np.ndarray) -> np.ndarray:
        """As that policy does."""
        return self._policy.act(observation)


class KnownMass(AdaptiveFeedForward):
    """Mass and friction told at the beginning; the drive's own feed-forward stays nominal."""

    def __init__(self, env: ServoEnv, seed: int):
        super().__init__(datasheet(env), seed)
        self._env = env

    def reset(self, observation: np.ndarray, info: dict[str, Any]) -> None:
        """Take them over."""
        super().reset(observation, info)
        payload = self._env.parameters.get("payload", self._axis.payload)
        self.found = np.array([self._axis.mass(payload), self._env.parameters.get("friction", 1.0)])

    def identify(self, acceleration: float, velocity: float, force: float) -> None:
        """Nothing is left to be found."""


class KnownSkew(Squaring):
    """The skew told at the beginning."""

    def __init__(self, env: ServoEnv, seed: int):
        super().__init__(datasheet(env), seed)
        self._env = env

    def reset(self, observation: np.ndarray, info: dict[str, Any]) -> None:
        """Take it over."""
        super().reset(observation, info)
        self._square = -float(self._env.episode.skew)

    def apart(self, seen: Any) -> float:
        """As it has been from the beginning (m)."""
        return self._square


ORACLES: dict[str, Callable[[ServoEnv, int], Any]] = {  # by the policy that is told
    "adaptive_feed_forward": KnownMass,
    "squaring": KnownSkew,
    "lqr": lambda env, seed: Told(Lqr, env, seed),
    "ruckig": lambda env, seed: Told(ruckig_policy, env, seed),
}


def oracle(env: ServoEnv, seed: int) -> Any:
    """That of the task. Raises ValueError where no law of it can be told anything."""
    for name, make in ORACLES.items():
        if name in env.POLICIES:
            return make(env, seed)
    raise ValueError(f"policy 'oracle': no law of {env.ID} has unknowns; of {', '.join(ORACLES)}")
