"""PDOs on the bus: transmission types, SYNC, events, inhibit and event timers (CiA 301, PDO).

RPDO: 0-240 at the next SYNC, 254 and 255 at once; the event timer is a deadline that begins with
the first RPDO. TPDO: 0 at the SYNC after a change, 1-240 every n-th SYNC, 252 sampled at SYNC and
sent on request, 253 on request, 254 and 255 on a change of the data and by the event timer, never
faster than the inhibit time.

The PDO records are read when a communication object has changed, so a frame finds its PDO by one
look into a table, with 512 PDOs as with one.
"""

from collections.abc import Callable
from functools import partial

import numpy as np

from .. import process_data
from ..drive import Drive
from ..faults import Cause
from ..jit import entry
from ..objects import NO_RTR
from .emcy import Emergency, ErrorCode
from .frame import Frame
from .sync import Sync

SYNCHRONOUS = range(241)
RTR_SYNC, RTR, EVENT = 252, 253, (254, 255)
CYCLIC = 254  # in models with the quirk cyclic_event: the inhibit time is a period
FIRST_MASK = 0x2014  # transmit masks of the first TPDO, in models that have them

Route = tuple[int, Callable[[bytes, int], None]]  # identifier, who takes data and time


@entry
def _latch(all_bytes, index, pdos, number, image):
    process_data.latch_one(all_bytes[index], pdos[number], image, 0)


@entry
def _collect(all_bytes, index, pdos, number, image):
    process_data.collect_one(all_bytes[index], pdos[number], image, 0)


class _Receive:
    """One valid RPDO."""

    __slots__ = ("deadline", "failed", "heard_at", "number", "synchronous", "waiting", "width")

    def __init__(self, number: int):
        self.number = number
        self.width = self.deadline = 0  # byte, µs
        self.synchronous = self.failed = False
        self.waiting: bytes | None = None  # for the next SYNC
        self.heard_at: int | None = None  # µs, while the deadline runs


