"""RPDOs on the bus: transmission types, deadlines and lengths (CiA 301, PDO).

Data of types 0-240 take effect at the next SYNC, in some models type n at every n-th SYNC
(`rpdo_counts_syncs`: Metronix ARS 2000 5.3.1, Festo CMMP-AS 3.3.1); types 254 and 255 take effect
at once. The event timer is a deadline that starts with the first RPDO. The PDO records are read
when a communication object has changed, so finding the PDO of a frame takes the same time for 512
PDOs as for one.
"""

from functools import partial

import numpy as np

from ..drive import Drive
from ..kernel import process_data
from ..kernel.faults import Cause
from ..kernel.jit import entry
from ..kernel.words import Latched
from .emcy import Emergency, ErrorCode
from .frame import SYNCHRONOUS, Route
from .sync import Sync


@entry
def _latch(all_bytes, index, pdos, number, image):
    process_data.move(image, all_bytes[index], pdos[number], 0, True)


class _Receive:
    """One valid RPDO."""

    __slots__ = (
        "deadline", "errors", "every", "heard_at", "number", "synchronous", "syncs", "waiting",
        "width",
    )

    def __init__(self, number: int):
        self.number = number
        self.width = self.deadline = 0  # byte, µs
        self.every, self.syncs = 1, 0  # used at each `every`-th SYNC; SYNCs since the last one
        self.synchronous = False
        self.errors: set[ErrorCode] = set()  # reported and not cleared
        self.waiting: bytes | None = None  # for the next SYNC
        self.heard_at: int | None = None  # µs, while the deadline runs


class Receiver:
    """The RPDOs of a drive."""

    routes: list[Route]

    def __init__(self, drive: Drive, sync: Sync, emergency: Emergency):
        self._drive = drive
        self._sync = sync
        self._emergency = emergency
        self._counts = drive.model.quirk("rpdo_counts_syncs")
        own = slice(drive.index, drive.index + 1)
        self._changed = drive.axes["parameters_changed"][own]
        self._latched = drive.axes["sync"][own]
        self._timed_out = drive.axes["rpdo_timeout"][own]
        self._too_short = drive.axes["rpdo_too_short"][own]

    def reset(self) -> None:
        """Forget the RPDOs, as after a reset of the communication."""
        self._rpdos: dict[int, _Receive] = {}
        self._waiting: dict[int, _Receive] = {}
        self._timed_out[0] = self._too_short[0] = 0

    def configure(self) -> None:
        """Read 1400h… and 1600h…; a new deadline begins with the next RPDO."""
        rpdos, before = self._drive.rpdos, self._rpdos
        self._rpdos, self.routes = {}, []
        numbers = np.flatnonzero(rpdos["valid"])
        rows = rpdos[["cob_id", "transmission_type", "event_timer", "width"]][numbers].tolist()
        for number, (cob_id, kind, timer, width) in zip(numbers.tolist(), rows, strict=True):
            rpdo = before.pop(number) if number in before else _Receive(number)
            self._rpdos[number] = rpdo
            rpdo.width, rpdo.synchronous = width, kind in SYNCHRONOUS
            rpdo.every = max(kind, 1) if self._counts and rpdo.synchronous else 1
            if rpdo.deadline != timer * 1000:
                rpdo.deadline, rpdo.heard_at = timer * 1000, None
                self._clear(rpdo)
            self.routes.append((cob_id & 0x7FF, partial(self._receive, rpdo)))
        for rpdo in before.values():
            self._waiting.pop(rpdo.number, None)
            self._clear(rpdo)
        self._show_errors()
        self._monitored = [rpdo for rpdo in self._rpdos.values() if rpdo.deadline]

    @property
    def monitors(self) -> bool:
        """Whether an RPDO has a deadline."""
        return bool(self._monitored)

    def _receive(self, rpdo: _Receive, data: bytes, time: int) -> None:
        """Receive an RPDO; a short one is ignored, excess bytes of a long one are dropped."""
        if rpdo.deadline:
            rpdo.heard_at = time
        if len(data) != rpdo.width:
            if len(data) < rpdo.width:
                self._report(rpdo, ErrorCode.PDO_TOO_SHORT, Cause.RPDO_TOO_SHORT)
                return
            self._report(rpdo, ErrorCode.PDO_TOO_LONG)
        elif rpdo.errors:
            self._clear(rpdo)
            self._show_errors()
        if not rpdo.synchronous:
            self._take(rpdo, data)
            self._latched[0] = self._latched[0] or Latched.ALONE
        elif self._sync.open(time):
            rpdo.waiting = data
            self._waiting[rpdo.number] = rpdo

    def _report(self, rpdo: _Receive, code: ErrorCode, cause: Cause = Cause.NONE) -> None:
        rpdo.errors.add(code)
        self._show_errors()
        self._emergency.report(code, rpdo.number, cause)

    def _clear(self, rpdo: _Receive) -> None:
        for code in rpdo.errors:
            self._emergency.clear(code, rpdo.number)
        rpdo.errors.clear()

    def _show_errors(self) -> None:
        """Show the drive whether an RPDO is overdue or too short."""
        errors = {code for rpdo in self._rpdos.values() for code in rpdo.errors}
        self._timed_out[0] = ErrorCode.RPDO_TIMEOUT in errors
        self._too_short[0] = ErrorCode.PDO_TOO_SHORT in errors

    def _take(self, rpdo: _Receive, data: bytes) -> None:
        drive = self._drive
        image = np.frombuffer(data, np.uint8)
        _latch(drive.memory, drive.index, drive.rpdos, rpdo.number, image)
        self._changed[0] = 1

    def sync(self) -> None:
        """Latch the data that waited for this SYNC."""
        if self._counts:
            for rpdo in self._rpdos.values():
                rpdo.syncs = (rpdo.syncs + 1) % rpdo.every
        for number, rpdo in sorted(self._waiting.items()):
            if rpdo.syncs == 0:
                assert rpdo.waiting is not None
                self._take(rpdo, rpdo.waiting)
                self._latched[0] = Latched.CYCLIC
                del self._waiting[number]

    def poll(self, time: int) -> None:
        """Report deadlines that have expired at `time` (µs)."""
        for rpdo in self._monitored:
            if rpdo.heard_at is not None and time - rpdo.heard_at > rpdo.deadline:
                rpdo.heard_at = None
                self._report(rpdo, ErrorCode.RPDO_TIMEOUT, Cause.RPDO_TIMEOUT)

    def forget(self) -> None:
        """Drop waiting data and stop the deadlines, after leaving OPERATIONAL."""
        self._waiting.clear()
        for rpdo in self._rpdos.values():
            rpdo.syncs = 0
        for rpdo in self._monitored:
            rpdo.heard_at = None
