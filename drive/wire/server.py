"""Serves drives as CANopen nodes on a python-can bus, in real time."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import can

from ..canopen.frame import Frame
from ..canopen.node import Node
from ..machine import Machine
from .adapter import Adapter
from .bus import to_frame, to_message
from .log import LogFile

SDO_REQUESTS = range(0x601, 0x680)
INITIATE = (1, 2)  # command specifiers that initiate a download and an upload
WAIT = 0.0005  # s, to wait for a frame; short enough for a period of 1 ms


def arrival(message: can.Message | None) -> float:
    """Time of arrival of a message (s of `time.monotonic`) by its time stamp.

    Time stamps of another clock, or older than `Server.TOLERANCE`, are not used.
    """
    now = time.monotonic()
    age = time.time() - message.timestamp if message else 0.0
    return now - age if 0.0 < age < Server.TOLERANCE else now


@dataclass
class Statistics:
    """The statistics of a real-time server."""

    received: int = 0
    sent: int = 0
    cycles: int = 0
    missed: int = 0  # times a machine fell behind by more than `Server.TOLERANCE`
    last_sdo: Frame | None = None  # the latest request that named an object


class Server:
    """Serves machines with one drive each as nodes on one bus.

    Simulated time follows the clock; if the computer cannot keep up, cycles are skipped and
    counted. A frame takes effect at the time at which it reached this computer, if the bus reports
    it (`arrival`). A server delayed by other programs therefore answers late, but the motion is the
    same. The nodes receive each other's frames. A failed bus is reopened, see `adapter`.

    Args:
        bus: the bus; `close` shuts it down.
        machines: machines with drives of different node-ids.
        log: records all frames.
        reopen: opens the bus again if it does not recover by itself.
        tell: called with a line about trouble with bus or log.
    """

    TOLERANCE = 0.05  # s

    def __init__(
        self,
        bus: can.BusABC,
        machines: Sequence[Machine],
        log: LogFile | None = None,
        *,
        reopen: Callable[[], can.BusABC] | None = None,
        tell: Callable[[str], None] = lambda text: None,
    ) -> None:
        self.adapter = Adapter(bus, reopen, tell)
        self.log = log
        self.machines = list(machines)
        self.nodes = [Node(d) for machine in machines for d in machine.drives.values()]
        self.statistics = Statistics()
        self._begin = self._at = time.monotonic()
        self._stopped = False
        self._cycles_at_request = -1

    @property
    def bus(self) -> can.BusABC:
        """The bus that is open now."""
        return self.adapter.bus

    def stop(self) -> None:
        """Make `run` return; may be called from another thread."""
        self._stopped = True

    def run(self) -> None:
        """Serve until `stop`."""
        while not self._stopped:
            self.serve(self.adapter.recv(WAIT))

    def serve(self, message: can.Message | None) -> None:
        """Handle a received message, run the due cycles, and send the answers."""
        at = self._at = max(self._at, arrival(message))
        self._advance(at)
        now = int((at - self._begin) * 1e6)
        frame = to_frame(message) if message else None
        if frame and SDO_REQUESTS.start <= frame.id < SDO_REQUESTS.stop:
            self._pass_a_cycle()
            if frame.data and frame.data[0] >> 5 in INITIATE:
                self.statistics.last_sdo = frame
        if message and frame:
            self.statistics.received += 1
            if self.log is not None:
                self.log(message)
            for node in self.nodes:
                node.receive(frame, now)
        for node in self.nodes:
            for answer in node.poll(now):
                self._send(answer)
                for other in self.nodes:
                    if other is not node:
                        other.receive(answer, now)
        if self.log is not None:
            self.log.flush()

    def _send(self, frame: Frame) -> None:
        message = to_message(frame)
        message.is_rx = False
        self.adapter.send(message)
        self.statistics.sent += 1
        if self.log is not None:
            message.timestamp = time.time()
            self.log(message)

    def _pass_a_cycle(self) -> None:
        """Run at least one cycle between two SDO requests, so that the first one takes effect."""
        while self.statistics.cycles == self._cycles_at_request:
            time.sleep(1e-4)
            self._advance(time.monotonic())
        self._cycles_at_request = self.statistics.cycles

    def skip(self, seconds: float) -> None:
        """Advance the clock, because the machines have been stepped ahead of it (s)."""
        self._begin -= seconds

    def close(self) -> None:
        """Close log and bus."""
        if self.log is not None:
            self.log.stop()
        self.adapter.shutdown()

    def _advance(self, until: float) -> None:
        """Let the machines run up to a time of the clock (s)."""
        for machine in self.machines:
            behind = until - self._begin - machine.time
            if behind > self.TOLERANCE:
                self.statistics.missed += 1
                self._begin += behind - self.TOLERANCE
                behind = self.TOLERANCE
            cycles = int(behind / machine.cycle_time)
            if cycles > 0:
                machine.step(cycles)
                self.statistics.cycles += cycles
