"""Episodes in parts: one job plays each part, and their results are joined again."""

import inspect
import math
from collections.abc import Sequence
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from ...envs.environment.servo_env import ServoEnv
from ..pictures.recording import Recording
from ..policies import label, make, trainings
from ..policies.file import SUFFIX
from ..policies.trained.saved import STATISTICS, ZIP
from ..scale.job import Job, Result
from ..setup import Setup
from .episodes import Evaluation, Evaluator, pooled
from .metrics import metrics

PART = 10  # episodes of a job
OURS = "servogym."

# the latest ones made by this process, because the next job or cell often needs the same
_last: dict[str, Evaluator] = {}
_example: dict[str, ServoEnv] = {}


def play(
    setup: Setup, policy: Any, training: int | None, seeds: Sequence[int], traced: int | None,
    options: Sequence[dict[str, Any]] = (),
) -> Result:
    """Play some episodes under one policy, or under one of its trainings, as a job."""
    key = repr((setup, len(seeds), options))
    if key not in _last:
        for evaluator in _last.values():
            evaluator.close()
        _last.clear()
        _last[key] = Evaluator(
            setup.task, drive=setup.drive, seeds=seeds, options=options, prepare=setup.prepare,
            **setup.arguments,
        )
    evaluator = _last[key]
    evaluator.seeds, evaluator.traced = list(seeds), traced
    chosen = policy if training is None else trainings(policy, evaluator.task.ID)[training]
    found = evaluator.run(chosen)
    result: Result = {f"values/{name}": values for name, values in found.values.items()}
    result["faults"] = found.faults
    if (trace := found.trace) is not None:
        result |= {"time": trace.time, "samples": trace.samples}
        result |= {"done": trace.done, "ended": trace.ended}
    return result


class Episodes:
    """The fixed episodes under one policy: a cell, each of whose jobs plays some of them.

    Args:
        setup: of the environments.
        policy: by name, or a class or function (`policies.file.policy_of`).
        seeds: of the episodes.
        traced: the episode that is recorded, counted from 0; None: none is.
        options: of the reset of each episode; none if not given.

    Raises:
        ValueError: an unknown drive or policy, or one that does not fit, before the first episode.
    """

    def __init__(
        self, setup: Setup, policy: Any, seeds: Sequence[int], traced: int | None = None,
        options: Sequence[dict[str, Any]] = (),
    ):
        self._policy, self._seeds, self._setup = policy, list(seeds), setup
        first = example(setup)
        make(policy, first)
        self._words, self._channels = first.DONE, first.channels()
        self.duration = first.STEPS * first.step_time
        folders = trainings(policy, setup.task.ID)
        parts = math.ceil(len(self._seeds) / PART)
        edges = np.linspace(0, len(self._seeds), parts + 1).astype(int).tolist()
        about = f"{label(policy)} on {setup.task.ID.rpartition('/')[2]}"
        job = partial(Job, function=play, watched=watched(setup, policy, folders))
        self.jobs = [
            job(
                name=f"{about}, drive {setup.drive}, episodes {begin} to {end - 1}",
                arguments={
                    "setup": setup, "policy": policy, "training": training,
                    "seeds": self._seeds[begin:end],
                    "traced": traced - begin
                    if traced is not None and not training and begin <= traced < end
                    else None,
                    "options": list(options[begin:end]),
                },
            )
            for training in (range(len(folders)) if folders else [None])
            for begin, end in pairwise(edges)
        ]
        self._parts = parts

    def results(self, found: Sequence[Result]) -> Evaluation:
        """Collect the results of the jobs in their order."""
        each = [found[i : i + self._parts] for i in range(0, len(found), self._parts)]
        return pooled(label(self._policy), [self._training(parts) for parts in each])

    def _training(self, parts: Sequence[Result]) -> Evaluation:
        names = [name for name in parts[0] if name.startswith("values/")]
        return Evaluation(
            label(self._policy),
            self._seeds,
            {
                name.removeprefix("values/"): np.concatenate([part[name] for part in parts])
                for name in names
            },
            [fault for part in parts for fault in part["faults"]],
            next((self.trace(part) for part in parts if "time" in part), None),
            metrics=metrics(self._setup.task),
        )

    def trace(self, part: Result) -> Recording:
        """Return the recording of the episode recorded in a part."""
        return Recording(
            label(self._policy), self._channels, self._words, part["time"], part["samples"],
            part["done"], part["ended"],
        )


def example(setup: Setup) -> ServoEnv:
    """Return an environment to inspect, not to step; the latest one is kept.

    Raises ValueError as the task does.
    """
    key = repr(setup)
    if key not in _example:
        for env in _example.values():
            env.close()
        _example.clear()
        _example[key] = setup.make()
    return _example[key]


def warm(setup: Setup) -> Job:
    """Return a small job that needs all code that is compiled for an environment."""
    return Job(f"compiling for {setup.name}", once, {"env": setup.name, "drive": setup.drive})


def once(env: str, drive: str) -> Result:
    """Take the first step of an episode of a task, by its id, as a job.

    A process that has loaded nothing yet is told of it, before the task can be looked up.
    """
    evaluator = Evaluator(env, drive=drive, episodes=1)
    evaluator.first_step()
    evaluator.close()
    return {}


def watched(setup: Setup, policy: Any, folders: Sequence[str]) -> tuple[str, ...]:
    """Return the files outside the package that determine what a policy does."""
    found = [*folders, *(str(Path(f).with_name(STATISTICS)) for f in folders if f.endswith(ZIP))]
    base, _, _ = policy.rpartition(":") if isinstance(policy, str) else ("", "", "")
    if base.endswith(SUFFIX):
        found.append(base)
    if Path(setup.drive).is_dir():
        found.append(str(setup.drive))
    if setup.parameter_file is not None:
        found.append(setup.parameter_file)
    for own in (setup.task, policy):
        if isinstance(own, type) and not own.__module__.startswith(OURS):
            found.append(inspect.getfile(own))
    return tuple(found)
