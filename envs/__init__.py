"""Plants, machines and Gymnasium environments; and what a task of your own is written with."""

from .autotune.bode import bode
from .autotune.tune import tune
from .batch import episode
from .engine.machine import Machine
from .faces import clip, faulted, limited
from .fields import action, observation
from .plants.axis_parameters import FAMILY, LinearAxisParameters
from .plants.commissioning import commission_joint
from .plants.gantry import Gantry, GantryParameters, gantry
from .plants.linear_axis import linear_axis
from .plants.rotary import ROTARY_FAMILY, RotaryParameters, rotary_axis
from .registry import register, task
from .servo_env import METRE, ServoEnv
from .tasks import ON_MODELS, POINT_TO_POINT, TASKS

__all__ = [
    "FAMILY",
    "METRE",
    "POINT_TO_POINT",
    "ROTARY_FAMILY",
    "TASKS",
    "Gantry",
    "GantryParameters",
    "LinearAxisParameters",
    "Machine",
    "RotaryParameters",
    "ServoEnv",
    "action",
    "bode",
    "clip",
    "commission_joint",
    "episode",
    "faulted",
    "gantry",
    "limited",
    "linear_axis",
    "observation",
    "register",
    "rotary_axis",
    "task",
    "tune",
]

for _task in (*TASKS, *ON_MODELS):
    register(_task, f"{_task.__module__}:vector")
