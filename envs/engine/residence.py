"""A residence: MjModel and MjData that machines of one structure share by taking turns.

A machine that enters writes its own values of the `variable` fields into the shared MjModel and its
state into MjData, after those of the machine before it have been saved.
"""

import copy
import zlib

import mujoco
import numpy as np

from ...drive.memory import address, peek
from .guard import Turn
from .world import FIELD

# fields of MjModel that may differ between machines that share one
VARIABLE = (
    "body_pos", "body_ipos", "body_mass", "body_subtreemass", "body_inertia", "body_invweight0",
    "jnt_stiffness", "dof_armature", "dof_damping", "dof_invweight0", "dof_M0",
    "dof_length", "geom_pos", "geom_size", "geom_aabb", "geom_rbound", "light_poscom0",
    "cam_poscom0",
    "tendon_stiffness", "tendon_length0", "tendon_invweight0",
    "actuator_acc0", "actuator_gainprm", "actuator_gear",
)
FLOAT = np.dtype("f8")


class Residence:
    """MjModel and MjData shared by machines of the same structure, and whose turn it is.

    Args:
        model: the MuJoCo model of the machine that they are taken from.
        data: its state.
    """

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData):
        self.model, self.data = model, data
        self.checksum = checksum(model)
        self.turn = Turn()
        self.resident = np.zeros(1, np.int64)  # address of the machine whose state is there now
        arrays = variable(model)
        self.fields = np.zeros(len(arrays), FIELD)
        for field, array in zip(self.fields, arrays, strict=True):
            field["address"], field["length"] = address(array), array.size
        # the state of the last machine is saved when another one enters, even if it was deleted
        self.alive: list[np.ndarray] = [self.resident, self.fields]


def variable(model: mujoco.MjModel) -> list[np.ndarray]:
    """The arrays of a model that may differ between machines that share it.

    The last two are the gravity and mjStatistic.
    """
    center = model.stat.center  # behind mean inertia, mass and size, and extent, which it follows
    arrays = [getattr(model, name) for name in VARIABLE]
    return [*arrays, model.opt.gravity, peek(FLOAT, address(center) - 32, 7)]


def checksum(model: mujoco.MjModel) -> int:
    """Return a checksum of everything in the model that does not vary."""
    model = copy.copy(model)
    for array in variable(model):
        array[:] = 0
    buffer = np.empty(mujoco.mj_sizeModel(model), np.uint8)
    mujoco.mj_saveModel(model, None, buffer)
    return zlib.crc32(buffer.tobytes())
