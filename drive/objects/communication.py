"""Rules of the communication objects 1000h-127Fh: what a master may write (CiA 301).

The identifier of a service may change only while the service is not in use; identifiers of 29 bits
and those that CiA 301 restricts are refused. The rules of PDOs are in `mapping`.
"""

from collections.abc import Callable
from typing import NamedTuple

from ..model.rows import Object
from .abort import Abort
from .device import Dictionary

BIT_31, BIT_30 = 0x8000_0000, 0x4000_0000
UNUSABLE = 0x3FFF_F800  # bit 29 for an identifier of 29 bits, and its upper bits
RESTRICTED = (  # CiA 301, restricted CAN-IDs
    (0x000, 0x07F), (0x101, 0x180), (0x581, 0x5FF), (0x601, 0x67F), (0x6E0, 0x6FF),
    (0x701, 0x77F), (0x780, 0x7FF),
)


class CobId(NamedTuple):
    """The COB-ID of a service: it is in use if ``value & bit == used``."""

    bit: int
    used: int
    refused: int = 0  # bits of features that the drive does not support
    always: bool = False  # the identifier counts independently of `bit`

    def check(self, old: int, new: int) -> Abort:
        """Whether `new` may replace `old`."""
        in_use = new & self.bit == self.used
        if new & (UNUSABLE | self.refused):
            return Abort.INVALID_VALUE
        if in_use and old & self.bit == self.used and (old ^ new) & 0x3FFF_FFFF:
            return Abort.DEVICE_STATE
        if (in_use or self.always) and restricted(new & 0x7FF):
            return Abort.INVALID_VALUE
        return Abort.NONE


_SYNC = CobId(BIT_30, BIT_30, always=True)  # bit 30: the drive produces SYNC
_TIME = CobId(BIT_31, BIT_31, refused=BIT_30, always=True)  # the drive consumes TIME only
_EMCY = CobId(BIT_31, 0, refused=BIT_30)
_SDO = CobId(BIT_31, 0, refused=BIT_30)  # bit 30: dynamically allocated
PDO_COB_ID = CobId(BIT_31, 0)


def restricted(identifier: int) -> bool:
    """Whether CiA 301 keeps the identifier for services that cannot be moved."""
    return any(low <= identifier <= high for low, high in RESTRICTED)


def _cob_id(rule: CobId):
    def hook(od: Dictionary, row: Object, value: int) -> Abort:
        return rule.check(int(od.slots[row.index, row.subindex].get()), value)

    return hook


def sdo_server(od: Dictionary, row: Object, value: int) -> Abort:
    """1201h…: sub 1 and 2 are identifiers, sub 3 is the client's node-id."""
    if row.subindex == 3:
        return Abort.NONE if 1 <= value <= 127 else Abort.INVALID_VALUE
    return _SDO.check(int(od.slots[row.index, row.subindex].get()), value)


def _sync_counter(od: Dictionary, row: Object, value: int) -> Abort:
    """1019h: 0 or 2..240, and only while the communication cycle period 1006h is 0."""
    if value == 1 or value > 240:
        return Abort.INVALID_VALUE
    period = od.slots.get((0x1006, 0))
    return Abort.DEVICE_STATE if period and period.get() else Abort.NONE


def _consumer_heartbeat(od: Dictionary, row: Object, value: int) -> Abort:
    """1016h: a node-id may be monitored by one entry only."""
    node, time = value >> 16, value & 0xFFFF
    if node > 0xFF:
        return Abort.INVALID_VALUE  # reserved bits (inferred)
    for (index, subindex), slot in od.slots.items():
        if index == 0x1016 and subindex not in (0, row.subindex) and 1 <= node <= 127 and time:
            other = int(slot.get())
            if other >> 16 == node and other & 0xFFFF:
                return Abort.PARAMETER_INCOMPATIBLE
    return Abort.NONE


def _standard_error_field(od: Dictionary, row: Object) -> int | Abort:
    """1003h: there is no data in a field beyond the number of errors (CiA 301)."""
    known = row.subindex <= int(od.slots[row.index, 0].get())
    if not known and not od.drive.model.quirk("empty_history_reads_0"):
        return Abort.NO_DATA
    return int(od.slots[row.index, row.subindex].get())


READ_RULES: dict[tuple[int, int], Callable[[Dictionary, Object], int | Abort]] = {
    (0x1003, n): _standard_error_field for n in range(1, 255)
}
RULES: dict[int, Callable[[Dictionary, Object, int], Abort]] = {
    0x1005: _cob_id(_SYNC),
    0x1012: _cob_id(_TIME),
    0x1014: _cob_id(_EMCY),
    0x1016: _consumer_heartbeat,
    0x1019: _sync_counter,
}
