"""The thread that serves a bus; it alone touches the machines on it."""

import threading
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from functools import partial
from queue import Empty, SimpleQueue
from typing import Any, TypeVar

from ...drive.drive import Drive
from ..engine.machine import Machine
from .buses import ServedBus
from .description import EventRow

T = TypeVar("T")
PATIENCE = 10.0  # s that a caller waits for the thread of a bus


class BusThread:
    """Serves a bus, and between two frames acts on its machines for other threads.

    Args:
        name: of the bus.
        connect: opens the bus.
        machines: on the bus.
        script: events, each with its machine and drive.
    """

    def __init__(
        self,
        name: str,
        connect: Callable[[], ServedBus],
        machines: Sequence[Machine],
        script: list[tuple[Machine, Drive, EventRow]],
    ):
        self.bus: ServedBus | None = None
        self.error: BaseException | None = None  # that has ended the thread
        self.where = ""
        self._machines = [*machines]
        self._connect = connect
        self._requests: SimpleQueue[tuple[Callable[[], Any], Future]] = SimpleQueue()
        self._script = script
        self._due: list[tuple[float, Machine, Callable[[], object]]] = []
        for machine in self._machines:
            self.rewind(machine)
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name=f"bus {name}", daemon=True)

    def rewind(self, machine: Machine) -> None:
        """Start the script of a machine again."""
        self._due = [row for row in self._due if row[1] is not machine]
        for of, drive, event in self._script:
            if of is machine:
                self._due.append((event.at, of, partial(drive.inject, event.inject)))
                if event.clear_after:
                    end = event.at + event.clear_after
                    self._due.append((end, of, drive.clear_injected))
        self._due.sort(key=lambda row: row[0])

    def open(self) -> None:
        """Open the bus. Raises ValueError, OSError or can.CanError where that fails."""
        self.bus = self._connect()
        self.where = self.bus.where

    def start(self) -> None:
        """Serve the bus."""
        self._thread.start()

    def stop(self) -> None:
        """End the thread, then close the bus."""
        self._stopping.set()
        if self._thread.is_alive():
            self._thread.join(PATIENCE)
        bus, self.bus = self.bus, None
        if bus is not None:
            bus.close()

    def do(self, function: Callable[[], T]) -> T:
        """Call a function in the thread; without a thread, in that of the caller.

        Raises:
            TimeoutError: the thread does not answer.
            Exception: whatever `function` raises.
        """
        if not self._thread.is_alive() or threading.current_thread() is self._thread:
            return function()
        future: Future[T] = Future()
        self._requests.put((function, future))
        try:
            return future.result(PATIENCE)
        except TimeoutError:
            if future.cancel():
                raise TimeoutError(f"the bus {self._thread.name} does not answer") from None
            raise

    def advance(self, seconds: float) -> None:
        """Let all machines of the bus run ahead."""
        for machine in self._machines:
            machine.step(round(seconds / machine.cycle_time))
        if self.bus is not None:
            self.bus.ahead(seconds)

    def _run(self) -> None:
        assert self.bus is not None
        try:
            while not self._stopping.is_set():
                self.bus.serve()
                self._between()
        except BaseException as error:
            self.error = error
        while not self._requests.empty():
            _answer(*self._requests.get())

    def _between(self) -> None:
        """Act between two frames: events of the script that are due, requests of other threads."""
        for row in [row for row in self._due if row[0] <= row[1].time]:
            self._due.remove(row)
            row[2]()
        while True:
            try:
                request = self._requests.get_nowait()
            except Empty:
                return
            _answer(*request)


def _answer(function: Callable[[], Any], future: Future) -> None:
    if not future.set_running_or_notify_cancel():
        return
    try:
        future.set_result(function())
    except BaseException as error:
        future.set_exception(error)
