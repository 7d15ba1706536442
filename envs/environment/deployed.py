"""Episodes on drives of a bus: the exchange of frames does not wait for the policy.

The policy runs in a process of its own (`policy_process`), so ending, hanging or exhausting its
memory does not affect the process that exchanges frames and stops the drives. If its action has not
arrived when the set-points are due, the previous action is used again, as a drive bridges a missing
set-point. Several missing actions in a row stop the drives, and so does an error in the policy or a
return value that is no action.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

import numpy as np

from ...drive.wire import real_time
from ..exchange import fields
from ..exchange.envelope import Stopped
from ..exchange.over_port import PortLine
from .policy_process import MEMORY, Acting, PolicyProcess
from .servo_env import ServoEnv


class Played(NamedTuple):
    """The result of an episode."""

    returned: float  # sum of its rewards
    steps: int
    late: int  # number of actions that came too late
    info: dict[str, Any]  # of the last step
    values: dict[str, float]  # metrics, see `Figures`


class Figures:
    """Metrics of an episode, derived from the answers of the drives on a bus and in memory alike.

    ``episode_return``, ``success``, ``settling_time`` (s, to the step; the length of the episode
    where it has not settled at the end), ``peak_error`` (µm or µrad), ``rms_torque`` (rated).
    """

    def __init__(self, env: ServoEnv):
        self._env = env
        self._returned = self._squares = self._peak = 0.0
        self._steps = self._unsettled = 0

    def step(self, reward: float, info: dict[str, Any]) -> None:
        """Take the outcome of a step."""
        answers = self._env._part.tpdos[0]
        names = answers.dtype.names
        self._returned += reward
        self._steps += 1
        if not info.get("is_success"):
            self._unsettled = self._steps
        if "following_error_actual_value" in names:
            error = np.abs(answers["following_error_actual_value"].astype(float)).max()
            self._peak = max(self._peak, float(error))
        if "torque_actual_value" in names:
            self._squares += float(np.square(1e-3 * answers["torque_actual_value"]).max())

    def values(self) -> dict[str, float]:
        """Return the metrics by name."""
        steps = max(self._steps, 1)
        return {
            "episode_return": self._returned, "success": float(self._unsettled < self._steps),
            "settling_time": self._unsettled * self._env.step_time,
            "peak_error": 1e6 * self._peak / self._env.units,
            "rms_torque": (self._squares / steps) ** 0.5,
        }


def in_memory(
    env: ServoEnv, policy: Acting, episodes: int, seed: int, slow: float = 1.0
) -> tuple[list[dict[str, float]], str]:
    """Play episodes in this process without real time and return their metrics.

    Args:
        env: on a port in this process, as `servogym.envs.serve.in_process.environment` makes one.
        policy: acts as on the bus.
        episodes: how many.
        seed: of the first episode; the next ones have the next.
        slow: share of each action that is applied.

    Returns:
        The metrics of each episode, and why the guard or an error of the policy stopped the next
        one; empty if all episodes were played.
    """
    values: list[dict[str, float]] = []
    try:
        for episode in range(episodes):
            observation, info = env.reset(seed=seed + episode)
            policy.reset(observation, info)
            figures, ended, steps = Figures(env), False, 0
            while not ended and steps < env.STEPS:
                action = policy.act(observation)
                given = slow * action if slow != 1.0 else action
                observation, reward, ended, _, info = env.step(given)
                figures.step(reward, info)
                steps += 1
            values.append(figures.values())
    except Stopped as stopped:
        return values, f"{stopped}"
    return values, ""


class _Plain:
    """A function of an observation as a policy."""

    def __init__(self, act: Callable[[np.ndarray], Any]):
        self.act = act

    def reset(self, observation: np.ndarray, info: dict[str, Any]) -> None:
        pass


@contextmanager
def _guarded(line: PortLine) -> Iterator[None]:
    """Stop the drives on any error, and let the reason be a `Stopped`."""
    try:
        yield
    except Stopped as stopped:
        raise line.stop(stopped) from stopped.__cause__
    except (Exception, KeyboardInterrupt) as error:
        raise line.stop(error) from error


def play(
    env: ServoEnv, act: Callable[[np.ndarray], Any] | None = None, episodes: int = 1, **how: Any
) -> list[Played]:
    """Play episodes to the end and return all of them; arguments and errors of `episodes_of`."""
    return [*episodes_of(env, act, episodes, **how)]


def episodes_of(
    env: ServoEnv, act: Callable[[np.ndarray], Any] | None = None, episodes: int = 1, *,
    make: Callable[[], Acting] | PolicyProcess | None = None, patience: float | None = None,
    slow: float = 1.0, seed: int | None = None, memory: int = MEMORY, fast: bool = False,
) -> Iterator[Played]:
    """Play episodes on an environment whose drives are on a bus; yield each when it is over.

    Args:
        env: made with ``port``.
        act: observation to action; it runs in a process of its own, so variables that it changes do
            not change here.
        episodes: how many.
        make: instead of `act`, makes a policy in that process; or such a process, which the caller
            closes.
        patience: for an action (s); until the set-points of the step are due, if not given.
        slow: share of each action that is applied, above 0, at most 1.
        seed: of the first episode; the next ones have the next.
        memory: bytes that the policy may allocate.
        fast: request real-time scheduling; ``env.line.refused`` lists what the system refuses.

    Raises:
        ValueError: the environment is not on a bus.
        Stopped: the guard, the bus, the policy or Ctrl-C ended it; the drives have been stopped.
    """
    line = env.line
    if not isinstance(line, PortLine):
        raise ValueError("this environment has no drives on a bus: make it with port=...")
    if (make is None) == (act is None):
        raise ValueError("give act, a function of the observation, or make, which makes a policy")
    if make is None:
        assert act is not None
        plain = _Plain(act)
        make = lambda: plain  # noqa: E731
    hold = np.array([env.HOLD.get(name, 0.0) for name in fields.names(env.ACTION)])
    policy: PolicyProcess | None = None
    try:
        with _guarded(line):
            policy = make if isinstance(make, PolicyProcess) else PolicyProcess(make, memory, fast)
            if fast:
                line.refused = real_time.ask()
            for episode in range(episodes):
                observation, info = env.reset(seed=None if seed is None else seed + episode)
                policy.begin(observation, info, line.idle)
                line.settle()
                yield _episode(env, line, policy, observation, info, hold, patience, slow)
    finally:
        if policy is not None and policy is not make:
            policy.close()


def _episode(
    env: ServoEnv, line: PortLine, policy: PolicyProcess, observation: np.ndarray,
    info: dict[str, Any], hold: np.ndarray, patience: float | None, slow: float,
) -> Played:
    late, in_a_row, ended, steps, applied = 0, 0, False, 0, hold
    figures = Figures(env)
    while not ended and steps < env.STEPS:
        action = policy.ask(observation, line.patience if patience is None else patience)
        if action is None:
            in_a_row, late = in_a_row + 1, late + 1
            line.timing.stale += 1
            if line.timing.row(in_a_row) >= line.missed:
                raise Stopped("", f"the policy is late: {line.missed} actions have not come")
        else:
            in_a_row = 0
            line.timing.thinking.append(policy.took)
            applied = slow * action if slow != 1.0 else action
        observation, reward, ended, _, info = env.step(applied)
        figures.step(reward, info)
        steps += 1
    values = figures.values()
    return Played(values["episode_return"], steps, late, info, values)
