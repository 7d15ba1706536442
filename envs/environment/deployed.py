"""Episodes on drives of a bus: a policy thinks beside the exchange, which does not wait for it.

The policy has a process of its own. There it may end, hang, or fill its memory without holding up
the one that exchanges frames and stops the drives. An action that has not come when the set-points
go out is replaced by the one before, as a drive bridges a set-point that is missing; a few of these
in a row stop the drives, as does whatever the policy raises or returns that is not an action.
"""

import ctypes
import multiprocessing
import pickle
import signal
import struct
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from multiprocessing.connection import Connection
from typing import Any, NamedTuple, Protocol

import numpy as np

from ...drive.wire import real_time
from ..exchange import fields
from ..exchange.envelope import Stopped
from ..exchange.over_port import PortLine
from .servo_env import ServoEnv

MEMORY = 2 << 30  # bytes that a policy may take beyond what it has at its beginning
BELOW = 10  # its priority, so much less than that of the exchange of frames
START = 180.0  # s in which a policy has to be ready
IDLE = 5e-3  # s between frames, while it plans an episode
DIE_WITH_PARENT = 1  # PR_SET_PDEATHSIG of prctl(2)
BEGIN, ACT = b"b", b"a"
READY, ACTION, NONE, RAISED = b"r", b"a", b"n", b"e"
REAL = "fiub"  # kinds of dtypes
SHAPE = struct.Struct("<i")


class Acting(Protocol):
    """A policy: see `servogym.training.policies.Policy`."""

    def reset(self, observation: np.ndarray, info: dict[str, Any]) -> None:
        """Begin an episode."""

    def act(self, observation: np.ndarray) -> Any:
        """An action."""


class Played(NamedTuple):
    """What an episode brought."""

    returned: float  # sum of its rewards
    steps: int
    late: int  # actions that came too late
    info: dict[str, Any]  # of its end
    values: dict[str, float]  # metrics, of what a bus tells: see `Figures`


class Figures:
    """Metrics of an episode from the answers of the drives, on a bus and in memory alike.

    ``episode_return``, ``success``, ``settling_time`` (s, to the step; the length of the episode
    where it has not settled at the end), ``peak_error`` (µm or µrad), ``rms_torque`` (rated).
    """

    def __init__(self, env: ServoEnv):
        self._env = env
        self._returned = self._squares = self._peak = 0.0
        self._steps = self._unsettled = 0

    def step(self, reward: float, info: dict[str, Any]) -> None:
        """After a step."""
        answers = self._env._part.tpdos[0]
        names = answers.dtype.names
        self._returned += reward
        self._steps += 1
        if not info.get("is_success"):
            self._unsettled = self._steps
        if "following_error_actual_value" in names:
            error = np.abs(answers["following_error_actual_value"].astype(float)).max()
            self._peak = max(self._peak, float(error))
        if "torque_actual_value" in names:
            self._squares += float(np.square(1e-3 * answers["torque_actual_value"]).max())

    def values(self) -> dict[str, float]:
        """By name."""
        steps = max(self._steps, 1)
        return {
            "episode_return": self._returned, "success": float(self._unsettled < self._steps),
            "settling_time": self._unsettled * self._env.step_time,
            "peak_error": 1e6 * self._peak / self._env.units,
            "rms_torque": (self._squares / steps) ** 0.5,
        }


def in_memory(
    env: ServoEnv, policy: Acting, episodes: int, seed: int, slow: float = 1.0
) -> tuple[list[dict[str, float]], str]:
    """The metrics of the same episodes, played in this process by whoever sees to its time.

    Args:
        env: on a port in this process, as `servogym.envs.serve.in_process.drives` makes one.
        policy: acts as on the bus.
        episodes: how many.
        seed: of the first episode; the next ones have the next.
        slow: share of each action that is taken.

    Returns:
        The metrics of each episode, and why the guard has stopped the next one; empty where it has
        not, and all were played.
    """
    values: list[dict[str, float]] = []
    try:
        for episode in range(episodes):
            seen, info = env.reset(seed=seed + episode)
            policy.reset(seen, info)
            figures, ended, steps = Figures(env), False, 0
            while not ended and steps < env.STEPS:
                action = policy.act(seen)
                seen, reward, ended, _, info = env.step(slow * action if slow != 1.0 else action)
                figures.step(reward, info)
                steps += 1
            values.append(figures.values())
    except Stopped as stopped:
        return values, f"{stopped}"
    return values, ""


class _Plain:
    """A function of an observation as a policy."""

    def __init__(self, act: Callable[[np.ndarray], Any]):
        self.act = act

    def reset(self, observation: np.ndarray, info: dict[str, Any]) -> None:
        pass


