"""The recording of one fixed episode under a policy.

A recorder reads one environment at each of its steps: the body that the task moves, in MjData, and
the records of the drives. It changes nothing.
"""

import math
from typing import NamedTuple

import numpy as np

from ...envs.environment.servo_env import ServoEnv
from ...envs.view.channels import Channel


class Recording(NamedTuple):
    """Recording of one episode.

    `time` (s) has shape ``(n,)``; `samples` has shape ``(n, channels, 3)``: value, aim and half
    window of each channel, or NaN. `done` (s) is the time from which the goal of the task was kept,
    or NaN; `words` are the names of success and failure; `ended` is the fault or other event that
    ended the episode.
    """

    policy: str
    channels: tuple[Channel, ...]
    words: tuple[str, str]
    time: np.ndarray
    samples: np.ndarray
    done: float
    ended: str


class Recorder:
    """Records an environment, look by look."""

    def __init__(self, env: ServoEnv):
        self._env = env
        self._channels = env.channels()
        self._times: list[float] = []
        self._rows: list[list[list[float]]] = []

    def look(self, time: float) -> None:
        """Record the present state at `time` (s)."""
        self._times.append(time)
        self._rows.append(
            [
                [
                    math.nan if quantity is None else quantity(self._env)
                    for quantity in (channel.value, channel.aim, channel.window)
                ]
                for channel in self._channels
            ]
        )
        self._declared = self._env.declared()

    def trace(self, policy: str, done: float, fault: str = "") -> Recording:
        """Return the recording; a task whose agent declares success counts that time as done."""
        if self._declared is not None:
            done = self._times[-1] if self._declared else math.nan
        if not any(self._env.DONE):  # the task has no goal that ends it
            done = math.nan
        ended = self._env.outcome() or (f"fault {fault.partition(' ')[0]}" if fault else "")
        return Recording(
            policy, self._channels, self._env.DONE, np.array(self._times), np.array(self._rows),
            done, ended,
        )
