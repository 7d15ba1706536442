"""Entries and blocks as dispatchers of Numba, which keep their code and compile it but once.

Of the inner names of Numba, which change from release to release, some are used here, the others in
`compiler` and `reach`: `jit` imports these files only with the releases they are written for.
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

SECONDS_A_FUNCTION = 0.05  # of compiling, to tell how long it will take
LONG = 2.0  # s; what takes longer tells its end as well
OPTIONS: dict[str, Any] = {"error_model": "numpy", "nogil": True}


class _Locator(_CacheLocator):
    """One folder; a file name and a stamp made of the digest, whatever the source's path or age."""

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
    """Numba's cache, which a damaged or a read-only folder does not stop."""

    _impl_class = _Implementation

    @property
    def functions(self) -> int:
        return self._impl.locator.functions

    def _index_key(self, sig, codegen):
        return sig, codegen.magic_tuple()  # the code is in the digest

    def holds(self, sig, context) -> bool:
        """Whether there is code for a signature, without reading it."""
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
        except Exception as error:  # whatever unpickling what is not a pickle raises
            code_cache.say(f"{self._cache_file._index_path} is damaged ({error!r}): compiling anew")
            with contextlib.suppress(OSError):
                self.flush()

    def _save_overload(self, sig, data):
        try:
            super()._save_overload(sig, data)
            code_cache.prune(Path(self.cache_path))
        except OSError as error:
            code_cache.cannot_keep(f"compiled code is not kept: {error}")


if hasattr(os, "register_at_fork"):  # a fork waits until no other thread compiles, or the child
    os.register_at_fork(  # would wait for a thread that it does not have
        before=global_compiler_lock.acquire,
        after_in_parent=global_compiler_lock.release,
        after_in_child=global_compiler_lock.release,
    )


class Entry(CPUDispatcher):
    """What Python calls: kept in the cache, and compiled by one process at a time."""

    def compile(self, sig):
        """Load the code for a signature, or compile and keep it."""
        with global_compiler_lock:
            without_linear_algebra()
            if isinstance(self._cache, NullCache):  # now all the code it reaches is there
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
    """A type without the value it had where the call stands: 3 and Cause.STO are integers."""
    kind = types.unliteral(kind)
    return kind.dtype if isinstance(kind, types.IntEnumMember) else kind


class Block(CPUDispatcher):
    """What compiled code calls: without the wrapper for Python, a fifth of the compile time.

    Called from Python, as a test does, it is an entry of its own.
    """

    def get_call_template(self, args, kws):
        """Compile for types, not for values, or a block were compiled once for each.

        Of what is compiled only the very types of the call are offered: among several, Numba asks
        whether one record is the beginning of another, and warns where it is.
        """
        kws = {name: _plain(kind) for name, kind in kws.items()}
        template, names, args, kws = super().get_call_template(tuple(map(_plain, args)), kws)
        template.cases = [self.overloads[tuple(args)].signature]
        return template, names, args, kws

    def compile(self, sig):
        """Without the clocks of Numba, each of which hears all that is below it."""
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
    """What compiled code seldom calls: LLVM puts it, and the way to it, behind all else."""

    def compile(self, sig):
        """As a block, with LLVM's word for it."""
        with global_compiler_lock:
            args = tuple(sigutils.normalize_signature(sig)[0])
            known = args in self.overloads
            code = super().compile(sig)
            if not known:
                made = self.overloads[args]
                made.library.get_function(made.fndesc.llvm_func_name).add_function_attribute("cold")
            return code


def block(function, kind=Block):
    """A dispatcher that compiled code calls."""
    options = OPTIONS | {"nopython": True, "no_cpython_wrapper": True, "no_cfunc_wrapper": True}
    return kind(function, targetoptions=options, pipeline_class=Pipeline)


def rare(function):
    """A dispatcher that compiled code seldom calls."""
    return block(function, Rare)


def entry(function):
    """A dispatcher that Python calls."""
    return Entry(function, targetoptions=OPTIONS | {"nopython": True}, pipeline_class=Pipeline)
