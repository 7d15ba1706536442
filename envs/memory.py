"""Arrays by address: how compiled code reaches the memory of many machines without Python."""

import ctypes
from collections.abc import Callable
from typing import Any

import numba
import numpy as np
from numba import carray, types
from numba.extending import intrinsic

from ..drive.jit import DISABLED, block
from ..drive.record import accessible


def viewer(dtype: np.dtype) -> Callable[[int, int], np.ndarray]:
    """A function ``(address, n)`` that gives the `n` elements at an address, shape ``(n,)``.

    The caller keeps what lies there alive.
    """
    if DISABLED:

        def view_in_python(address: int, n: int) -> np.ndarray:
            memory: Any = (ctypes.c_char * int(n * dtype.itemsize)).from_address(int(address))
            return np.frombuffer(memory, accessible(dtype) if dtype.names else dtype)

        return view_in_python
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
