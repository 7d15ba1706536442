"""A comparison: the jobs that play policies on the same fixed episodes, and their results.

A score of 0 is holding still, a score of 1 is the reference of the task, both as the interquartile
means of their returns over the same episodes.
"""

import json
import shlex
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from rich.console import Console

from ...envs.environment.servo_env import ServoEnv
from ..pictures.recording import Recording
from ..policies import POLICIES, needed
from ..scale.job import Result
from ..scale.work import ALONE, Work
from ..setup import Setup
from .episodes import Evaluation, fixed
from .grid import played
from .metrics import iqm
from .parts import Episodes, warm
from .tables import summaries

ZERO = "hold"
# arguments that set how a policy commands and are no part of the task
COMMANDING = {name for row in POLICIES.values() for name in row.arguments}


def scores(returns: np.ndarray, zero: np.ndarray, one: np.ndarray) -> np.ndarray:
    """Return the score of each episode; NaN where `one` earns no more than `zero`."""
    low, high = float(iqm(zero)), float(iqm(one))
    span = high - low
    return (returns - low) / span if span > 0.0 else np.full_like(returns, np.nan)


@dataclass(frozen=True)
class Request:
    """A user's request to `eval` or `compare`: policies to be played on fixed episodes.

    Args:
        setup: of the environments.
        policies: names, classes or functions (`policies.file.policy_of`). Each plays in an
            environment with the arguments it needs; a policy named twice is played once.
        episodes: the number of episodes, 1..1000.
        seed: of the episodes.
        traced: the episode to be recorded, counted from 0.
    """

    setup: Setup
    policies: Sequence[Any]
    episodes: int
    seed: int = 0
    traced: int = 0

    @property
    def seeds(self) -> list[int]:
        """Return the seeds of the episodes. Raises ValueError for numbers out of range."""
        return fixed(self.seed, self.episodes)

    @property
    def each(self) -> list[Any]:
        """Return the policies, each once."""
        return list(dict.fromkeys(self.policies))

    def needed(self, policy: Any) -> Setup:
        """Return the setup of a policy, with the arguments it needs and those given."""
        return self.setup.having(needed(policy) | dict(self.setup.arguments))

    def command(self, name: str, more: str = "") -> str:
        """Return the command that makes this request."""
        option = "policy" if name == "eval" else "policies"
        return (
            f"servogym {name} {self.setup.name} --{option} {','.join(self.policies)} "
            f"--drive {self.setup.drive} --episodes {self.episodes} --seed {self.seed}"
            + (f" --trace {self.traced}" if self.traced else "")
            + more
            + "".join(f" --argument {quoted(*one)}" for one in self.setup.arguments.items())
        )


def quoted(name: str, value: Any) -> str:
    """Return ``NAME=VALUE`` for a shell, with a text as it is and anything else in JSON."""
    return shlex.quote(f"{name}={value if isinstance(value, str) else json.dumps(value)}")


class Comparison:
    """Policies on the fixed episodes: a cell whose jobs play them, and its evaluations.

    The ends of the score are played as well; they keep the way they command. The jobs that record
    the traced episode come first.

    Args:
        request: policies, episodes and environments.

    Raises:
        ValueError: an unknown drive or policy, before the first episode.
    """

    def __init__(self, request: Request):
        setup, seeds = request.setup, request.seeds
        common = {n: value for n, value in setup.arguments.items() if n not in COMMANDING}
        ends = [ZERO, setup.task.REFERENCE] if setup.task.REFERENCE else []
        if not 0 <= request.traced < request.episodes:
            raise ValueError(
                f"--trace = {request.traced} is out of range 0..{request.episodes - 1}: "
                "choose one of the episodes, counted from 0"
            )
        asked = [(policy, request.needed(policy)) for policy in request.each]
        bounds = [(policy, setup.having(common | needed(policy))) for policy in ends]
        self._played = [(policy, repr(own)) for policy, own in asked]
        self._bounds = [(policy, repr(own)) for policy, own in bounds]
        self._episodes = {
            (policy, repr(own)): Episodes(own, policy, seeds, request.traced)
            for policy, own in (*asked, *bounds)
        }
        jobs = [(key, job) for key, each in self._episodes.items() for job in each.jobs]
        late = [job.arguments["traced"] is None for _, job in jobs]
        # `BackgroundSummary` waits for the traced ones
        order = sorted(range(len(jobs)), key=late.__getitem__)
        self.jobs = [jobs[i][1] for i in order]
        self._places = {
            key: [order.index(i) for i, (owner, _) in enumerate(jobs) if owner == key]
            for key in self._episodes
        }

    def results(self, found: Sequence[Result]) -> list[Evaluation]:
        """Return the results of each policy; with `score` if the task has a reference."""
        done = {key: self._evaluation(key, found) for key in self._episodes}
        results = [done[key] for key in self._played]
        if self._bounds:
            ends = [done[key].values["episode_return"] for key in self._bounds]
            for result, score in [
                (result, scores(result.values["episode_return"], *ends)) for result in results
            ]:
                result.values["score"] = score
        return results

    def ready(self, found: Mapping[int, Result], k: int) -> Evaluation | None:
        """Return the evaluation of the policy whose last job is k; None while jobs are open."""
        key = next(key for key, places in self._places.items() if k in places)
        if any(place not in found for place in self._places[key]):
            return None
        return self._evaluation(key, found)

    def _evaluation(
        self, key: tuple[Any, str], found: Sequence[Result] | Mapping[int, Result]
    ) -> Evaluation:
        return self._episodes[key].results([found[k] for k in self._places[key]])

    def traces(self, found: Mapping[int, Result]) -> list[Recording] | None:
        """Return the recordings of the traced episode; None while one is missing."""
        traces = []
        for key in self._played:
            (k,) = (k for k in self._places[key] if self.jobs[k].arguments["traced"] is not None)
            if k not in found:
                return None
            if "time" in found[k]:
                traces.append(self._episodes[key].trace(found[k]))
        return traces


class BackgroundSummary:
    """Makes the second picture and the intervals of a comparison while other jobs still run.

    Args:
        comparison: the comparison to which the finished jobs belong.
        draw: returns the bytes of a picture of the recordings.
    """

    def __init__(self, comparison: Comparison, draw: Callable[[Sequence[Recording]], bytes]):
        self._comparison, self._draw = comparison, draw
        self._found: dict[int, Result] = {}
        self.picture: bytes | None = None

    def __call__(self, k: int, result: Result) -> None:
        """Take the result of the k-th job of the comparison."""
        self._found[k] = result
        if self.picture is None and (traces := self._comparison.traces(self._found)) is not None:
            self.picture = self._draw(traces) if traces else b""  # a bound is never played
        if (evaluation := self._comparison.ready(self._found, k)) is not None:
            summaries([evaluation])  # resamples are kept


def evaluate(
    env: str | type[ServoEnv], policies: Sequence[Any], drive: str, episodes: int, seed: int,
    arguments: Mapping[str, Any] | None = None, traced: int = 0, work: Work = ALONE,
) -> list[Evaluation]:
    """Evaluate each policy on the fixed episodes of a task, given by its id or class.

    Further arguments are those of `Setup` and `Request`; `work` runs the jobs.
    """
    setup = Setup.of(env, drive, arguments)
    comparison = Comparison(Request(setup, policies, episodes, seed, traced))
    with played(comparison, work, Console(quiet=True), warm=[warm(setup)]) as results:
        return results
