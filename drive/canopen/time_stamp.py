"""TIME: the data type TIME_OF_DAY, and the consumer of the time stamp object (CiA 301, 1012h)."""

import datetime
import struct
from typing import NamedTuple

from ..drive import Drive
from .frame import Route

_EPOCH = datetime.datetime(1984, 1, 1)
_TIME_OF_DAY = struct.Struct("<IH")
DAY = 86_400_000  # ms


class TimeOfDay(NamedTuple):
    """TIME_OF_DAY of CiA 301, without a time zone."""

    days: int  # since 1984-01-01
    milliseconds: int  # after midnight

    @classmethod
    def unpack(cls, data: bytes) -> "TimeOfDay | None":
        """Unpack the data of a TIME message; None if the length is wrong."""
        if len(data) != _TIME_OF_DAY.size:
            return None
        milliseconds, days = _TIME_OF_DAY.unpack(data)
        return cls(days, milliseconds & 0x0FFF_FFFF)  # four bits are reserved

    def datetime(self) -> datetime.datetime:
        """Return the time as a `datetime.datetime`."""
        return _EPOCH + datetime.timedelta(days=self.days, milliseconds=self.milliseconds)


class TimeStamp:
    """The TIME consumer of a node."""

    def __init__(self, drive: Drive):
        self._objects = drive.objects

    def reset(self) -> None:
        """Forget the time."""
        self.last: TimeOfDay | None = None
        self.received_at = 0  # µs, the node's time

    def configure(self) -> None:
        """Read 1012h."""
        cob_id = self._objects.value(0x1012)
        consumes = cob_id & 0x8000_0000
        self.routes: list[Route] = [(cob_id & 0x7FF, self.take)] if consumes else []

    def take(self, data: bytes, time: int) -> None:
        """Process a TIME message; one of wrong length or beyond midnight is ignored."""
        received = TimeOfDay.unpack(data)
        if received and received.milliseconds < DAY:
            self.last, self.received_at = received, time

    def now(self, time: int) -> TimeOfDay | None:
        """Time of day at `time` (µs), extrapolated from the last message; None before the first."""
        if self.last is None:
            return None
        passed = self.last.milliseconds + (time - self.received_at) // 1000
        return TimeOfDay(self.last.days + passed // DAY, passed % DAY)
