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

from ...drive.kernel import jit
from ...drive.memory import floats_at

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


def _step1_in_python(model: int, data: int) -> None:
    mujoco.mj_step1(_models[model], _datas[data])


def _step2_in_python(model: int, data: int) -> None:
    mujoco.mj_step2(_models[model], _datas[data])


def _actuation_in_python(model: int, data: int) -> None:
    mujoco.mj_fwdActuation(_models[model], _datas[data])


def _acceleration_in_python(model: int, data: int) -> None:
    mujoco.mj_fwdAcceleration(_models[model], _datas[data])


def _solve_in_python(model: int, data: int, solution: int, right: int, n: int) -> None:
    shape = n, _models[model].nv
    x, y = (floats_at(at, n * shape[1]).reshape(shape) for at in (solution, right))
    mujoco.mj_solveM(_models[model], _datas[data], x, y)


def _get_in_python(model: int, data: int, state: int, signature: int) -> None:
    mujoco.mj_getState(_models[model], _datas[data], _state(model, state), signature)


def _set_in_python(model: int, data: int, state: int, signature: int) -> None:
    mujoco.mj_setState(_models[model], _datas[data], _state(model, state), signature)


def _state(model: int, address: int) -> np.ndarray:
    return floats_at(address, mujoco.mj_stateSize(_models[model], STATE))


def _reset_in_python(model: int, data: int) -> None:
    mujoco.mj_resetData(_models[model], _datas[data])


LIBRARY = _library()
mj_step: Any = _step_in_python
mj_step1: Any = _step1_in_python
mj_step2: Any = _step2_in_python
mj_fwd_actuation: Any = _actuation_in_python
mj_fwd_acceleration: Any = _acceleration_in_python
mj_solve_m: Any = _solve_in_python
mj_get_state: Any = _get_in_python
mj_set_state: Any = _set_in_python
mj_reset: Any = _reset_in_python
if not jit.DISABLED:
    llvmlite.binding.load_library_permanently(LIBRARY)
    stepping = types.void(types.intp, types.intp)
    mj_step = types.ExternalFunction("mj_step", stepping)
    mj_step1 = types.ExternalFunction("mj_step1", stepping)
    mj_step2 = types.ExternalFunction("mj_step2", stepping)
    mj_fwd_actuation = types.ExternalFunction("mj_fwdActuation", stepping)
    mj_fwd_acceleration = types.ExternalFunction("mj_fwdAcceleration", stepping)
    mj_solve_m = types.ExternalFunction(
        "mj_solveM", types.void(types.intp, types.intp, types.intp, types.intp, types.int32)
    )
    copying = types.void(types.intp, types.intp, types.intp, types.int32)
    mj_get_state = types.ExternalFunction("mj_getState", copying)
    mj_set_state = types.ExternalFunction("mj_setState", copying)
    mj_reset = types.ExternalFunction("mj_resetData", types.void(types.intp, types.intp))


def addresses(model: mujoco.MjModel, data: mujoco.MjData) -> tuple[int, int]:
    """Addresses these functions take; the caller keeps `model` and `data` alive."""
    if jit.DISABLED:
        _models[model._address], _datas[data._address] = model, data
    return model._address, data._address
