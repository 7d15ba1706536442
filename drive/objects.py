"""Object dictionary: SDO access to the memory of one drive, with the abort codes of CiA 301.

Order of the checks: object, sub-index, access, length, range, device state, side effects. A refused
write changes nothing. What a write does beside storing its bytes is a row of `HOOKS`.
"""

import math
import struct
from collections.abc import Callable
from fractions import Fraction
from typing import TYPE_CHECKING

from .abort import Abort, SdoAbort
from .communication import PDO_COB_ID, RULES, sdo_server
from .factors import FRACTION_LIMIT
from .model import Object
from .process_data import DUMMY, ENTRIES, INVALID, MAX_BITS, PDO

if TYPE_CHECKING:
    from .drive import Drive

DUMMY_BITS = {2: 8, 3: 16, 4: 32, 5: 8, 6: 16, 7: 32}  # CiA 301, dummy mapping
RECEIVE = ((0x1400, 0x1600), "rpdo", "rx")
TRANSMIT = ((0x1800, 0x1A00), "tpdo", "tx")
SYNC_ID = 0x080  # no PDO has it (inferred): each frame would be a SYNC
SAVE, LOAD = 0x65766173, 0x64616F6C  # "save", "load"


class Slot:
    """An object and where its bytes are."""

    __slots__ = ("code", "hook", "offset", "row", "view", "writable")

    def __init__(self, row: Object, view: memoryview | None, offset: int):
        self.row = row
        self.view = view
        self.offset = offset
        self.code = struct.Struct("<" + row.format)
        self.writable = row.access not in ("ro", "const")
        self.hook = HOOKS.get(row.index) or RANGE_HOOKS.get(row.index & 0xFE00)

    def get(self) -> int | float | str:
        """The value as it stands."""
        if self.view is None:
            return self.row.default
        return self.code.unpack_from(self.view, self.offset)[0]

    def put(self, value: int | float) -> None:
        """Store a checked value."""
        assert self.view is not None
        self.code.pack_into(self.view, self.offset, value)


def pdo_objects(n_rpdo: int, n_tpdo: int) -> list[Object]:
    """Rows 1400h…, 1600h…, 1800h…, 1A00h… of a drive with so many PDOs (CiA 301)."""
    rows = []
    for (communication, mapping), area, direction in (RECEIVE, TRANSMIT):
        parameters = [
            (1, "cob_id", "UNSIGNED32", "cob_id", 0),
            (2, "transmission_type", "UNSIGNED8", "transmission_type", 0),
            (3, "inhibit_time", "UNSIGNED16", "inhibit_time", 0),
            (5, "event_timer", "UNSIGNED16", "event_timer", 0),
        ]
        if direction == "tx":
            parameters.append((6, "sync_start_value", "UNSIGNED8", "sync_start", 0))
        maps = [(0, "number_of_mapped_objects", "UNSIGNED8", "count", 0)]
        maps += [
            (n + 1, f"mapping_{n + 1}", "UNSIGNED32", "mapping", 4 * n) for n in range(ENTRIES)
        ]
        for i in range(n_rpdo if direction == "rx" else n_tpdo):
            name, base = f"{area}{i + 1}", i * PDO.itemsize
            rows.append(_constant(communication + i, f"{name}_entries", parameters[-1][0]))
            for index, fields in ((communication + i, parameters), (mapping + i, maps)):
                for subindex, label, data_type, field, more in fields:
                    offset = base + PDO.fields[field][1] + more  # type: ignore[index]
                    rows.append(_row(index, subindex, f"{name}_{label}", data_type, area, offset))
    return rows


def _row(index, subindex, name, data_type, area, offset, access="rw", default=0) -> Object:
    bits = int(data_type.removeprefix("UNSIGNED"))
    return Object(
        index, subindex, name, "RECORD", data_type, access, "", "", 0.0, float(2**bits - 1), None,
        default, access == "rw", "CiA 301", "", area, offset, "",
    )  # fmt: skip


def _constant(index, name, value) -> Object:
    return _row(index, 0, name, "UNSIGNED8", "constant", 0, "const", value)


