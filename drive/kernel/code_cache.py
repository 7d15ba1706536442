"""The folder of the compiled entries: its place, its permissions, its size, and its messages."""

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

try:
    import fcntl
except ImportError:  # Windows: two processes may compile the same, and the later one is kept
    fcntl = None  # type: ignore[assignment]

LARGEST_CACHE = 256 * 2**20  # bytes; the least recently used entries are removed first


@functools.cache
def cache_directory() -> Path:
    """Return the folder of the compiled entries; ``SERVOGYM_CACHE_DIR`` selects another one."""
    try:
        chosen = os.environ.get("SERVOGYM_CACHE_DIR") or Path.home() / ".cache" / "servogym"
        folder = Path(chosen)
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        if hasattr(os, "getuid") and not _trusted(folder, (os.getuid(), 0)):
            raise OSError(
                f"{folder} or a folder above it can be written by others, and a cache is run: "
                "chmod 700 it"
            )
    except (OSError, RuntimeError) as error:  # no home, not writable, or writable by others
        folder = _temporary_directory()
        said = getattr(error, "strerror", None)
        reason = f"{error.filename}: {said}" if said else f"{error}"  # type: ignore[union-attr]
        cannot_keep(f"{reason}; compiled code goes to {folder}")
    return folder


def _trusted(folder: Path, owners: tuple[int, ...]) -> bool:
    """Whether only `owners` can have put code into a folder, or replaced the folder.

    The user's own group may write. A folder above it may be open to all if it has the sticky bit.
    """
    found = folder.stat()
    parents = (place.stat() for place in folder.resolve().parents)
    return (
        stat.S_ISDIR(found.st_mode) and found.st_uid in owners and not _open(found)
        and not any(_open(above) and not above.st_mode & stat.S_ISVTX for above in parents)
    )


def _open(found: os.stat_result) -> bool:
    others = stat.S_IWOTH | (0 if found.st_gid == os.getgid() else stat.S_IWGRP)
    return bool(found.st_mode & others)


def _temporary_directory() -> Path:
    """Return a temporary folder that nobody else can have prepared, as its code is executed."""
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
    """Whether stderr is interactive: a terminal or a notebook."""
    return sys.stderr.isatty() or type(sys.stderr).__module__.startswith("ipykernel.")


def say(text: str, *, always: bool = False) -> None:
    """Print a line for a waiting user, or always; ``SERVOGYM_QUIET=1`` suppresses it."""
    if sys.stderr is None or os.environ.get("SERVOGYM_QUIET"):
        return
    if always or _watched():
        print(f"servogym: {text}", file=sys.stderr, flush=True)


@functools.cache
def cannot_keep(reason: str) -> None:
    """Warn, once for each reason, that compiled code is not stored."""
    say(f"{reason} (SERVOGYM_CACHE_DIR names a folder that can be written)", always=True)


def prune(folder: Path) -> None:
    """Remove the least recently used entries until the folder is within `LARGEST_CACHE`."""
    free = LARGEST_CACHE
    for index in sorted(folder.glob("*.nbi"), key=lambda path: -path.stat().st_mtime):
        files = [index, *folder.glob(f"{index.stem}.*.nbc")]
        free -= sum(path.stat().st_size for path in files)
        if free < 0:
            for path in files:
                path.unlink(missing_ok=True)


_locked = 0  # nesting depth, guarded by the global compiler lock


@contextlib.contextmanager
def only_one(folder: str) -> Iterator[None]:
    """Hold the lock of a cache; the system releases the lock of a process that ended."""
    global _locked
    with contextlib.ExitStack() as held:
        if fcntl is not None and not _locked:
            with contextlib.suppress(OSError):  # read-only, or a file system without locks
                file = held.enter_context(open(Path(folder, "lock"), "a"))
                try:
                    fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                except BlockingIOError:
                    say("another process is compiling, waiting for it")
                    fcntl.flock(file, fcntl.LOCK_EX)
        _locked += 1
        try:
            yield
        finally:
            _locked -= 1
