"""Error control: heartbeat producer and consumer, node guarding (CiA 301, error control services).

A node uses heartbeat or guarding, not both: guarding is not answered while 1017h is not 0.
"""

from functools import partial

from ..drive import Drive
from ..kernel.faults import Cause
from .emcy import Emergency, ErrorCode
from .frame import Base, Route


class HeartbeatProducer:
    """Heartbeat of the node (1017h); the boot-up message counts as the first one."""

    def __init__(self, drive: Drive):
        self._objects = drive.objects

    def reset(self) -> None:
        """Start with the boot-up message."""
        self._period = self._objects.value(0x1017) * 1000
        self._sent_at: int | None = None
        self._booted = True

    def configure(self) -> None:
        """Read 1017h; a new period starts at once."""
        period = self._objects.value(0x1017) * 1000
        if period != self._period:
            self._period, self._sent_at, self._booted = period, None, False

    @property
    def produces(self) -> bool:
        """Whether the node produces a heartbeat."""
        return self._period > 0

    def due(self, time: int) -> bool:
        """Whether a heartbeat is due at `time` (µs); to be called only if one is produced."""
        if self._booted:
            self._booted, self._sent_at = False, time
            return False
        if self._sent_at is None:
            self._sent_at = time
            return True
        late = time - self._sent_at - self._period
        if late < 0:
            return False
        # a late poll does not shift the following ones; a very late one skips some
        self._sent_at = time - late if late < self._period else time
        return True


class HeartbeatConsumer:
    """Heartbeats of other nodes (1016h); each node is monitored from its first one on."""

    def __init__(self, drive: Drive, emergency: Emergency):
        self._objects = drive.objects
        self._axis = drive.axis
        self._subs = sorted(sub for index, sub in drive.objects.slots if index == 0x1016 and sub)
        self._emergency = emergency

    def reset(self) -> None:
        """Forget the heartbeats received."""
        self._limits: dict[int, int] = {}  # node-id -> µs
        self._heard: dict[int, int] = {}  # node-id -> time of its last heartbeat
        self.lost: set[int] = set()

    def configure(self) -> None:
        """Read 1016h; monitoring restarts for a node whose entry has changed."""
        entries = [self._objects.value(0x1016, sub) for sub in self._subs]
        limits = {
            entry >> 16: (entry & 0xFFFF) * 1000
            for entry in entries
            if 1 <= entry >> 16 <= 127 and entry & 0xFFFF
        }
        for node in [n for n, limit in self._limits.items() if limits.get(n) != limit]:
            self._heard.pop(node, None)
            self._found(node)
        self._limits = limits

    @property
    def monitors(self) -> bool:
        """Whether a node is monitored."""
        return bool(self._limits)

    @property
    def routes(self) -> list[Route]:
        """Identifiers of the heartbeats, each with its receiver."""
        return [(Base.ERROR_CONTROL + node, partial(self._hear, node)) for node in self._limits]

    def _hear(self, node: int, data: bytes, time: int) -> None:
        if len(data) == 1:
            self._heard[node] = time
            self._found(node)

    def _found(self, node: int) -> None:
        self.lost.discard(node)
        self._emergency.clear(ErrorCode.CONNECTION, node)

    def poll(self, time: int) -> bool:
        """Whether a heartbeat has become overdue since the last call."""
        late = [n for n, heard in self._heard.items() if time - heard > self._limits[n]]
        for node in late:
            del self._heard[node]
            self.lost.add(node)
            self._axis.lost_node = node
            self._emergency.report(ErrorCode.CONNECTION, node, Cause.CONNECTION)
        return bool(late)


class NodeGuarding:
    """Node guarding by remote frames of the master; life guarding starts with the first one."""

    def __init__(self, drive: Drive, emergency: Emergency):
        self._objects = drive.objects
        self._axis = drive.axis
        self._emergency = emergency

    def reset(self) -> None:
        """Forget the master; the toggle bit starts with 0."""
        self._toggle = 0
        self._guarded_at: int | None = None
        self.lost = False

    def configure(self) -> None:
        """Read guard time 100Ch and life time factor 100Dh; changes apply from the next request."""
        self._answers = not self._objects.value(0x1017)
        self._life = self._objects.value(0x100C) * self._objects.value(0x100D) * 1000
        if not self._life or not self._answers:
            self._guarded_at = None
            self._found()

    @property
    def monitors(self) -> bool:
        """Whether the node monitors the master."""
        return self._answers and self._life > 0

    def _found(self) -> None:
        self.lost = False
        self._emergency.clear(ErrorCode.CONNECTION, "guarding")

    def answer(self, state: int, time: int) -> bytes | None:
        """Answer the master's remote frame with toggle bit and NMT state; None if not used."""
        if not self._answers:
            return None
        self._guarded_at = time
        self._found()
        data = bytes([self._toggle | state])
        self._toggle ^= 0x80
        return data

    def poll(self, time: int) -> bool:
        """Whether the life time has expired since the last call."""
        if self._guarded_at is None or not self._life or time - self._guarded_at <= self._life:
            return False
        self._guarded_at, self.lost = None, True
        self._axis.lost_node = 0
        self._emergency.report(ErrorCode.CONNECTION, "guarding", Cause.CONNECTION)
        return True
