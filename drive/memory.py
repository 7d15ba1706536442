"""Arrays by address: how compiled code reaches the memory of many machines without Python."""

import ctypes
import functools
from collections.abc import Callable
from typing import Any

import numba
import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from .kernel.jit import DISABLED
from .kernel.record import accessible


def peek(dtype: np.dtype, address: int, n: int) -> np.ndarray:
    """The `n` elements at an address, for Python, shape ``(n,)``."""
    memory: Any = (ctypes.c_char * int(n * dtype.itemsize)).from_address(int(address))
    return np.frombuffer(memory, accessible(dtype) if dtype.names else dtype)


def viewer(dtype: np.dtype) -> Callable[[int, int], np.ndarray]:
    """A function ``(address, n)`` that gives the `n` elements at an address, shape ``(n,)``.

    The caller keeps what lies there alive.
    """
    if DISABLED:
        return functools.partial(peek, dtype)
    kind = types.Array(numba.from_dtype(dtype), 1, "C")

    @intrinsic
    def view(context, address, n):
        return kind(types.intp, types.intp), array_at

    compiled: Any = view
    return compiled


def array_at(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    """Code for the array that begins at the first of the arguments, as long as the second says.

    It asks nothing of Numba but the context, so that it serves a GPU as well.
    """
    place, n = arguments
    array = context.make_array(signature.return_type)(context, builder)
    array.data = builder.inttoptr(place, array.data.type)
    size = context.get_abi_sizeof(context.get_data_type(signature.return_type.dtype))
    itemsize = n.type(size)
    array.nitems, array.itemsize = n, itemsize
    array.shape, array.strides = _tuple(builder, n), _tuple(builder, itemsize)
    array.meminfo, array.parent = (part.type(None) for part in (array.meminfo, array.parent))
    return array._getvalue()


def _tuple(builder: Any, value: Any) -> Any:
    """Of one number, as shape and strides are."""
    kind = ir.ArrayType(value.type, 1)
    return builder.insert_value(ir.Constant(kind, ir.Undefined), value, 0)


def address(array: np.ndarray) -> int:
    """Where the elements of an array lie."""
    return int(array.__array_interface__["data"][0])


floats_at = viewer(np.dtype("f8"))
integers_at = viewer(np.dtype("i8"))
bytes_at = viewer(np.dtype("u1"))