class Receiver:
    """The RPDOs of a drive."""

    def __init__(self, drive: Drive, sync: Sync, emergency: Emergency):
        self._drive = drive
        self._sync = sync
        self._emergency = emergency
        own = slice(drive.index, drive.index + 1)
        self._changed = drive.axes["parameters_changed"][own]
        self._synchronised = drive.axes["sync"][own]
        self._timed_out = drive.axes["rpdo_timeout"][own]
        self._too_short = drive.axes["rpdo_too_short"][own]
        self.reset()

    def reset(self) -> None:
        """Begin anew, as after a reset of the communication."""
        self._rpdos: dict[int, _Receive] = {}
        self._waiting: dict[int, _Receive] = {}
        self._late: set[int] = set()
        self._short: set[int] = set()
        self._timed_out[0] = self._too_short[0] = 0
        self.configure()

    def configure(self) -> None:
        """Read 1400h… and 1600h…; a new deadline begins with the next RPDO."""
        rpdos, before = self._drive.rpdos, self._rpdos
        self._rpdos, self.routes = {}, []
        numbers = np.flatnonzero(rpdos["valid"])
        for number, cob_id, kind, timer, width in zip(
            numbers.tolist(),
            *(
                rpdos[field][numbers].tolist()
                for field in ("cob_id", "transmission_type", "event_timer", "width")
            ),
            strict=True,
        ):
            rpdo = before.pop(number) if number in before else _Receive(number)
            self._rpdos[number] = rpdo
            rpdo.width, rpdo.synchronous = width, kind in SYNCHRONOUS
            if rpdo.deadline != timer * 1000:
                rpdo.deadline, rpdo.heard_at = timer * 1000, None
                self._recover(rpdo)
            self.routes.append((cob_id & 0x7FF, partial(self._receive, rpdo)))
        for rpdo in before.values():
            self._waiting.pop(rpdo.number, None)
            self._recover(rpdo)
        self._monitored = [rpdo for rpdo in self._rpdos.values() if rpdo.deadline]

    routes: list[Route]

    @property
    def monitors(self) -> bool:
        """Whether an RPDO has a deadline."""
        return bool(self._monitored)

    def _receive(self, rpdo: _Receive, data: bytes, time: int) -> None:
        """Take an RPDO; a short one is not used, of a long one the first bytes are."""
        if rpdo.deadline:
            rpdo.heard_at = time
        if len(data) != rpdo.width:
            short = len(data) < rpdo.width
            rpdo.failed = True
            if short:
                self._short.add(rpdo.number)
                self._too_short[0] = 1
                cause = Cause.RPDO_TOO_SHORT
                self._emergency.report(ErrorCode.PDO_TOO_SHORT, rpdo.number, cause)
                return
            self._emergency.report(ErrorCode.PDO_TOO_LONG, rpdo.number)
        elif rpdo.failed:
            self._recover(rpdo)
        if not rpdo.synchronous:
            self._take(rpdo, data, 0)
        elif self._sync.open(time):
            rpdo.waiting = data
            self._waiting[rpdo.number] = rpdo

    def _recover(self, rpdo: _Receive) -> None:
        rpdo.failed = False
        for code in (ErrorCode.PDO_TOO_SHORT, ErrorCode.PDO_TOO_LONG, ErrorCode.RPDO_TIMEOUT):
            self._emergency.clear(code, rpdo.number)
        self._late.discard(rpdo.number)
        self._short.discard(rpdo.number)
        self._timed_out[0] = bool(self._late)
        self._too_short[0] = bool(self._short)

    def _take(self, rpdo: _Receive, data: bytes, synchronous: int) -> None:
        drive = self._drive
        image = np.frombuffer(data, np.uint8)
        _latch(drive.memory, drive.index, drive.rpdos, rpdo.number, image)
        self._changed[0] = 1
        self._synchronised[0] = synchronous

    def sync(self) -> None:
        """Latch what waited for the SYNC."""
        for _, rpdo in sorted(self._waiting.items()):
            assert rpdo.waiting is not None
            self._take(rpdo, rpdo.waiting, 1)
        self._waiting.clear()

    def poll(self, time: int) -> None:
        """Notice deadlines that have run out at `time` (µs)."""
        for rpdo in self._monitored:
            if rpdo.heard_at is not None and time - rpdo.heard_at > rpdo.deadline:
                rpdo.heard_at, rpdo.failed = None, True
                self._late.add(rpdo.number)
                self._timed_out[0] = 1
                self._emergency.report(ErrorCode.RPDO_TIMEOUT, rpdo.number, Cause.RPDO_TIMEOUT)

    def forget(self) -> None:
        """Drop what waits and stop the deadlines; after leaving OPERATIONAL."""
        self._waiting.clear()
        for rpdo in self._monitored:
            rpdo.heard_at = None


