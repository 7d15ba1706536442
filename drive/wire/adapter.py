"""A CAN adapter that may fail: wraps a python-can bus so that a node survives its faults."""

import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress

import can

from .bus import TROUBLE, Echoes

QUEUE = 256  # waiting messages; when full, the oldest is lost
PATIENCE = 1.0  # s, for which a message waits, and between two attempts to reopen the bus


class Adapter:
    """A bus that may refuse frames, go bus-off or be unplugged, and that recovers.

    Messages that cannot be sent are queued and retried in order. A message that has waited for
    `PATIENCE` is dropped, as in a controller whose transmission is cancelled. If the queue is
    empty, a message is sent at once, so a busy machine loses none. The beginning and the end of a
    disturbance are reported once each.

    Args:
        bus: the bus; `shutdown` closes it.
        reopen: opens the bus again if it does not recover by itself.
        tell: called with a line for the user.
    """

    def __init__(
        self, bus: can.BusABC, reopen: Callable[[], can.BusABC] | None = None,
        tell: Callable[[str], None] = lambda text: None,
    ):
        self.bus = bus
        self.failed = 0  # failed attempts to send or receive
        self.lost = 0  # lost messages
        self._reopen = reopen
        self._tell = tell
        self._waiting: deque[tuple[float, can.Message]] = deque()
        self._trouble_since: float | None = None
        self._opened_at = 0.0
        self._echoes = Echoes(bus)

    def send(self, message: can.Message) -> None:
        """Send a message as soon as the bus accepts it."""
        if not self._waiting and self._takes(message):
            return
        if len(self._waiting) >= QUEUE:
            self._waiting.popleft()
            self.lost += 1
        self._waiting.append((time.monotonic(), message))
        if len(self._waiting) > 1:
            self.flush()

    def _takes(self, message: can.Message) -> bool:
        """Try to send a message now; -> whether the bus accepts it."""
        try:
            self.bus.send(message)
        except TROUBLE as error:
            self._failed(error)
            return False
        self._echoes.sent(message)
        self._works()
        return True

    def flush(self) -> None:
        """Try to send waiting messages."""
        while self._waiting:
            since, message = self._waiting[0]
            if time.monotonic() - since > PATIENCE:
                self._waiting.popleft()
                self.lost += 1
            elif self._takes(message):
                self._waiting.popleft()
            else:
                return

    def recv(self, timeout: float) -> can.Message | None:
        """Return the next message of others; None after `timeout` (s) or for an echo."""
        if self._waiting:
            self.flush()
        try:
            message = self.bus.recv(timeout)
        except TROUBLE as error:
            self._failed(error)
            time.sleep(timeout)
            return None
        if message is None:
            return None
        if not message.is_error_frame:
            self._works()
        return None if self._echoes.own(message) else message

    def _failed(self, error: Exception) -> None:
        now = time.monotonic()
        self.failed += 1
        if self._trouble_since is None:
            self._trouble_since = self._opened_at = now
            reason = " ".join(str(error).split())
            self._tell(f"the bus fails: {reason}; the drive keeps running and retries")
        elif self._reopen and now - self._opened_at > PATIENCE:
            self._opened_at = now
            self._open_anew(self._reopen)

    def _open_anew(self, reopen: Callable[[], can.BusABC]) -> None:
        with suppress(Exception):  # back-ends raise their own exceptions for a removed device
            self.bus.shutdown()
        try:
            self.bus = reopen()
        except Exception:  # the device is still missing
            self.failed += 1

    def _works(self) -> None:
        if self._trouble_since is not None:
            lasted = time.monotonic() - self._trouble_since
            self._trouble_since = None
            self._tell(f"the bus works again after {lasted:.1f} s, {self.lost} frames were lost")

    def shutdown(self) -> None:
        """Close the bus."""
        self.bus.shutdown()
