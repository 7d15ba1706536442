"""PDOs on the bus: transmission types, SYNC, events, inhibit and event timers (CiA 301, PDO).

RPDO: 0-240 at the next SYNC, 254 and 255 at once. TPDO: 0 at the SYNC after a change, 1-240 every
n-th SYNC, 252 sampled at SYNC and sent on request, 253 on request, 254 and 255 on a change of the
data and by the event timer, never faster than the inhibit time.
"""

import numpy as np

from .. import process_data
from ..drive import Drive
from ..jit import entry
from .frame import Frame

SYNCHRONOUS = range(241)
RTR_SYNC, RTR, EVENT = 252, 253, (254, 255)


@entry
def _latch(all_bytes, index, pdos, number, image):
    process_data.latch_one(all_bytes[index], pdos[number], image, 0)


@entry
def _collect(all_bytes, index, pdos, number, image):
    process_data.collect_one(all_bytes[index], pdos[number], image, 0)


class Receiver:
    """The RPDOs of a drive."""

    def __init__(self, drive: Drive):
        self._drive = drive
        self._waiting: dict[int, np.ndarray] = {}  # for the next SYNC

    def receive(self, frame: Frame) -> bool:
        """Take a frame if it is a valid RPDO of the drive; too short ones are not used."""
        rpdos = self._drive.rpdos
        found = False
        for number in np.flatnonzero((rpdos["valid"] == 1) & (rpdos["cob_id"] & 0x7FF == frame.id)):
            found = True
            pdo = rpdos[number]
            if len(frame.data) < pdo.width:
                continue
            image = np.frombuffer(frame.data, np.uint8)
            if pdo.transmission_type in SYNCHRONOUS:
                self._waiting[int(number)] = image
            else:
                self._take(int(number), image, synchronous=False)
        return found

    def _take(self, number: int, image: np.ndarray, synchronous: bool) -> None:
        drive = self._drive
        _latch(drive.memory, drive.index, drive.rpdos, number, image)
        drive.axis.parameters_changed = 1
        drive.axis.sync = synchronous

    def sync(self) -> None:
        """Latch what waited for the SYNC."""
        for number, image in sorted(self._waiting.items()):
            self._take(number, image, synchronous=True)
        self._waiting.clear()

    def forget(self) -> None:
        """Drop what waits; after leaving OPERATIONAL."""
        self._waiting.clear()


class Transmitter:
    """One TPDO of a drive."""

    def __init__(self, drive: Drive, number: int):
        self._drive = drive
        self._number = number
        self.start()

    def start(self) -> None:
        """Begin anew, as on entering OPERATIONAL: event-driven PDOs are sent once."""
        self._last: bytes | None = None
        self._sampled = b""
        self._sent_at = -(1 << 62)
        self._syncs = 0

    def _content(self) -> bytes:
        pdo = self._drive.tpdos[self._number]
        image = np.empty(pdo.width, np.uint8)
        _collect(self._drive.memory, self._drive.index, self._drive.tpdos, self._number, image)
        return image.tobytes()

    def _frame(self, data: bytes, time: int) -> Frame:
        self._last, self._sent_at = data, time
        return Frame(int(self._drive.tpdos[self._number].cob_id) & 0x7FF, data)

    def sync(self, counter: int, time: int) -> Frame | None:
        """What this PDO sends at a SYNC; `counter` is 0 where SYNC has none."""
        pdo = self._drive.tpdos[self._number]
        kind = int(pdo.transmission_type)
        if not pdo.valid:
            return None
        if kind == RTR_SYNC:
            self._sampled = self._content()
        elif kind == 0:
            data = self._content()
            if data != self._last:
                return self._frame(data, time)
        elif kind in SYNCHRONOUS:
            if counter and pdo.sync_start and self._syncs == 0 and counter != pdo.sync_start:
                return None
            self._syncs += 1
            if (self._syncs - 1) % kind == (0 if counter and pdo.sync_start else kind - 1):
                return self._frame(self._content(), time)
        return None

    def poll(self, time: int) -> Frame | None:
        """What this PDO sends by event or event timer at `time` (µs)."""
        pdo = self._drive.tpdos[self._number]
        if not pdo.valid or pdo.transmission_type not in EVENT:
            return None
        waited = time - self._sent_at
        if waited < int(pdo.inhibit_time) * 100:
            return None
        data = self._content()
        due = pdo.event_timer and waited >= int(pdo.event_timer) * 1000
        return self._frame(data, time) if data != self._last or due else None

    def request(self, frame: Frame, time: int) -> Frame | None:
        """Answer to a remote frame (RTR), where the identifier allows it (bit 30 clear)."""
        pdo = self._drive.tpdos[self._number]
        cob_id = int(pdo.cob_id)
        if not pdo.valid or cob_id & 0x7FF != frame.id or cob_id & 0x4000_0000:
            return None
        sampled = pdo.transmission_type == RTR_SYNC and self._sampled
        return self._frame(self._sampled if sampled else self._content(), time)
