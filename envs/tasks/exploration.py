"""How several tasks are explored while they are learned: hyper-parameters they share."""

from typing import Any

# An exploration that depends on the state can be bold on the way and calm at the goal (gSDE).
CALM: dict[str, Any] = {
    "learning_rate": [1e-3, 0.0],
    "gamma": 0.99,
    "use_sde": True,
    "sde_sample_freq": 4,
    "policy_kwargs": {"log_std_init": -3.0, "net_arch": [64, 64]},
}
