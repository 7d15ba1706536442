"""Fault injection on a link: seeded drops, corruption, delays, swaps and duplicates of frames.

A CAN controller detects almost every disturbed frame by its CRC and repeats it. The faults injected
here are those that remain, or that a gateway causes.
"""

from dataclasses import dataclass, fields

import numpy as np

from .frame import Frame
from .link import Link

RECOVERY = 128 * 11  # bits a controller waits after bus-off (ISO 11898-1)
RATES = ("drop", "corrupt", "delay", "reorder", "duplicate", "bus_off")


@dataclass(frozen=True)
class Faults:
    """The probability of each fault for a frame, 0..1, and the duration of faults.

    Raises ValueError naming field, value and range.
    """

    drop: float = 0.0  # the frame is lost
    corrupt: float = 0.0  # one bit of its data is inverted
    delay: float = 0.0  # it arrives up to `longest_delay` later
    reorder: float = 0.0  # the next frame in its direction overtakes it
    duplicate: float = 0.0  # it arrives twice
    bus_off: float = 0.0  # sending it puts the member off the bus for `bus_off_time`
    longest_delay: int = 10_000  # µs
    bus_off_time: int = RECOVERY  # µs; at 1 Mbit/s without another member sending

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if field.name in RATES:
                if not (isinstance(value, float | int) and 0.0 <= value <= 1.0):
                    raise ValueError(f"{field.name} = {value!r} is out of range 0..1")
            elif not (isinstance(value, int) and value > 0):
                raise ValueError(f"{field.name} = {value!r} must be a whole number above 0 (µs)")


class Faulty:
    """Wraps a link and injects faults in both directions.

    Each frame consumes the same number of random numbers, so one seed gives the same frames the
    same faults.

    Args:
        link: the link that is wrapped.
        faults: probabilities of the faults.
        random: generator; the same seed gives the same faults.
    """

    def __init__(self, link: Link, faults: Faults, random: np.random.Generator):
        self._link = link
        self._faults = faults
        self._random = random
        self._outgoing = _Direction()
        self._incoming = _Direction()
        self._off_until = 0
        self.counts = dict.fromkeys(RATES, 0)  # number of occurrences of each fault

    def bus_off(self, time: int) -> bool:
        """Whether the member is off the bus at `time`."""
        return time < self._off_until

    def send(self, frame: Frame, time: int) -> None:
        """Send a frame at `time`; it is lost if the member is off the bus."""
        happens = self._pass(frame, time, self._outgoing)
        if happens["bus_off"] and not self.bus_off(time):
            self.counts["bus_off"] += 1
            self._off_until = time + self._faults.bus_off_time
            self._outgoing = _Direction()
        self._flush(time)

    def receive(self, time: int) -> list[Frame]:
        """The frames of the other members that arrive by `time`."""
        for frame in self._link.receive(time):
            self._pass(frame, time, self._incoming)
        self._flush(time)
        return self._incoming.take(time)

    def _flush(self, time: int) -> None:
        for frame in self._outgoing.take(time):
            self._link.send(frame, time)

    def _pass(self, frame: Frame, time: int, direction: "_Direction") -> dict[str, bool]:
        """Queue `frame` with its faults."""
        faults, draw = self._faults, self._random.random(len(RATES) + 2)
        happens = {name: draw[i] < getattr(faults, name) for i, name in enumerate(RATES)}
        where, how_long = draw[len(RATES) :]
        if self.bus_off(time):
            return happens
        happens["corrupt"] = happens["corrupt"] and bool(frame.data)
        for name in RATES[:-1]:
            self.counts[name] += happens[name]
        if happens["drop"]:
            return happens
        if happens["corrupt"]:
            frame = _inverted(frame, int(where * len(frame.data) * 8))
        due = time + 1 + int(how_long * faults.longest_delay) if happens["delay"] else time
        latest = time + faults.longest_delay if happens["reorder"] else None
        direction.add(frame, due, latest)
        if happens["duplicate"]:
            direction.add(frame, due, None)
        return happens


class _Direction:
    """Frames in transit, and one frame that waits to be overtaken."""

    def __init__(self) -> None:
        self._frames: list[tuple[int, Frame]] = []  # due, frame
        self._held: tuple[int, Frame] | None = None  # latest time, frame

    def add(self, frame: Frame, due: int, latest: int | None) -> None:
        """Add a frame; with `latest` it waits for the next one, but no longer than that."""
        if latest is not None and self._held is None:
            self._held = latest, frame
            return
        self._frames.append((due, frame))
        if self._held is not None:
            self._frames.append((due, self._held[1]))
            self._held = None

    def take(self, time: int) -> list[Frame]:
        """Return the frames that are due, in the order of their times."""
        if self._held is not None and time >= self._held[0]:
            self._frames.append(self._held)
            self._held = None
        due = [(at, frame) for at, frame in self._frames if at <= time]
        self._frames = [(at, frame) for at, frame in self._frames if at > time]
        return [frame for _, frame in sorted(due, key=lambda entry: entry[0])]


def _inverted(frame: Frame, bit: int) -> Frame:
    """The frame with one bit of its data inverted."""
    data = bytearray(frame.data)
    data[bit // 8] ^= 1 << bit % 8
    return frame._replace(data=bytes(data))
