"""A comparison: the jobs that play policies on the same fixed episodes, and what comes of them.

Score: 0 is holding still, 1 the reference of the task, both as the interquartile means of their
returns over the same episodes.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from ...envs.environment.registry import task
from ..pictures.recording import Recording
from ..policies import POLICIES, needed
from ..scale.job import Result
from ..scale.work import ALONE, Work
from .episodes import Evaluation, fixed
from .metrics import iqm
from .parts import Episodes, warm
from .tables import summaries

ZERO = "hold"
# arguments that are a way to command and not a part of the task
COMMANDING = {name for row in POLICIES.values() for name in row.arguments}


def scores(returns: np.ndarray, zero: np.ndarray, one: np.ndarray) -> np.ndarray:
    """Of each episode; not a number where `one` earns no more than `zero`."""
    low, high = float(iqm(zero)), float(iqm(one))
    span = high - low
    return (returns - low) / span if span > 0.0 else np.full_like(returns, np.nan)


class Comparison:
    """Policies on the fixed episodes: the jobs that play them, and the evaluations they give.

    Args:
        env: id of the environment.
        policies: by name, each in an environment with the arguments it needs; or classes and
            functions (`policies.file.policy_of`).
        drive: drive model.
        episodes: how many, 1..1000.
        seed: of the episodes.
        arguments: of the environment; the ends of the score keep the way they command.
        traced: the episode to be recorded, 0 being the first.
        console: a terminal shows there how far it is.

    Raises:
        ValueError: an unknown environment, drive or policy, before the first episode.
    """

    def __init__(
        self, env: str, policies: Sequence[Any], drive: str, episodes: int, seed: int,
        arguments: Mapping[str, Any] | None = None, traced: int = 0,
    ):  # fmt: skip
        given = dict(arguments or {})
        common = {name: value for name, value in given.items() if name not in COMMANDING}
        kind = task(env)
        ends = [ZERO, kind.REFERENCE] if kind.REFERENCE else []
        seeds = fixed(seed, episodes)
        if not 0 <= traced < episodes:
            raise ValueError(
                f"--trace = {traced} is out of range 0..{episodes - 1}: "
                "choose one of the episodes, counted from 0"
            )
        self._played = [(policy, needed(policy) | given) for policy in dict.fromkeys(policies)]
        self._bounds = [(policy, common | needed(policy)) for policy in ends]
        self._episodes = {
            (policy, repr(own)): Episodes(env, policy, drive, seeds, own, traced)
            for policy, own in (*self._played, *self._bounds)
        }
        jobs = [(key, job) for key, each in self._episodes.items() for job in each.jobs]
        first = [i for i, (_, job) in enumerate(jobs) if job.arguments["traced"] is not None]
        order = [*first, *(i for i in range(len(jobs)) if i not in first)]  # `Early` waits for them
        self.jobs = [jobs[i][1] for i in order]
        self._places = {
            key: [order.index(i) for i, (owner, _) in enumerate(jobs) if owner == key]
            for key in self._episodes
        }

    def results(self, found: Sequence[Result]) -> list[Evaluation]:
        """Of each policy, from the results of the jobs; `score` where the task has a reference."""
        done = {key: self._evaluation(key, found) for key in self._episodes}
        results = [done[policy, repr(own)] for policy, own in self._played]
        if self._bounds:
            ends = [
                done[policy, repr(own)].values["episode_return"] for policy, own in self._bounds
            ]
            for result, score in [
                (result, scores(result.values["episode_return"], *ends)) for result in results
            ]:
                result.values["score"] = score
        return results

    def ready(self, found: Mapping[int, Result], k: int) -> Evaluation | None:
        """Of the policy that the k-th job belongs to, where it was the last of them."""
        key = next(key for key, places in self._places.items() if k in places)
        if any(place not in found for place in self._places[key]):
            return None
        return self._evaluation(key, found)

    def _evaluation(
        self, key: tuple[Any, str], found: Sequence[Result] | Mapping[int, Result]
    ) -> Evaluation:
        return self._episodes[key].evaluation([found[k] for k in self._places[key]])

    def traces(self, found: Mapping[int, Result]) -> list[Recording] | None:
        """Of the traced episode under each policy that recorded it; None while one is missing."""
        traces = []
        for policy, own in self._played:
            key = policy, repr(own)
            (k,) = (k for k in self._places[key] if self.jobs[k].arguments["traced"] is not None)
            if k not in found:
                return None
            if "time" in found[k]:
                traces.append(self._episodes[key].trace(found[k]))
        return traces


class Early:
    """What is made of a comparison while others still play: the second picture, and intervals.

    Args:
        comparison: whose jobs are done.
        draw: gives the bytes of a picture of what was recorded.
    """

    def __init__(self, comparison: Comparison, draw: Callable[[Sequence[Recording]], bytes]):
        self._comparison, self._draw = comparison, draw
        self._found: dict[int, Result] = {}
        self.picture: bytes | None = None

    def __call__(self, k: int, result: Result) -> None:
        """The k-th job of the comparison is done."""
        self._found[k] = result
        if self.picture is None and (traces := self._comparison.traces(self._found)) is not None:
            self.picture = self._draw(traces) if traces else b""  # a bound is never played
        if (evaluation := self._comparison.ready(self._found, k)) is not None:
            summaries([evaluation])  # resamples are kept


def evaluate(
    env: str, policies: Sequence[Any], drive: str, episodes: int, seed: int,
    arguments: Mapping[str, Any] | None = None, traced: int = 0, work: Work = ALONE,
) -> list[Evaluation]:  # fmt: skip
    """Each policy on the fixed episodes; what is given is that of `Comparison`, and who works."""
    comparison = Comparison(env, policies, drive, episodes, seed, arguments, traced)
    return comparison.results(work.map(comparison.jobs, warm=[warm(env, drive)]))
