"""Serves drives as EtherCAT slaves on Ethernet ports."""

import select
import time
from collections.abc import Callable, Sequence
from typing import Protocol

from ..ethercat.bus import Bus, Clock
from ..ethercat.frame import LENGTH, LOGICAL
from .pcapng import Writer


class Port(Protocol):
    """A port that receives and sends frames."""

    name: str

    def receive(self, buffer: memoryview) -> int:
        """Read a frame; -> its length, 0 if none has arrived."""

    def send(self, frame: memoryview) -> None:
        """Send a frame."""

    def close(self) -> None:
        """Close the port."""

    @property
    def socket(self):
        """The socket or file descriptor to wait on."""


class EtherCatServer:
    """Serves a bus at one port of the master, or at two for redundancy.

    Args:
        bus: the segment and its machines.
        ports: Ethernet ports.
        log: capture of all frames.
        tell: called once with each hint for the user of a master.
    """

    def __init__(
        self,
        bus: Bus,
        ports: Sequence[Port],
        log: Writer | None = None,
        tell: Callable[[str], object] = lambda line: None,
    ):
        self.bus = bus
        self.ports = list(ports)
        self.log = log
        self._tell = tell
        self._told: set[str] = set()
        self.working_counter = 0  # of the first datagram of the last frame of process data
        self._begin = time.monotonic_ns()
        self._buffer = memoryview(bus.segment.frame)  # type: ignore[arg-type]

    @property
    def now(self) -> int:
        """Time since the start (ns)."""
        return time.monotonic_ns() - self._begin

    def serve(self) -> None:
        """Wait for a frame, answer it, and advance the machines."""
        if len(self.ports) == 1:
            self._serve(0)
            return
        ready, _, _ = select.select([port.socket for port in self.ports], [], [], 0.001)
        for number, port in enumerate(self.ports):
            if port.socket in ready:
                self._serve(number)
        if not ready and self.bus.clock != Clock.FRAME:
            self.bus.advance(self.now)

    def _serve(self, port: int) -> None:
        length = self.ports[port].receive(self._buffer)
        if length == 0:
            if self.bus.clock != Clock.FRAME:
                self.bus.advance(self.now)
            return
        now = self.now
        self._record(self._buffer[:length], port)
        if self.bus.receive(length, now, port):
            back = -1 - self.bus.segment.exits[port]
            if back < len(self.ports):
                self.ports[back].send(self._buffer[:length])
                self._record(self._buffer[:length], back)
        while self.bus.extra:
            late = memoryview(self.bus.extra.popleft())
            self.ports[port].send(late)
            self._record(late, port)
        if self._buffer[16] in LOGICAL:
            end = 26 + (int.from_bytes(self._buffer[22:24], "little") & LENGTH)
            self.working_counter = int.from_bytes(self._buffer[end : end + 2], "little")
        self.bus.advance(self.now)
        for line in self.bus.notes():
            if line not in self._told:
                self._told.add(line)
                self._tell(line)

    def _record(self, frame: memoryview, port: int) -> None:
        if self.log:
            self.log.write(frame, time.time_ns(), port)

    def close(self) -> None:
        """Close the capture and the ports."""
        if self.log:
            self.log.close()
        for port in self.ports:
            port.close()
