"""The rows of a drive model's files: objects, PDOs and faults, read and checked.

A row that cannot be right is refused with file, line and reason, before a drive exists.
"""

import csv
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .faults import Cause, Reaction
from .hooks import HOOKS, WHEN
from .process_data import DUMMY_BITS, ENTRIES, MAX_BITS, parameter_place
from .record import OD, VENDOR_BYTES

# data type of CiA 301 -> struct format; strings have none
FORMATS = {
    "BOOLEAN": "B",
    "INTEGER8": "b",
    "INTEGER16": "h",
    "INTEGER32": "i",
    "INTEGER64": "q",
    "UNSIGNED8": "B",
    "UNSIGNED16": "H",
    "UNSIGNED32": "I",
    "UNSIGNED64": "Q",
    "REAL32": "f",
    "VISIBLE_STRING": "",
    "DOMAIN": "",
}
SIZES = {"B": 1, "b": 1, "H": 2, "h": 2, "I": 4, "i": 4, "Q": 8, "q": 8, "f": 4, "": 0}
ACCESS = ("ro", "wo", "rw", "const")
PDO_USE = ("", "rx", "tx", "rxtx")


@dataclass(frozen=True)
class Object:
    """One row of the object dictionary; its bytes lie `offset` into the `area` of the drive."""

    index: int
    subindex: int
    name: str
    object_type: str
    data_type: str
    access: str
    pdo: str
    unit: str
    minimum: float
    maximum: float
    allowed: frozenset[int] | None
    default: int | float | str
    storable: bool
    section: str
    note: str
    area: str  # "axis", "rpdo", "tpdo" or "constant": where the bytes are
    offset: int
    when: str = ""  # `hooks.WHEN`: state of the drive that a write needs
    hook: str = ""  # `hooks.HOOKS`: what reading or writing does beside moving bytes
    per_node: bool = False  # the node-id is added to the default

    @property
    def format(self) -> str:
        """Format of the value for `struct`, empty for strings."""
        return FORMATS[self.data_type]

    @property
    def size(self) -> int:
        """Bytes of the value, 0 for strings."""
        return SIZES[self.format]


@dataclass(frozen=True)
class Mapping:
    """A PDO of pdo.csv: default communication parameters and mapped objects."""

    number: int
    cob_id: str
    transmission_type: int
    inhibit_time: int
    entries: tuple[tuple[int, int, int], ...]  # index, subindex, bits


@dataclass(frozen=True)
class Fault:
    """A row of faults.csv."""

    code: int
    main: int | None  # number the manufacturer gives the fault, with `sub`
    sub: int | None
    meaning: str
    register: int
    cause: Cause  # NONE: comes only by injection
    reaction: Reaction
    changeable: bool
    section: str

    @property
    def name(self) -> str:
        """As the manufacturer's lists and displays call it, ``17-0``."""
        return "" if self.main is None else f"{self.main:02d}-{self.sub or 0}"


def _rows(path: Path) -> Iterator[tuple[dict[str, str], str]]:
    """Rows of a CSV file, each with the words "file, line n" for error messages."""
    with path.open(newline="", encoding="utf-8") as file:
        reader = csv.DictReader(file)
        for row in reader:
            where = f"{path.name}, line {reader.line_num} ({path.parent.name})"
            if None in row or None in row.values():
                raise ValueError(f"{where}: {len(reader.fieldnames or ())} columns expected")
            yield {key: value.strip() for key, value in row.items()}, where


def _integer(text: str, where: str, what: str) -> int:
    try:
        return int(text, 0)
    except ValueError:
        raise ValueError(f"{where}: {what} = {text!r} is not an integer") from None


