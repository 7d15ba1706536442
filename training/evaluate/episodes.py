"""Fixed episodes of an environment under a policy, and the metrics of each.

Episode i of evaluation seed s has the seed 1,000,000 + 1,000 s + i. Training counts up from small
seeds and does not reach these. All episodes run in parallel in a vector environment.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from numbers import Integral
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode

from ...drive.kernel.words import Mode
from ...drive.model.model import DriveModel
from ...envs.engine import probe
from ...envs.environment.registry import task
from ...envs.environment.servo_env import ServoEnv
from ...envs.environment.vector_env import ServoVectorEnv
from ...envs.view.about import Metric
from ..pictures.recording import Recorder, Recording
from ..policies import Bound, BuiltIn, label, make, trainings
from ..policies.trained.residual import PUBLIC
from ..policies.trained.saved import HELD_OUT_SEEDS
from .metrics import METRICS, metrics

FIRST_SEED, SEEDS_APART = HELD_OUT_SEEDS.start, 1_000
LAST_SEED = len(HELD_OUT_SEEDS) // SEEDS_APART - 1
WITHOUT_POSITION = (
    Mode.PROFILE_VELOCITY, Mode.CYCLIC_SYNC_VELOCITY, Mode.CYCLIC_SYNC_TORQUE,
)


@dataclass(frozen=True)
class Evaluation:
    """Evaluation of one policy: seeds and values of each metric, shape ``(n,)``."""

    policy: str
    seeds: list[int]
    values: dict[str, np.ndarray]
    faults: list[str]  # code and meaning; empty without a fault
    trace: Recording | None  # of one episode, under the first training if there are several
    trainings: int = 1  # of the policy from different seeds, each evaluated on all episodes
    metrics: Mapping[str, Metric] = field(default_factory=lambda: METRICS)  # known metrics

    def by_training(self, metric: str) -> np.ndarray | None:
        """Return the values of a metric, ``(trainings, episodes)``; None if it does not apply."""
        values = self.values.get(metric)
        if values is None or not np.isfinite(values).any():
            return None
        return values.reshape(self.trainings, -1)


def pooled(policy: str, results: Sequence[Evaluation]) -> Evaluation:
    """Return the evaluations of several trainings on the same episodes as one."""
    trace = results[0].trace
    return Evaluation(
        policy,
        [seed for result in results for seed in result.seeds],
        {
            metric: np.concatenate([result.values[metric] for result in results])
            for metric in results[0].values
        },
        [fault for result in results for fault in result.faults],
        trace and trace._replace(policy=policy),
        len(results),
        results[0].metrics,
    )


def fixed(seed: int, episodes: int) -> list[int]:
    """Return the fixed episodes. Raises ValueError for numbers out of range."""
    if not (isinstance(episodes, Integral) and 1 <= episodes <= SEEDS_APART):
        raise ValueError(f"--episodes = {episodes!r} is out of range 1..{SEEDS_APART}")
    if not (isinstance(seed, Integral) and 0 <= seed <= LAST_SEED):
        raise ValueError(f"--seed = {seed!r} is out of range 0..{LAST_SEED}")
    first = FIRST_SEED + SEEDS_APART * seed
    return list(range(first, first + episodes))


class Evaluator:
    """The fixed episodes of one environment.

    Args:
        env: id of the environment, or the class of its task.
        drive: drive model.
        episodes: how many, 1..1000.
        seed: evaluation seed.
        seeds: of the episodes, a part of the fixed ones; instead of `episodes` and `seed`.
        options: of the reset of each episode, shape ``(n,)``; none by default.
        traced: the episode that is recorded, counted from 0; None for none.
        prepare: called with each environment before the first episode, as `Setup.prepare`.
        **arguments: of the environment.

    Raises:
        ValueError: naming what is wrong, before the first episode.
    """

    def __init__(
        self, env: str | type[ServoEnv], *, drive: str | DriveModel = "generic", episodes: int = 50,
        seed: int = 0, seeds: Sequence[int] | None = None, options: Sequence[dict[str, Any]] = (),
        traced: int | None = 0, prepare: Callable[[ServoEnv], None] | None = None, **arguments: Any
    ):
        self.task = task(env)
        self.metrics = metrics(self.task)
        self.seeds = fixed(seed, episodes) if seeds is None else list(seeds)
        episodes = len(self.seeds)
        if traced is not None and not 0 <= traced < episodes:
            raise ValueError(
                f"--trace = {traced} is out of range 0..{episodes - 1}: "
                "choose one of the episodes, counted from 0"
            )
        self.traced = traced
        self._options = options
        self.vector = ServoVectorEnv(
            self.task, episodes, autoreset_mode=AutoresetMode.DISABLED, drive=drive, **arguments
        )
        self.env = self.vector.envs[0]
        self._actions = math.prod(self.env.action_space.shape or ())
        self.steps = self.vector.max_episode_steps
        self.played = 0  # steps of all episodes in the last run
        self.duration = self.steps * self.env.step_time
        for each in self.vector.envs:
            each.machine.probe()
            if prepare is not None:
                prepare(each)

    def close(self) -> None:
        """Stop the threads."""
        self.vector.close()

    def run(self, policy: Any) -> Evaluation:
        """Play all episodes under a policy, or under each of its trainings.

        Raises ValueError if the policy does not fit.
        """
        if folders := trainings(policy, self.task.ID):
            return pooled(policy, [self._run(folder) for folder in folders])
        return self._run(policy)

    def first_step(self) -> None:
        """Call everything once that has to be compiled."""
        self._reset()
        self.vector.step(np.zeros((len(self.seeds), self._actions), np.float32))
        for env in self.vector.envs:
            self._measured(env, "")

    def _run(self, policy: Any) -> Evaluation:
        observations, infos = self._reset()
        first = make(policy, self.env, self.seeds[0])
        if isinstance(first, BuiltIn):
            return self._built_in(policy, first)
        if isinstance(first, Bound):
            return self._bound(policy)
        made: list[Any] = [first]
        made += [
            make(policy, self.vector.envs[i], self.seeds[i]) for i in range(1, len(self.seeds))
        ]
        n = len(self.seeds)
        returns, sway = np.zeros(n), np.zeros(n)
        steps, unsettled = np.zeros(n, int), np.zeros(n, int)
        active, faults = np.ones(n, bool), [""] * n
        for i, one in enumerate(made):
            one.reset(observations[i], {k: infos[k][i] for k in PUBLIC if k in infos})
        actions = np.zeros((n, self._actions), np.float32)
        traced = self.traced
        recorder = None if traced is None else Recorder(self.vector.envs[traced])
        if recorder:
            recorder.look(0.0)
        while active.any():
            for i in np.flatnonzero(active).tolist():
                actions[i] = made[i].act(observations[i])
            observations, rewards, ends, truncations, infos = self.vector.step(actions)
            returns += rewards
            steps += active
            if recorder and active[traced]:
                recorder.look(float(steps[traced]) * self.env.step_time)
            if "sway" in infos and steps.max() > 0.75 * self.steps:
                sway = np.maximum(sway, infos["sway"])
            failing = active & ~infos["is_success"]
            unsettled[failing] = steps[failing]
            for i in np.flatnonzero(ends & active).tolist():
                faults[i] = str(infos["fault"][i]) if "fault" in infos else ""
            active &= ~(ends | truncations)
        self.played = int(steps.sum())
        success = infos["is_success"].astype(float)
        settled = np.where(success > 0, unsettled * self.env.step_time, self.duration)
        values = self._empty() | {
            "episode_return": returns,
            "success": success,
            "settling_time": settled.copy(),
            "faults": np.array([fault != "" for fault in faults], float),
        }
        if "sway" in infos:
            values["sway"] = np.where(steps == self.steps, 1e3 * sway, math.nan)
        for i, env in enumerate(self.vector.envs):
            for name, value in self._measured(env, faults[i]).items():
                values[name][i] = value
        trace = None
        if recorder and traced is not None:
            done = float(values["settling_time"][traced])
            if math.isnan(done) and success[traced]:  # the task has no settling time
                done = float(settled[traced])
            done = done if done < self.duration else math.nan
            trace = recorder.trace(label(policy), done, faults[traced])
        return Evaluation(label(policy), self.seeds, values, faults, trace, metrics=self.metrics)

    def _reset(self) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin all episodes and their measurements."""
        seeds: list[int | None] = list(self.seeds)
        observations, infos = self.vector.reset(seed=seeds)
        for i, options in enumerate(self._options):
            mask = np.arange(len(seeds)) == i
            observations, infos = self.vector.reset(
                seed=seeds, options={**options, "reset_mask": mask}
            )
        for env in self.vector.envs:
            probe.begin(env.machine, self.duration, **env.settling(), unit=1.0 / env.units)
        return observations, infos

    def _measured(self, env: ServoEnv, fault: str) -> dict[str, float]:
        """Return the figures of a finished episode: the largest of all drives; work is a sum."""
        probes = env.machine.probes
        ticks = max(int(probes["ticks"][0]), 1)
        rated = env.machine.axes["rated_torque"]
        values: dict[str, Any] = {
            "peak_error": 1e6 * probes["error_peak"].max(),
            "rms_error": 1e6 * np.sqrt(probes["error_squares"] / ticks).max(),
            "peak_torque": (probes["torque_peak"] / rated).max(),
            "rms_torque": (np.sqrt(probes["torque_squares"] / ticks) / rated).max(),
            "rms_jerk": np.sqrt(probes["jerk_squares"] / np.maximum(probes["jerks"], 1)).max(),
            "energy": probes["work"].sum(),
            "limited": probes["limited"].max() / ticks,
        }
        if env.MODES[0] in WITHOUT_POSITION:
            values["peak_error"] = values["rms_error"] = math.nan  # no demand, nothing follows
        one = probes[0]
        if env.settling():
            values["overshoot"] = 1e6 * one.overshoot
            inside = one.outside < one.ticks and not fault
            timestep = env.machine.model.opt.timestep
            values["settling_time"] = one.outside * timestep if inside else self.duration
        if one.first >= 0 and one.highest >= one.lowest:
            values["vibration"] = 0.5e6 * (one.highest - one.lowest)
        values |= env.figures()
        if unknown := values.keys() - self.metrics.keys():
            raise ValueError(
                f"task {self.task.__name__}: METRICS lacks {', '.join(sorted(unknown))}, which "
                "its figures() return"
            )
        return {name: float(value) for name, value in values.items()}

    def _built_in(self, policy: str, chosen: BuiltIn) -> Evaluation:
        """Evaluate a homing method of the drive from the same starts."""
        values = self._empty()
        traced = self.traced
        recorder = None if traced is None else Recorder(self.vector.envs[traced])
        for i, env in enumerate(self.vector.envs):
            observer = recorder.look if recorder and i == traced else None
            judged: Any = env
            found = judged.judged(chosen.method, chosen.objects, observer=observer)
            for name, value in ({"settling_time": self.duration} | found).items():
                values[name][i] = value
        trace = recorder.trace(policy, math.nan) if recorder else None
        faults = [""] * len(self.seeds)
        return Evaluation(policy, self.seeds, values, faults, trace, metrics=self.metrics)

    def _bound(self, policy: str) -> Evaluation:
        """Return the bound of the same episodes; nothing is played."""
        values = self._empty()
        for i, env in enumerate(self.vector.envs):
            for metric, value in Bound(env).values().items():
                values[metric][i] = value
        faults = [""] * len(self.seeds)
        return Evaluation(policy, self.seeds, values, faults, None, metrics=self.metrics)

    def _empty(self) -> dict[str, np.ndarray]:
        return {name: np.full(len(self.seeds), math.nan) for name in self.metrics}
