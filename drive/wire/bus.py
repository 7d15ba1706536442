"""python-can: converts frames to its messages, and offers its bus as the port of a master.

>>> bus = CanPort(can.Bus(interface="socketcan", channel="can0", bitrate=1_000_000))
>>> master = Master(CanOpenPort(bus, 1))
"""

import time
from collections import deque
from collections.abc import Callable, Iterable
from typing import Any

import can
from can.interfaces.udp_multicast import UdpMulticastBus

from ..canopen.frame import Frame
from ..master.errors import BusError

TROUBLE = (can.CanError, OSError)  # what the back-ends of python-can raise
PATIENCE = 0.5  # s, for a full transmit buffer to empty
AGAIN = 0.002  # s, until it is tried again
ECHOES = 1024  # messages that may be on their way back


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
    end = None
    while True:
        try:
            send(message)
            return
        except TROUBLE as error:
            end = time.monotonic() + PATIENCE if end is None else end
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

    Args:
        bus: of python-can.
    """

    def __init__(self, bus: can.BusABC):
        unmarked = isinstance(bus, UdpMulticastBus)
        self._sent: deque[Frame] | None = deque(maxlen=ECHOES) if unmarked else None

    def sent(self, message: can.Message) -> None:
        """Note a message that is about to be sent."""
        if self._sent is not None and (frame := to_frame(message)):
            self._sent.append(frame)

    def own(self, message: can.Message) -> bool:
        """Whether a received message is one that was sent here."""
        if not message.is_rx:
            return True
        frame = to_frame(message)
        if not self._sent or frame not in self._sent:
            return False
        while self._sent.popleft() != frame:
            pass  # they come in their order, so what was sent before it is lost
        return True


class CanPort:
    """The port of a python-can bus for a master, in real time.

    Args:
        bus: of python-can, or an `adapter.Adapter`; its owner shuts it down.
        wait: how long to wait for the very first frame (s); afterwards `patience` applies.
        log: called with every message sent or received, such as a
            `servogym.drive.wire.log.LogFile`.

    A full transmit buffer has `PATIENCE` to drain. A bus that accepts or delivers no frames raises
    `servogym.drive.master.BusError`.
    """

    def __init__(
        self, bus: Any, wait: float = 0.002, log: Callable[[can.Message], object] | None = None
    ):
        self._send, self._receive, self.patience, self._log = bus.send, bus.recv, wait, log
        self._echoes = Echoes(bus)

    def now(self) -> float:
        """The clock (s)."""
        return time.monotonic()

    def exchange(self, frames: Iterable[Frame]) -> list[Frame]:
        """Send `frames`, -> what has been received since."""
        for frame in frames:
            message = to_message(frame)
            self._echoes.sent(message)
            give(self._send, message)
            if self._log is not None:
                message.timestamp, message.is_rx = time.time(), False
                self._log(message)
        received = []
        try:
            heard = self._receive(self.patience)
            while heard is not None:
                if not self._echoes.own(heard):
                    if self._log is not None:
                        self._log(heard)
                    received.append(to_frame(heard))
                heard = self._receive(0)
        except TROUBLE as error:
            raise BusError(
                "receiving", f"the adapter fails: {' '.join(str(error).split())}",
                "check that it is plugged in, then open the bus anew",
            ) from error
        return [frame for frame in received if frame is not None]
