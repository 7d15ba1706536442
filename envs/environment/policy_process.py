"""A policy in a process of its own, where it cannot hold up the one that stops the drives."""

import ctypes
import multiprocessing
import pickle
import signal
import struct
import sys
import time
import warnings
from collections.abc import Callable
from contextlib import suppress
from multiprocessing.connection import Connection
from typing import Any, Protocol

import numpy as np

from ...drive.wire import real_time
from ..exchange.envelope import Stopped

MEMORY = 2 << 30  # bytes that a policy may allocate beyond what its process has at the beginning
PRIORITY_BELOW = 10  # its real-time priority is so much below that of the exchange of frames
READY_TIME_OUT = 180.0  # s for a policy to be made, or to begin an episode
ACTION_TIME_OUT = 10.0  # s for an action where nothing waits for it
IDLE = 5e-3  # s between frames while a policy plans an episode
DIE_WITH_PARENT = 1  # PR_SET_PDEATHSIG of prctl(2)
BEGIN, ACT, RENEW = b"b", b"a", b"n"  # requests
READY, REFUSED, ACTION, NO_NUMBER, RAISED = b"r", b"v", b"a", b"n", b"e"  # answers
NUMERIC = "fiub"  # kinds of dtypes
SHAPE = struct.Struct("<i")


class Acting(Protocol):
    """A policy: see `servogym.training.policies.Policy`."""

    def reset(self, observation: np.ndarray, info: dict[str, Any]) -> None:
        """Begin an episode."""

    def act(self, observation: np.ndarray) -> Any:
        """Return an action."""


class PolicyProcess:
    """A policy in a process of its own, which has no access to a bus that is opened later.

    Args:
        make: makes the policy, in that process.
        memory: bytes that it may allocate beyond those of its beginning.
        fast: whether it requests real-time priority, below that of the exchange.

    Attributes:
        took: time that the last action took (s).

    Raises:
        Stopped: the policy cannot be made.
    """

    def __init__(self, make: Callable[[], Acting], memory: int = MEMORY, fast: bool = False):
        self._arguments = make, memory, fast
        self.took = 0.0
        self._launch()

    def _launch(self) -> None:
        kind = "fork" if sys.platform != "win32" else None
        context: Any = multiprocessing.get_context(kind)
        self._here, there = context.Pipe()
        self._process = context.Process(
            target=_serve, args=(there, self._here, *self._arguments), daemon=True
        )
        with warnings.catch_warnings():  # forking with threads: the child runs its policy alone
            warnings.simplefilter("ignore", DeprecationWarning)
            self._process.start()
        there.close()
        self._ended = False
        self._thinking = False  # about an action that did not come in time
        self._asked_at = 0.0
        self._answer(READY_TIME_OUT, "to get ready")

    def renew(self) -> None:
        """Make the policy again, as it was before its first episode. Raises Stopped.

        It stays in its process, unless that has ended or does not answer.
        """
        if self._ended or self._thinking:
            self.close()
            self._launch()
        else:
            self._send(RENEW)
            self._answer(READY_TIME_OUT, "to get ready")

    def begin(
        self, observation: np.ndarray, info: dict[str, Any], idle: Callable[[], object]
    ) -> None:
        """Begin an episode; `idle` is called while the policy plans it. Raises Stopped."""
        self._send(BEGIN + pickle.dumps((observation, info)))
        end = time.monotonic() + READY_TIME_OUT
        while not self._here.poll(IDLE) and time.monotonic() < end:
            idle()
        self._answer(IDLE, "to begin an episode")

    def ask(self, observation: np.ndarray, patience: float) -> np.ndarray | None:
        """Return an action, None if it takes longer than `patience` (s).

        Raises Stopped if the policy raises an error, ends, or returns no array of numbers.
        """
        if self._thinking and self._here.poll():
            self._answer(0.0, "")  # to an earlier observation
            self._thinking = False
        if not self._thinking:
            self._asked_at = time.perf_counter()
            self._send(ACT + observation.tobytes())
        if self._thinking or not self._here.poll(patience):
            self._thinking = True
            return None
        action: np.ndarray = self._answer(0.0, "")
        self.took = time.perf_counter() - self._asked_at
        return action

    def reset(self, observation: np.ndarray, info: dict[str, Any]) -> None:
        """Begin an episode where nothing else is to be done meanwhile. Raises Stopped."""
        self.begin(observation, info, lambda: None)

    def act(self, observation: np.ndarray) -> np.ndarray:
        """Return an action where nothing waits for it. Raises Stopped."""
        action = self.ask(observation, ACTION_TIME_OUT)
        if action is None:
            raise Stopped("", f"the policy takes more than {ACTION_TIME_OUT:g} s for an action")
        return action

    def _send(self, request: bytes) -> None:
        with suppress(OSError):  # `_answer` reports that the process has ended
            self._here.send_bytes(request)

    def _answer(self, patience: float, what: str) -> Any:
        try:
            if patience and not self._here.poll(patience):
                raise Stopped("", f"the policy takes more than {patience:g} s {what}")
            data = self._here.recv_bytes()
        except (EOFError, OSError):
            self._ended = True
            self._process.join(1.0)
            raise Stopped("", f"the policy has ended: {_ending(self._process.exitcode)}") from None
        kind, body = data[:1], data[1:]
        self._ended = kind in (REFUSED, RAISED)  # the last words of the process
        if kind == REFUSED:
            raise Stopped("", body.decode(errors="replace"))
        if kind == RAISED:
            raise Stopped("", f"the policy raised {body.decode(errors='replace')}")
        if kind == NO_NUMBER:
            raise Stopped("", f"the policy's action {body.decode(errors='replace')} is no number")
        if kind == ACTION:
            n = SHAPE.unpack_from(body)[0]
            shape = struct.unpack_from(f"<{n}i", body, SHAPE.size)
            return np.frombuffer(body[SHAPE.size * (n + 1) :]).reshape(shape)
        return None

    def close(self) -> None:
        """Kill the process, whatever it does."""
        with suppress(OSError):
            self._here.close()
        self._process.kill()
        self._process.join(5.0)


