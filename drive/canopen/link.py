"""Links between the members of a simulated bus, without I/O; time in µs.

A `Link` is the connection of one member: it sends frames and receives those of the others.
`Loopback` is a bus within the process, with or without transmission times; `Faulty` injects faults
into any link. Links to python-can and to log files: `servogym.drive.wire.bus`.
"""

from collections import deque
from collections.abc import Iterable
from typing import Protocol

from .bit_time import length, priority
from .frame import Frame

QUEUE = 4096  # waiting frames of a member in each direction; when full, the oldest is lost
FASTEST = 1_000_000  # bit/s of classical CAN
MICRO = 1_000_000


class Link(Protocol):
    """A member's connection to the bus. `time` (µs, an integer) never decreases."""

    def send(self, frame: Frame, time: int) -> None:
        """Queue a frame at `time`; it is sent as soon as the bus is free."""

    def receive(self, time: int) -> Iterable[Frame]:
        """Return the frames of the other members that are complete at `time`, in order."""


class Loopback:
    """A CAN bus within the process.

    A member sends its frames in the order in which they were queued, so that a SYNC does not
    overtake the RPDOs before it. Between the members, the frame with the lowest identifier wins.

    Args:
        bit_rate: bit/s; frames then take their bit times and wait for the bus. Without it they
            take no time, but still arrive in the order of arbitration.

    Raises:
        ValueError: bit rate out of range.
    """

    def __init__(self, bit_rate: int | None = None):
        if bit_rate is not None and not 1 <= bit_rate <= FASTEST:
            raise ValueError(
                f"bit_rate = {bit_rate} bit/s is out of range 1..{FASTEST}; "
                "None is a bus on which frames take no time"
            )
        # a bit takes `_bit` units of time and a µs has `_unit` of them: exact for every bit rate
        self._bit = 0 if bit_rate is None else MICRO
        self._unit = bit_rate or 1
        self._members: list[Member] = []
        self._running: tuple[int, Member, Frame] | None = None  # end, sender, frame
        self._free = 0  # end of the last frame
        self._busy = 0
        self.frames = 0  # number of transmitted frames
        self.lost = 0  # number of frames lost because a queue was full

    def join(self) -> "Member":
        """Add a member to the bus."""
        member = Member(self)
        self._members.append(member)
        return member

    def load(self, time: int) -> float:
        """Share of the time up to `time` in which the bus was not idle, 0..1."""
        self.advance(time)
        to_come = max(0, self._free - time * self._unit)  # of the running frame
        return (self._busy - to_come) / (time * self._unit) if time > 0 else 0.0

    def due(self) -> int | None:
        """Time at which the next frame will be complete (µs, rounded up); None if none waits."""
        if self._running:
            return -(-self._running[0] // self._unit)
        start, winner = self._next()
        if winner is None:
            return None
        return -(-(start + self._length(winner.queue[0][2])) // self._unit)

    def advance(self, time: int) -> None:
        """Deliver all frames that are complete at `time`."""
        limit = time * self._unit
        while True:
            if self._running is None:
                start, winner = self._next()
                if winner is None or start > limit:
                    return
                self._start(start, winner)
            end, sender, frame = self._running  # type: ignore[misc]
            if end > limit:
                return
            self._running = None
            self.frames += 1
            for member in self._members:
                if member is not sender:
                    self.lost += len(member.inbox) == QUEUE
                    member.inbox.append(frame)

    def _next(self) -> "tuple[int, Member | None]":
        """Start of the next frame, and the member that wins the arbitration."""
        waiting = [member for member in self._members if member.queue]
        if not waiting:
            return self._free, None
        start = max(self._free, min([m.queue[0][0] for m in waiting]) * self._unit)
        if len(waiting) == 1:
            return start, waiting[0]
        ready = [m for m in waiting if m.queue[0][0] * self._unit <= start]
        # frames of two members with one identifier would collide; here the first member wins
        return start, min(ready, key=lambda m: m.queue[0][1])

    def _length(self, frame: Frame) -> int:
        return length(frame) * self._bit if self._bit else 0

    def _start(self, start: int, winner: "Member") -> None:
        _, _, frame = winner.queue.popleft()
        duration = self._length(frame)
        self._free = start + duration
        self._busy += duration
        self._running = self._free, winner, frame


class Member:
    """The link of one member of a `Loopback`."""

    def __init__(self, bus: Loopback):
        self._bus = bus
        # time of queueing, priority, frame
        self.queue: deque[tuple[int, int, Frame]] = deque(maxlen=QUEUE)
        self.inbox: deque[Frame] = deque(maxlen=QUEUE)

    def send(self, frame: Frame, time: int) -> None:
        """Queue a frame at `time`."""
        self._bus.lost += len(self.queue) == QUEUE
        self.queue.append((time, priority(frame), frame))

    def receive(self, time: int) -> list[Frame]:
        """Return the frames of the others that are complete at `time`."""
        self._bus.advance(time)
        frames = list(self.inbox)
        self.inbox.clear()
        return frames
