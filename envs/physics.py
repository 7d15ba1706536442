"""`mj_step` as a function of the compiled loop: the library of the mujoco package, by address.

No C compiler, no plugin, no callback: LLVM resolves the symbol in the library that the Python
package has already loaded. Without JIT the same name is a Python function.
"""

from pathlib import Path
from typing import Any

import llvmlite.binding
import mujoco
from numba import types

from ..drive import jit

_alive: dict[int, tuple[mujoco.MjModel, mujoco.MjData]] = {}  # only without JIT


def _library() -> str:
    folder = Path(mujoco.__file__).parent
    for pattern in ("libmujoco*.so*", "libmujoco*.dylib", "mujoco.dll"):
        for path in sorted(folder.glob(pattern)):
            return str(path)
    raise ImportError(f"no MuJoCo library in {folder}: reinstall the mujoco package")


def _step_in_python(model_address: int, data_address: int) -> None:
    mujoco.mj_step(*_alive[data_address])


mj_step: Any = _step_in_python
if not jit.DISABLED:
    llvmlite.binding.load_library_permanently(_library())
    mj_step = types.ExternalFunction("mj_step", types.void(types.intp, types.intp))


def addresses(model: mujoco.MjModel, data: mujoco.MjData) -> tuple[int, int]:
    """Addresses `mj_step` takes; the caller keeps `model` and `data` alive."""
    if jit.DISABLED:
        _alive[data._address] = model, data
    return model._address, data._address
