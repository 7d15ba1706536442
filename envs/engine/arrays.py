"""Arrays of the physics, found through a WORLD, in the precision of that world.

The arrays of MuJoCo have double precision, those of a `SINGLE`, which mujoco-warp steps, single
precision. The code that runs between the steps is the same for both.
"""

from typing import Any

import numpy as np
from numba import types
from numba.extending import intrinsic

from ...drive.kernel.jit import DISABLED, block
from ...drive.kernel.record import AXIS
from ...drive.memory import array_at, peek, viewer
from .world import COUPLING

MARK = "present"  # a field that only a SINGLE has
axes_at = viewer(AXIS)
couplings_at = viewer(COUPLING)
DOUBLES, FLOATS = (types.Array(kind, 1, "C") for kind in (types.float64, types.float32))


@intrinsic
def _reals_at(context, world, address, n):
    return (FLOATS if MARK in world.fields else DOUBLES)(world, types.intp, types.intp), _at


def _at(context, builder, signature, arguments):
    return array_at(context, builder, signature, arguments[1:])


def _peeked(world: Any, address: int, n: int) -> np.ndarray:
    return peek(np.dtype("f4" if MARK in world.dtype.names else "f8"), address, n)


reals_at: Any = _peeked if DISABLED else _reals_at


@block
def positions(world):
    """Joint coordinates of the physics (qpos)."""
    return reals_at(world, world.mj_qpos, world.nq)


@block
def velocities(world):
    """Joint speeds of the physics (qvel)."""
    return reals_at(world, world.mj_qvel, world.nv)
