"""The objects 1400h-1BFFh: what a PDO carries and when, and the order in which it may change.

CiA 301, 7.5.2.35-38: not valid first, then the number of entries 0, the entries, their number.
"""

import dataclasses
from collections.abc import Callable

import numpy as np

from ..kernel.process_data import (
    DUMMY,
    DUMMY_BITS,
    ENTRIES,
    INVALID,
    MAX_BITS,
    PDO,
    parameter_place,
)
from ..kernel.record import OD
from ..model.model import DriveModel
from ..model.pdo import Mapping, mapping_entry
from ..model.rows import Object
from .abort import Abort
from .communication import PDO_COB_ID, sdo_server
from .device import Dictionary
from .hooks.ethercat import mappable

RECEIVE = ((0x1400, 0x1600), "rpdo", "rx")
LAST_PDO_OBJECT = 0x1BFF
TRANSMIT = ((0x1800, 0x1A00), "tpdo", "tx")
NO_RTR = 0x4000_0000  # bit 30 of a PDO's identifier
MAX_ENTRIES = 0x40  # CiA 301: more are reserved, or multiplexed PDOs
VENDOR = OD.fields["vendor"][1]  # type: ignore[index]
LARGEST = (1 << 63) - 1
ANYTHING = -LARGEST - 1, LARGEST
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
        for i in range(n_rpdo if direction == "rx" else n_tpdo):
            name = f"{area}{i + 1}"
            rows.append(_constant(communication + i, f"{name}_entries", parameters[-1][0]))
            for index, names in ((communication + i, parameters), (mapping + i, MAPPING)):
                rows += _placed(index, index, name, names)
    return rows


MAPPING = [
    (0, "number_of_mapped_objects", "UNSIGNED8"),
    *((n, f"mapping_{n}", "UNSIGNED32") for n in range(1, ENTRIES + 1)),
]  # sub-index, name, data type


def _placed(index: int, of: int, name: str, names: list[tuple[int, str, str]]) -> list[Object]:
    """Rows of a PDO parameter object, stored in the record of the PDO with index `of` on CAN."""
    rows = []
    for subindex, label, data_type in names:
        place = parameter_place(of, subindex)
        assert place is not None
        rows.append(_row(index, subindex, f"{name}_{label}", data_type, *place))
    return rows


def ethercat_pdo_objects(model: DriveModel) -> list[Object]:
    """Rows of the PDOs of an EtherCAT model: flexible ones can be mapped, fixed ones are constant.

    A PDO has no communication parameters there, and `cob_id` is its index.
    """
    rows = []
    for ((_, first), area, _), pdos, flexible in zip(
        (RECEIVE, TRANSMIT), (model.rpdos, model.tpdos), mappable(model), strict=True
    ):
        for i, pdo in enumerate(pdos):
            index = int(pdo.cob_id, 0)
            if i < flexible:
                rows += _placed(index, first + i, f"{area}{i + 1}", MAPPING)
                continue
            name = f"{area}_{index:04X}h"
            rows.append(_constant(index, f"{name}_{MAPPING[0][1]}", len(pdo.entries)))
            for n, (target, subindex, bits) in enumerate(pdo.entries, 1):
                value = target << 16 | subindex << 8 | bits
                label, data_type = MAPPING[n][1:]
                rows.append(
                    _row(index, n, f"{name}_{label}", data_type, "constant", 0, "const", value)
                )
    return rows


def all_objects(model: DriveModel) -> list[Object]:
    """The objects of a model, with those of its PDOs, which it lists or which are standard."""
    rows = [*model.objects.values()]
    if model.ethercat is not None:
        own = {row.index for row in rows}
        rows += [row for row in ethercat_pdo_objects(model) if row.index not in own]
    elif not any(RECEIVE[0][0] <= row.index <= LAST_PDO_OBJECT for row in rows):
        rows += pdo_objects(len(model.rpdos), len(model.tpdos))
    return rows


def described(model: DriveModel) -> list[Object]:
    """All objects of a model in order; those of its PDOs have the defaults of pdo.csv."""
    found = [_with_default(row, model) for row in all_objects(model)]
    return sorted(found, key=lambda row: (row.index, row.subindex))


def _with_default(row: Object, model: DriveModel) -> Object:
    """A row of a PDO with the default of `pdo.csv`."""
    if row.area not in ("rpdo", "tpdo"):
        return row
    pdo: Mapping = (model.rpdos if row.area == "rpdo" else model.tpdos)[_number(row)]
    if row.index & 0x200:  # 1600h, 1A00h: mapping
        entries = [i << 16 | s << 8 | bits for i, s, bits in pdo.entries]
        values = dict(enumerate([len(entries), *entries]))
        return dataclasses.replace(row, default=values.get(row.subindex, 0))
    base, _, node_id = pdo.cob_id.partition("+")
    values = {1: int(base, 0), 2: pdo.transmission_type, 3: pdo.inhibit_time}
    relative = row.subindex == 1 and bool(node_id)
    default = values.get(row.subindex, row.default)
    return dataclasses.replace(row, default=default, per_node=relative)


def _row(index, subindex, name, data_type, area, offset, access="rw", default=0) -> Object:
    bits = int(data_type.removeprefix("UNSIGNED"))
    return Object(
        index, subindex, name, "RECORD", data_type, access, "", "", 0.0, float(2**bits - 1), None,
        default, access == "rw", "CiA 301", "", area, offset,
    )


def _constant(index, name, value) -> Object:
    return _row(index, 0, name, "UNSIGNED8", "constant", 0, "const", value)


WriteHook = Callable[[Dictionary, Object, int], Abort]


