"""A digest of everything that a compiled function depends on: the key of its compiled code.

The digest covers the byte code of a function and of everything that it can reach by name:
functions, constants, enumerations, dtypes, values of closures, attributes of modules. Comments,
docstrings, line numbers and paths are left out, so equal code has the same digest in every
checkout.

It errs on the safe side: every attribute of a module counts whose name occurs in the function. It
does not cover implementations that another file registers with Numba
(``numba.extending.overload``).
"""

import dis
import enum
import hashlib
import pickle
import sys
from collections.abc import Iterator
from types import BuiltinFunctionType, CodeType, FunctionType, ModuleType
from typing import Any

import llvmlite
import numba
import numpy as np
from numba import types
from numba.core import config
from numba.core.dispatcher import Dispatcher
from numba.core.extending import _Intrinsic

# their code counts by its name and by the versions in the digest
_TOOLS = frozenset(sys.stdlib_module_names) | {"numba", "numpy", "llvmlite", "mujoco"}
_SETTINGS = ("OPT", "BOUNDSCHECK", "DEBUGINFO_DEFAULT", "LOOP_VECTORIZE", "SLP_VECTORIZE")


def reach(function: FunctionType, options: dict[str, Any]) -> tuple[str, int]:
    """Return the digest of everything that `function` depends on, and the number of functions.

    Args:
        function: plain Python function.
        options: options of Numba for it.
    """
    found = _Reach()
    found.feed((sys.version_info[:2], numba.__version__, llvmlite.__version__, np.__version__))
    found.feed(tuple(str(getattr(config, name, None)) for name in _SETTINGS))
    found.feed(options)
    found.feed(function)
    return found.hash.hexdigest(), found.functions


class _Reach:
    def __init__(self):
        self.hash = hashlib.sha256()
        self.functions = 0
        self._seen: dict[int, tuple[int, Any]] = {}  # holds the values, or an id could recur

    def add(self, *words) -> None:
        """Add the representations of values."""
        for word in words:
            self.hash.update(f"{word!r}\0".encode())

    def feed(self, value: Any) -> None:
        """Add a value by the first row of `_KINDS` that fits it."""
        if isinstance(value, _ONCE):
            if id(value) in self._seen:
                self.add("seen", self._seen[id(value)][0])
                return
            self._seen[id(value)] = len(self._seen), value
        for kind, take in _KINDS:
            if isinstance(value, kind):
                self.add(kind.__name__)
                take(self, value)
                return
        _exotic(self, value)


def _names(code: CodeType) -> set[str]:
    """Names of globals and attributes in a function and its inner functions."""
    return set(code.co_names).union(*map(_names, _inner(code)))


def _globals(code: CodeType) -> set[str]:
    """Names of globals in a function and its inner functions."""
    indices = {argument >> 1 for operation, argument in _instructions(code) if operation == _GLOBAL}
    return {code.co_names[index] for index in indices}.union(*map(_globals, _inner(code)))


def _inner(code: CodeType) -> list[CodeType]:
    return [const for const in code.co_consts if isinstance(const, CodeType)]


def _instructions(code: CodeType) -> Iterator[tuple[int, int]]:
    """Operation and argument of each instruction."""
    raw, extended = code.co_code, 0
    for operation, argument in zip(raw[::2], raw[1::2], strict=True):
        argument |= extended << 8
        extended = argument if operation == dis.EXTENDED_ARG else 0
        if operation != dis.EXTENDED_ARG:
            yield operation, argument


def _function(found: _Reach, function: FunctionType) -> None:
    found.add(function.__module__, function.__qualname__)
    if _of_tools(function.__module__):
        return
    found.functions += 1
    found.feed(function.__code__)
    found.feed((function.__defaults__, function.__kwdefaults__))
    names = _names(function.__code__)
    inside: set[int] = set()
    for name, cell in zip(function.__code__.co_freevars, function.__closure__ or (), strict=True):
        _named(found, name, cell.cell_contents, names, inside)
    for name in sorted(_globals(function.__code__) & function.__globals__.keys()):
        _named(found, name, function.__globals__[name], names, inside)


def _named(found: _Reach, name: str, value: Any, names: set[str], inside: set[int]) -> None:
    """Add the value of a name; of a module, the attributes that are among `names`."""
    found.add(name)
    if not isinstance(value, ModuleType):
        found.feed(value)
        return
    found.add(value.__name__)
    if _of_tools(value.__name__) or id(value) in inside:
        return
    inside.add(id(value))
    for attribute in sorted(names & vars(value).keys()):
        _named(found, attribute, vars(value)[attribute], names, inside)


def _of_tools(module: str | None) -> bool:
    return (module or "").partition(".")[0] in _TOOLS


