"""Iterative learning control: the same motion is repeated, each time with less error.

Machines make the same move thousands of times, so an error at some moment can be corrected just
before that moment in the next repetition (Arimoto 1984; Bristow, Tharayil, Alleyne 2006, A survey
of iterative learning control). Here the move is rehearsed `REHEARSALS` times on a twin of the drawn
environment, with other noise, and then played. This is more than a policy can know that meets an
episode for the first time, so the row shows what is possible and does not compete.

    u ← Q (u + gain · e, `LEAD` steps earlier)

where Q smooths over three steps without a shift. The law was chosen by hand from seven on 6
episodes of evaluation seed 11: gains of 0.3 to 0.8, leads of 1 and 2, weights of each neighbour of
0 to 0.2.
"""

from typing import Any

import numpy as np

from ...envs.environment.servo_env import ServoEnv
from .datasheet import datasheet
from .feed_forward import FeedForward
from .gantry import FullFeed

REHEARSALS = 8
GAIN, LEAD, NEIGHBOUR = 0.5, 1, 0.05
OTHER_NOISE = 0x9E3779B97F4A7C15  # added to the state of the noise generator


def corrected(table: np.ndarray, errors: np.ndarray) -> np.ndarray:
    """Return the next table from the errors at the end of each step, both ``(steps, k)``."""
    ahead = np.concatenate([errors[LEAD:], np.repeat(errors[-1:], LEAD, axis=0)])
    wider = np.pad(table + GAIN * ahead, ((1, 1), (0, 0)), "edge")
    sides = NEIGHBOUR * (wider[:-2] + wider[2:])
    return np.clip((1.0 - 2.0 * NEIGHBOUR) * wider[1:-1] + sides, -1.0, 1.0)


class Repeated:
    """A law and a table of corrections of its set-points, learned on a twin before each episode."""

    def __init__(self, law: Any, env: ServoEnv):
        self._law, self._env, self._known = law, env, datasheet(env)
        args, arguments = env._arguments
        self._twin = type(env)(*args, **arguments)

    def reset(self, observation: np.ndarray, info: dict[str, Any]) -> None:
        """Rehearse the episode on the twin, then begin it."""
        self._law.reset(observation, info)
        axes = len(self._errors(observation))
        self.table = np.zeros((self._known.steps, axes))
        kept = self._env.snapshot()
        for rehearsal in range(REHEARSALS):
            self._twin.restore(kept)
            states = self._twin.machine.couplings["noise_state"]
            states[:] = [(int(s) + OTHER_NOISE * (rehearsal + 1)) % 2**64 for s in states]
            self._begin(observation, info)
            errors, seen = np.zeros_like(self.table), observation
            for step in range(len(self.table)):
                seen, _, terminated, _, _ = self._twin.step(self.act(seen))
                errors[step] = self._errors(seen)
                if terminated:
                    break
            self.learn(errors)
        self._begin(observation, info)

    def learn(self, errors: np.ndarray) -> None:
        """Take one iteration, from the errors at the end of each step."""
        self.table = corrected(self.table, errors)

    def _begin(self, observation: np.ndarray, info: dict[str, Any]) -> None:
        self._step = 0
        self._law.reset(observation, info)

    def act(self, observation: np.ndarray) -> np.ndarray:
        """Return the action of the law plus the correction learned for this step."""
        learned = self.table[min(self._step, len(self.table) - 1)]
        self._step += 1
        action = self._law.act(observation)
        return np.clip(action + self._known.action(correction=learned), -1.0, 1.0)

    def _errors(self, observation: np.ndarray) -> np.ndarray:
        """Return the error of each axis, in units of the correction."""
        raise NotImplementedError


class RepeatedTracking(Repeated):
    """Corrections of `feed_forward`; the tracking error has the unit of the correction."""

    def _errors(self, observation: np.ndarray) -> np.ndarray:
        return np.array([float(self._known.named(observation).error)])


class RepeatedContour(Repeated):
    """Corrections of `full_feed`, from where that law wants the axes at the end of a step."""

    def __init__(self, law: FullFeed, env: ServoEnv):
        super().__init__(law, env)
        self._share = env._window / self._known.constant("correction")

    def _errors(self, observation: np.ndarray) -> np.ndarray:
        axes = self._known.named_by_axis(observation)
        behind = self._share * np.array([float(axis.distance) for axis in axes])
        return behind - self._law.lead / self._known.constant("correction")


REPEATED: dict[str, tuple[Any, Any]] = {  # by the law that is corrected
    "feed_forward": (FeedForward, RepeatedTracking),
    "full_feed": (FullFeed, RepeatedContour),
}


def repeated(env: ServoEnv, seed: int) -> Repeated:
    """Return the law of the task with rehearsals. Raises ValueError if the task has none."""
    for name, (law, kind) in REPEATED.items():
        if name in env.POLICIES:
            return kind(law(datasheet(env), seed), env)
    raise ValueError(f"{env.ID} has no motion to rehearse: it offers none of {', '.join(REPEATED)}")
