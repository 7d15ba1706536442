"""Arrays by address, by which compiled code accesses the memory of many machines."""

import ctypes
import functools
import math
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
    """The `n` elements at an address as an array for Python, shape ``(n,)``."""
    memory: Any = (ctypes.c_char * int(n * dtype.itemsize)).from_address(int(address))
    return np.frombuffer(memory, accessible(dtype) if dtype.names else dtype)


def viewer(dtype: np.dtype, dimensions: int = 1) -> Callable[..., np.ndarray]:
    """A function ``(address, *shape)`` that returns the elements at an address as an array.

    The caller keeps the memory alive.
    """
    if DISABLED:
        return functools.partial(_peeked, dtype)
    kind = types.Array(numba.from_dtype(dtype), dimensions, "C")

    @intrinsic
    def one(context, address, n):
        return kind(types.intp, types.intp), array_at

    @intrinsic
    def two(context, address, n, m):
        return kind(types.intp, types.intp, types.intp), array_at

    compiled: Any = two if dimensions == 2 else one
    return compiled


def _peeked(dtype: np.dtype, address: int, *shape: int) -> np.ndarray:
    return peek(dtype, address, math.prod(shape)).reshape(shape)


def array_at(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    """Code for an array at the address in the first argument, with the shape of the others.

    It needs only Numba's context, so it works on a GPU as well.
    """
    place, *shape = arguments
    array = context.make_array(signature.return_type)(context, builder)
    array.data = builder.inttoptr(place, array.data.type)
    size = context.get_abi_sizeof(context.get_data_type(signature.return_type.dtype))
    array.itemsize = place.type(size)
    strides, array.nitems = [array.itemsize], shape[-1]
    for n in reversed(shape[:-1]):
        strides.insert(0, builder.mul(array.nitems, array.itemsize))
        array.nitems = builder.mul(n, array.nitems)
    array.shape, array.strides = _tuple(builder, shape), _tuple(builder, strides)
    array.meminfo, array.parent = (part.type(None) for part in (array.meminfo, array.parent))
    return array._getvalue()


def _tuple(builder: Any, values: list) -> Any:
    """Build a tuple of integers in LLVM, for shape and strides."""
    made = ir.Constant(ir.ArrayType(values[0].type, len(values)), ir.Undefined)
    for i, value in enumerate(values):
        made = builder.insert_value(made, value, i)
    return made


def address(array: np.ndarray) -> int:
    """Address of the first element of an array."""
    return int(array.ctypes.data)


floats_at = viewer(np.dtype("f8"))
integers_at = viewer(np.dtype("i8"))
bytes_at = viewer(np.dtype("u1"))
