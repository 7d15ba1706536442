"""The folder in which compiled entries are kept, who may write there, and what is said of it."""

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

LARGEST_CACHE = 256 * 2**20  # bytes; what was used longest ago goes first


@functools.cache
def cache_directory() -> Path:
    """Where compiled entries are kept; ``SERVOGYM_CACHE_DIR`` moves it."""
    try:
        chosen = os.environ.get("SERVOGYM_CACHE_DIR") or Path.home() / ".cache" / "servogym"
        folder = Path(chosen)
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        if hasattr(os, "getuid") and not _trusted(folder, (os.getuid(), 0)):
            raise OSError(
                f"{folder} or a folder above it can be written by others, and a cache is run: "
                "chmod 700 it"
            )
    except (OSError, RuntimeError) as error:  # no home, none to write to, or one of others
        folder = _temporary_directory()
        said = getattr(error, "strerror", None)
        reason = f"{error.filename}: {said}" if said else f"{error}"  # type: ignore[union-attr]
        cannot_keep(f"{reason}; compiled code goes to {folder}")
    return folder


def _trusted(folder: Path, owners: tuple[int, ...]) -> bool:
    """Whether nobody but `owners` can have put code into a folder, or another folder in its place.

    One's own group may write. Of the folders above it, one with the sticky bit may be open to all.
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


def say(text: str, *, always: bool = False) -> None:
    """A line for the person who waits; none with ``SERVOGYM_QUIET=1``."""
    if sys.stderr is None or os.environ.get("SERVOGYM_QUIET"):
        return
    if always or _watched():
        print(f"servogym: {text}", file=sys.stderr, flush=True)


@functools.cache
def cannot_keep(reason: str) -> None:
    """Told once."""
    say(f"{reason} (SERVOGYM_CACHE_DIR names a folder that can be written)", always=True)


def prune(folder: Path) -> None:
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
def only_one(folder: str) -> Iterator[None]:
    """Hold the lock of a cache; the system releases what a dead process held."""
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
