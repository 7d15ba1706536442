"""Protects the loop from errors of MuJoCo, raising callbacks, and concurrent threads.

MuJoCo reports an error by a function that must not return; unhandled, it ends the process. MuJoCo's
own batches survive errors: `mjb_apply` calls a function and returns if it failed. The loop runs
inside such a call, on a batch of one empty simulation per thread.
"""

import ctypes
import os
import threading
import weakref
from typing import Any

import numpy as np

from ...drive.kernel.jit import DISABLED
from ...drive.kernel.record import accessible
from .physics import EMPTY, LIBRARY

ERROR_SIZE = 1000

# A call of the loop: the arguments of `loop.run`, its progress, and the first machine that refused.
JOB = np.dtype(
    [
        ("worlds", "i8"),  # addresses of the arrays, and their sizes
        ("count", "i8"),
        ("ticks", "i8"),
        ("rpdos", "i8"),
        ("rpdo_bytes", "i8"),
        ("tpdos", "i8"),
        ("tpdo_bytes", "i8"),
        ("refused", "i8"),  # address of the WORLD of that machine; 0: none has refused
        ("status", "i8"),  # the reason, `loop.Status`
        ("row", "i8"),  # machine and physics step at which the next piece begins
        ("tick", "i8"),
        ("paced", "i8"),  # address of the WORLD whose pace applies
    ]
)


class _Config(ctypes.Structure):
    """mjBatchConfig."""

    _fields_ = (("nthread", ctypes.c_int), ("persistent", ctypes.c_ubyte))


class _Batch:
    """A batch of one empty simulation that runs on the calling thread."""

    def __init__(self) -> None:
        library: Any = ctypes.CDLL(LIBRARY)
        library.mjb_makeBatch.restype = ctypes.c_void_p
        library.mjb_error.restype = ctypes.c_char_p
        self._library = library
        text = ctypes.create_string_buffer(ERROR_SIZE)
        alone = ctypes.byref(_Config(1, 0))
        made = library.mjb_makeBatch(ctypes.c_void_p(EMPTY._address), 1, alone, text, ERROR_SIZE)
        if not made:
            raise MemoryError(f"MuJoCo makes no batch: {text.value.decode(errors='replace')}")
        self.address = made
        self._handle = ctypes.c_void_p(made)
        weakref.finalize(self, library.mjb_deleteBatch, self._handle).atexit = False

    def error(self) -> str:
        """MuJoCo's message about the last call, if it failed."""
        return self._library.mjb_error(self._handle, 0).decode(errors="replace")


class _Guarded(threading.local):
    """Per thread: the batch its calls go through, their JOB, and whether one is running."""

    def __init__(self) -> None:
        self.running = False
        self.job = np.zeros(1, accessible(JOB))
        self.batch = None if DISABLED else _Batch()  # MuJoCo's Python functions catch errors
        self.address = 0 if self.batch is None else self.batch.address


guarded = _Guarded()
_turns: "weakref.WeakSet[Turn]" = weakref.WeakSet()


class Turn:
    """Lock that is held while machines that share memory are stepped or read.

    Raises RuntimeError in a callback that MuJoCo calls while the same thread steps a machine.
    """

    def __init__(self) -> None:
        self._lock = threading.RLock()
        _turns.add(self)

    def __enter__(self) -> None:
        if guarded.running:
            raise RuntimeError(
                "a callback of MuJoCo must not step, reset or read a machine while one is being "
                "stepped: use the MjModel and MjData that the callback is given"
            )
        self._lock.acquire()

    def __exit__(self, *_: object) -> None:
        self._lock.release()


def _forked() -> None:
    """Release all turns in a forked process, where their threads do not exist."""
    for turn in _turns:
        turn._lock = threading.RLock()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forked)
