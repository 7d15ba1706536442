"""Plants, machines and Gymnasium environments."""

import gymnasium

from .axis_parameters import FAMILY, LinearAxisParameters
from .commissioning import commission_joint
from .gantry import Gantry, GantryParameters, gantry
from .linear_axis import linear_axis
from .machine import Machine
from .tasks import TASKS

__all__ = [
    "FAMILY",
    "TASKS",
    "Gantry",
    "GantryParameters",
    "LinearAxisParameters",
    "Machine",
    "commission_joint",
    "gantry",
    "linear_axis",
]

for task in TASKS:
    gymnasium.register(
        task.ID,
        entry_point=f"{task.__module__}:{task.__name__}",
        vector_entry_point=f"{task.__module__}:vector",
        max_episode_steps=task.STEPS,
    )