class Mind:
    """A policy in a process of its own, which has no bus where none was open before.

    Args:
        make: makes it, there.
        memory: bytes that it may take beyond those of its beginning.
        fast: it asks for real time, below that of the exchange.

    Raises:
        Stopped: it cannot be made.
    """

    def __init__(self, make: Callable[[], Acting], memory: int = MEMORY, fast: bool = False):
        kind = "fork" if sys.platform != "win32" else None
        context: Any = multiprocessing.get_context(kind)
        self._here, there = context.Pipe()
        self._process = context.Process(
            target=_think, args=(there, self._here, make, memory, fast), daemon=True
        )
        _quietly(self._process.start)
        there.close()
        self._thinks = False
        self.took = 0.0  # s, of the last action
        self._asked_at = 0.0
        self._answer(START, "to get ready")

    def begin(self, seen: np.ndarray, info: dict[str, Any], idle: Callable[[], object]) -> None:
        """Before an episode; `idle` is called while it thinks. Raises Stopped."""
        self._send(BEGIN + pickle.dumps((seen, info)))
        end = time.monotonic() + START
        while not self._here.poll(IDLE) and time.monotonic() < end:
            idle()
        self._answer(IDLE, "to begin an episode")

    def ask(self, seen: np.ndarray, patience: float) -> tuple[np.ndarray] | None:
        """An action, None where none has come in time. Raises Stopped for what it raised."""
        if self._thinks and self._here.poll():
            self._answer(0.0, "")  # of an observation that has passed
            self._thinks = False
        if not self._thinks:
            self._asked_at = time.perf_counter()
            self._send(ACT + seen.tobytes())
        if self._thinks or not self._here.poll(patience):
            self._thinks = True
            return None
        said = self._answer(0.0, "")
        self.took = time.perf_counter() - self._asked_at
        return (said,)

    def _send(self, what: bytes) -> None:
        with suppress(OSError):  # that it has ended is told by the answer
            self._here.send_bytes(what)

    def _answer(self, patience: float, what: str) -> Any:
        try:
            if patience and not self._here.poll(patience):
                raise Stopped("", f"the policy takes more than {patience:g} s {what}")
            data = self._here.recv_bytes()
        except (EOFError, OSError):
            self._process.join(1.0)
            raise Stopped("", f"the policy has ended: {_ending(self._process.exitcode)}") from None
        kind, body = data[:1], data[1:]
        if kind == RAISED:
            raise Stopped("", f"the policy raised {body.decode(errors='replace')}")
        if kind == NONE:
            raise Stopped("", f"the policy's action {body.decode(errors='replace')} is no number")
        if kind == ACTION:
            n = SHAPE.unpack_from(body)[0]
            shape = struct.unpack_from(f"<{n}i", body, SHAPE.size)
            return np.frombuffer(body[SHAPE.size * (n + 1) :]).reshape(shape)
        return None

    def close(self) -> None:
        """End its process, whatever it does."""
        with suppress(OSError):
            self._here.close()
        self._process.kill()
        self._process.join(5.0)


def _ending(code: int | None) -> str:
    if code is None:
        return "it has closed the way to it"
    return f"killed by {signal.Signals(-code).name}" if code < 0 else f"exit status {code}"


def _quietly(start: Callable[[], None]) -> None:
    """Fork without Python's warning about threads: the copy goes on with its policy alone."""
    import warnings

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        start()


def _think(
    there: Connection, other_end: Connection, make: Callable[[], Acting], memory: int, fast: bool
) -> None:
    """The process of a policy: actions for observations, until nobody asks any more."""
    other_end.close()
    for name in ("SIGINT", "SIGHUP"):  # Ctrl-C, a closed terminal: for who stops the drives
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    with suppress(AttributeError, OSError):
        ctypes.CDLL(None).prctl(DIE_WITH_PARENT, signal.SIGKILL)
    _first_to_go()
    try:
        policy = make()
        if fast:
            real_time.ask(BELOW)  # the exchange of frames comes first
        _limit(memory)
        there.send_bytes(READY)
        while True:
            data = there.recv_bytes()
            if data[:1] == BEGIN:
                first, info = pickle.loads(data[1:])
                policy.reset(first, info)
                there.send_bytes(READY)
            else:  # in bytes: at 1 kHz pickling an array takes a tenth of the time there is
                seen = np.frombuffer(data, first.dtype, offset=1).reshape(first.shape).copy()
                there.send_bytes(_packed(policy.act(seen)))
    except EOFError:
        return
    except BaseException as error:  # an exit of its own as well
        with suppress(OSError):
            there.send_bytes(RAISED + f"{type(error).__name__}: {error}"[:500].encode())


