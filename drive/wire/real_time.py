"""Real-time priority and locked memory, as far as the system permits."""

import ctypes
import gc
import os

PRIORITY = 50  # of 1..99; interrupts of a PREEMPT_RT kernel have the same, its watchdogs 99
LOCK_ALL = 3  # MCL_CURRENT | MCL_FUTURE


def ask(below: int = 0) -> list[str]:
    """Request SCHED_FIFO for this thread and those it starts, and lock the memory.

    Objects that exist now are excluded from garbage collection, which would take tens of ms. A
    forked process inherits none of this and has to ask again.

    Args:
        below: difference of the priority from `PRIORITY`.

    Returns: the refused requests, each with the permission it needs.
    """
    missing = []
    gc.collect()
    gc.freeze()
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY - below))
    except (AttributeError, OSError):
        missing.append("SCHED_FIFO (ulimit -r 50, or CAP_SYS_NICE)")
    try:
        locked = ctypes.CDLL(None).mlockall(LOCK_ALL) == 0
    except (AttributeError, OSError):
        locked = False
    if not locked:
        missing.append("locked memory (ulimit -l unlimited, or CAP_IPC_LOCK)")
    return missing