class ObjectDictionary:
    """The objects of one drive. `read` and `write` speak bytes and abort codes, never raise."""

    def __init__(self, drive: "Drive", views: dict[str, memoryview | None]):
        self.drive = drive
        rows = [*drive.model.objects.values()]
        rows += pdo_objects(len(drive.rpdos), len(drive.tpdos))
        self.slots = {
            (row.index, row.subindex): Slot(row, views[row.area], row.offset) for row in rows
        }
        self.names = {slot.row.name: slot for slot in self.slots.values()}
        self.indices = {index for index, _ in self.slots}
        self._changed = drive.axes["parameters_changed"][drive.index : drive.index + 1]

    def find(self, index: int, subindex: int) -> tuple[Slot | None, Abort]:
        """The slot of an object, or why there is none."""
        slot = self.slots.get((index, subindex))
        if slot is not None:
            return slot, Abort.NONE
        return None, Abort.NO_SUBINDEX if index in self.indices else Abort.NO_OBJECT

    def value(self, index: int, subindex: int = 0, default: int = 0) -> int:
        """Value of a communication object, `default` where the model does not have it."""
        slot = self.slots.get((index, subindex))
        return int(slot.get()) if slot else default

    def read(self, index: int, subindex: int) -> tuple[bytes, Abort]:
        """SDO upload: the object's bytes, or an abort code."""
        slot = self.slots.get((index, subindex))
        if slot is None:
            return b"", self.find(index, subindex)[1]
        if slot.row.access == "wo":
            return b"", Abort.WRITE_ONLY
        value = slot.get()
        return value.encode() if isinstance(value, str) else slot.code.pack(value), Abort.NONE

    def write(self, index: int, subindex: int, data: bytes) -> Abort:
        """SDO download: store the bytes, or return the abort code and change nothing."""
        slot = self.slots.get((index, subindex))
        if slot is None:
            return self.find(index, subindex)[1]
        if not slot.writable:
            return Abort.READ_ONLY
        size = slot.code.size  # 0: a string
        if size and len(data) != size:
            return Abort.LENGTH_TOO_HIGH if len(data) > size else Abort.LENGTH_TOO_LOW
        return self.store(slot, slot.code.unpack(data)[0])

    def store(self, slot: Slot, value: int | float) -> Abort:
        """Store a value of the right type after the checks of range, state and side effects."""
        row = slot.row
        if not slot.writable:
            return Abort.READ_ONLY
        if not value >= row.minimum:
            return Abort.VALUE_TOO_LOW
        if value > row.maximum:
            return Abort.VALUE_TOO_HIGH
        if row.allowed is not None and value not in row.allowed:
            return Abort.INVALID_VALUE
        if row.when == "disabled" and self.drive.energised:
            return Abort.DEVICE_STATE
        abort = slot.hook(self, row, int(value)) if slot.hook else Abort.NONE
        if abort is Abort.STORED:
            return Abort.NONE
        if abort is Abort.NONE:
            slot.put(value)
            self._changed[0] = 1
            if row.index < 0x2000:
                self.drive.communication_version += 1
        return abort

    def slot(self, index: int | str, subindex: int) -> Slot:
        """For Python: the slot of an address or name; raises SdoAbort with a hint."""
        if isinstance(index, str):
            slot = self.names.get(index)
            if slot is None:
                raise SdoAbort(Abort.NO_OBJECT, 0, 0, f"no object is called {index!r}")
            return slot
        slot, abort = self.find(index, subindex)
        if slot is None:
            raise SdoAbort(abort, index, subindex)
        return slot


Hook = Callable[[ObjectDictionary, Object, int], Abort]


def _clear_history(od: ObjectDictionary, row: Object, value: int) -> Abort:
    if value != 0:
        return Abort.INVALID_VALUE
    od.drive.axis.od.error_field[:] = 0
    return Abort.NONE


def _mode(od: ObjectDictionary, row: Object, value: int) -> Abort:
    return Abort.NONE if value == 0 or value in od.drive.model.modes else Abort.INVALID_VALUE


def _homing_method(od: ObjectDictionary, row: Object, value: int) -> Abort:
    return Abort.NONE if value in od.drive.model.homing_methods else Abort.INVALID_VALUE


def _factor(od: ObjectDictionary, row: Object, value: int) -> Abort:
    """608Fh, 6091h, 6092h: the exact fraction they make together has to stay computable."""
    fractions = []
    for index, upside_down in ((0x608F, True), (0x6091, True), (0x6092, False)):
        parts = []
        for subindex in (1, 2):
            here = (index, subindex) == (row.index, row.subindex)
            parts.append(value if here else int(od.slots[index, subindex].get()))
        fractions.append(Fraction(*(reversed(parts) if upside_down else parts)))
    product = math.prod(fractions)
    too_long = max(product.numerator, product.denominator) > FRACTION_LIMIT
    return Abort.INTERNAL_INCOMPATIBLE if too_long else Abort.NONE


