"""Compiles the code around the steps of mujoco-warp for a GPU, from the same source as for a CPU.

numba-cuda compiles the `parts`, and with them the whole drive, without changes. Three features of
Numba that it lacks are registered here: members of an IntEnum as an index, `math.gcd`, and
functions that return a view of an array. Machine code can be made and cached without a GPU;
`launcher` has not been run on one.
"""

import math
import operator
import os
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import cache
from importlib import import_module
from importlib.metadata import version
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
from numba import types

from ...drive.kernel.jit import cache_directory
from ...drive.kernel.reach import reach
from ...drive.memory import integers_at, viewer
from . import arrays, friction, parts, tick
from .parts import PARTS

VIEWS: tuple[Any, ...] = (  # blocks that return an array
    arrays.positions, arrays.velocities, tick.coordinates, tick.speeds, parts.controls,
    friction.response,
)
HOPPER = (9, 0)  # compute capability of an H100 or H200
THREADS = 32  # per block: 4096 machines make a block for each multiprocessor (not measured)
ENTRY = "servogym"


def ptx(kernel: "Kernel", capability: tuple[int, int] = HOPPER) -> str:
    """PTX of a kernel for GPUs of a compute capability; no GPU is needed.

    Args:
        kernel: kernel of a part of a step (`of_part`) or of a task.
        capability: compute capability of the GPUs.

    Raises:
        ImportError: numba-cuda or its compiler is not installed.
    """
    cuda = _cuda()
    with _compiling_for(capability):
        text, _ = cuda.compile(
            kernel.make(cuda), (types.int64,) * kernel.arguments,
            device=False, abi="numba", cc=capability,
        )
    return text


def machine_code(text: str, capability: tuple[int, int] = HOPPER) -> bytes:
    """Assemble PTX for GPUs of a compute capability, as a driver does when it loads it.

    Raises:
        ImportError: nvJitLink is not installed.
        Exception: an error of nvJitLink, if the code does not assemble.
    """
    try:
        linker: Any = import_module("cuda.bindings.nvjitlink")
    except ImportError as error:
        raise ImportError(f"{error}: pip install 'servogym[gpu]'") from None
    options = [f"-arch=sm_{capability[0]}{capability[1]}"]
    handle = linker.create(len(options), options)
    try:
        data = text.encode() + b"\0"
        linker.add_data(handle, linker.InputType.PTX, data, len(data), "servogym")
        linker.complete(handle)
        code = bytearray(linker.get_linked_cubin_size(handle))
        linker.get_linked_cubin(handle, code)
        return bytes(code)
    finally:
        linker.destroy(handle)


class Kernel(NamedTuple):
    """A kernel with one thread per machine; its function is made once numba-cuda is loaded."""

    make: Callable[[Any], Any]
    arguments: int  # whole numbers, the last is how many machines there are


def of_part(name: str) -> Kernel:
    """Kernel of one of `PARTS`; arguments: address of the first machine, stride, count."""
    part = PARTS[name]

    def make(cuda: Any) -> Any:
        def kernel(first, stride, n):
            i = cuda.grid(1)
            if i < n:
                part(first + i * stride)

        return kernel

    return Kernel(make, 3)


def of_act(act: Any, drives: int, episode: np.dtype, command: np.dtype, rpdo: np.dtype) -> Kernel:
    """Kernel of ``act`` of a task.

    Its arguments are the addresses of the array of machine addresses, of the episodes, commands and
    RPDO images, and the number of machines.
    """
    episodes_at, commands_at, images_at = viewer(episode), viewer(command), viewer(rpdo, 2)
    a, b, c = episode.itemsize, command.itemsize, rpdo.itemsize * drives

    def make(cuda: Any) -> Any:
        def kernel(worlds, episodes, commands, rpdos, n):
            i = cuda.grid(1)
            if i < n:
                act(
                    integers_at(worlds + 8 * i, 1), episodes_at(episodes + a * i, 1),
                    commands_at(commands + b * i, 1), images_at(rpdos + c * i, 1, drives),
                )

        return kernel

    return Kernel(make, 5)


def of_judge(
    judge: Any, drives: int, episode: np.dtype, rpdo: np.dtype, tpdo: np.dtype,
    observation: np.dtype,
) -> Kernel:
    """Kernel of ``judge``, see `of_act`: machines, episodes, RPDO and TPDO images, observations."""
    episodes_at, observations_at = viewer(episode), viewer(observation)
    rpdos_at, tpdos_at = viewer(rpdo, 2), viewer(tpdo, 2)
    a, b = episode.itemsize, rpdo.itemsize * drives
    c, d = tpdo.itemsize * drives, observation.itemsize

    def make(cuda: Any) -> Any:
        def kernel(worlds, episodes, rpdos, tpdos, observations, n):
            i = cuda.grid(1)
            if i < n:
                judge(
                    integers_at(worlds + 8 * i, 1), episodes_at(episodes + a * i, 1),
                    rpdos_at(rpdos + b * i, 1, drives), tpdos_at(tpdos + c * i, 1, drives),
                    observations_at(observations + d * i, 1),
                )

        return kernel

    return Kernel(make, 6)


