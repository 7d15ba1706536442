"""What a recorder saw of one fixed episode under a policy.

A recorder looks at one environment at each of its steps: at the body its task moves, in MjData, and
at the records of its drives. It only reads, so nothing that is measured changes.
"""

import math
from typing import NamedTuple

import numpy as np

from ...envs.environment.servo_env import ServoEnv
from ...envs.view.channels import Channel


class Recording(NamedTuple):
    """Recording of one episode.

    `time` (s) has shape ``(n,)``; `samples` has shape ``(n, channels, 3)``: value, aim and half
    window of each channel, not a number where there is none. `done` (s) is when what the task asks
    for was reached for good, not a number if never, and `words` what that and the contrary are
    called; `ended` is the fault or the like that ended it.
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
        """Keep the present, at `time` (s)."""
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
        """What was kept; `done` is when the agent declared it, where it does, right or wrong."""
        if self._declared is not None:
            done = self._times[-1] if self._declared else math.nan
        if not any(self._env.DONE):  # the task goes on to its end
            done = math.nan
        ended = self._env.outcome() or (f"fault {fault.partition(' ')[0]}" if fault else "")
        return Recording(
            policy, self._channels, self._env.DONE, np.array(self._times), np.array(self._rows),
            done, ended,
        )