class _Transmit:
    """One valid TPDO."""

    def __init__(self, drive: Drive, number: int):
        self._drive = drive
        self._number = number
        self.kind = self._width = -1

    def configure(self, cob_id: int, kind: int, inhibit: int, timer: int, start: int, width: int):
        """Take over parameters; with another type or length the PDO begins anew."""
        self._identifier = cob_id & 0x7FF
        self._inhibit, self._timer, self._sync_start = inhibit * 100, timer * 1000, start
        if kind == CYCLIC and self._drive.model.quirk("cyclic_event"):
            self._timer = self._inhibit  # 0: not sent at all (inferred)
            self._silent = True
        else:
            self._silent = False
        self._mask = self._transmit_mask()
        if (kind, width) != (self.kind, self._width):
            self.kind, self._width = kind, width
            self._image = np.empty(width, np.uint8)
            self.start()

    def _transmit_mask(self) -> int | None:
        """Bits whose change sends the PDO: 2014h… of some models; None: all."""
        if self.kind == CYCLIC or not self._drive.model.quirk("transmit_masks"):
            return None
        objects, index = self._drive.objects, FIRST_MASK + self._number
        return objects.value(index, 1, 0xFFFF_FFFF) | objects.value(index, 2, 0xFFFF_FFFF) << 32

    def _changed(self, data: bytes) -> bool:
        if self._silent:
            return False
        if self._mask is None or self._last is None:
            return data != self._last
        now, before = (int.from_bytes(part, "little") for part in (data, self._last))
        return bool((now ^ before) & self._mask)

    def start(self) -> None:
        """Begin anew, as on entering OPERATIONAL: event-driven PDOs are sent once."""
        self._last: bytes | None = None
        self._sampled = b""
        self._sent_at = -(1 << 62)
        self._syncs = 0

    def _content(self) -> bytes:
        drive = self._drive
        _collect(drive.memory, drive.index, drive.tpdos, self._number, self._image)
        return self._image.tobytes()

    def _frame(self, data: bytes, time: int) -> Frame:
        self._last, self._sent_at = data, time
        return Frame(self._identifier, data)

    def sync(self, counter: int, time: int) -> Frame | None:
        """What this PDO sends at a SYNC; `counter` is 0 where SYNC has none."""
        kind = self.kind
        if kind == RTR_SYNC:
            self._sampled = self._content()
            return None
        if kind == 0:
            data = self._content()
            return self._frame(data, time) if data != self._last else None
        # the SYNC with the start value counts as the first, and is the first to be answered
        # (inferred); without a start value the n-th is
        by_counter = counter and self._sync_start
        if by_counter and self._syncs == 0 and counter != self._sync_start:
            return None
        self._syncs += 1
        if (self._syncs - 1) % kind == (0 if by_counter else kind - 1):
            return self._frame(self._content(), time)
        return None

    def poll(self, time: int) -> Frame | None:
        """What this PDO sends by event or event timer at `time` (µs)."""
        waited = time - self._sent_at
        if waited < self._inhibit:
            return None
        data = self._content()
        due = self._timer and waited >= self._timer
        return self._frame(data, time) if due or self._changed(data) else None

    def request(self, time: int) -> Frame:
        """Answer to a remote frame (RTR)."""
        sampled = self.kind == RTR_SYNC and self._sampled
        return self._frame(self._sampled if sampled else self._content(), time)


class Transmitter:
    """The TPDOs of a drive; `send` takes frames."""

    def __init__(self, drive: Drive, send: Callable[[Frame], None]):
        self._drive = drive
        self._send = send
        self._tpdos: dict[int, _Transmit] = {}
        self.configure()

    def configure(self) -> None:
        """Read 1800h… and 1A00h…."""
        tpdos, before = self._drive.tpdos, self._tpdos
        self._tpdos, self.routes = {}, []
        numbers = np.flatnonzero(tpdos["valid"])
        fields = ("cob_id", "transmission_type", "inhibit_time", "event_timer", "sync_start")
        columns = (tpdos[field][numbers].tolist() for field in (*fields, "width"))
        for number, cob_id, *more in zip(numbers.tolist(), *columns, strict=True):
            tpdo = self._tpdos[number] = before.get(number) or _Transmit(self._drive, number)
            tpdo.configure(cob_id, *more)
            if not cob_id & NO_RTR:
                self.routes.append((cob_id & 0x7FF, partial(self._request, tpdo)))
        kinds = [(tpdo, tpdo.kind) for tpdo in self._tpdos.values()]
        self._at_sync = [t for t, kind in kinds if kind in SYNCHRONOUS or kind == RTR_SYNC]
        self._by_event = [t for t, kind in kinds if kind in EVENT]

    routes: list[Route]  # of remote frames

    @property
    def has_events(self) -> bool:
        """Whether a TPDO is sent without SYNC or request."""
        return bool(self._by_event)

    def start(self) -> None:
        """On entering OPERATIONAL."""
        for tpdo in self._tpdos.values():
            tpdo.start()

    def sync(self, counter: int, time: int) -> list[Frame]:
        """What a SYNC at `time` (µs) makes the drive send, within the synchronous window."""
        return [f for tpdo in self._at_sync if (f := tpdo.sync(counter, time))]

    def poll(self, time: int) -> None:
        """Send what is due by event or event timer at `time` (µs)."""
        for tpdo in self._by_event:
            frame = tpdo.poll(time)
            if frame:
                self._send(frame)

    def _request(self, tpdo: _Transmit, data: bytes, time: int) -> None:
        self._send(tpdo.request(time))
