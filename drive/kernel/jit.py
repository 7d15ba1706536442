"""Compile the blocks of the cycle with Numba, or run them as plain Python.

`block` marks a box of the block diagram: compiled into whoever calls it, never on its own.
`entry` marks the few functions Python calls; only these are kept, in `cache_directory`, each under
the digest (`reach`) of all the code it is made of. Numba's own key sees one file only, and every
comment in it. ``NUMBA_DISABLE_JIT=1`` runs all of it as ordinary Python.
"""

import atexit
import contextlib
import functools
import os
import shutil
import stat
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numba
from numba import types
from numba.core import config, sigutils
from numba.core.caching import CompileResultCacheImpl, FunctionCache, NullCache, _CacheLocator
from numba.core.compiler_lock import global_compiler_lock
from numba.core.registry import CPUDispatcher

from .reach import reach

TESTED = "0.68"  # releases of Numba whose inner names `compiler` is written for

if numba.__version__.startswith(f"{TESTED}.") and not os.environ.get("SERVOGYM_PLAIN_NUMBA"):
    from .compiler import Pipeline, compiling, without_linear_algebra
else:  # Numba as it is: the same code, compiled more slowly
    from numba.core.compiler import Compiler as Pipeline  # type: ignore[assignment]

    compiling = contextlib.nullcontext  # type: ignore[assignment]

    def without_linear_algebra() -> None:  # type: ignore[misc]
        """Nothing is left out."""


try:
    import fcntl
except ImportError:  # Windows: two processes may compile the same, and the later one is kept
    fcntl = None  # type: ignore[assignment]

LARGEST_CACHE = 256 * 2**20  # bytes; what was used longest ago goes first
SECONDS_A_FUNCTION = 0.05  # of compiling, to tell how long it will take
LONG = 2.0  # s; what takes longer tells its end as well
DISABLED = bool(config.DISABLE_JIT)  # type: ignore[attr-defined]

_OPTIONS: Any = {"error_model": "numpy", "nogil": True}


@functools.cache
def cache_directory() -> Path:
    """Where compiled entries are kept; ``SERVOGYM_CACHE_DIR`` moves it."""
    try:
        chosen = os.environ.get("SERVOGYM_CACHE_DIR") or Path.home() / ".cache" / "servogym"
        folder = Path(chosen)
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        if hasattr(os, "getuid") and not _trusted(folder, (os.getuid(), 0)):
            raise OSError(f"{folder} can be written by others, and a cache is run: chmod 700 it")
    except (OSError, RuntimeError) as error:  # no home, none to write to, or one of others
        folder = _temporary_directory()
        _cannot_keep(f"{error}; compiled code goes to {folder}")
    return folder


def _trusted(folder: Path, owners: tuple[int, ...]) -> bool:
    """Whether nobody but `owners` can have put code into a folder; one's own group may write."""
    found = folder.stat()
    others = stat.S_IWOTH | (0 if found.st_gid == os.getgid() else stat.S_IWGRP)
    return stat.S_ISDIR(found.st_mode) and not found.st_mode & others and found.st_uid in owners


def _temporary_directory() -> Path:
    """A folder in the temporary one that nobody else can have prepared: a cache is run."""
    if hasattr(os, "getuid"):
        folder = Path(tempfile.gettempdir()) / f"servogym-{os.getuid()}"
        with contextlib.suppress(OSError):
            folder.mkdir(mode=0o700, exist_ok=True)
        with contextlib.suppress(OSError):
            if not folder.is_symlink() and _trusted(folder, (os.getuid(),)):
                return folder
    folder = Path(tempfile.mkdtemp(prefix="servogym-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder


def _watched() -> bool:
    """Whether a person sees what is said: at a terminal, or in a notebook."""
    return sys.stderr.isatty() or type(sys.stderr).__module__.startswith("ipykernel.")


def _say(text: str, *, always: bool = False) -> None:
    """A line for the person who waits; none with ``SERVOGYM_QUIET=1``."""
    if sys.stderr is None or os.environ.get("SERVOGYM_QUIET"):
        return
    if always or _watched():
        print(f"servogym: {text}", file=sys.stderr, flush=True)


if not numba.__version__.startswith(f"{TESTED}."):
    _say(f"Numba {numba.__version__} is not {TESTED}, which was tested: compiling takes longer")


@functools.cache
def _cannot_keep(reason: str) -> None:
    """Told once."""
    _say(f"{reason} (SERVOGYM_CACHE_DIR names a folder that can be written)", always=True)


class _Locator(_CacheLocator):
    """One folder; a file name and a stamp made of the digest, whatever the source's path or age."""

    def __init__(self, function):
        self.digest, self.functions = reach(function, _OPTIONS)
        self._py_file = function.__code__.co_filename  # for Numba's warnings

    def get_cache_path(self):
        return str(cache_directory())

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
        except Exception as error:  # whatever unpickling what is no pickle raises
            _say(f"{self._cache_file._index_path} is damaged ({error!r}): compiling anew")
            with contextlib.suppress(OSError):
                self.flush()

    def _save_overload(self, sig, data):
        try:
            super()._save_overload(sig, data)
            _prune(Path(self.cache_path))
        except OSError as error:
            _cannot_keep(f"compiled code is not kept: {error}")


def _prune(folder: Path) -> None:
    """Drop what was used longest ago, until the folder is no larger than `LARGEST_CACHE`."""
    free = LARGEST_CACHE
    for index in sorted(folder.glob("*.nbi"), key=lambda path: -path.stat().st_mtime):
        files = [index, *folder.glob(f"{index.stem}.*.nbc")]
        free -= sum(path.stat().st_size for path in files)
        if free < 0:
            for path in files:
                path.unlink(missing_ok=True)


_locked = 0  # how often; the global compiler lock guards it


@contextlib.contextmanager
def _only_one(folder: str) -> Iterator[None]:
    """Hold the lock of a cache; the system releases what a dead process held."""
    global _locked
    with contextlib.ExitStack() as held:
        if fcntl is not None and not _locked:
            with contextlib.suppress(OSError):  # read-only, or a file system without locks
                file = held.enter_context(open(Path(folder, "lock"), "a"))
                try:
                    fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                except BlockingIOError:
                    _say("another process is compiling, waiting for it")
                    fcntl.flock(file, fcntl.LOCK_EX)
        _locked += 1
        try:
            yield
        finally:
            _locked -= 1


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
            with _only_one(cache.cache_path):
                about, new = SECONDS_A_FUNCTION * cache.functions, not cache.holds(sig, context)
                name = f"{self.py_func.__module__}.{self.py_func.__qualname__}"
                if new:
                    _say(f"compiling {name} (once, about {max(round(about), 1)} s)")
                with compiling(context.codegen()):
                    code = super().compile(sig)
                if new and about > LONG:
                    _say(f"compiled {name}; the next start is at once")
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
        """Compile for types, not for values, or a block were compiled once for each."""
        kws = {name: _plain(kind) for name, kind in kws.items()}
        return super().get_call_template(tuple(map(_plain, args)), kws)

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
        """From Python."""
        return self._alone(*args, **kws)


def block(function):
    """Mark a box of the block diagram."""
    if DISABLED:
        return function
    options = _OPTIONS | {"nopython": True, "no_cpython_wrapper": True, "no_cfunc_wrapper": True}
    return Block(function, targetoptions=options, pipeline_class=Pipeline)


def entry(function):
    """Compile `function` at its first call and keep the result in `cache_directory`."""
    options = _OPTIONS | {"nopython": True}
    return function if DISABLED else Entry(function, targetoptions=options, pipeline_class=Pipeline)
