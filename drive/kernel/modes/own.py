"""Modes of operation that a drive model defines, compiled separately and called by address.

The compiled cycle is the same with and without them. It looks up the active mode in a table outside
of the code, so a new mode takes only the second in which it is compiled, and a drive without such
modes loses no time. A GPU has no such table.
"""

from collections.abc import Callable
from enum import IntEnum
from typing import Any, NamedTuple

import llvmlite.binding
import numba
import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from ..jit import DISABLED, block, entry, rare
from ..record import AXIS, Axis

NUMBERS = range(-16, 0)  # of 6060h: those that have a bit in 6502h
MOST = 64  # modes of all the models in a process
SYMBOL = "servogym_own_modes"


class Step(IntEnum):
    """Which function of a mode is called."""

    START = 0
    DEMAND = 1
    STATUS = 2
    LEAVE = 3


class ModeOfOperation(NamedTuple):
    """Functions of a mode of operation, each of them with the record of the axis as argument.

    They are compiled by Numba; a function that they call has to be a `block` as well. All numbers
    of the record are in SI units at the motor shaft.

    Attributes:
        start: called when the mode takes the enabled axis over: continue from the demand of the
            previous mode and choose `axis.control`.
        demand: called in every position cycle in which the mode moves the axis.
        status: called in every position cycle; sets `mode_bit10`, `mode_bit12` and `mode_bit13`.
        leave: called when another mode is selected, and when the power of the mode goes off; it may
            be called without a `start` before.
    """

    start: Callable[[Axis], None]
    demand: Callable[[Axis], None]
    status: Callable[[Axis], None]
    leave: Callable[[Axis], None] | None = None


_installed: dict[tuple[int, int], tuple[ModeOfOperation, Any]] = {}  # holds the compiled code
_table = np.zeros(3 * MOST, np.int64)  # key of the model, number of the mode, address: row by row


def install(key: int, number: int, mode: ModeOfOperation) -> None:
    """Compile a mode and have the cycle call it for records whose `own_modes` is `key`.

    Raises:
        ValueError: there are too many.
        Exception: of Numba, for what it does not compile.
    """
    if (key, number) in _installed:
        return
    row = 3 * len(_installed)
    if row == len(_table):
        raise ValueError(f"a process has room for {MOST} modes of operation of drive models")
    address, code = (0, None) if DISABLED else _compiled(mode)
    _installed[key, number] = mode, code
    _table[row + 1 : row + 3] = number, address
    _table[row] = key  # the row counts from now on


def _compiled(mode: ModeOfOperation) -> tuple[int, Any]:
    """Address of a C function ``(record, step)``, and what keeps its code alive."""
    start, demand, status, leave = (
        function if hasattr(function, "py_func") else block(function)
        for function in (*mode[:3], mode.leave or _nothing)
    )

    def own_mode(record, step):
        axis = numba.carray(record, 1)[0]
        if step == Step.START:
            start(axis)
        elif step == Step.DEMAND:
            demand(axis)
        elif step == Step.STATUS:
            status(axis)
        else:
            leave(axis)

    code = entry(own_mode)
    arguments = types.CPointer(numba.from_dtype(AXIS)), types.int64
    code.compile(types.void(*arguments))
    result = code.overloads[arguments]
    name = result.fndesc.llvm_cfunc_wrapper_name
    return result.library.get_pointer_to_function(name), code


def _nothing(axis: Axis) -> None:
    pass


if DISABLED:

    def call(axis: Axis, step: int) -> None:
        """Call a function of the active mode, one of the model's own."""
        found = _installed.get((int(axis.own_modes), int(axis.mode)))
        function = found[0][step] if found else None
        if function is not None:
            function(axis)
else:
    llvmlite.binding.add_symbol(SYMBOL, _table.ctypes.data)
    _word = ir.IntType(64)

    def _on_gpu(context) -> bool:
        return type(context).__module__.startswith("numba.cuda")

    @intrinsic
    def _of_table(typing, index):
        """A number of the table, which compiled code reaches by its symbol; 0 on a GPU."""

        def code(context, builder, signature, arguments):
            if _on_gpu(context):
                return _word(0)
            table = builder.module.globals.get(SYMBOL) or ir.GlobalVariable(
                builder.module, ir.ArrayType(_word, 3 * MOST), SYMBOL
            )
            return builder.load(builder.gep(table, [_word(0), arguments[0]]))

        return types.int64(types.int64), code

    @intrinsic
    def _to_address(typing, address, axis, step):
        """Call the C function at an address with a record and a number."""

        def code(context, builder, signature, arguments):
            if not _on_gpu(context):
                kind = ir.FunctionType(ir.VoidType(), [_word, _word]).as_pointer()
                place, record, number = arguments
                record = builder.ptrtoint(record, _word)
                builder.call(builder.inttoptr(place, kind), [record, number])
            return context.get_dummy_value()

        return types.void(types.int64, axis, types.int64), code

    _cell: Any = _of_table  # to mypy an intrinsic takes the typing context as well
    _jump: Any = _to_address

    @rare
    def call(axis: Axis, step) -> None:
        """Call a function of the active mode, one of the model's own."""
        for row in range(MOST):
            key, number, address = _cell(3 * row), _cell(3 * row + 1), _cell(3 * row + 2)
            if key == axis.own_modes and number == axis.mode:
                _jump(address, axis, step)
                return
