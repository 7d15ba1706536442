"""SYNC: consumer with counter and window, producer (CiA 301, 1005h, 1006h, 1007h, 1019h)."""

from ..drive import Drive
from .emcy import Emergency, ErrorCode
from .frame import Base


class Sync:
    """The SYNC service of a node."""

    def __init__(self, drive: Drive, emergency: Emergency):
        self._objects = drive.objects
        self._emergency = emergency

    def reset(self) -> None:
        """Forget the last SYNC; a producer starts with counter 1."""
        self.produces, self._period = False, 0
        self._opened_at: int | None = None
        self.stop()

    def configure(self) -> None:
        """Read 1005h, 1006h, 1007h and 1019h; a producer starts or stops."""
        cob_id = self._objects.value(0x1005, default=Base.SYNC)
        before = self.produces, self._period
        self.identifier = cob_id & 0x7FF
        self._period = self._objects.value(0x1006)
        self.produces = bool(cob_id & 0x4000_0000) and self._period > 0
        self._window = self._objects.value(0x1007)
        self._overflow = self._objects.value(0x1019)
        if (self.produces, self._period) != before:
            self.stop()

    def stop(self) -> None:
        """Stop the producer; it restarts with counter 1."""
        self._next: int | None = None
        self._counter = 0

    def take(self, data: bytes, time: int) -> int | None:
        """Counter of a SYNC received at `time` (µs), 0 without one; None if its length is wrong.

        1019h determines whether a counter is expected. A SYNC of another length is ignored
        (inferred).
        """
        if len(data) != (1 if self._overflow else 0):
            self._emergency.report(ErrorCode.SYNC_LENGTH, "sync")
            return None
        self._emergency.clear(ErrorCode.SYNC_LENGTH, "sync")
        self._opened_at = time
        return data[0] if data else 0

    def produce(self, time: int) -> bytes | None:
        """Data of the SYNC that is due at `time` (µs); None if none is due."""
        if not self.produces or (self._next is not None and time < self._next):
            return None
        self._next = (time if self._next is None else self._next) + self._period
        if self._next <= time:  # a very late poll skips some
            self._next = time + self._period
        if not self._overflow:
            return b""
        self._counter = self._counter % self._overflow + 1
        return bytes([self._counter])

    def open(self, time: int) -> bool:
        """Whether synchronous PDOs are valid at `time` (µs): within the window 1007h."""
        if not self._window or self._opened_at is None:
            return True
        return time - self._opened_at <= self._window
