"""What runs around the steps of mujoco-warp, for a GPU, from the same source as for a CPU.

numba-cuda takes the `parts` and all they are made of, the whole drive among it, as they are, but
for two things core Numba has and it has not: a member of an IntEnum as an index, and `math.gcd`.
They are registered here. `ptx` compiles without a GPU; what `launcher` does has been run on none.
"""

import math
import operator
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from importlib import import_module
from types import SimpleNamespace
from typing import Any

from numba import types

from . import arrays, friction, parts, tick
from .parts import PARTS

VIEWS: tuple[Any, ...] = (  # blocks whose result is an array
    arrays.positions, arrays.velocities, tick.coordinates, tick.speeds, parts.controls,
    friction.response,
)  # fmt: skip
HOPPER = (9, 0)  # compute capability of an H100 or H200
THREADS = 64  # of a block; a drive takes many registers (inferred, not measured)


def ptx(part: str, capability: tuple[int, int] = HOPPER) -> str:
    """Code of one of `PARTS` for GPUs of a compute capability, of which there need not be one here.

    A kernel called with the address of the first machine's row on the device, the bytes from one
    to the next, and how many they are: a thread a machine.

    Raises:
        ImportError: numba-cuda or its compiler is not installed.
    """
    cuda = _cuda()
    with _compiling_for(capability):
        text, _ = cuda.compile(
            _kernel(cuda, PARTS[part]), (types.int64,) * 3, device=False, abi="numba", cc=capability
        )
    return text


def launcher(wp: Any, device: Any, first: int, stride: int, n: int) -> Callable[[str], None]:
    """A function that runs a part on all machines of a device, in the stream that warp uses.

    Args:
        wp: warp.
        device: of warp, with CUDA.
        first, stride, n: as for the kernels.
    """
    cuda = _cuda()
    cuda.select_device(device.ordinal)  # its primary context, as warp's
    kernels = {name: cuda.jit(_kernel(cuda, part)) for name, part in PARTS.items()}
    blocks = -(-n // THREADS)

    def launch(part: str) -> None:
        stream = cuda.external_stream(wp.get_stream(device).cuda_stream)
        kernels[part][blocks, THREADS, stream](first, stride, n)

    return launch


def _kernel(cuda: Any, part: Callable[..., None]) -> Any:
    def kernel(first, stride, n):
        i = cuda.grid(1)
        if i < n:
            part(first + i * stride)

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

    for view in VIEWS:  # else it refuses an array as a result; these own nothing
        options = view.targetoptions | {"device": True, "debug": False, "opt": True}
        dispatcher = cuda.dispatcher.CUDADispatcher(view.py_func, options | {"inline": "always"})
        view._CUDATypingContext__dispatcher = dispatcher
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