def read_objects(path: Path) -> dict[tuple[int, int], Object]:
    """The objects by index and sub-index. Raises ValueError with file, line and reason."""
    objects: dict[tuple[int, int], Object] = {}
    names: set[str] = set()
    free = OD.fields["vendor"][1]  # type: ignore[index]
    end = free + VENDOR_BYTES
    for row, where in _rows(path):
        index = _integer(row["index"], where, "index")
        subindex = _integer(row["subindex"], where, "subindex")
        if not 0 <= index <= 0xFFFF or not 0 <= subindex <= 0xFF:
            raise ValueError(f"{where}: {index:04X}h:{subindex:02X}h is no object address")
        if (index, subindex) in objects:
            raise ValueError(f"{where}: {index:04X}h:{subindex:02X}h occurs twice")
        if row["name"] in names:
            raise ValueError(f"{where}: the name {row['name']!r} occurs twice")
        for column, known in (("data_type", FORMATS), ("access", ACCESS), ("pdo", PDO_USE)):
            if row[column] not in known:
                raise ValueError(
                    f"{where}: {column} {row[column]!r} is unknown, use one of {', '.join(known)}"
                )
        for column, table in (("when", WHEN), ("hook", HOOKS)):
            if row[column] and row[column] not in table:
                raise ValueError(
                    f"{where}: {column} {row[column]!r} is unknown, use one of {', '.join(table)}"
                )
        size = SIZES[FORMATS[row["data_type"]]]
        constant = row["access"] == "const"
        area, offset = (not constant and parameter_place(index, subindex)) or ("axis", 0)
        if area != "axis":
            pass
        elif row["field"].startswith("@"):  # another name for the bytes of an earlier row
            other = objects.get(_address(row["field"][1:], where))
            if other is None or other.size != size:
                raise ValueError(f"{where}: {row['field']} is no earlier row of this size")
            area, offset = other.area, other.offset
        elif row["field"]:
            offset = _field_offset(row["field"], row["data_type"], where)
        elif row["data_type"] in ("VISIBLE_STRING", "DOMAIN") or row["access"] == "const":
            area = "constant"
        else:
            free += -free % max(size, 1)
            offset, free = free, free + size
            if free > end:
                raise ValueError(f"{where}: more than {VENDOR_BYTES} bytes of objects of its own")
        objects[index, subindex] = _object(row, where, index, subindex, area, offset)
        names.add(row["name"])
    return objects


def _object(row, where, index, subindex, area, offset) -> Object:
    code = FORMATS[row["data_type"]]
    allowed = None
    default, plus, _ = row["default"].partition("+node_id")
    low, high = _type_range(code)
    if row["min"].startswith("{"):
        allowed = _set(row["min"], where)
    elif row["min"]:
        low = max(low, float(_integer(row["min"], where, "min")))
    if row["max"]:
        high = min(high, float(_integer(row["max"], where, "max")))
    if code:
        default = float(default or 0) if code == "f" else _integer(default or "0", where, "default")
        if not low <= default <= high or (allowed is not None and default not in allowed):
            raise ValueError(f"{where}: default {default} is out of range [{low:.0f}, {high:.0f}]")
        if area == "constant" and row["pdo"]:
            raise ValueError(f"{where}: a constant cannot be mapped to a PDO")
    return Object(
        index, subindex, row["name"], row["object_type"], row["data_type"], row["access"],
        row["pdo"], row["unit"], low, high, allowed, default, row["storable"] == "yes",
        row["section"], row["note"], area, offset, row["when"], row["hook"], bool(plus),
    )  # fmt: skip


def _address(text: str, where: str) -> tuple[int, int]:
    match = re.fullmatch(r"([0-9A-Fa-f]{4}):([0-9A-Fa-f]{2})", text)
    if not match:
        raise ValueError(f"{where}: {text!r} is not an address like 201A:01")
    return int(match[1], 16), int(match[2], 16)


def _set(text: str, where: str) -> frozenset[int]:
    """``{0;2..5;254}``."""
    values: set[int] = set()
    for part in text.strip("{}").split(";"):
        first, _, last = part.partition("..")
        low = _integer(first, where, "min")
        values.update(range(low, (_integer(last, where, "min") if last else low) + 1))
    return frozenset(values)


def _type_range(code: str) -> tuple[float, float]:
    if not code or code == "f":
        return -np.inf, np.inf
    info = np.iinfo(np.dtype("<" + code))
    return float(info.min), float(info.max)


def _field_offset(field: str, data_type: str, where: str) -> int:
    """Byte offset of `name` or `name[i]` in the `od` half of the record."""
    match = re.fullmatch(r"(\w+)(?:\[(\d+)\])?", field)
    if not match or match[1] not in OD.fields:  # type: ignore[operator]
        raise ValueError(f"{where}: the record has no field od.{field}")
    kind, offset = OD.fields[match[1]][:2]  # type: ignore[index]
    base, shape = kind.base, kind.shape
    if bool(shape) != bool(match[2]) or (shape and int(match[2]) >= shape[0]):
        raise ValueError(f"{where}: od.{match[1]} has the shape {shape}, not {field!r}")
    if not _fits(np.dtype("<" + FORMATS[data_type]), base):
        raise ValueError(f"{where}: od.{match[1]} is {base.name}, not {data_type}")
    return offset + int(match[2] or 0) * base.itemsize


