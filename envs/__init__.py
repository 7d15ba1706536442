"""Plants, machines and Gymnasium environments."""

import gymnasium

from .gantry import gantry
from .linear_axis import LinearAxisParameters, linear_axis
from .machine import Machine

__all__ = ["LinearAxisParameters", "Machine", "gantry", "linear_axis"]

gymnasium.register(
    "servogym/LinearAxis-v0",
    entry_point="servogym.envs.axis_env:LinearAxisEnv",
    vector_entry_point="servogym.envs.axis_vector_env:LinearAxisVectorEnv",
    max_episode_steps=200,
)
