"""MuJoCo's functions for the compiled loop: the library of the mujoco package, by address.

No C compiler, no plugin, no callback: LLVM resolves the symbols in the library that the Python
package has already loaded. Without JIT the same names are Python functions.
"""

from pathlib import Path
from typing import Any

import llvmlite.binding
import mujoco
import numpy as np
from numba import types

from ..drive import jit
from .memory import floats_at

STATE = int(mujoco.mjtState.mjSTATE_INTEGRATION)
_models: dict[int, mujoco.MjModel] = {}  # by address, only without JIT
_datas: dict[int, mujoco.MjData] = {}


def _library() -> str:
    folder = Path(mujoco.__file__).parent
    for pattern in ("libmujoco*.so*", "libmujoco*.dylib", "mujoco.dll"):
        for path in sorted(folder.glob(pattern)):
            return str(path)
    raise ImportError(f"no MuJoCo library in {folder}: reinstall the mujoco package")


def _step_in_python(model: int, data: int) -> None:
    mujoco.mj_step(_models[model], _datas[data])


def _get_in_python(model: int, data: int, state: int, signature: int) -> None:
    mujoco.mj_getState(_models[model], _datas[data], _state(model, state), signature)


def _set_in_python(model: int, data: int, state: int, signature: int) -> None:
    mujoco.mj_setState(_models[model], _datas[data], _state(model, state), signature)


def _state(model: int, address: int) -> np.ndarray:
    return floats_at(address, mujoco.mj_stateSize(_models[model], STATE))


mj_step: Any = _step_in_python
mj_get_state: Any = _get_in_python
mj_set_state: Any = _set_in_python
if not jit.DISABLED:
    llvmlite.binding.load_library_permanently(_library())
    mj_step = types.ExternalFunction("mj_step", types.void(types.intp, types.intp))
    copying = types.void(types.intp, types.intp, types.intp, types.int32)
    mj_get_state = types.ExternalFunction("mj_getState", copying)
    mj_set_state = types.ExternalFunction("mj_setState", copying)


def addresses(model: mujoco.MjModel, data: mujoco.MjData) -> tuple[int, int]:
    """Addresses these functions take; the caller keeps `model` and `data` alive."""
    if jit.DISABLED:
        _models[model._address], _datas[data._address] = model, data
    return model._address, data._address
