"""The drive's cycle for a GPU, from the same source: `ptx` compiles it without one.

numba-cuda takes the functions of `servogym.drive.kernel` as they are, but for two things core Numba
has and it has not: a member of an IntEnum as an index, and `math.gcd`. They are registered here.
A loop on the device, with physics by mujoco-warp, is not there yet.
"""

import math
import operator
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from importlib import import_module
from types import SimpleNamespace
from typing import Any

from numba import from_dtype, types

from ...drive.kernel.cycle import velocity_cycle
from ...drive.kernel.record import AXIS

HOPPER = (9, 0)  # compute capability of an H100 or H200


def ptx(capability: tuple[int, int] = HOPPER) -> str:
    """Code for GPUs of a compute capability, of which there need not be one here.

    A device function of the records of the drives, in memory of the device: one velocity cycle of
    each, a thread a drive.

    Raises:
        ImportError: numba-cuda or its compiler is not installed.
    """
    cuda = _cuda()
    with _compiling_for(capability):
        text, _ = cuda.compile(
            _kernel(cuda), (types.Array(from_dtype(AXIS), 1, "C"),), cc=capability
        )
    return text


def _kernel(cuda: Any) -> Any:
    def kernel(axes):
        i = cuda.grid(1)
        if i < axes.shape[0]:
            velocity_cycle(axes[i])

    return kernel


@cache
def _cuda() -> Any:
    """numba-cuda, with what it lacks."""
    try:
        from numba import cuda

        overload: Any = vars(import_module("numba.cuda.extending"))["overload"]
        arraydecl: Any = import_module("numba.cuda.typing.arraydecl")
    except (ImportError, KeyError) as error:
        raise ImportError(f"{error}: pip install 'servogym[gpu]'") from None

    @overload(math.gcd)
    def gcd(a, b):
        if not isinstance(a, types.Integer) or not isinstance(b, types.Integer):
            return None

        def euclid(a, b):
            while b:
                a, b = b, a % b
            return abs(a)

        return euclid

    @overload(operator.getitem)
    def of_a_tuple(values, index):
        if isinstance(values, types.UniTuple) and isinstance(index, types.IntEnumMember):
            return lambda values, index: values[index.value]
        return None

    index_type = arraydecl.get_array_index_type
    arraydecl.get_array_index_type = lambda array, index: index_type(array, _plain(index))
    return cuda


def _plain(kind: Any) -> Any:
    """Of an index: members of an IntEnum are integers."""
    if isinstance(kind, types.BaseTuple):
        inner: Any = kind
        return types.Tuple([*map(_plain, inner)])
    return kind.dtype if isinstance(kind, types.IntEnumMember) else kind


@contextmanager
def _compiling_for(capability: tuple[int, int]) -> Iterator[None]:
    """numba-cuda asks the present device for what it calls; it is told of one that need not be."""
    compiler: Any = import_module("numba.cuda.compiler")
    dispatcher: Any = import_module("numba.cuda.dispatcher")
    device = SimpleNamespace(compute_capability=capability)
    before = dispatcher.get_current_device, compiler.get_current_device
    dispatcher.get_current_device = compiler.get_current_device = lambda: device
    try:
        yield
    finally:
        dispatcher.get_current_device, compiler.get_current_device = before