def _save(od: ObjectDictionary, row: Object, value: int) -> Abort:
    if value != SAVE:
        return Abort.NOT_TRANSFERABLE
    return Abort.STORED if od.drive.store_parameters() else Abort.HARDWARE


def _load(od: ObjectDictionary, row: Object, value: int) -> Abort:
    if value != LOAD:
        return Abort.NOT_TRANSFERABLE
    return Abort.STORED if od.drive.forget_parameters() else Abort.HARDWARE


def _pdo(od: ObjectDictionary, row: Object):
    receive = row.index < 0x1800
    pdos = od.drive.rpdos if receive else od.drive.tpdos
    return pdos[row.index & 0x1FF], receive


def _communication(od: ObjectDictionary, row: Object, value: int) -> Abort:
    """1400h…/1800h…: the identifier may change only while the PDO is not valid."""
    pdo, receive = _pdo(od, row)
    if row.subindex == 1:
        abort = PDO_COB_ID.check(int(pdo.cob_id), value)
        valid = not value & INVALID
        if abort or (valid and value & 0x7FF == SYNC_ID):
            return abort or Abort.INVALID_VALUE
        pdo.valid = valid
        od.drive.image_changed()
    elif row.subindex == 2:
        only_transmit = value in (252, 253)
        if 241 <= value <= 251 or (receive and only_transmit):
            return Abort.INVALID_VALUE
    elif row.subindex in (3, 6) and pdo.valid:
        return Abort.DEVICE_STATE
    return Abort.NONE


def _mapping(od: ObjectDictionary, row: Object, value: int) -> Abort:
    """1600h…/1A00h…: PDO not valid, then sub 0 = 0, then the entries, then sub 0 = their number."""
    pdo, receive = _pdo(od, row)
    if pdo.valid:
        return Abort.DEVICE_STATE
    if row.subindex == 0:
        return _compile(od, pdo, receive, value)
    if pdo.count:
        return Abort.DEVICE_STATE
    return _target(od, receive, value)[1] if value else Abort.NONE


def _target(od: ObjectDictionary, receive: bool, mapping: int) -> tuple[int, Abort]:
    """Where a mapping entry's bytes lie in the record, or the abort code of the refusal."""
    index, subindex, bits = mapping >> 16, mapping >> 8 & 0xFF, mapping & 0xFF
    if index in DUMMY_BITS and subindex == 0:
        mappable = receive and bits == DUMMY_BITS[index]
        return DUMMY, Abort.NONE if mappable else Abort.NOT_MAPPABLE
    slot, abort = od.find(index, subindex)
    if slot is None:
        return DUMMY, abort
    if ("rx" if receive else "tx") not in slot.row.pdo:
        return DUMMY, Abort.NOT_MAPPABLE
    if bits != slot.row.size * 8:
        return DUMMY, Abort.NOT_MAPPABLE
    return slot.offset, Abort.NONE


def _compile(od: ObjectDictionary, pdo, receive: bool, count: int) -> Abort:
    if count > ENTRIES:
        return Abort.PDO_LENGTH
    offsets, lengths = [], []
    for mapping in pdo.mapping[:count].tolist():
        offset, abort = _target(od, receive, mapping)
        if abort:
            return abort
        offsets.append(offset)
        lengths.append((mapping & 0xFF) // 8)
    if sum(lengths) * 8 > MAX_BITS:
        return Abort.PDO_LENGTH
    pdo.offset[:count] = offsets
    pdo.length[:count] = lengths
    pdo.width = sum(lengths)
    od.drive.image_changed()
    return Abort.NONE


HOOKS: dict[int, Hook] = {
    **RULES,
    0x1003: _clear_history,
    0x1010: _save,
    0x1011: _load,
    0x6060: _mode,
    0x608F: _factor,
    0x6091: _factor,
    0x6092: _factor,
    0x6098: _homing_method,
}
RANGE_HOOKS: dict[int, Hook] = {  # by index & FE00h
    0x1200: sdo_server,
    **RULES,
    0x1400: _communication,
    0x1600: _mapping,
    0x1800: _communication,
    0x1A00: _mapping,
}


def compile_default(od: ObjectDictionary, pdo, receive: bool) -> None:
    """Compile a mapping that the model or a parameter file brought."""
    abort = _compile(od, pdo, receive, int(pdo.count))
    pdo.valid = abort is Abort.NONE and not int(pdo.cob_id) & INVALID
