"""A python-can bus with injected faults, for a served machine."""

import time
from collections import deque

import can
import numpy as np

from ..canopen.faulty import Faults, Faulty
from ..canopen.frame import Frame
from .bus import CanLink, to_frame, to_message

WAIT = 5e-4  # s, to wait for a frame


class BadBus:
    """Wraps `recv` and `send` of a bus and injects faults.

    Args:
        bus: the bus that is wrapped; `shutdown` closes it.
        faults: probabilities of the faults.
        seed: seed of the faults.
    """

    def __init__(self, bus: can.BusABC, faults: Faults, seed: int):
        self._bus, self.channel_info = bus, bus.channel_info
        self._bad = Faulty(CanLink(bus, wait=WAIT), faults, np.random.default_rng(seed))
        self._waiting: deque[Frame] = deque()

    @property
    def counts(self) -> dict[str, int]:
        """Number of occurrences of each fault."""
        return self._bad.counts

    def send(self, message: can.Message, timeout: float | None = None) -> None:
        """Send a message, subject to the faults."""
        if frame := to_frame(message):
            self._bad.send(frame, time.monotonic_ns() // 1000)

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """Return the next message after the faults; None after `WAIT` at the latest."""
        if not self._waiting:
            self._waiting.extend(self._bad.receive(time.monotonic_ns() // 1000))
        return to_message(self._waiting.popleft()) if self._waiting else None

    def shutdown(self) -> None:
        """Close the bus."""
        self._bus.shutdown()
