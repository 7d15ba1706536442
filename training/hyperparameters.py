"""Hyper-parameters of the training runs: for each algorithm the common ones, for each id its own.

The names are those of the arguments of SB3's algorithms; `n_envs` and `normalize` (running mean and
variance of observations and rewards) are of what is put around the environments. `batch_size` of
PPO is made smaller where it does not divide the rollout, `n_steps` times the environments. A
`learning_rate` of two numbers goes from the first to the second in the course of the run.
"""

import math
from typing import Any

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
STEPS = 500_000  # of training, of all environments together
# An exploration that depends on the state can be bold on the way and calm at the goal (gSDE).
CALM: dict[str, Any] = {
    "learning_rate": [1e-3, 0.0],
    "gamma": 0.99,
    "use_sde": True,
    "sde_sample_freq": 4,
    "policy_kwargs": {"log_std_init": -3.0, "net_arch": [64, 64]},
}
OWN: dict[str, dict[str, dict[str, Any]]] = {  # id: algorithm: what differs
    "servogym/LinearAxis-v0": {
        # at rest within the tolerance there is no room for noise
        "PPO": {
            "learning_rate": 5e-4,
            "policy_kwargs": {"log_std_init": -3.0, "net_arch": [64, 64]},
        },
    },
    "servogym/LinearAxisTracking-v0": {
        # the actions are small corrections of what the drive does well by itself
        "PPO": {"gamma": 0.9, "policy_kwargs": {"log_std_init": -3.0, "net_arch": [64, 64]}},
    },
    "servogym/CompliantAxis-v0": {"PPO": CALM},
    "servogym/GantrySway-v0": {"PPO": {"learning_rate": [1e-3, 0.0], "gamma": 0.99}},
    "servogym/Homing-v0": {
        # what counts comes at the end, hundreds of steps later; a search goes on for a while
        "PPO": CALM
        | {
            "learning_rate": 5e-4,
            "gamma": 0.998,
            "n_steps": 128,
            "batch_size": 1024,
            "sde_sample_freq": 32,
            "policy_kwargs": {"log_std_init": -2.5, "net_arch": [64, 64]},
        },
    },
}


def of(env_id: str, algorithm: str, envs: int | None = None) -> dict[str, Any]:
    """Those of an algorithm on an environment; with `envs`, PPO's batches divide its rollout.

    Raises ValueError for an unknown algorithm.
    """
    if algorithm not in COMMON:
        raise ValueError(f"algorithm = {algorithm!r}, use one of {', '.join(COMMON)}")
    chosen = COMMON[algorithm] | OWN.get(env_id, {}).get(algorithm, {})
    if envs is not None:
        chosen["n_envs"] = envs
    if "n_steps" in chosen:
        rollout = chosen["n_steps"] * chosen["n_envs"]
        batches = range(math.ceil(rollout / chosen["batch_size"]), rollout + 1)
        chosen["batch_size"] = rollout // next(n for n in batches if rollout % n == 0)
    return chosen
