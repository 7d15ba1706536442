"""TPDOs on the bus: transmission types, SYNC, events, inhibit and event timers (CiA 301, PDO).

Type 0 is sent at the SYNC after a change and types 1-240 at every n-th SYNC. Type 252 is sampled at
SYNC and sent on request, type 253 is sent on request. Types 254 and 255 are sent on a change of the
data and by the event timer, no faster than the inhibit time allows. The PDO records are read when a
communication object has changed.
"""

from collections.abc import Callable
from functools import partial

import numpy as np

from ..drive import Drive
from ..kernel import process_data
from ..kernel.jit import entry
from ..objects.mapping import NO_RTR
from .frame import SYNCHRONOUS, Frame, Route

CYCLIC, ON_CHANGE = 254, 255  # with the quirk cyclic_event the inhibit time is a period
RTR_SYNC, EVENT = 252, (CYCLIC, ON_CHANGE)
FIRST_MASK = 0x2014  # transmit masks of the first TPDO, in models that have them


@entry
def _collect(all_bytes, index, pdos, number, image):
    process_data.move(all_bytes[index], image, pdos[number], 0, False)


class _Transmit:
    """One valid TPDO."""

    def __init__(self, drive: Drive, number: int):
        self._drive = drive
        self._number = number
        self.kind = self._width = -1

    def configure(
        self, cob_id: int, kind: int, inhibit: int, timer: int, start: int, width: int
    ) -> None:
        """Set the parameters; if type or length has changed, the PDO restarts."""
        self._identifier = cob_id & 0x7FF
        self._inhibit, self._timer, self._sync_start = inhibit * 100, timer * 1000, start
        if self._number == 1:
            gap = self._drive.model.quirk("shortest_gap_of_tpdo_2") * 1000
            self._inhibit = max(self._inhibit, gap)
        self._periodic = kind == CYCLIC and bool(self._drive.model.quirk("cyclic_event"))
        if self._periodic:
            self._timer = self._inhibit  # 0: never sent (inferred)
        self._mask = self._transmit_mask(kind)
        if (kind, width) != (self.kind, self._width):
            self.kind, self._width = kind, width
            self._image = np.empty(width, np.uint8)
            self.start()

    def _transmit_mask(self, kind: int) -> int | None:
        """Bits whose change triggers the PDO (2014h… in some models); None for all bits."""
        if kind != ON_CHANGE or not self._drive.model.quirk("transmit_masks"):
            return None
        objects, index = self._drive.objects, FIRST_MASK + self._number
        return objects.value(index, 1, 0xFFFF_FFFF) | objects.value(index, 2, 0xFFFF_FFFF) << 32

    def _changed(self, data: bytes) -> bool:
        if self._periodic:
            return False
        if self._mask is None or self._last is None:
            return data != self._last
        now, before = (int.from_bytes(part, "little") for part in (data, self._last))
        return bool((now ^ before) & self._mask)

    def start(self) -> None:
        """Restart, as on entering OPERATIONAL: event-driven PDOs are sent once."""
        self._last: bytes | None = None
        self._sampled = b""
        self._sent_at = -(1 << 62)  # when it was due, so that a late poll does not shift the next
        self._syncs = 0

    def _content(self) -> bytes:
        drive = self._drive
        _collect(drive.memory, drive.index, drive.tpdos, self._number, self._image)
        return self._image.tobytes()

    def _frame(self, data: bytes, time: int) -> Frame:
        self._last, self._sent_at = data, time
        return Frame(self._identifier, data)

    def sync(self, counter: int, time: int) -> Frame | None:
        """Return the frame to send at a SYNC; `counter` is 0 if the SYNC has none."""
        kind = self.kind
        if kind == RTR_SYNC:
            self._sampled = self._content()
            return None
        if kind == 0:
            data = self._content()
            return self._frame(data, time) if data != self._last else None
        # with a start value, the SYNC that has it is the first one and is answered (inferred);
        # without it, the n-th SYNC is the first to be answered
        by_counter = counter and self._sync_start
        if by_counter and self._syncs == 0 and counter != self._sync_start:
            return None
        self._syncs += 1
        if (self._syncs - 1) % kind == (0 if by_counter else kind - 1):
            return self._frame(self._content(), time)
        return None

    def poll(self, time: int) -> Frame | None:
        """Return the frame to send by event or event timer at `time` (µs)."""
        waited = time - self._sent_at
        if waited < self._inhibit:
            return None
        data = self._content()
        if self._timer and waited >= self._timer:
            late = waited - self._timer
            return self._frame(data, time - late if late < self._timer else time)
        return self._frame(data, time) if self._changed(data) else None

    def request(self, time: int) -> Frame:
        """Answer a remote frame (RTR)."""
        sampled = self.kind == RTR_SYNC and self._sampled
        return self._frame(self._sampled if sampled else self._content(), time)


class Transmitter:
    """The TPDOs of a drive; `send` takes frames."""

    routes: list[Route]  # of remote frames

    def __init__(self, drive: Drive, send: Callable[[Frame], None]):
        self._drive = drive
        self._send = send
        self._tpdos: dict[int, _Transmit] = {}

    def configure(self) -> None:
        """Read 1800h… and 1A00h…."""
        tpdos, before = self._drive.tpdos, self._tpdos
        self._tpdos, self.routes = {}, []
        numbers = np.flatnonzero((tpdos["valid"] == 1) & (tpdos["width"] > 0))
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

    @property
    def has_events(self) -> bool:
        """Whether a TPDO is sent without SYNC or request."""
        return bool(self._by_event)

    def start(self) -> None:
        """Restart all TPDOs on entering OPERATIONAL."""
        for tpdo in self._tpdos.values():
            tpdo.start()

    def sync(self, counter: int, time: int) -> list[Frame]:
        """Return the TPDOs for a SYNC at `time` (µs), to be sent within the synchronous window."""
        return [f for tpdo in self._at_sync if (f := tpdo.sync(counter, time))]

    def poll(self, time: int) -> None:
        """Send the TPDOs that are due by event or event timer at `time` (µs)."""
        for tpdo in self._by_event:
            frame = tpdo.poll(time)
            if frame:
                self._send(frame)

    def _request(self, tpdo: _Transmit, data: bytes, time: int) -> None:
        self._send(tpdo.request(time))
