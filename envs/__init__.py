"""Plants, machines and Gymnasium environments; and what a task of your own is written with."""

from .autotune.bode import bode
from .autotune.tune import tune
from .engine.machine import Machine
from .environment.registry import register, task
from .environment.servo_env import METRE, ServoEnv
from .exchange.batch import episode
from .exchange.faces import clip, faulted, limited
from .exchange.fields import action, observation
from .plants.axis_parameters import FAMILY, LinearAxisParameters
from .plants.commissioning import commission_joint
from .plants.gantry import Gantry, GantryParameters, gantry
from .plants.linear_axis import linear_axis
from .plants.rotary import rotary_axis
from .plants.rotary_parameters import ROTARY_FAMILY, RotaryParameters
from .tasks import ON_MODELS, POINT_TO_POINT, SWINGING_LOAD, TASKS

__all__ = [
    "FAMILY", "METRE", "POINT_TO_POINT", "ROTARY_FAMILY", "SWINGING_LOAD", "TASKS", "Gantry",
    "GantryParameters", "LinearAxisParameters", "Machine", "RotaryParameters", "ServoEnv", "action",
    "bode", "clip", "commission_joint", "episode", "faulted", "gantry", "limited", "linear_axis",
    "observation", "register", "rotary_axis", "task", "tune",
]

for _task in (*TASKS, *ON_MODELS):
    register(_task)
