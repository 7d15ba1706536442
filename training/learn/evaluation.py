"""Evaluates policies on the same episodes each time, and compares them with holding still."""

from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
from rich.console import Console
from stable_baselines3.common.callbacks import EvalCallback
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.vec_env import VecEnv

from ...drive.model import foreign
from . import checkpoint

PATIENCE, FALL = 8, 0.15  # a training ends after so many evaluations this far below the best
EPISODES = 16  # of an evaluation, each in an environment of its own
WRITTEN = ".evaluations"  # temporary name of a file until it is complete
EPISODES_SEED = 20_000_000  # the same for every run


class Score(NamedTuple):
    """Result on the fixed episodes: mean return, standard deviation, mean length (steps)."""

    reward: float
    deviation: float
    length: float

    def __str__(self) -> str:
        """``"87.2 ± 4.1 in 200 steps"``."""
        return f"{self.reward:.1f} ± {self.deviation:.1f} in {self.length:.0f} steps"


class HoldStill:
    """A policy with actions of 0, or no correction, which every other policy has to beat."""

    def __init__(self, actions: gym.Space):
        self.shape = actions.shape or ()

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        """Return actions of 0, shape ``(num_envs, actions)``, and no state."""
        return np.zeros((len(observation), *self.shape), np.float32), None


def score(policy, env: VecEnv) -> Score:
    """Play the fixed episodes in `EPISODES` environments."""
    env.seed(EPISODES_SEED)
    rewards, lengths = evaluate_policy(policy, env, EPISODES, return_episode_rewards=True)
    return Score(float(np.mean(rewards)), float(np.std(rewards)), float(np.mean(lengths)))


class EvaluationCallback(EvalCallback):
    """SB3's evaluation on fixed episodes; it continues from a checkpoint and keeps the best."""

    def __init__(self, env: VecEnv, about: dict[str, Any], out: Path, every: int, console: Console):
        freq = max(every // about["envs"], 1)
        super().__init__(
            env, n_eval_episodes=EPISODES, eval_freq=freq, log_path=str(out), verbose=0
        )
        self.log_path = str(out / WRITTEN)
        self.about, self.out, self.console = about, out, console
        self.fallen = 0  # consecutive evaluations far below the best

    def go_on(self, steps: int) -> None:
        """Recover the results up to `steps`."""
        self.n_calls = steps // self.about["envs"]
        file = self.out / "evaluations.npz"
        if not file.is_file():
            return
        found = foreign.arrays(file)
        kept = found["timesteps"] <= steps
        self.evaluations_timesteps = found["timesteps"][kept].tolist()
        self.evaluations_results = found["results"][kept].tolist()
        self.evaluations_length = found["ep_lengths"][kept].tolist()
        if "successes" in found:
            self.evaluations_successes = found["successes"][kept].tolist()
        means = [float(np.mean(rewards)) for rewards in self.evaluations_results]
        self.best_mean_reward = max(means, default=-np.inf)

    def now(self, model: Any) -> None:
        """Evaluate a model that is trained without `model.learn`; the latest one is kept."""
        if not self.n_calls:
            self.init_callback(model)
        self.best_mean_reward = -np.inf
        self.n_calls, self.num_timesteps = self.eval_freq, model.num_timesteps
        self._on_step()

    def _on_training_end(self) -> None:
        """Evaluate a run that was too short for a single evaluation."""
        if not self.evaluations_timesteps:
            self.eval_freq = self.n_calls
            self._on_step()

    def _on_step(self) -> bool:
        if self.n_calls % self.eval_freq:
            return True
        self.eval_env.seed(EPISODES_SEED)
        best = self.best_mean_reward
        super()._on_step()
        with suppress(FileNotFoundError):
            (self.out / f"{WRITTEN}.npz").replace(self.out / "evaluations.npz")
        better = self.best_mean_reward > best
        if better:
            about = self.about | {"mean_reward": self.best_mean_reward}
            checkpoint.save(self.model, about, self.out / "best", resumable=False)
        self.console.print(
            f"{self.num_timesteps:>10} steps: reward of an episode {self.last_mean_reward:.1f}"
            + (", the best so far" if better else "")
        )
        fallen = self.last_mean_reward < self.best_mean_reward - FALL * abs(self.best_mean_reward)
        self.fallen = self.fallen + 1 if fallen else 0
        if self.fallen < PATIENCE:
            return True
        self.console.print(
            f"stopped: {PATIENCE} evaluations running were more than {100 * FALL:.0f} % below the "
            f"best, {self.best_mean_reward:.1f}, whose policy is in {self.out / 'best'}; "
            "--resume goes on all the same"
        )
        return False