def _code(found: _Reach, code: CodeType) -> None:
    """Add byte code with its constants in the order of their use, which omits docstrings."""
    found.add(
        code.co_name, code.co_flags, code.co_names, code.co_varnames, code.co_freevars,
        code.co_cellvars, code.co_argcount, code.co_posonlyargcount, code.co_kwonlyargcount,
        code.co_exceptiontable,
    )
    used: dict[int, int] = {}
    instructions = bytearray()
    for operation, argument in _instructions(code):
        if operation in _LOADS_CONSTANT:
            argument = used.setdefault(argument, len(used))
        instructions += bytes((operation,)) + argument.to_bytes(4, "little")
    found.add(bytes(instructions))
    for index in used:
        found.feed(code.co_consts[index])


_LOADS_CONSTANT = frozenset(dis.hasconst)
_GLOBAL = dis.opmap["LOAD_GLOBAL"]  # its argument is twice the index of a name, and a flag


def _dispatcher(found: _Reach, dispatcher: Dispatcher) -> None:
    found.feed(dispatcher.targetoptions)
    found.feed(dispatcher.py_func)


def _class(found: _Reach, kind: type) -> None:
    found.add(kind.__module__, kind.__qualname__, getattr(kind, "_fields", None))
    if issubclass(kind, enum.Enum):
        for name, member in kind.__members__.items():
            found.add(name)
            found.feed(member.value)


def _member(found: _Reach, member: enum.Enum) -> None:
    found.feed(type(member))
    found.add(member.name)
    found.feed(member.value)


def _sequence(found: _Reach, values: tuple | list) -> None:
    found.feed(type(values))
    found.add(len(values))
    for value in values:
        found.feed(value)


def _set(found: _Reach, values: frozenset | set) -> None:
    """Add members in an order that does not depend on the hashes of strings."""
    _sequence(found, sorted(values, key=lambda value: (type(value).__name__, repr(value))))


def _mapping(found: _Reach, values: dict) -> None:
    _sequence(found, list(values.items()))


def _dtype(found: _Reach, dtype: np.dtype) -> None:
    found.add(dtype.str, dtype.itemsize, dtype.alignment, dtype.isalignedstruct, dtype.shape)
    if dtype.subdtype:
        found.feed(dtype.base)
    for name, (kind, offset, *_) in (dtype.fields or {}).items():
        found.add(name, offset)
        found.feed(kind)


def _array(found: _Reach, array: np.ndarray | np.generic) -> None:
    array = np.asarray(array)
    found.feed(array.dtype)
    found.add(array.shape, array.flags.c_contiguous, array.flags.f_contiguous, array.tobytes())


def _type(found: _Reach, kind: types.Type) -> None:
    if isinstance(kind, types.Dispatcher):
        found.feed(kind.dispatcher)
    elif isinstance(kind, types.ExternalFunction):
        found.add(kind.symbol, str(kind.sig))
    else:
        found.add(type(kind).__name__, str(kind))


def _intrinsic(found: _Reach, intrinsic: _Intrinsic) -> None:
    found.feed(intrinsic._defn)


def _builtin(found: _Reach, function) -> None:
    found.add(getattr(function, "__module__", None), function.__name__)


def _atom(found: _Reach, value: Any) -> None:
    found.add(type(value).__name__, value)


def _module(found: _Reach, module: ModuleType) -> None:
    found.add(module.__name__)


def _exotic(found: _Reach, value: Any) -> None:
    """Add any other value if Numba has a type for it; otherwise compiled code cannot use it."""
    found.feed(type(value))
    try:
        found.add(str(numba.typeof(value)), pickle.dumps(value))
    except Exception:
        found.add("unknown to Numba")


# added once; equal constants may be one object or two, at the interpreter's discretion
_ONCE = (FunctionType, CodeType, type)
_ATOMS = (bool, int, float, complex, str, bytes, type(None), type(Ellipsis))
# an integer may be a member, a float may be NumPy's: those come first
_KINDS: tuple[tuple[type, Any], ...] = (
    (enum.Enum, _member),
    (np.generic, _array),
    *((kind, _atom) for kind in _ATOMS),
    (tuple, _sequence),
    (list, _sequence),
    (frozenset, _set),
    (set, _set),
    (dict, _mapping),
    (np.dtype, _dtype),
    (np.ndarray, _array),
    (Dispatcher, _dispatcher),
    (FunctionType, _function),
    (CodeType, _code),
    (types.Type, _type),
    (type, _class),
    (_Intrinsic, _intrinsic),
    (BuiltinFunctionType, _builtin),
    (np.ufunc, _builtin),
    (ModuleType, _module),
)
