"""Hyper-parameters of training runs: common ones for each algorithm, overridden by the task.

The names are those of the arguments of SB3's algorithms. Three belong to the environments instead:
`n_envs`, `normalize` (running mean and variance of observations and rewards) and `streams`, by
which environments draw their episodes. "independent" gives each its own stream. With "consecutive",
as in SB3, environment k of seed s has the stream s + k, so trainings of neighbouring seeds share
nearly all episodes. PPO's `batch_size` is reduced if it does not divide the rollout, `n_steps`
times the environments. A `learning_rate` of two numbers changes linearly from the first to the
second.
"""

import math
from collections.abc import Mapping
from typing import Any

from ...envs.engine.checks import choice, flag, in_range, whole
from ...envs.environment.servo_env import ServoEnv
from ..policies.trained.saved import COUNTED

INDEPENDENT, CONSECUTIVE = STREAMS = "independent", "consecutive"
COMMON: dict[str, dict[str, Any]] = {
    "PPO": {
        "n_envs": 64,
        "normalize": True,
        "streams": INDEPENDENT,
        "n_steps": 64,  # per environment and update
        "batch_size": 512,
        "n_epochs": 5,
        "learning_rate": 1e-3,
        "gamma": 0.98,
        # little noise at first: large steps of the set-point end in a following error
        "policy_kwargs": {"log_std_init": -1.0, "net_arch": [64, 64]},
    },
    "SAC": {
        "n_envs": 8,
        "normalize": False,
        "streams": INDEPENDENT,
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
# For a correction: its actions are shares of the bounds, so exploration may be bold.
RESIDUAL: dict[str, dict[str, Any]] = {
    "PPO": {
        "learning_rate": [1e-3, 1e-4],
        "policy_kwargs": {"log_std_init": -2.0, "net_arch": [64, 64]},
    },
    "SAC": {},
}
COMPILED = "compiled"  # a removed implementation of PPO; only false is accepted
STEPS = 500_000  # of a training, of all environments together
MOST = 10**9
WHOLE = {  # ranges of whole numbers
    "n_envs": (1, 100_000), "n_steps": (1, MOST), "batch_size": (2, MOST), "n_epochs": (1, MOST),
    "buffer_size": (1, MOST), "learning_starts": (0, MOST), "train_freq": (1, MOST),
    "gradient_steps": (-1, MOST), "target_update_interval": (1, MOST),
    "sde_sample_freq": (-1, MOST), "stats_window_size": (1, MOST),
}
REAL = {
    "gamma": (0.0, 1.0), "gae_lambda": (0.0, 1.0), "tau": (0.0, 1.0), "clip_range": (0.0, 100.0),
    "vf_coef": (0.0, 1e6), "max_grad_norm": (0.0, 1e6), "target_kl": (0.0, 1e6),
}
OF_A_RUN = {  # ranges of numbers that belong to a run and not to its algorithm
    "steps": (1, 10**12), "checkpoint_every": (1, 10**12), "evaluate_every": (1, 10**12),
    **COUNTED,
}
FLAGS = ("normalize", "normalize_advantage", "use_sde")
OWN = {  # names that are not hyper-parameters, with the place where they are given
    "seed": "give --seed", "env": "give the id of the environment", "policy": "it is MlpPolicy",
    "device": "a run is on the processor", "tensorboard_log": "the files are in --out",
}


def counted(given: Mapping[str, int | None]) -> None:
    """Raise ValueError for a number of a run that is out of range; torch is not needed."""
    for name, value in given.items():
        if value is not None:
            whole(name, value, *OF_A_RUN[name])


def checked(settings: Mapping[str, Any]) -> None:
    """Raise ValueError for an invalid hyper-parameter, with its value and range."""
    for name, value in settings.items():
        if name in OWN:
            raise ValueError(f"{name} = {value!r} is not a hyper-parameter: {OWN[name]}")
        if name in WHOLE:
            whole(name, value, *WHOLE[name])
        elif name in REAL:
            in_range(name, value, *REAL[name])
        elif name in FLAGS:
            flag(name, value)
        elif name == "streams":
            choice(name, value, STREAMS)
    kwargs = settings.get("policy_kwargs", {})
    if not isinstance(kwargs, Mapping):
        raise ValueError(f'policy_kwargs = {kwargs!r}: give values by name, {{"net_arch": [64]}}')
    net = kwargs.get("net_arch", [])
    for layers in net.values() if isinstance(net, Mapping) else [net]:
        if not isinstance(layers, list | tuple):
            raise ValueError(f"net_arch = {net!r}: give the width of each layer, [64, 64]")
        for width in layers:
            whole("net_arch", width, 1, 100_000)
    rates = settings.get("learning_rate", 0.0)
    for rate in rates if isinstance(rates, list | tuple) else [rates]:
        in_range("learning_rate", rate, 0.0, 10.0)
    ppo, entropy = "n_epochs" in settings, settings.get("ent_coef", 0.0)
    if ppo or not str(entropy).startswith("auto"):
        in_range("ent_coef", entropy, 0.0, 1e6)
    if ppo and settings["n_steps"] * settings.get("n_envs", 2) < 2:
        raise ValueError("n_steps = 1 and n_envs = 1: an update needs 2 steps at least")


def of(
    task: type[ServoEnv], algorithm: str, envs: int | None = None, *, residual: bool = False
) -> dict[str, Any]:
    """Return an algorithm's hyper-parameters on a task; with `envs`, PPO's batch fits it.

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
    return divided(chosen, {})


def divided(table: Mapping[str, Any], settings: Mapping[str, Any]) -> dict[str, Any]:
    """Return `table` with `settings`, checked; by default batches divide a rollout.

    Raises ValueError as `checked` does.
    """
    chosen = {**table, **settings}
    if chosen.pop(COMPILED, False):
        raise ValueError(
            "compiled = True: PPO is that of stable-baselines3 now; leave it out, or train by sbx, "
            "see docs/how-to/train.md"
        )
    checked(chosen)
    if "n_epochs" in chosen and "batch_size" not in settings:
        rollout = chosen["n_steps"] * chosen["n_envs"]
        batches = range(math.ceil(rollout / chosen["batch_size"]), rollout + 1)
        chosen["batch_size"] = rollout // next(n for n in batches if rollout % n == 0)
    return chosen