def _number(row: Object) -> int:
    """Number of the PDO of a row, by its place in the records or by its index."""
    return row.offset // PDO.itemsize if row.area in ("rpdo", "tpdo") else row.index & 0x1FF


def _pdo(od: Dictionary, row: Object):
    receive = row.index < 0x1800
    pdos = od.drive.rpdos if receive else od.drive.tpdos
    return pdos[_number(row)], receive


def _communication(od: Dictionary, row: Object, value: int) -> Abort:
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


def _mapping(od: Dictionary, row: Object, value: int) -> Abort:
    """1600h…/1A00h…: PDO not valid, then sub 0 = 0, then the entries, then sub 0 = their number.

    CiA 301 gives 06040042h for a number of entries that is not possible, and no code for steps in
    another order: unsupported access (inferred).
    """
    pdo, receive = _pdo(od, row)
    ethercat, stop = od.drive.model.ethercat is not None, od.drive.model.quirk("pdo_needs_stop")
    if od.drive.operational and stop:
        return Abort.DEVICE_STATE
    if pdo.valid or (row.subindex and pdo.count):
        return Abort.DEVICE_STATE if ethercat or stop else Abort.UNSUPPORTED_ACCESS
    if row.subindex == 0:
        if value > MAX_ENTRIES and not ethercat:
            return Abort.INVALID_VALUE
        return _compile(od, pdo, receive, value)
    return _target(od, receive, value)[1] if value else Abort.NONE


def _own(row: Object) -> bool:
    """Whether an object lies in the model's own bytes, which no cycle limits."""
    return row.area == "axis" and row.offset >= VENDOR


def unfit_for_rpdo(row: Object) -> str:
    """Why process data cannot keep to the rules that SDO has for an object; empty if they can."""
    if "rx" not in row.pdo or not _own(row):
        return ""
    if row.when:
        return "does not know the state that `when` asks for"
    if row.allowed and len(row.allowed) != max(row.allowed) - min(row.allowed) + 1:
        return "checks a range, and not a set with gaps"
    if row.format == "Q" and row.minimum > 0 and row.maximum > LARGEST:
        return "checks no range that ends above 2^63"
    return ""


def _range(row: Object | None, bits: int) -> tuple[int, int]:
    """The least and the greatest value that process data may bring to an object, as SDO has them.

    Those of a real number are integers in its order, see `process_data.ordinal`.
    """
    if row is None or (not row.stored and not _own(row)):
        return ANYTHING
    if row.stored:  # a value that the record does not hold is not taken over
        own, other = np.iinfo(f"<{row.stored}"), np.iinfo(f"<{row.format}")
        return max(int(own.min), int(other.min)), min(int(own.max), int(other.max))
    values = row.allowed or (row.minimum, row.maximum)
    if row.real:
        if bits != 8 * row.size:
            return ANYTHING
        low, high = _ordinal(row, min(values)), _ordinal(row, max(values))
        return -1 if low == 0 else low, high  # -0.0 is 0.0
    info = np.iinfo("<" + row.format)
    low, high = max(int(min(values)), int(info.min)), min(int(max(values)), int(info.max))
    return ANYTHING if (low, high) == (info.min, info.max) else (low, min(high, LARGEST))


def _ordinal(row: Object, value: float) -> int:
    """A real number as `process_data.ordinal` has it."""
    number = int.from_bytes(row.code.pack(value), "little", signed=True)
    return number ^ (1 << 8 * row.size - 1) - 1 if number < 0 else number


def _held(row: Object, receive: bool) -> int:
    """Bytes of a value in the record, < 0 if it is extended by its sign."""
    signed = (row.format if receive else row.stored).islower()
    return -row.held.size if signed else row.held.size


def _target(od: Dictionary, receive: bool, mapping: int, exact: bool = True) -> tuple[int, Abort]:
    """Offset of a mapping entry's bytes in the record, or the abort code of its refusal."""
    index, subindex, bits = mapping_entry(mapping)
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


def _compile(od: Dictionary, pdo, receive: bool, count: int, fixed: bool = False) -> Abort:
    if count > ENTRIES:
        return Abort.PDO_LENGTH
    offsets, lengths, ranges, floating, held = [], [], [], [], []
    for mapping in pdo.mapping[:count].tolist():
        offset, abort = _target(od, receive, mapping, exact=not fixed)
        if abort:
            return abort
        offsets.append(offset)
        lengths.append((mapping & 0xFF) // 8)
        slot = od.slots.get(mapping_entry(mapping)[:2])
        row = slot.row if slot is not None and offset != DUMMY else None
        ranges.append(_range(row, mapping & 0xFF))
        floating.append(row is not None and row.real)
        held.append(_held(row, receive) if row is not None and row.stored else lengths[-1])
    if sum(lengths) * 8 > MAX_BITS and not fixed:
        return Abort.PDO_LENGTH
    pdo.offset[:count] = offsets
    pdo.length[:count], pdo.held[:count], pdo.floating[:count] = lengths, held, floating
    pdo.low[:count], pdo.high[:count] = zip(*ranges, strict=True) if ranges else ((), ())
    pdo.bounded = any(range_ != ANYTHING for range_ in ranges)
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


def compile_default(od: Dictionary, pdo, receive: bool) -> None:
    """Compile a mapping that comes from the model or a parameter file."""
    fixed = od.drive.model.ethercat is not None
    abort = _compile(od, pdo, receive, int(pdo.count), fixed=fixed)
    if abort:
        pdo.count = pdo.width = 0
    pdo.valid = abort is Abort.NONE and not int(pdo.cob_id) & INVALID
