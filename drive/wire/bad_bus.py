"""A bus of python-can on which frames are lost, delayed or doubled, for a served machine."""

import time
from collections import deque

import can
import numpy as np

from ..canopen.faulty import Faults, Faulty
from ..canopen.frame import Frame
from .bus import to_frame, to_message
from .can_link import CanLink

WAIT = 5e-4  # s for a frame


class BadBus:
    """What a server sees of a bad bus: `recv` and `send` of the good one, with faults.

    Args:
        bus: the good one; `shutdown` ends it.
        faults: what happens how often, see `servogym.drive.canopen.faulty.Faults`.
        seed: of what happens to which frame.
    """

    def __init__(self, bus: can.BusABC, faults: Faults, seed: int):
        self._bus, self.channel_info = bus, bus.channel_info
        self._bad = Faulty(CanLink(bus, wait=WAIT), faults, np.random.default_rng(seed))
        self._waiting: deque[Frame] = deque()

    @property
    def counts(self) -> dict[str, int]:
        """How often each fault has happened."""
        return self._bad.counts

    def send(self, message: can.Message, timeout: float | None = None) -> None:
        """Send a message, if it survives."""
        if frame := to_frame(message):
            self._bad.send(frame, time.monotonic_ns() // 1000)

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """Return the next message that has survived; None after `WAIT` at the latest."""
        if not self._waiting:
            self._waiting.extend(self._bad.receive(time.monotonic_ns() // 1000))
        return to_message(self._waiting.popleft()) if self._waiting else None

    def shutdown(self) -> None:
        """Close the bus."""
        self._bus.shutdown()
