"""MuJoCo's functions for the compiled loop: the library of the mujoco package, by address.

No C compiler, no plugin, no callback: LLVM resolves the symbols in the library that the Python
package has already loaded. Without JIT the same names are Python functions.

The layout of MuJoCo's structs, the order of a step and the functions of the library may change with
a release. A release that has not been tested is therefore refused.
"""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import llvmlite.binding
import mujoco
import numpy as np
from numba import types

from ...drive.kernel import jit
from ...drive.memory import address, floats_at, peek

TESTED = "4.0"  # releases of MuJoCo


def refuse_untested(version: str) -> None:
    """Raise ImportError for a release of MuJoCo that has not been tested."""
    if not f"{version}.".startswith(f"{TESTED}."):
        raise ImportError(
            f"MuJoCo {version} is not {TESTED}, with which servogym was tested: it uses addresses "
            f"inside MuJoCo that may differ in another release: pip install "
            f"'mujoco=={TESTED}.*'"
        )


refuse_untested(mujoco.__version__)
STATE = int(mujoco.mjtState.mjSTATE_INTEGRATION)
_models: dict[int, mujoco.MjModel] = {}  # by address, only without JIT
_datas: dict[int, mujoco.MjData] = {}


def _library() -> str:
    folder = Path(mujoco.__file__).parent
    for pattern in ("libmujoco*.so*", "libmujoco*.dylib", "mujoco.dll"):
        for path in sorted(folder.glob(pattern)):
            return str(path)
    raise ImportError(f"no MuJoCo library in {folder}: reinstall the mujoco package")


def _in_python(name: str) -> Any:
    """A function of MuJoCo with addresses of model and data as arguments."""
    function = getattr(mujoco, name)
    return lambda model, data: function(_models[model], _datas[data])


def _solve_in_python(model: int, data: int, solution: int, right: int, n: int) -> None:
    shape = n, _models[model].nv
    x, y = (floats_at(at, n * shape[1]).reshape(shape) for at in (solution, right))
    mujoco.mj_solveM(_models[model], _datas[data], x, y)


def _get_in_python(model: int, data: int, state: int, signature: int) -> None:
    mujoco.mj_getState(_models[model], _datas[data], _state(model, state), signature)


def _set_in_python(model: int, data: int, state: int, signature: int) -> None:
    mujoco.mj_setState(_models[model], _datas[data], _state(model, state), signature)


def _state(model: int, place: int) -> np.ndarray:
    return floats_at(place, mujoco.mj_stateSize(_models[model], STATE))


STEPPING = (  # functions (model, data)
    "mj_step", "mj_step1", "mj_step2", "mj_fwdActuation", "mj_fwdAcceleration", "mj_fwdConstraint",
    "mj_sensorAcc", "mj_checkAcc", "mj_compareFwdInv", "mj_Euler", "mj_implicit", "mj_resetData",
)
LIBRARY = _library()
mj_solve_m: Any = _solve_in_python
mj_get_state: Any = _get_in_python
mj_set_state: Any = _set_in_python
_stepping: list[Any] = [_in_python(name) for name in STEPPING]


def refuse_incomplete(names: Iterable[str]) -> None:
    """Raise ImportError if MuJoCo's library lacks a function, whose call would end Python."""
    if missing := [name for name in names if llvmlite.binding.address_of_symbol(name) is None]:
        raise ImportError(
            f"the library of MuJoCo {mujoco.__version__} has no {', '.join(missing)}: "
            f"pip install 'mujoco=={TESTED}.*'"
        )


if not jit.DISABLED:
    llvmlite.binding.load_library_permanently(LIBRARY)
    refuse_incomplete([*STEPPING, "mj_solveM", "mj_getState", "mj_setState"])
    pair = types.void(types.intp, types.intp)
    _stepping = [types.ExternalFunction(name, pair) for name in STEPPING]
    mj_solve_m = types.ExternalFunction(
        "mj_solveM", types.void(types.intp, types.intp, types.intp, types.intp, types.int32)
    )
    copying = types.void(types.intp, types.intp, types.intp, types.int32)
    mj_get_state = types.ExternalFunction("mj_getState", copying)
    mj_set_state = types.ExternalFunction("mj_setState", copying)
(
    mj_step, mj_step1, mj_step2, mj_fwd_actuation, mj_fwd_acceleration, mj_fwd_constraint,
    mj_sensor_acc, mj_check_acc, mj_compare_fwd_inv, mj_euler, mj_implicit, mj_reset,
) = _stepping

CALLBACKS = ("control", "passive", "act_dyn", "act_gain", "act_bias")  # called when a spec compiles


def compiled(spec: mujoco.MjSpec) -> mujoco.MjModel:
    """Compile a spec.

    Raises:
        ValueError: the error of MuJoCo, or the callbacks in Python that prevent it from compiling.
    """
    try:
        return spec.compile()
    except ValueError as error:
        names = [f"set_mjcb_{n}" for n in CALLBACKS if getattr(mujoco, f"get_mjcb_{n}")()]
        if "Python exception raised" not in str(error) or not names:
            raise
        raise ValueError(
            "MuJoCo compiles no model while a callback in Python is set: build the machine first "
            f"and call mujoco.{', mujoco.'.join(names)} then"
        ) from None


EMPTY = compiled(mujoco.MjSpec.from_string('<mujoco><size memory="1K"/></mujoco>'))
NEAR = 256  # bytes of a struct before an array that are searched, and twice as many after it


def _offset(holder: Any, name: str, array: str, kind: str, values: tuple[Any, Any]) -> int:
    """Bytes from an array in a struct of MuJoCo to a number of the struct, found by its values."""
    usual, found, size = getattr(holder, name), [], np.dtype(kind).itemsize
    for value in values:
        setattr(holder, name, value)
        start = address(getattr(holder, array)) - NEAR
        found.append(peek(np.dtype(kind), start, 3 * NEAR // size) == value)
    setattr(holder, name, usual)
    places = np.flatnonzero(found[0] & found[1])
    if len(places) != 1:
        raise ImportError(f"MuJoCo {mujoco.__version__} has no {name} where {TESTED} has it")
    return int(places[0]) * size - NEAR


OPTIONS = {  # from the gravity in MjModel.opt
    "timestep": _offset(EMPTY.opt, "timestep", "gravity", "f8", (0.123, 0.456)),
    "integrator": _offset(EMPTY.opt, "integrator", "gravity", "i4", (1, 2)),
    "enableflags": _offset(EMPTY.opt, "enableflags", "gravity", "i4", (1, 2)),
}
RNE_FLAG = _offset(mujoco.MjData(EMPTY), "flg_rnepost", "energy", "u1", (True, False))


def addresses(model: mujoco.MjModel, data: mujoco.MjData) -> tuple[int, int]:
    """Return the addresses of model and data; the caller keeps both alive."""
    if jit.DISABLED:
        _models[model._address], _datas[data._address] = model, data
    return model._address, data._address
