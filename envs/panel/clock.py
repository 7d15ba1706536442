"""Clock: runs a session against the wall clock, in the only thread that touches it.

Requests are served between two cycles. A motion lasts until it ends or until the next one begins.
The next one waits for a change of state or mode to complete, unless it is a stop.
"""

import queue
import threading
import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import suppress
from typing import Any

from .bench import ENDED, Bench, Interrupted

SLOWEST, FASTEST = 0.1, 10.0
NAP = 0.004  # s
SILENT = "the window in control was closed, disconnected or has frozen"
DEBT = 0.1  # s behind the wall clock that are made up for; a greater delay is dropped
MEASURED = 1.0  # s over which the speed is measured


class Clock:
    """Runs a session until `stop`.

    Args:
        session: belongs to the thread of this clock from `start` on.
        pictures: maximum number of updates of `shown` per second.
        nap: shortest time for which the thread sleeps when it is ahead of the wall clock (s).
    """

    def __init__(self, session: Bench, pictures: float = 25.0, nap: float = NAP):
        self.session, self._picture, self._nap = session, 1 / pictures, nap
        self.speed, self.paused = 1.0, False
        self.achieved = 1.0  # speed over the last second
        self.shown: dict[str, Any] = session.shown()
        self._requests: queue.SimpleQueue[tuple[Callable[[Bench], Any], Future[Any]]] = (
            queue.SimpleQueue()
        )
        self._motions: deque[tuple[Callable[[Bench], Any], Future[Any], bool]] = deque()
        self._single = 0
        self._stopping = False
        self._begin = self._begun = self._drawn = 0.0
        self._mark: tuple[float, float] = (0.0, 0.0)
        self._in_motion = False
        self._thread = threading.Thread(target=self._run, name="panel clock", daemon=True)

    def start(self) -> None:
        """Start the clock."""
        self._rebase()
        self._mark = time.monotonic(), self.session.time
        self._thread.start()

    def end(self) -> None:
        """Request the end, even in the middle of a motion."""
        self._stopping = True

    def stop(self) -> None:
        """Stop the clock and wait until it has stopped."""
        self.end()
        if self._thread.is_alive():
            self._thread.join(5.0)

    # ----------------------------------------------- called from other threads

    def ask(self, request: Callable[[Bench], Any]) -> "Future[Any]":
        """Carry out an action between two cycles, which takes no machine time."""
        future: Future[Any] = Future()
        self._requests.put((request, future))
        return future

    def move(self, motion: Callable[[Bench], Any], *, at_once: bool = False) -> "Future[Any]":
        """Carry out a motion; a change of state or mode completes first, unless `at_once`."""
        future: Future[Any] = Future()
        self._motions.append((motion, future, at_once))
        return future

    def stop_motion(self, stop: Callable[[Bench], Any], why: str = ENDED) -> "Future[Any]":
        """Carry out a stop now; waiting motions are dropped (`why`) and the present one ends."""
        waiting = []
        while self._motions:
            waiting.append(self._motions.popleft()[1])
        future = self.move(stop, at_once=True)
        for dropped in waiting:
            if dropped.set_running_or_notify_cancel():
                dropped.set_result(why)
        return future

    def set_speed(self, speed: float) -> None:
        """Set the speed of time, 0.1..10. Raises ValueError beyond this range."""
        self._own_time()
        if not SLOWEST <= speed <= FASTEST:
            raise ValueError(f"speed {speed:g} is out of range {SLOWEST:g}..{FASTEST:g}")
        self.speed = float(speed)
        self._begin = 0.0

    def pause(self, paused: bool) -> None:
        """Pause or resume time. Raises ValueError if the session does not control it."""
        self._own_time()
        self.paused = paused
        self._begin = 0.0

    def single(self, cycles: int = 1) -> None:
        """Pause time and advance by some position cycles. Raises ValueError as `pause`."""
        self._own_time()
        self.paused = True
        self._single += cycles

    def _own_time(self) -> None:
        if why := self.session.absent.get("time"):
            raise ValueError(why)

    # ------------------------------------------------------- in its own thread

    def _run(self) -> None:
        session = self.session
        session.pace = self._pace
        while not self._stopping:
            try:
                if self._motions:
                    motion, future, _ = self._motions.popleft()
                    self._in_motion = True
                    self._answer(motion, future)
                elif session.agent is not None:
                    session.agent.step()
                else:
                    session.exchange()
            except Interrupted:
                pass
            except Exception as error:  # the machine stands until a reset or a snapshot
                session.release()
                session.tell("alarm", f"the simulation stopped: {error}")
                self.paused = "time" not in session.absent
                time.sleep(NAP)
            finally:
                self._in_motion = False
        session.pace = lambda: False
        if session.real_time:  # the drives are elsewhere and would go on
            with suppress(Exception):
                session.abandon("the panel ends")
        while not self._requests.empty():
            self._requests.get()[1].cancel()
        while self._motions:
            self._motions.popleft()[1].cancel()

    def _answer(self, request: Callable[[Bench], Any], future: "Future[Any]") -> None:
        if not future.set_running_or_notify_cancel():
            return
        try:
            future.set_result(request(self.session))
        except Interrupted:
            future.set_result("ended")
            raise
        except Exception as error:
            future.set_exception(error)

    def _pace(self) -> bool:
        """Wait for the next exchange and serve requests; -> whether it is a single cycle."""
        while True:
            self._serve()
            if self._stopping or self._is_over():
                raise Interrupted
            now = time.monotonic()
            if now - self._drawn >= self._picture:
                self._show(now)
                if self.session.control.lost(now):
                    self.stop_motion(lambda s: s.abandon(SILENT), SILENT)
            if self.session.real_time:
                return False
            if self.paused:
                if self._single:
                    self._single -= 1
                    self._rebase()
                    return True
                if self._motions:
                    self.paused = False  # a commanded motion has to be visible
                    continue
                self._rebase()
                self._wait(self._nap * 4)
                continue
            if not self._begin:
                self._rebase()
            ahead = (self.session.time - self._begun) - (now - self._begin) * self.speed
            if ahead <= 0:
                if -ahead / self.speed > DEBT:
                    self._rebase()
                return False
            self._wait(max(ahead / self.speed, self._nap))

    def _is_over(self) -> bool:
        """Whether the present motion ends in favour of a waiting one."""
        if not self._in_motion or not self._motions:
            return False
        if not self.session.carried_through:
            return True
        return any(at_once for *_, at_once in self._motions.copy())

    def _wait(self, seconds: float) -> None:
        """Sleep for some time, or until a request arrives."""
        try:
            request = self._requests.get(timeout=seconds)
        except queue.Empty:
            return
        self._answer(*request)
        self._show(time.monotonic())

    def _serve(self) -> None:
        if not self._requests.empty():
            while not self._requests.empty():
                self._answer(*self._requests.get())
            self._show(time.monotonic())

    def _show(self, now: float) -> None:
        begun, at = self._mark
        if now - begun >= MEASURED:
            self.achieved = (self.session.time - at) / (now - begun)
            self._mark = now, self.session.time
        self._drawn = now
        self.shown = self.session.shown()

    def _rebase(self) -> None:
        self._begin, self._begun = time.monotonic(), self.session.time
