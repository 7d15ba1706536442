"""A process that has loaded and compiled what jobs need; the workers are forked from it.

It is the fork server of `multiprocessing`, which imports this module first. A command starts it
before it loads anything itself: this module needs nothing but Python's own library.
"""

import gc
import json
import os
import signal
import sys
from collections.abc import Sequence
from contextlib import suppress
from importlib import import_module
from multiprocessing import forkserver, get_all_start_methods, get_context
from typing import Any

GIVEN = "SERVOGYM_TEMPLATE"  # environment variable: path of Python, and what is called
BLAS = "OPENBLAS_NUM_THREADS"  # those of several workers would wait for one another
WORKER = "servogym.training.scale.processes"

Call = tuple[str, dict[str, Any]]  # "module:function", and its arguments

_prepared: list[list[Call]] = []  # what it was started for; none before it is


def prepare(calls: Sequence[Call]) -> bool:
    """Have it load and do this, while this process goes on.

    Args:
        calls: small jobs that need all the others need.

    Returns whether workers will find it done; not where there is no fork server, or where it has
    been started for something else.
    """
    if "forkserver" not in get_all_start_methods():
        return False
    if not _prepared:
        try:
            given = json.dumps([sys.path, calls])
        except TypeError:  # an object of the user's own
            return False
        before = dict(os.environ)
        os.environ |= {GIVEN: given, BLAS: "1"}
        try:
            get_context("forkserver").set_forkserver_preload([__name__, WORKER])
            forkserver.ensure_running()
        finally:
            os.environ.clear()
            os.environ.update(before)
        _prepared.append(list(calls))
    return all(call in _prepared[0] for call in calls)


def _do(path: list[str], calls: list[Call]) -> None:
    """In the new process; what fails here fails again in a job, which tells of it."""
    from ...envs.engine.checks import THREADS

    sys.path[:] = path
    os.environ[THREADS] = "1"  # a process with threads cannot be forked
    gc.disable()
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for who sends the jobs
    try:
        for place, arguments in calls:
            module, _, function = place.partition(":")
            with suppress(Exception):
                getattr(import_module(module), function)(**arguments)
    finally:
        signal.signal(signal.SIGINT, before)
        del os.environ[THREADS]
        gc.freeze()  # what is there stays, and stays in pages that all workers share
        gc.enable()


if GIVEN in os.environ:
    _do(*json.loads(os.environ.pop(GIVEN)))
