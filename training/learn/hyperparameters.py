"""Hyper-parameters of the training runs: for each algorithm the common ones, and what a task says.

The names are those of the arguments of SB3's algorithms; `n_envs` and `normalize` (running mean and
variance of observations and rewards) are of what is put around the environments. `batch_size` of
PPO is made smaller where it does not divide the rollout, `n_steps` times the environments. A
`learning_rate` of two numbers goes from the first to the second in the course of the run.
"""

import math
from typing import Any

from ...envs.servo_env import ServoEnv

COMMON: dict[str, dict[str, Any]] = {
    "PPO": {
        "n_envs": 64,
        "normalize": True,
        "n_steps": 64,  # an environment and update
        "batch_size": 512,
        "n_epochs": 5,
        "learning_rate": 1e-3,
        "gamma": 0.98,
        # careful at first: a set-point thrown about trips the following error
        "policy_kwargs": {"log_std_init": -1.0, "net_arch": [64, 64]},
    },
    "SAC": {
        "n_envs": 8,
        "normalize": False,
        "buffer_size": 200_000,
        "learning_starts": 2_000,
        "train_freq": 1,
        "gradient_steps": 2,  # for each step of the `n_envs`
        "batch_size": 256,
        "learning_rate": 1e-3,
        "gamma": 0.98,
        "policy_kwargs": {"net_arch": [64, 64]},
    },
}
# of a correction: its bounds are the unit, in which to explore boldly
RESIDUAL: dict[str, dict[str, Any]] = {
    "PPO": {
        "learning_rate": [1e-3, 1e-4],
        "policy_kwargs": {"log_std_init": -2.0, "net_arch": [64, 64]},
    },
    "SAC": {},
}
STEPS = 500_000  # of training, of all environments together


def of(
    task: type[ServoEnv], algorithm: str, envs: int | None = None, *, residual: bool = False
) -> dict[str, Any]:
    """Those of an algorithm on a task; with `envs`, PPO's batches divide its rollout.

    With `residual`, those of a correction of another policy.

    Raises ValueError for an unknown algorithm.
    """
    if algorithm not in COMMON:
        raise ValueError(f"algorithm = {algorithm!r}, use one of {', '.join(COMMON)}")
    chosen = COMMON[algorithm] | dict(task.HYPERPARAMETERS.get(algorithm, {}))
    if residual:
        chosen |= RESIDUAL[algorithm]
    if envs is not None:
        chosen["n_envs"] = envs
    if "n_steps" in chosen:
        rollout = chosen["n_steps"] * chosen["n_envs"]
        batches = range(math.ceil(rollout / chosen["batch_size"]), rollout + 1)
        chosen["batch_size"] = rollout // next(n for n in batches if rollout % n == 0)
    return chosen
