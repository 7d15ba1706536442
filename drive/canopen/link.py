"""Links between the members of a simulated bus, without I/O; time in µs.

A `Link` is what one member sees of the bus: it sends frames and receives those of the others.
`Loopback` is a bus within the process, with or without transmission times; `Faulty` injects faults
into any link. Links to python-can and to log files: `servogym.drive.wire.bus`.
"""

from collections import deque
from collections.abc import Iterable
from typing import Protocol

from .bit_time import length, priority
from .frame import Frame

QUEUE = 4096  # frames a member has waiting in each direction; then it loses the oldest
FASTEST = 1_000_000  # bit/s of classical CAN
MICRO = 1_000_000


class Link(Protocol):
    """A member's way to the bus. `time` (µs, an integer) never goes back."""

    def send(self, frame: Frame, time: int) -> None:
        """Hand over a frame at `time`; it goes out as soon as the bus takes it."""

    def receive(self, time: int) -> Iterable[Frame]:
        """The frames of the other members that are complete at `time`, in their order."""


class Loopback:
    """A CAN bus within the process.

    A member sends its frames in the order they were handed over, so that a SYNC does not overtake
    the RPDOs before it. Between the members the frame with the lowest identifier goes first.

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
        self._bit = 0 if bit_rate is None else MICRO  # length of a bit, in ...
        self._unit = bit_rate or 1  # ... units per µs, so that every bit rate is exact
        self._members: list[Member] = []
        self._running: tuple[int, Member, Frame] | None = None  # end, sender, frame
        self._free = 0  # end of the last frame
        self._busy = 0
        self.frames = 0  # that have passed
        self.lost = 0  # because a member had `QUEUE` frames waiting

    def join(self) -> "Member":
        """A new member of the bus."""
        member = Member(self)
        self._members.append(member)
        return member

    def load(self, time: int) -> float:
        """Share of the time up to `time` in which the bus was not idle, 0..1."""
        self.advance(time)
        begun = max(0, self._free - time * self._unit)  # of the running frame, not yet passed
        return (self._busy - begun) / (time * self._unit) if time > 0 else 0.0

    def due(self) -> int | None:
        """When the next frame will be complete (µs, rounded up); None if none is waiting."""
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
        """When the next frame starts, and the member that wins the arbitration."""
        waiting = [member for member in self._members if member.queue]
        if not waiting:
            return self._free, None
        start = max(self._free, min([m.queue[0][0] for m in waiting]) * self._unit)
        if len(waiting) == 1:
            return start, waiting[0]
        ready = [m for m in waiting if m.queue[0][0] * self._unit <= start]
        # two members with one identifier would destroy each other's frames; here the elder wins
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
        self.queue: deque[tuple[int, int, Frame]] = deque(
            maxlen=QUEUE
        )  # since when, priority, what
        self.inbox: deque[Frame] = deque(maxlen=QUEUE)

    def send(self, frame: Frame, time: int) -> None:
        """Hand over a frame at `time`."""
        self._bus.lost += len(self.queue) == QUEUE
        self.queue.append((time, priority(frame), frame))

    def receive(self, time: int) -> list[Frame]:
        """The frames of the others that are complete at `time`."""
        self._bus.advance(time)
        frames = list(self.inbox)
        self.inbox.clear()
        return frames
