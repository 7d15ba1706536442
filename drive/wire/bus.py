"""python-can: its messages as frames, its bus as a link or as a master's port, its logs.

>>> bus = CanPort(can.Bus(interface="socketcan", channel="can0", bitrate=1_000_000))
>>> master = Master(CanOpenPort(bus, 1))
"""

import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from typing import Any

import can
from can.interfaces.udp_multicast import UdpMulticastBus

from ..canopen.frame import Frame
from ..canopen.link import Link
from ..master.errors import BusError
from .log import LogFile

TROUBLE = (can.CanError, OSError)  # exceptions of python-can's back-ends
PATIENCE = 0.5  # s, for a full transmit buffer to drain
AGAIN = 0.002  # s, between two attempts to send
ECHOES = 1024  # messages whose echo may be outstanding


def to_message(frame: Frame) -> can.Message:
    """Convert a frame to a message of python-can."""
    return can.Message(
        arbitration_id=frame.id, data=frame.data, is_extended_id=frame.extended,
        is_remote_frame=frame.remote,
    )


def to_frame(message: can.Message) -> Frame | None:
    """Convert a message to a classical data or remote frame; None for error frames and CAN FD."""
    if message.is_error_frame or message.is_fd:
        return None
    return Frame(
        message.arbitration_id, bytes(message.data), message.is_remote_frame, message.is_extended_id
    )


def give(send: Callable[[can.Message], None], message: can.Message) -> None:
    """Send a message, with retries if the buffer is full. Raises BusError if it stays full."""
    end = None  # read no clock unless it fails
    while True:
        try:
            return send(message)
        except TROUBLE as error:
            end = end or time.monotonic() + PATIENCE
            if time.monotonic() >= end:
                raise BusError(
                    f"sending {to_frame(message)}",
                    f"the adapter refuses it: {' '.join(str(error).split())}",
                    "a frame leaves only when another node acknowledges it: check that the drive "
                    "has power, the wiring and its termination, and that both have one bit rate",
                ) from error
            time.sleep(AGAIN)


class Echoes:
    """Distinguishes a sender's own messages, which some buses return, from those of others.

    Most interfaces mark an echo as sent (`can.Message.is_rx`); ``udp_multicast`` returns every
    message unmarked, so sent messages are remembered.
    """

    def __init__(self, bus: can.BusABC):
        unmarked = isinstance(bus, UdpMulticastBus)
        self._sent: deque[Frame] | None = deque(maxlen=ECHOES) if unmarked else None

    def sent(self, message: can.Message) -> None:
        """Note a message that is about to be sent."""
        if self._sent is not None and (frame := to_frame(message)):
            self._sent.append(frame)

    def own(self, message: can.Message) -> bool:
        """Whether a received message was sent here."""
        if not message.is_rx:
            return True
        frame = to_frame(message)
        if not self._sent or frame not in self._sent:
            return False
        while self._sent.popleft() != frame:
            pass  # echoes come in order, so those of earlier messages are lost
        return True


class CanLink:
    """A link to a python-can bus, which has its own time and ignores that of a simulation.

    A full transmit buffer has `PATIENCE` to drain. A bus that accepts or delivers no frames raises
    `servogym.drive.master.BusError`.

    Args:
        bus: a bus of python-can, or an `adapter.Adapter`; its owner shuts it down.
        wait: initial `patience`, the time to wait for the first frame of a `receive` (s).
        log: called with every message sent or received, such as a
            `servogym.drive.wire.log.LogFile`.
    """

    def __init__(
        self, bus: Any, wait: float = 0.0, log: Callable[[can.Message], object] | None = None
    ):
        self._send, self._receive, self.patience, self._log = bus.send, bus.recv, wait, log
        self._echoes = Echoes(bus)

    def send(self, frame: Frame, time_us: int = 0) -> None:
        """Send a frame at once."""
        message = to_message(frame)
        self._echoes.sent(message)
        give(self._send, message)
        if self._log is not None:
            message.timestamp, message.is_rx = time.time(), False
            self._log(message)

    def receive(self, time_us: int = 0) -> Iterator[Frame]:
        """Return the classical frames of others that have been received so far."""
        try:
            message = self._receive(self.patience)
            while message is not None:
                if not self._echoes.own(message):
                    if self._log is not None:
                        self._log(message)
                    if frame := to_frame(message):
                        yield frame
                message = self._receive(0)
        except TROUBLE as error:
            raise BusError(
                "receiving", f"the adapter fails: {' '.join(str(error).split())}",
                "check that it is plugged in, then open the bus anew",
            ) from error


class CanPort(CanLink):
    """The port of a python-can bus for a master, in real time; arguments as for `CanLink`."""

    def __init__(
        self, bus: Any, wait: float = 0.002, log: Callable[[can.Message], object] | None = None
    ):
        super().__init__(bus, wait, log)

    def now(self) -> float:
        """The time of the computer's clock (s)."""
        return time.monotonic()

    def exchange(self, frames: Iterable[Frame]) -> list[Frame]:
        """Send `frames`; -> the frames received since the last call."""
        for frame in frames:
            self.send(frame)
        return [*self.receive()]


class Traced:
    """Wraps any link and writes its frames, with their simulated time, to a log of python-can.

    Args:
        link: the link.
        file: name of the log; its suffix selects the format: .log (candump), .asc, .blf, .csv, ...

    Raises:
        ValueError: unknown suffix.
    """

    def __init__(self, link: Link, file: str):
        self._link = link
        self._time = 0  # µs, of the last line, because a frame may be older than the previous one
        self._log = LogFile(file)

    def send(self, frame: Frame, time: int) -> None:
        """Send a frame and log it."""
        self._link.send(frame, time)
        self._write(frame, time, received=False)

    def receive(self, time: int) -> Iterator[Frame]:
        """Receive frames and log them."""
        for frame in self._link.receive(time):
            self._write(frame, time, received=True)
            yield frame

    def _write(self, frame: Frame, time: int, received: bool) -> None:
        self._time = max(self._time, time)
        message = to_message(frame)
        message.timestamp, message.is_rx = self._time * 1e-6, received
        message.channel = 0
        self._log(message)

    def close(self) -> None:
        """Complete the file."""
        self._log.stop()