def of_control(
    control: Any, modes: np.ndarray, drives: int, command: np.dtype, rpdo: np.dtype
) -> Kernel:
    """Kernel of `faces.control` with the possible modes: machines, controls, RPDO images."""
    controls_at, images_at = viewer(command, 2), viewer(rpdo, 2)
    a, b = command.itemsize * drives, rpdo.itemsize * drives

    def make(cuda: Any) -> Any:
        def kernel(worlds, controls, rpdos, n):
            i = cuda.grid(1)
            if i < n:
                control(
                    integers_at(worlds + 8 * i, 1), controls_at(controls + a * i, 1, drives),
                    modes, images_at(rpdos + b * i, 1, drives),
                )

        return kernel

    return Kernel(make, 4)


def of_report(
    report: Any, modes: np.ndarray, drives: int, tpdo: np.dtype, status: np.dtype
) -> Kernel:
    """Kernel of `faces.report`: machines, TPDO images and the status of each drive."""
    images_at, status_at = viewer(tpdo, 2), viewer(status, 2)
    a, b = tpdo.itemsize * drives, status.itemsize * drives

    def make(cuda: Any) -> Any:
        def kernel(worlds, tpdos, statuses, n):
            i = cuda.grid(1)
            if i < n:
                report(
                    images_at(tpdos + a * i, 1, drives), modes,
                    status_at(statuses + b * i, 1, drives),
                )

        return kernel

    return Kernel(make, 4)


def code(kernel: Kernel, capability: tuple[int, int] = HOPPER) -> bytes:
    """Machine code of a kernel, cached; its only entry is called ENTRY.

    Raises:
        ImportError: a package of the extra ``servogym[gpu]`` is missing.
    """
    versions = [version(name) for name in ("numba-cuda", "nvidia-nvvm", "nvidia-nvjitlink")]
    about = {"capability": capability, "versions": versions}
    digest, _ = reach(kernel.make(_cuda()), about)
    path = cache_directory() / f"{digest[:32]}.cubin"
    with suppress(OSError):
        return path.read_bytes()
    name = re.compile(r"^(\.visible \.entry )(\w+)", re.M)
    made = machine_code(name.sub(rf"\1{ENTRY}", ptx(kernel, capability)), capability)
    part = path.with_suffix(f".{os.getpid()}")
    try:
        part.write_bytes(made)
        part.replace(path)
    except OSError:  # a full disk, say: it is compiled again the next time
        with suppress(OSError):
            part.unlink(missing_ok=True)
    return made


def launcher(wp: Any, device: Any, kernel: Kernel, n: int) -> Callable[..., None]:
    """Return a function that runs a kernel on `n` machines of a device, in the stream of warp.

    cuda.core loads and launches it in the primary context, which warp uses as well.

    Args:
        wp: warp.
        device: warp device with CUDA.
        kernel: the kernel to run.
        n: number of machines.

    Raises:
        ImportError: a package of the extra ``servogym[gpu]`` is missing.
        RuntimeError: the driver refuses the code.
    """
    try:
        core: Any = import_module("cuda.core")
    except ImportError as error:
        raise ImportError(f"{error}: pip install 'servogym[gpu]'") from None
    made = code(kernel, divmod(device.arch, 10))
    core.Device(device.ordinal).set_current()
    try:
        loaded = core.ObjectCode.from_cubin(made).get_kernel(ENTRY)
    except Exception as error:  # of the driver, each its own
        raise RuntimeError(
            f"{device}: its driver does not take what numba-cuda {version('numba-cuda')} makes "
            f"({error}): the extra servogym[gpu] is for drivers of CUDA 13"
        ) from None
    config = core.LaunchConfig(grid=-(-n // THREADS), block=THREADS)
    stream = core.Stream.from_handle(device.stream.cuda_stream)  # not in a capture: it asks for it

    def launch(*addresses: int) -> None:
        with wp.ScopedDevice(device):
            core.launch(stream, config, loaded, *map(np.int64, (*addresses, n)))

    return launch


@cache
def _cuda() -> Any:
    """Load numba-cuda and register the features that it lacks."""
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

    for view in VIEWS:  # numba-cuda refuses arrays as results; inlined, these return none
        options = view.targetoptions | {"device": True, "debug": False, "opt": True}
        dispatcher = cuda.dispatcher.CUDADispatcher(view.py_func, options | {"inline": "always"})
        view._CUDATypingContext__dispatcher = dispatcher
    index_type = arraydecl.get_array_index_type
    arraydecl.get_array_index_type = lambda array, index: index_type(array, _plain(index))
    return cuda


def _plain(kind: Any) -> Any:
    """Return an index as an integer, also for members of an IntEnum."""
    if isinstance(kind, types.BaseTuple):
        inner: Any = kind
        return types.Tuple([*map(_plain, inner)])
    return kind.dtype if isinstance(kind, types.IntEnumMember) else kind


@contextmanager
def _compiling_for(capability: tuple[int, int]) -> Iterator[None]:
    """Make numba-cuda compile for a compute capability instead of that of the present device."""
    compiler: Any = import_module("numba.cuda.compiler")
    dispatcher: Any = import_module("numba.cuda.dispatcher")
    device = SimpleNamespace(compute_capability=capability)
    before = dispatcher.get_current_device, compiler.get_current_device
    dispatcher.get_current_device = compiler.get_current_device = lambda: device
    try:
        yield
    finally:
        dispatcher.get_current_device, compiler.get_current_device = before
