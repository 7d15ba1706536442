"""Object dictionary: SDO access to the memory of one drive, with the abort codes of CiA 301.

Order of the checks: object, sub-index, access, length, range, device state, side effects. A refused
write changes nothing. What a write does beside storing its bytes is a row of `HOOKS`.
"""

import functools
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

from .abort import Abort, SdoAbort
from .communication import PDO_COB_ID, RULES, sdo_server
from .hooks import WHEN
from .process_data import DUMMY, DUMMY_BITS, ENTRIES, INVALID, MAX_BITS, parameter_place
from .rows import Object
from .slots import Names, Slot, Slots

if TYPE_CHECKING:
    from .drive import Drive
    from .model import DriveModel

RECEIVE = ((0x1400, 0x1600), "rpdo", "rx")
LAST_PDO_OBJECT = 0x1BFF
TRANSMIT = ((0x1800, 0x1A00), "tpdo", "tx")
NO_RTR = 0x4000_0000  # bit 30 of a PDO's identifier
SYNC_ID = 0x080  # no PDO has it (inferred): each frame would be a SYNC


def pdo_objects(n_rpdo: int, n_tpdo: int) -> list[Object]:
    """Rows 1400h…, 1600h…, 1800h…, 1A00h… of a drive with so many PDOs (CiA 301)."""
    rows = []
    for (communication, mapping), area, direction in (RECEIVE, TRANSMIT):
        parameters = [
            (1, "cob_id", "UNSIGNED32"),
            (2, "transmission_type", "UNSIGNED8"),
            (3, "inhibit_time", "UNSIGNED16"),
            (5, "event_timer", "UNSIGNED16"),
        ]
        if direction == "tx":
            parameters.append((6, "sync_start_value", "UNSIGNED8"))
        maps = [(0, "number_of_mapped_objects", "UNSIGNED8")]
        maps += [(n, f"mapping_{n}", "UNSIGNED32") for n in range(1, ENTRIES + 1)]
        for i in range(n_rpdo if direction == "rx" else n_tpdo):
            name = f"{area}{i + 1}"
            rows.append(_constant(communication + i, f"{name}_entries", parameters[-1][0]))
            for index, names in ((communication + i, parameters), (mapping + i, maps)):
                for subindex, label, data_type in names:
                    place = parameter_place(index, subindex)
                    assert place is not None
                    rows.append(_row(index, subindex, f"{name}_{label}", data_type, *place))
    return rows


def all_objects(model: "DriveModel") -> list[Object]:
    """The objects of a model; it lists those of its PDOs itself, or has the standard ones."""
    rows = [*model.objects.values()]
    if not any(RECEIVE[0][0] <= row.index <= LAST_PDO_OBJECT for row in rows):
        rows += pdo_objects(len(model.rpdos), len(model.tpdos))
    return rows


def _row(index, subindex, name, data_type, area, offset, access="rw", default=0) -> Object:
    bits = int(data_type.removeprefix("UNSIGNED"))
    return Object(
        index, subindex, name, "RECORD", data_type, access, "", "", 0.0, float(2**bits - 1), None,
        default, access == "rw", "CiA 301", "", area, offset,
    )  # fmt: skip


def _constant(index, name, value) -> Object:
    return _row(index, 0, name, "UNSIGNED8", "constant", 0, "const", value)


@functools.cache
def patterns(model: "DriveModel") -> tuple[dict[tuple[int, int], Slot], dict[str, tuple[int, int]]]:
    """The objects of a model by address, which all its drives share, and addresses by name."""
    rows = all_objects(model)
    slots = {
        (row.index, row.subindex): Slot(
            row, None, RULES.get(row.index) or RULES_OF_RANGES.get(row.index & 0xFE00)
        )
        for row in rows
    }
    return slots, {row.name: (row.index, row.subindex) for row in rows}


@functools.cache
def indices(model: "DriveModel") -> frozenset[int]:
    """The indices of a model's objects."""
    return frozenset(index for index, _ in patterns(model)[0])