def _fits(kind: np.dtype, field: np.dtype) -> bool:
    """Whether an object's bytes may be the lower bytes of a field: integers, no wider ones."""
    narrower = kind.kind == "u" and field.kind in "iu" and kind.itemsize < field.itemsize
    same_size = kind.kind in "iu" and field.kind in "iu" and kind.itemsize == field.itemsize
    return kind == field or narrower or same_size


def read_pdos(
    path: Path, objects, max_bits: int
) -> tuple[tuple[Mapping, ...], tuple[Mapping, ...]]:
    """Receive and transmit PDOs. Raises ValueError with file, line and reason."""
    found: dict[str, dict[int, Mapping]] = {"rx": {}, "tx": {}}
    for row, where in _rows(path):
        direction = row["direction"].lower()
        if direction not in found:
            raise ValueError(f"{where}: direction {row['direction']!r} is neither rx nor tx")
        number = _integer(row["number"], where, "number")
        before = found[direction].get(number)
        entries = before.entries if before else ()
        if row["index"]:  # a row without one is a PDO that is free for mapping
            entries = (*entries, _pdo_entry(row, where, direction, objects, max_bits > MAX_BITS))
        if sum(bits for _, _, bits in entries) > max_bits or len(entries) > ENTRIES:
            raise ValueError(f"{where}: PDO {number} is longer than {max_bits} bits")
        cob_id = row["cob_id"].replace(" ", "")
        if not re.fullmatch(r"0x[0-9A-Fa-f]+(\+node_id)?", cob_id):
            raise ValueError(f"{where}: cob_id {cob_id!r} is not like 0x200+node_id")
        found[direction][number] = Mapping(
            number,
            cob_id,
            _integer(row["transmission_type"], where, "transmission_type"),
            _integer(row["inhibit_time"] or "0", where, "inhibit_time"),
            entries,
        )
    for pdos in found.values():
        if sorted(pdos) != list(range(1, len(pdos) + 1)):
            raise ValueError(f"{path.name} ({path.parent.name}): PDO numbers have a gap")
    return tuple(tuple(pdos[n] for n in sorted(pdos)) for pdos in found.values())  # type: ignore


def _pdo_entry(row, where, direction, objects, partly: bool) -> tuple[int, int, int]:
    """Index, sub-index and bits; `partly`: the lower bytes of an object may stand alone."""
    index, subindex, bits = (
        _integer(row[key], where, key) for key in ("index", "subindex", "bits")
    )
    target = objects.get((index, subindex))
    if direction == "rx" and DUMMY_BITS.get(index) == bits and subindex == 0:
        return index, subindex, bits
    size = target.size * 8 if target else 0
    fits = bits == size or (partly and bits % 8 == 0 and bits < size)
    if target is None or not fits or direction not in target.pdo:
        raise ValueError(
            f"{where}: {index:04X}h:{subindex:02X}h with {bits} bits cannot be mapped to a "
            f"{direction} PDO"
        )
    return index, subindex, bits


def read_faults(path: Path) -> tuple[Fault, ...]:
    """The faults. Raises ValueError with file, line and reason."""
    faults = []
    for row, where in _rows(path):
        for column, known in (("cause", Cause), ("reaction", Reaction)):
            if (row[column] or "NONE") not in {"NONE", *known.__members__}:
                raise ValueError(f"{where}: {column} {row[column]!r} is none of {[*known]}")
        faults.append(
            Fault(
                _integer(row["emcy_code"] or "0x1000", where, "emcy_code"),  # generic error
                _integer(row["main"], where, "main") if row["main"] else None,
                _integer(row["sub"], where, "sub") if row["sub"] else None,
                row["meaning"],
                _integer(row["error_register_bit"] or "0", where, "error_register_bit"),
                Cause[row["cause"] or "NONE"],
                Reaction[row["reaction"] or "IGNORE"],
                row["changeable"] != "no",
                row["section"],
            )
        )
    return tuple(faults)