def _packed(action: Any) -> bytes:
    """An action as bytes: what is no array of numbers is told in words."""
    try:
        given = np.asarray(action)
        values = given.astype(float) if given.dtype.kind in REAL else None
    except (TypeError, ValueError):
        values = None
    if values is None:
        return NONE + f"{action!r}"[:200].encode()
    shape = struct.pack(f"<{values.ndim + 1}i", values.ndim, *values.shape)
    return ACTION + shape + values.tobytes()


def _first_to_go() -> None:
    """Where memory ends, the system takes this process and not the one that stops the drives."""
    with suppress(OSError), open("/proc/self/oom_score_adj", "w", encoding="ascii") as file:
        file.write("1000")


def _limit(memory: int) -> None:
    """No more memory than this beyond what there is; then it raises MemoryError."""
    try:
        import resource

        with open("/proc/self/status", encoding="ascii") as file:
            row = next(row for row in file if row.startswith("VmData"))
        most = 1024 * int(row.split()[1]) + memory
        resource.setrlimit(resource.RLIMIT_DATA, (most, most))
    except (ImportError, OSError, ValueError, StopIteration):
        return


@contextmanager
def _guarded(line: PortLine) -> Iterator[None]:
    """Whatever ends a step stops the drives first, and is named."""
    try:
        yield
    except Stopped as stopped:
        raise line.stop(stopped) from stopped.__cause__
    except (Exception, KeyboardInterrupt) as error:
        raise line.stop(error) from error


def play(
    env: ServoEnv, act: Callable[[np.ndarray], Any] | None = None, episodes: int = 1, **how: Any
) -> list[Played]:
    """Play episodes to the end and return all of them; arguments and errors of `episodes_of`."""
    return [*episodes_of(env, act, episodes, **how)]


def episodes_of(
    env: ServoEnv, act: Callable[[np.ndarray], Any] | None = None, episodes: int = 1, *,
    make: Callable[[], Acting] | Mind | None = None, patience: float | None = None,
    slow: float = 1.0, seed: int | None = None, memory: int = MEMORY, fast: bool = False,
) -> Iterator[Played]:
    """Play episodes on an environment whose drives are on a bus; yield each when it is over.

    Args:
        env: made with ``port``.
        act: observation to action; it runs in a process of its own, so what it writes down is not
            seen here.
        episodes: how many.
        make: instead of `act`, makes a policy in that process; or the process, see `Mind`.
        patience: for an action (s); until the set-points of the step go out, if not given.
        slow: share of each action that is taken, above 0, at most 1.
        seed: of the first episode; the next ones have the next.
        memory: bytes that the policy may take.
        fast: ask the system for real time; ``env.line.refused`` has what it did not give.

    Raises:
        ValueError: the environment is not on a bus.
        Stopped: the guard, the bus, the policy or Ctrl-C ended it; the drives have been stopped.
    """
    line = env.line
    if not isinstance(line, PortLine):
        raise ValueError("this environment has no drives on a bus: make it with port=...")
    if (make is None) == (act is None):
        raise ValueError("give act, a function of the observation, or make, which makes a policy")
    if make is None:
        assert act is not None
        plain = _Plain(act)
        make = lambda: plain  # noqa: E731
    hold = np.array([env.HOLD.get(name, 0.0) for name in fields.names(env.ACTION)])
    with _guarded(line):
        mind = make if isinstance(make, Mind) else Mind(make, memory, fast)
        if fast:
            line.refused = real_time.ask()
        try:
            for episode in range(episodes):
                seen, info = env.reset(seed=None if seed is None else seed + episode)
                mind.begin(seen, info, line.idle)
                line.settle()
                yield _episode(env, line, mind, seen, info, hold, patience, slow)
        finally:
            mind.close()


def _episode(
    env: ServoEnv, line: PortLine, mind: Mind, seen: np.ndarray, info: dict[str, Any],
    hold: np.ndarray, patience: float | None, slow: float,
) -> Played:
    late, running, ended, steps, action, figures = 0, 0, False, 0, hold, Figures(env)
    while not ended and steps < env.STEPS:
        said = mind.ask(seen, line.patience if patience is None else patience)
        if said is None:
            running, late = running + 1, late + 1
            line.timing.stale += 1
            if line.timing.row(running) >= line.missed:
                raise Stopped("", f"the policy is late: {line.missed} actions have not come")
        else:
            running = 0
            line.timing.thinking.append(mind.took)
            action = slow * said[0] if slow != 1.0 else said[0]
        seen, reward, ended, _, info = env.step(action)
        figures.step(reward, info)
        steps += 1
    values = figures.values()
    return Played(values["episode_return"], steps, late, info, values)