class ObjectDictionary:
    """The objects of one drive. `read` and `write` speak bytes and abort codes, never raise."""

    def __init__(self, drive: "Drive", views: Mapping[str, memoryview | None]):
        self.drive = drive
        shared, names = patterns(drive.model)
        self.slots = Slots(shared, views)
        self.names = Names(names, self.slots)
        self.results: dict[int, bytes] = {}  # of a parameter channel, by sub-index
        self._changed = drive.axes["parameters_changed"][drive.index : drive.index + 1]

    def find(self, index: int, subindex: int) -> tuple[Slot | None, Abort]:
        """The slot of an object, or why there is none."""
        slot = self.slots.get((index, subindex))
        if slot is not None:
            return slot, Abort.NONE
        known = index in indices(self.drive.model)
        return None, Abort.NO_SUBINDEX if known else Abort.NO_OBJECT

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
        if slot.raw:
            return slot.raw(self, slot.row, None)
        value = self.shown(slot)
        if isinstance(value, Abort):
            return b"", value
        return value.encode() if isinstance(value, str) else slot.code.pack(value), Abort.NONE

    def shown(self, slot: Slot) -> int | float | str | Abort:
        """Value of an object as a master reads it, or why it cannot."""
        return slot.reads(self, slot.row) if slot.reads else slot.get()

    def write(self, index: int, subindex: int, data: bytes) -> Abort:
        """SDO download: store the bytes, or return the abort code and change nothing."""
        slot = self.slots.get((index, subindex))
        if slot is None:
            return self.find(index, subindex)[1]
        if not slot.writable:
            return Abort.READ_ONLY
        if slot.raw:
            return slot.raw(self, slot.row, data)[1]
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
        if row.when and not WHEN[row.when](self.drive):
            return Abort.DEVICE_STATE
        abort = slot.hook(self, row, int(value)) if slot.hook else Abort.NONE
        if abort is Abort.STORED:
            return Abort.NONE
        if abort is Abort.NONE:
            slot.put(value)
            self._changed[0] = 1
            if row.index < 0x2018:  # with the transmit masks of some models
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


WriteHook = Callable[[ObjectDictionary, Object, int], Abort]


def _pdo(od: ObjectDictionary, row: Object):
    receive = row.index < 0x1800
    pdos = od.drive.rpdos if receive else od.drive.tpdos
    return pdos[row.index & 0x1FF], receive


def _communication(od: ObjectDictionary, row: Object, value: int) -> Abort:
    """1400h…/1800h…: the identifier may change only while the PDO is not valid."""
    pdo, receive = _pdo(od, row)
    model = od.drive.model
    if model.quirk("pdo_needs_stop") and (od.drive.operational or (row.subindex > 1 and pdo.valid)):
        return Abort.DEVICE_STATE
    if row.subindex == 1:
        old, valid = int(pdo.cob_id), not value & INVALID
        abort = PDO_COB_ID.check(old, value)
        if abort or (valid and value & 0x7FF == SYNC_ID):
            return abort or Abort.INVALID_VALUE
        if model.quirk("identifier_needs_valid_bit"):
            if valid and (value ^ old) & 0x7FF:
                return Abort.DEVICE_STATE  # another identifier only together with bit 31
            value |= NO_RTR
            pdo.cob_id = value
        pdo.valid = valid and (pdo.count > 0 or not model.quirk("pdo_needs_stop"))
        od.drive.image_changed()
        if model.quirk("identifier_needs_valid_bit"):
            return Abort.STORED
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
    if pdo.valid or (od.drive.operational and od.drive.model.quirk("pdo_needs_stop")):
        return Abort.DEVICE_STATE
    if row.subindex == 0:
        return _compile(od, pdo, receive, value)
    if pdo.count:
        return Abort.DEVICE_STATE
    return _target(od, receive, value)[1] if value else Abort.NONE


def _target(
    od: ObjectDictionary, receive: bool, mapping: int, exact: bool = True
) -> tuple[int, Abort]:
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
    if exact and bits != slot.row.size * 8:
        return DUMMY, Abort.NOT_MAPPABLE
    return slot.offset, Abort.NONE


def _compile(od: ObjectDictionary, pdo, receive: bool, count: int, fixed: bool = False) -> Abort:
    if count > ENTRIES:
        return Abort.PDO_LENGTH
    offsets, lengths = [], []
    for mapping in pdo.mapping[:count].tolist():
        offset, abort = _target(od, receive, mapping, exact=not fixed)
        if abort:
            return abort
        offsets.append(offset)
        lengths.append((mapping & 0xFF) // 8)
    if sum(lengths) * 8 > MAX_BITS and not fixed:
        return Abort.PDO_LENGTH
    pdo.offset[:count] = offsets
    pdo.length[:count] = lengths
    pdo.width = sum(lengths)
    od.drive.image_changed()
    return Abort.NONE


RULES_OF_RANGES: dict[int, WriteHook] = {  # by index & FE00h
    0x1200: sdo_server,
    0x1400: _communication,
    0x1600: _mapping,
    0x1800: _communication,
    0x1A00: _mapping,
}


def compile_default(od: ObjectDictionary, pdo, receive: bool) -> None:
    """Compile a mapping that the model or a parameter file brought."""
    abort = _compile(od, pdo, receive, int(pdo.count), fixed=True)
    pdo.valid = abort is Abort.NONE and not int(pdo.cob_id) & INVALID
