"""PDOs of an imported CANopen drive, from the communication objects 1400h to 1BFFh of its sheet."""

from collections.abc import Iterable
from dataclasses import replace

from ..canopen.sheet import Entry, number
from ..kernel.process_data import DUMMY_BITS, ENTRIES, MAX_BITS, MAX_PDOS
from ..kernel.record import VENDOR_BYTES
from ..model.made import PdoRow
from ..model.pdo import mapping_entry
from ..model.rows import FORMATS, SIZES
from .rows import SOURCE, ObjectRows

Mapped = tuple[int, int, int]  # index, sub-index, bits
_OFF = 0x8000_0000  # bit of an identifier: the PDO is not valid
_PREDEFINED = {"rx": (0x200, 0x300, 0x400, 0x500), "tx": (0x180, 0x280, 0x380, 0x480)}
_MAPPING = 0x200  # from the communication parameters of a PDO to its mapping
_CONFIGURABLE = 8  # entries of a mapping that the file leaves out


def default_pdos(objects: ObjectRows) -> list[PdoRow]:
    """The PDOs that the drive has at power-on; the rows of the mappings then hold the same."""
    parameters = [index for index, _ in objects.rows if 0x1400 <= index < 0x1C00]
    if not parameters:
        return [*_predefined(objects)]
    rows: list[PdoRow] = []
    for direction, first in (("rx", 0x1400), ("tx", 0x1800)):
        found = [index & 0x1FF for index in parameters if index & 0xFC00 == first & 0xFC00]
        numbers = [n for n in found if n < MAX_PDOS]
        for n in range(max(numbers, default=-1) + 1):
            _add_mapping(objects, direction, first + n)
            rows += _pdo(objects, direction, first + n, n)
    return rows


def _predefined(objects: ObjectRows) -> Iterable[PdoRow]:
    """The predefined connection set, for a sheet with CompactPDO or without PDOs."""
    for direction, key in (("rx", "NrOfRXPDO"), ("tx", "NrOfTXPDO")):
        try:
            count = number(objects.sheet.text("DeviceInfo", key) or "0")[0]
        except ValueError:
            count = 0
        for n, identifier in enumerate(_PREDEFINED[direction][:count], 1):
            yield PdoRow(direction, n, f"0x{identifier:X}+node_id", 255, note="empty",
                         section="inferred")


def _add_mapping(objects: ObjectRows, direction: str, index: int) -> None:
    """Give a PDO whose mapping is missing in the file an empty one that can be configured."""
    mapping = index + _MAPPING
    if (index, 1) not in objects.rows or (mapping, 0) in objects.rows:
        return
    objects.sheet.tell(0, f"{mapping:04X}h", f"missing, while {index:04X}h is there", "empty",
                       "a master reads both objects of a PDO")
    for subindex in range(_CONFIGURABLE + 1):
        objects.take(Entry(mapping, subindex, f"{direction} mapping", "RECORD",
                           0x07 if subindex else 0x05, "rw", False, "0", "", "", 0))


def _pdo(objects: ObjectRows, direction: str, index: int, n: int) -> list[PdoRow]:
    """The rows of the PDO number `n` (from 0 on), whose communication parameters are `index`."""

    def value(subindex: int, otherwise: int) -> int:
        found = objects.default(index, subindex)
        return otherwise if found is None else found

    mapping = index + _MAPPING
    count = objects.default(mapping, 0) or 0
    words = [objects.default(mapping, s) or 0 for s in range(1, min(count, ENTRIES) + 1)]
    entries = _mapped(objects, direction, mapping, [word for word in words if word])
    pdo = PdoRow(direction, n + 1, _identifier(objects, direction, index, n),
                 value(2, 255), value(3, 0), section=SOURCE)
    given = {0: len(entries)} | {
        s: i << 16 | sub << 8 | bits for s, (i, sub, bits) in enumerate(entries, 1)
    }
    for subindex in range(ENTRIES + 1):
        row = objects.rows.get((mapping, subindex))
        if row is not None:
            objects.set_default(row, given.get(subindex, 0))
    return [
        replace(pdo, position=position, index=f"0x{i:04X}", subindex=f"0x{sub:02X}", bits=bits)
        for position, (i, sub, bits) in enumerate(entries, 1)
    ] or [replace(pdo, note="empty")]


def _identifier(objects: ObjectRows, direction: str, index: int, n: int) -> str:
    """The identifier of a PDO; that of a DCF is written such that it follows the node-id."""
    row = objects.rows.get((index, 1))
    base, plus, _ = (row["default"] if row else str(_OFF)).partition("+")
    cob_id, node_id = int(base, 0) & 0xFFFF_FFFF, objects.sheet.node_id
    own = _PREDEFINED[direction][n] if n < 4 else 0
    if not plus and node_id is not None and own and cob_id & 0x7FF == own + node_id:
        cob_id, plus = cob_id - node_id, "+"
    if row is not None:
        row["default"] = f"{cob_id:#x}+node_id" if plus else str(cob_id)
    return f"0x{cob_id:08X}{'+node_id' if plus else ''}"


def _mapped(objects: ObjectRows, direction: str, index: int, words: list[int]) -> list[Mapped]:
    """The mapped objects that exist, each with the length of its type."""
    entries: list[Mapped] = []
    total = 0
    for n, word in enumerate(words, 1):
        target, subindex, bits = mapping_entry(word)
        where = f"{index:04X}h:{n:02X}h"
        row = objects.rows.get((target, subindex))
        written = objects.sheet.entries.get((index, n))
        at = written.line if written else 0
        if direction == "rx" and DUMMY_BITS.get(target) == bits and subindex == 0:
            own = bits
        elif row is None or not objects.is_process_data((target, subindex)):
            objects.sheet.tell(at, where, f"{word:08X}h", "left out", "no such object is mappable")
            continue
        else:
            own = 8 * SIZES[FORMATS[row["data_type"]]]
            if direction not in row["pdo"]:
                objects.sheet.tell(at, where, f"{word:08X}h, of an object that is not mappable",
                                   "mappable", "it is mapped")
                row["pdo"] = "rxtx" if row["pdo"] else direction
        if own != bits:
            objects.sheet.tell(at, where, f"{bits} bits", f"{own} bits", "the object has them")
        if total + own > MAX_BITS:
            objects.sheet.tell(at, where, f"{word:08X}h", "left out", f"beyond {MAX_BITS} bits")
            continue
        total += own
        entries.append((target, subindex, own))
    return entries


def limit_mappable(objects: ObjectRows, pdos: Iterable[PdoRow]) -> None:
    """Make objects unmappable if the record has no room; those of the default PDOs come first."""
    used = {(int(row.index, 0), int(row.subindex, 0)) for row in pdos if row.index}
    room, lost = VENDOR_BYTES, 0
    for address in sorted(objects.rows, key=lambda address: (address not in used, address)):
        row = objects.rows[address]
        if not row["pdo"] or row["field"] or not objects.is_process_data(address):
            continue
        size = 2 * SIZES[FORMATS[row["data_type"]]]  # its alignment can take as much again
        if size > room:
            row["pdo"] = ""
            lost += 1
        else:
            room -= size
    if lost:
        why = f"PDOs reach {VENDOR_BYTES} bytes of manufacturer-specific objects"
        objects.sheet.tell(0, "PDOs", f"{lost} more objects can be mapped", "they cannot", why)
