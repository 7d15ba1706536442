"""Compile the blocks of the cycle with Numba, or run them as plain Python.

`block` marks a box of the block diagram: compiled into whoever calls it, never on its own.
`entry` marks the few functions Python calls; only these are cached, in a folder named by a hash
of every kernel source, because Numba's own cache does not notice a change in a called function
of another file. ``NUMBA_DISABLE_JIT=1`` runs all of it as ordinary Python.
"""

import hashlib
import os
import tempfile
from pathlib import Path
from typing import Any

import numba
from numba.core import config

KERNEL_ROOTS = (Path(__file__).parent, Path(__file__).parent.parent / "envs")


def cache_directory() -> Path:
    """Where compiled entries are kept; ``SERVOGYM_CACHE_DIR`` moves it."""
    base = Path(os.environ.get("SERVOGYM_CACHE_DIR") or Path.home() / ".cache" / "servogym")
    try:
        base.mkdir(parents=True, exist_ok=True)
    except OSError:  # no home to write to
        base = Path(tempfile.gettempdir()) / "servogym"
    digest = hashlib.sha256(numba.__version__.encode())
    for folder in KERNEL_ROOTS:
        for source in sorted(folder.rglob("*.py")):
            digest.update(source.read_bytes())
    return base / digest.hexdigest()[:16]


_OPTIONS: Any = {"error_model": "numpy", "nogil": True}
_CACHE = cache_directory()
DISABLED = bool(config.DISABLE_JIT)  # type: ignore[attr-defined]

block = numba.njit(**_OPTIONS)


def entry(function):
    """Compile `function` at its first call and keep the result in `cache_directory`."""
    before = config.CACHE_DIR
    config.CACHE_DIR = str(_CACHE)
    try:
        return numba.njit(cache=True, **_OPTIONS)(function)
    finally:
        config.CACHE_DIR = before
