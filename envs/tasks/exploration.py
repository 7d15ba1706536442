"""Hyper-parameters for exploration that several tasks share."""

from typing import Any

# State-dependent exploration (gSDE) can be large on the way and small at the goal.
CALM: dict[str, Any] = {
    "learning_rate": [1e-3, 0.0],
    "gamma": 0.99,
    "use_sde": True,
    "sde_sample_freq": 4,
    "policy_kwargs": {"log_std_init": -3.0, "net_arch": [64, 64]},
}
