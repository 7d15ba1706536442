"""`servogym bench --train`: PPO on our vector compared with PPO on SB3's `DummyVecEnv`, in one run.

Algorithm, environment, network, rollout, batches and epochs are the same and only the vector
differs, so the ratio of the rollouts is the gain of our vector.
"""

import time
from functools import partial
from typing import Any

import gymnasium as gym
import numpy as np
from rich.console import Console

from ..learn import sb3  # first, because it reports what has to be installed

# isort: split
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import DummyVecEnv, VecEnv, VecMonitor

from ...envs import POINT_TO_POINT
from ..learn import checkpoint, hyperparameters
from . import Tell, alternate, show_table

ENV = POINT_TO_POINT.ID
ROLLOUT = 8192  # steps between updates, of all environments together
BLOCKS = 4
PEERS = 8  # environments in the `DummyVecEnv`
OURS = (8, 64, 256)


class _Stopwatch(BaseCallback):
    """Seconds spent in rollouts."""

    spent = 0.0

    def _on_rollout_start(self) -> None:
        self._begin = time.perf_counter()

    def _on_rollout_end(self) -> None:
        self.spent += time.perf_counter() - self._begin

    def _on_step(self) -> bool:
        return True


def _learner(env: VecEnv) -> PPO:
    chosen = hyperparameters.of(POINT_TO_POINT, "PPO")
    names = ("batch_size", "n_epochs", "learning_rate", "gamma", "policy_kwargs")
    settings = {name: chosen[name] for name in names}
    settings["learning_rate"] = sb3.learning_rate(settings["learning_rate"])
    n_steps = ROLLOUT // env.num_envs
    return PPO("MlpPolicy", VecMonitor(env), n_steps=n_steps, seed=0, device="cpu", **settings)


def _block(model: PPO) -> tuple[float, float]:
    """Run one rollout and update; -> time per step of the rollout and of the update (µs)."""
    stopwatch = _Stopwatch()
    begin = time.perf_counter()
    model.learn(ROLLOUT, stopwatch, reset_num_timesteps=False)
    whole = time.perf_counter() - begin
    return stopwatch.spent / ROLLOUT * 1e6, (whole - stopwatch.spent) / ROLLOUT * 1e6


def measure(drive: str, blocks: int = BLOCKS, ours: tuple[int, ...] = OURS) -> list[dict[str, Any]]:
    """Medians of `blocks` for each vector; the first row is that of the peer."""
    dummy = DummyVecEnv([lambda: gym.make(ENV, drive=drive) for _ in range(PEERS)])
    learners = {f"DummyVecEnv of {PEERS}": _learner(dummy)}
    for n in ours:
        learners[f"ServoVecEnv of {n}"] = _learner(sb3.make(ENV, n, drive=drive))
    taken = alternate([partial(_block, learner) for learner in learners.values()], blocks)
    first = taken[:, 0]
    rows = []
    for name, found in zip(learners, taken.swapaxes(0, 1), strict=True):
        whole = found.sum(axis=1)
        medians: dict[str, Any] = {
            "steps_per_s": 1e6 / np.median(whole),
            "rollout_us": np.median(found[:, 0]),
            "update_us": np.median(found[:, 1]),
            "ratio": np.median(first.sum(axis=1) / whole),
            "ratio_of_the_rollouts": np.median(first[:, 0] / found[:, 0]),
        }
        rows.append({"environments": name} | {key: float(x) for key, x in medians.items()})
    for learner in learners.values():
        learner.get_env().close()  # type: ignore[union-attr]
    return rows


def results(options: Any, tell: Tell) -> dict[str, Any]:
    """Measure everything."""
    with sb3.one_thread():
        rows = measure(options.drive)
    return {"drive": options.drive, "versions": checkpoint.versions(), "train": rows}


def show(results: dict[str, Any], console: Console) -> None:
    """Print the results as tables."""
    title = f"PPO on {ENV}, drive {results['drive']}, updates of {ROLLOUT} steps"
    heads = ("", "steps/s", "rollout\n(µs/step)", "update\n(µs/step)", "ratio", "of rollouts")
    rows = [
        (name, *(f"{value:.0f}" for value in times), *(f"{value:.2f}" for value in ratios))
        for name, *times, in_all, of_rollouts in (row.values() for row in results["train"])
        for ratios in [(in_all, of_rollouts)]
    ]
    show_table(console, title, heads, rows)
