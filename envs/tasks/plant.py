"""Builds the machine of a task from its data sheet."""

from typing import Any

from ...drive.model.model import DriveModel
from ..engine.machine import Machine
from ..environment.servo_env import ServoEnv
from ..plants.axis_parameters import LinearAxisParameters
from ..plants.gantry import GantryParameters, gantry
from ..plants.linear_axis import linear_axis
from ..plants.rotary import rotary_axis
from ..plants.rotary_parameters import RotaryParameters

PLANTS: dict[type, Any] = {
    LinearAxisParameters: linear_axis, GantryParameters: gantry, RotaryParameters: rotary_axis,
}


def of_datasheet(task: ServoEnv, model: DriveModel) -> Machine:
    """Build a commissioned machine with the following error window of the task, as `_make`."""
    plant = PLANTS[type(task.datasheet)]
    machine: Machine = plant(model, parameters=task.datasheet, tuned=task.tuned)
    if hasattr(task, "_window"):
        for name in task.DRIVES or machine.drives:
            window = round(task._window * task.units)
            machine.drives[name].write("following_error_window", window)
    return machine
