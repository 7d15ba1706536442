"""Entries and blocks as Numba dispatchers that compile their code once and store it.

This file, `compiler` and `reach` use private names of Numba, which change from release to release,
so `jit` imports them only with the release they were tested with.
"""

import contextlib
import functools
import os
import sys
from pathlib import Path
from typing import Any

from numba import types
from numba.core import sigutils
from numba.core.caching import CompileResultCacheImpl, FunctionCache, NullCache, _CacheLocator
from numba.core.compiler_lock import global_compiler_lock
from numba.core.registry import CPUDispatcher

from . import code_cache
from .compiler import PASSES, Pipeline, compiling, without_linear_algebra
from .reach import reach

SECONDS_A_FUNCTION = 0.05  # of compiling, to estimate the duration
LONG = 2.0  # s; the end of a longer compilation is announced, too
OPTIONS: dict[str, Any] = {"error_model": "numpy", "nogil": True}


class _Locator(_CacheLocator):
    """One folder; file name and stamp follow from the digest, not from the source's path or age."""

    def __init__(self, function):
        self.digest, self.functions = reach(function, OPTIONS | PASSES)
        self._py_file = function.__code__.co_filename  # for Numba's warnings

    def get_cache_path(self):
        return str(code_cache.cache_directory())

    def get_source_stamp(self):
        return self.digest

    def get_disambiguator(self):
        return self.digest[:16]


class _Implementation(CompileResultCacheImpl):
    def __init__(self, function):
        self._lineno = function.__code__.co_firstlineno
        self._locator = _Locator(function)
        name = f"{function.__module__}.{function.__qualname__}"
        self._filename_base = self.get_filename_base(name, getattr(sys, "abiflags", ""))


class _Cache(FunctionCache):
    """Numba's cache, which continues with a damaged or read-only folder."""

    _impl_class = _Implementation

    @property
    def functions(self) -> int:
        return self._impl.locator.functions

    def _index_key(self, sig, codegen):
        return sig, codegen.magic_tuple()  # the code is in the digest

    def holds(self, sig, context) -> bool:
        """Whether the cache has code for a signature; does not read the code."""
        with self._damage_is_a_miss():
            name = self._cache_file._load_index().get(self._index_key(sig, context.codegen()))
            return name is not None and Path(self.cache_path, name).exists()
        return False

    def _load_overload(self, sig, target_context):
        with self._damage_is_a_miss():
            loaded = super()._load_overload(sig, target_context)
            if loaded is not None:
                with contextlib.suppress(OSError):
                    os.utime(self._cache_file._index_path)  # used just now
            return loaded

    @contextlib.contextmanager
    def _damage_is_a_miss(self):
        try:
            yield
        except Exception as error:  # unpickling damaged data may raise anything
            code_cache.say(f"{self._cache_file._index_path} is damaged ({error!r}): compiling anew")
            with contextlib.suppress(OSError):
                self.flush()

    def _save_overload(self, sig, data):
        try:
            super()._save_overload(sig, data)
            code_cache.prune(Path(self.cache_path))
        except OSError as error:
            code_cache.cannot_keep(f"compiled code is not kept: {error}")


if hasattr(os, "register_at_fork"):  # a fork waits until no thread compiles: the child would
    os.register_at_fork(  # wait for a lock whose thread it does not have
        before=global_compiler_lock.acquire,
        after_in_parent=global_compiler_lock.release,
        after_in_child=global_compiler_lock.release,
    )


class Entry(CPUDispatcher):
    """A function that Python calls: stored in the cache, compiled by one process at a time."""

    def compile(self, sig):
        """Load the code for a signature, or compile and store it."""
        with global_compiler_lock:
            without_linear_algebra()
            if isinstance(self._cache, NullCache):  # now all code that it reaches exists
                self._cache = _Cache(self.py_func)
            cache, context = self._cache, self.targetctx
            if tuple(sigutils.normalize_signature(sig)[0]) in self.overloads:
                return super().compile(sig)
            if cache.holds(sig, context):
                return super().compile(sig)
            with code_cache.only_one(cache.cache_path):
                about, new = SECONDS_A_FUNCTION * cache.functions, not cache.holds(sig, context)
                name = f"{self.py_func.__module__}.{self.py_func.__qualname__}"
                if new:
                    code_cache.say(f"compiling {name} (once, about {max(round(about), 1)} s)")
                with compiling(context.codegen()):
                    code = super().compile(sig)
                if new and about > LONG:
                    code_cache.say(f"compiled {name}; the next start is at once")
                return code


def _plain(kind: types.Type) -> types.Type:
    """The type without a literal value: 3 and Cause.I2T are integers."""
    kind = types.unliteral(kind)
    return kind.dtype if isinstance(kind, types.IntEnumMember) else kind


class Block(CPUDispatcher):
    """A function that compiled code calls: no wrapper for Python, which saves compile time.

    When a test calls it from Python, it becomes an entry of its own.
    """

    def get_call_template(self, args, kws):
        """Resolve a call by types and not by values, so that 2 and 3 share one compilation.

        Only the exact types of the call are offered. Among several, Numba would check whether one
        record is the beginning of another, and warn if it is.
        """
        kws = {name: _plain(kind) for name, kind in kws.items()}
        template, names, args, kws = super().get_call_template(tuple(map(_plain, args)), kws)
        template.cases = [self.overloads[tuple(args)].signature]
        return template, names, args, kws

    def compile(self, sig):
        """Compile without Numba's timers and events."""
        with global_compiler_lock:
            args, result = sigutils.normalize_signature(sig)
            if tuple(args) not in self.overloads:
                with self._compiling_counter:
                    self.add_overload(self._compiler.compile(args, result))
            return self.overloads[tuple(args)].entry_point

    @functools.cached_property
    def _alone(self):
        return entry(self.py_func)

    def __call__(self, *args, **kws):
        """Call the compiled function from Python."""
        return self._alone(*args, **kws)


class Rare(Block):
    """A block that is rarely called: LLVM places it and the path to it out of line."""

    def compile(self, sig):
        """Compile as a block and mark the function as cold."""
        with global_compiler_lock:
            args = tuple(sigutils.normalize_signature(sig)[0])
            known = args in self.overloads
            code = super().compile(sig)
            if not known:
                made = self.overloads[args]
                made.library.get_function(made.fndesc.llvm_func_name).add_function_attribute("cold")
            return code


def block(function, kind=Block):
    """Make a dispatcher that compiled code calls."""
    options = OPTIONS | {"nopython": True, "no_cpython_wrapper": True, "no_cfunc_wrapper": True}
    return kind(function, targetoptions=options, pipeline_class=Pipeline)


def rare(function):
    """Make a dispatcher that compiled code calls rarely."""
    return block(function, Rare)


def entry(function):
    """Make a dispatcher that Python calls."""
    return Entry(function, targetoptions=OPTIONS | {"nopython": True}, pipeline_class=Pipeline)
