"""Links to the outside: a python-can bus, and a log of the frames on any link."""

from collections.abc import Iterator

import can

from ..canopen.frame import Frame
from ..canopen.link import Link
from .bus import Echoes, give, to_frame, to_message
from .log import LogFile


class CanLink:
    """A python-can bus; it runs in its own time and ignores the time of the simulation.

    Args:
        bus: the bus; its owner shuts it down.
        wait: for the first frame of a `receive` (s).
    """

    def __init__(self, bus: can.BusABC, wait: float = 0.0):
        self._bus = bus
        self._wait = wait
        self._echoes = Echoes(bus)

    def send(self, frame: Frame, time: int) -> None:
        """Send a frame at once. Raises BusError if the bus does not accept it."""
        message = to_message(frame)
        self._echoes.sent(message)
        give(self._bus.send, message)

    def receive(self, time: int) -> Iterator[Frame]:
        """Return all classical data and remote frames received so far."""
        message = self._bus.recv(self._wait)
        while message is not None:
            frame = to_frame(message)
            if frame is not None and not self._echoes.own(message):
                yield frame
            message = self._bus.recv(0)


class Traced:
    """Any link, with all its frames in a log file that the tools of python-can read.

    Args:
        link: the link.
        file: name of the log; its suffix is the format: .log (candump), .asc, .blf, .csv, ...

    Raises:
        ValueError: unknown suffix.
    """

    def __init__(self, link: Link, file: str):
        self._link = link
        self._time = 0  # µs, of the last line: a frame may be older than the time it is taken at
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
        """Finish the file."""
        self._log.stop()