def _ending(code: int | None) -> str:
    if code is None:
        return "it has closed its connection"
    return f"killed by {signal.Signals(-code).name}" if code < 0 else f"exit status {code}"


def _serve(
    there: Connection, other_end: Connection, make: Callable[[], Acting], memory: int, fast: bool
) -> None:
    """Return actions for observations until the other end is closed; runs in the process."""
    other_end.close()
    for name in ("SIGINT", "SIGHUP"):  # Ctrl-C and a closed terminal are for the other process
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    with suppress(AttributeError, OSError):
        ctypes.CDLL(None).prctl(DIE_WITH_PARENT, signal.SIGKILL)
    _preferred_by_the_oom_killer()
    try:
        try:
            policy = make()
        except ValueError as error:  # what was given is unsuitable, and the text says why
            there.send_bytes(REFUSED + f"{error}"[:2000].encode())
            return
        if fast:
            real_time.ask(PRIORITY_BELOW)
        _limit(memory)
        there.send_bytes(READY)
        first = np.empty(0)  # observation of an episode; the others are of its kind
        while True:
            data = there.recv_bytes()
            if data[:1] == ACT:  # as bytes: at 1 kHz pickling takes a tenth of the step
                given = np.frombuffer(data, first.dtype, offset=1).reshape(first.shape).copy()
                there.send_bytes(_packed(policy.act(given)))
            else:
                if data[:1] == BEGIN:
                    first, info = pickle.loads(data[1:])
                    policy.reset(first, info)
                else:
                    policy = make()
                there.send_bytes(READY)
    except EOFError:
        return
    except BaseException as error:  # including SystemExit
        with suppress(OSError):
            there.send_bytes(RAISED + f"{type(error).__name__}: {error}"[:500].encode())


def _packed(action: Any) -> bytes:
    """Return an action as bytes; one that is no array of numbers, as its text."""
    try:
        given = np.asarray(action)
        values = given.astype(float) if given.dtype.kind in NUMERIC else None
    except (TypeError, ValueError):
        values = None
    if values is None:
        return NO_NUMBER + f"{action!r}"[:200].encode()
    shape = struct.pack(f"<{values.ndim + 1}i", values.ndim, *values.shape)
    return ACTION + shape + values.tobytes()


def _preferred_by_the_oom_killer() -> None:
    """When memory runs out, the system kills this process and not the one that stops the drives."""
    with suppress(OSError), open("/proc/self/oom_score_adj", "w", encoding="ascii") as file:
        file.write("1000")


def _limit(memory: int) -> None:
    """Let this process raise MemoryError when it allocates more than so many further bytes."""
    try:
        import resource

        with open("/proc/self/status", encoding="ascii") as file:
            row = next(row for row in file if row.startswith("VmData"))
        most = 1024 * int(row.split()[1]) + memory
        resource.setrlimit(resource.RLIMIT_DATA, (most, most))
    except (ImportError, OSError, ValueError, StopIteration):
        return
