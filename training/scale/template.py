"""A process that has loaded and compiled all that jobs need; the workers are forked from it.

It is the fork server of `multiprocessing`, which imports this module first. A command starts it
before it loads anything itself, so this module uses only Python's standard library.
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

GIVEN = "SERVOGYM_TEMPLATE"  # environment variable with Python's path and the calls
BLAS = "OPENBLAS_NUM_THREADS"  # threads of several workers would wait for one another
WORKER = "servogym.training.scale.processes"

Call = tuple[str, dict[str, Any]]  # "module:function", and its arguments

_prepared: list[list[Call]] = []  # the calls of the fork server, once it is started


def prepare(calls: Sequence[Call]) -> bool:
    """Have the fork server do some calls, while this process goes on.

    Args:
        calls: small jobs that load and compile all that the others need.

    Returns whether workers will find the calls done. They will not if there is no fork server, or
    if it has been started for other calls.
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
    """Do the calls in the new process; an error is ignored, because a job reports it again."""
    from ...envs.engine.checks import THREADS

    sys.path[:] = path
    os.environ[THREADS] = "1"  # a process with threads cannot be forked
    gc.disable()
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the sender of jobs
    try:
        for place, arguments in calls:
            module, _, function = place.partition(":")
            with suppress(Exception):
                getattr(import_module(module), function)(**arguments)
    finally:
        signal.signal(signal.SIGINT, before)
        del os.environ[THREADS]
        gc.freeze()  # present objects stay in memory pages that all workers share
        gc.enable()


if GIVEN in os.environ:
    _do(*json.loads(os.environ.pop(GIVEN)))
