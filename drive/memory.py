"""Arrays by address: how compiled code reaches the memory of many machines without Python."""

import ctypes
import functools
from collections.abc import Callable
from typing import Any

import numba
import numpy as np
from numba import carray, types
from numba.extending import intrinsic

from .kernel.jit import DISABLED, block
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
    element = numba.from_dtype(dtype)

    @intrinsic
    def pointer(context, address):
        def build(context, builder, signature, arguments):
            return builder.inttoptr(arguments[0], context.get_value_type(signature.return_type))

        return types.CPointer(element)(types.intp), build

    @block
    def view(address, n):
        return carray(pointer(address), (n,))

    return view


def address(array: np.ndarray) -> int:
    """Where the elements of an array lie."""
    return int(array.__array_interface__["data"][0])


floats_at = viewer(np.dtype("f8"))
integers_at = viewer(np.dtype("i8"))
bytes_at = viewer(np.dtype("u1"))
