"""The rows of a drive model's files: objects and faults, read and checked.

An impossible row is refused with file, line and reason, before a drive exists.
"""

import csv
import io
import re
import struct
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from ..kernel.faults import Cause, Reaction
from ..kernel.process_data import parameter_place
from ..kernel.record import FAULT_ROWS, OD, OWN_STORED, VENDOR_BYTES, Kind
from . import foreign

# data type -> its number in CiA 301 and ETG.1020, and its format for `struct`; values without one
# are kept as bytes, so many of them (0: a string)
_TYPES: dict[str, tuple[int, str | int]] = {
    "BOOLEAN": (0x01, "B"), "INTEGER8": (0x02, "b"), "INTEGER16": (0x03, "h"),
    "INTEGER32": (0x04, "i"), "INTEGER64": (0x15, "q"), "UNSIGNED8": (0x05, "B"),
    "UNSIGNED16": (0x06, "H"), "UNSIGNED32": (0x07, "I"), "UNSIGNED64": (0x1B, "Q"),
    "REAL32": (0x08, "f"), "REAL64": (0x11, "d"), "VISIBLE_STRING": (0x09, 0),
    "OCTET_STRING": (0x0A, 0), "UNICODE_STRING": (0x0B, 0), "DOMAIN": (0x0F, 0),
    "TIME_OF_DAY": (0x0C, 6), "TIME_DIFFERENCE": (0x0D, 6), "INTEGER24": (0x10, 3),
    "INTEGER40": (0x12, 5), "INTEGER48": (0x13, 6), "INTEGER56": (0x14, 7), "UNSIGNED24": (0x16, 3),
    "UNSIGNED40": (0x18, 5), "UNSIGNED48": (0x19, 6), "UNSIGNED56": (0x1A, 7),
}
DATA_TYPES = {name: number for name, (number, _) in _TYPES.items()}
FORMATS = {name: kind if isinstance(kind, str) else "" for name, (_, kind) in _TYPES.items()}
LENGTHS = {name: kind for name, (_, kind) in _TYPES.items() if isinstance(kind, int) and kind}
REAL = ("f", "d")  # formats of numbers that are not whole
TEXTS = ("VISIBLE_STRING", "DOMAIN")
TEXT_BYTES = "bytes"  # hook of rows without a format that can be written or are not text
SIZES = {code: struct.calcsize(f"<{code}") for code in FORMATS.values()}
# rows of an objects.csv by index and sub-index, each with the words "file, line n"
Cells = dict[tuple[int, int], tuple[dict[str, str], str]]
ACCESS = ("ro", "wo", "rw", "const")
PDO_USE = ("", "rx", "tx", "rxtx")


@dataclass(frozen=True)
class Object:
    """One row of the object dictionary; its bytes are at `offset` in the `area` of the drive."""

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
    area: str  # where the bytes are: "axis", "rpdo", "tpdo", "more" (beyond the record), "constant"
    offset: int
    when: str = ""  # `objects.hooks.WHEN`: state of the drive that a write needs
    hook: str = ""  # `objects.hooks.HOOKS`: further effect of reading or writing
    per_node: bool = False  # the node-id is added to the default
    where: str = ""  # file and line of the row
    possible: tuple[int, ...] = ()  # values that its hook accepts, for error messages
    stored: str = ""  # format of its bytes in the record, if that has another size

    @property
    def address(self) -> str:
        """Index and sub-index, ``6081h:00``."""
        return f"{self.index:04X}h:{self.subindex:02X}"

    @property
    def format(self) -> str:
        """Format of the value for `struct`, empty for strings."""
        return FORMATS[self.data_type]

    @property
    def real(self) -> bool:
        """Whether the value is a REAL32 or REAL64."""
        return self.format in REAL

    @property
    def size(self) -> int:
        """Bytes of the value, 0 for strings."""
        return SIZES[self.format]

    @cached_property
    def code(self) -> struct.Struct:
        """The value as little-endian bytes; of size 0 for strings."""
        return struct.Struct("<" + self.format)

    @cached_property
    def held(self) -> struct.Struct:
        """The value as bytes in the drive's memory."""
        return struct.Struct(f"<{self.stored or self.format}")

    def shown(self, value: int) -> int:
        """A value of the drive's memory as a number of the data type, from its lower bytes."""
        bits = 8 * self.size
        value &= (1 << bits) - 1
        return value - (1 << bits) if self.format.islower() and value >> bits - 1 else value

    @property
    def length(self) -> int:
        """Size of every value (bytes), 0 for strings of any length."""
        return self.size or LENGTHS.get(self.data_type, 0)

    @cached_property
    def initial(self) -> bytes:
        """The default of a row without a format, as bytes."""
        text = str(self.default)
        if self.length:
            value = int(text or "0", 0) & (1 << 8 * self.length) - 1
            return value.to_bytes(self.length, "little")
        return text.encode("utf-16-le" if self.data_type == "UNICODE_STRING" else "utf-8")

    def pack(self, value: int | float) -> bytes:
        """Bytes of a number. Raises ValueError for a number outside of its data type."""
        try:
            return self.code.pack(value)
        except (struct.error, OverflowError) as error:
            raise ValueError(
                f"{self.name} = {value!r} is not of type {self.data_type}: {error}"
            ) from None

    def unpack(self, data: bytes) -> int | float:
        """The number at the beginning of `data`: an SDO without a size has four bytes (CiA 301).

        Raises:
            ValueError: fewer bytes than the number has.
        """
        if len(data) < self.size:
            raise ValueError(
                f"{self.name} came with {len(data)} bytes, an {self.data_type} has {self.size}: "
                "the drive is not of this model"
            )
        return self.code.unpack_from(data)[0]


@dataclass(frozen=True)
class Fault:
    """A row of faults.csv."""

    code: int
    main: int | None  # manufacturer's number of the fault, with `sub`
    sub: int | None
    meaning: str
    register: int
    cause: Cause  # NONE: only by fault injection
    reaction: Reaction
    changeable: bool  # False: a master may only choose a more severe reaction
    section: str
    row: int = 0  # of the model's faults

    @property
    def name(self) -> str:
        """Fault number as manuals and displays print it, ``17-0``."""
        return "" if self.main is None else f"{self.main:02d}-{self.sub or 0}"


KINDS_OF_UNITS = (  # first words of a unit -> of a signed type, of an unsigned one
    (("position",), Kind.POSITION, Kind.WIDTH),
    (("speed", "velocity"), Kind.SPEED, Kind.SPEED),  # a limit without direction (inferred)
    (("acceleration", "jerk"), Kind.ACCELERATION, Kind.ACCELERATION),
)


QUANTITIES = {  # quantity -> its unit as the manuals spell it
    "position": r"position units?",
    "velocity": r"(velocity|speed) units?",
    "acceleration": r"acceleration units?",
    "torque": r"rated torque/1000|per mille of motor_rated_torque( \(.*\))?",
}


def quantity(unit: str) -> str:
    """Quantity of a unit of the factor group or of the rated torque; "" for any other."""
    return next((name for name, spelt in QUANTITIES.items() if re.fullmatch(spelt, unit)), "")


def own_stored(objects: dict[tuple[int, int], Object]) -> tuple[tuple[int, int, int], ...]:
    """Objects in units of the factor group that are stored in the model's own bytes.

    Each has an offset in `od`, a size (byte, negative: signed) and a `Kind`. Raises ValueError if
    there are more than the record has room for.
    """
    found = {}
    for row in objects.values():
        words = row.unit.split()
        own = row.area == "axis" and row.offset >= OD.fields["vendor"][1]  # type: ignore[index]
        if not own or row.access not in ("rw", "wo") or len(words) < 2 or "unit" not in words[1]:
            continue
        for first, signed, unsigned in KINDS_OF_UNITS:
            if words[0] in first:
                minus = row.format.islower()
                found[row.offset] = (
                    -row.size if minus else row.size,
                    signed if minus else unsigned,
                )
    if len(found) > OWN_STORED:
        raise ValueError(
            f"{len(found)} objects of its own have position, velocity or acceleration units, "
            f"at most {OWN_STORED} can be kept: leave out values_keep_meaning or the unit of some"
        )
    return tuple((offset, size, int(kind)) for offset, (size, kind) in found.items())


OBJECT_COLUMNS = (
    "index", "subindex", "name", "object_type", "data_type", "access", "pdo", "unit", "min", "max",
    "default", "storable", "section", "note", "field", "when", "hook",
)
FAULT_COLUMNS = (
    "emcy_code", "main", "sub", "meaning", "error_register_bit", "cause", "reaction", "changeable",
    "section",
)
MORE_BYTES = 1 << 20  # objects beyond the record, which no PDO carries
ALIGNMENT = 7  # largest gap before an aligned object (bytes)
LAST_NODE = 127  # largest node-id that is added to a default
LARGEST_SET = 1 << 16  # values of {low..high}


def lines_of(path: Path, columns: tuple[str, ...]) -> Iterator[tuple[dict[str, str], str]]:
    """Rows of a CSV file, each with "file, line n" for error messages."""
    reader = csv.DictReader(io.StringIO(foreign.text(path, "a file of a model"), newline=""))
    try:
        missing = [column for column in columns if column not in (reader.fieldnames or ())]
        for row in reader:
            if missing:
                raise ValueError(
                    f"{path.name}, line 1 ({path.parent.name}): there is no column {missing[0]!r}"
                )
            where = f"{path.name}, line {reader.line_num} ({path.parent.name})"
            if None in row or None in row.values():
                raise ValueError(f"{where}: {len(reader.fieldnames or ())} columns expected")
            yield {key: value.strip() for key, value in row.items()}, where
    except csv.Error as error:
        line = reader.line_num
        raise ValueError(f"{path.name}, line {line} ({path.parent.name}): {error}") from None


def integer(text: str, where: str, what: str, bits: int = 0) -> int:
    """An integer; with `bits`, one that fits an unsigned field of that length."""
    try:
        value = int(text, 0)
    except ValueError:
        raise ValueError(f"{where}: {what} = {text!r} is not an integer") from None
    if bits and not 0 <= value < 1 << bits:
        raise ValueError(f"{where}: {what} = {value} is out of range 0..{(1 << bits) - 1}")
    return value


def read_cells(path: Path) -> Cells:
    """The rows of an objects.csv by index and sub-index, as text.

    Raises ValueError with file, line and reason.
    """
    cells: Cells = {}
    for row, where in lines_of(path, OBJECT_COLUMNS):
        index = integer(row["index"], where, "index")
        subindex = integer(row["subindex"], where, "subindex")
        if not 0 <= index <= 0xFFFF or not 0 <= subindex <= 0xFF:
            raise ValueError(f"{where}: {index:04X}h:{subindex:02X}h is not an object address")
        if (index, subindex) in cells:
            raise ValueError(f"{where}: {index:04X}h:{subindex:02X}h occurs twice")
        cells[index, subindex] = row, where
    return cells


def referred(own: Cells, base: Cells, standard: Cells) -> Cells:
    """The rows of `base`, replaced and extended by those of `own`.

    A row without a data_type refers to the row of its address in `base`, or else in `standard`. It
    contains only the differences; ``-`` empties a cell. Raises ValueError if there is no such row.
    """
    cells = {**base}
    for address, (row, where) in own.items():
        if not row["data_type"]:
            other, _ = base.get(address) or standard.get(address) or (None, "")
            if other is None:
                raise ValueError(
                    f"{where}: the row has no data_type, and neither the base nor the model "
                    f"of objects_of has {address[0]:04X}h:{address[1]:02X}h: fill it in"
                )
            row = {
                column: other[column] if not cell else "" if cell == "-" else cell
                for column, cell in row.items()
            }
        cells[address] = row, where
    return cells


def read_objects(cells: Cells) -> dict[tuple[int, int], Object]:
    """Objects by index and sub-index. Raises ValueError with file, line and reason."""
    objects: dict[tuple[int, int], Object] = {}
    names: set[str] = set()
    record = _Places(OD.fields["vendor"][1], VENDOR_BYTES)  # type: ignore[index]
    more = _Places(0, MORE_BYTES)
    mapped = sum(_own_size(a, row) for a, (row, _) in cells.items() if row["pdo"])
    for (index, subindex), (row, where) in cells.items():
        if row["name"] in names:
            raise ValueError(f"{where}: the name {row['name']!r} occurs twice")
        for column, known in (("data_type", FORMATS), ("access", ACCESS), ("pdo", PDO_USE)):
            if row[column] not in known:
                raise ValueError(
                    f"{where}: {column} {row[column]!r} is unknown, use one of {', '.join(known)}"
                )
        size, stored = SIZES[FORMATS[row["data_type"]]], ""
        place = parameter_place(index, subindex) if row["access"] != "const" else None
        if place == ("constant", 0) and row["access"] in ("rw", "wo"):  # reserved, yet writable
            place = None
        area, offset = place or ("axis", 0)
        if area != "axis":
            pass
        elif row["field"].startswith("@"):  # another name for the bytes of an earlier row
            other = objects.get(address(row["field"][1:], where))
            if other is None or other.size != size or other.stored:
                raise ValueError(f"{where}: {row['field']} is not an earlier row of this size")
            area, offset = other.area, other.offset
        elif row["field"]:
            offset, stored = _field(row["field"], row["data_type"], where)
        elif not FORMATS[row["data_type"]] or row["access"] == "const":
            area = "constant"
        else:
            # mappable objects have to be in the record, others if there is room
            fits = bool(row["pdo"]) or record.left - size - ALIGNMENT >= mapped
            area = "axis" if fits else "more"
            offset = (record if fits else more).take(size, where)
            mapped -= _own_size((index, subindex), row) if row["pdo"] else 0
        objects[index, subindex] = _object(row, where, index, subindex, area, offset, stored)
        names.add(row["name"])
    return objects


@dataclass
class _Places:
    """Bytes that are allocated in order, each object aligned to its size."""

    free: int
    left: int

    def take(self, size: int, where: str) -> int:
        """Allocate an object. Raises ValueError if no room is left."""
        gap = -self.free % max(size, 1)
        if gap + size > self.left:
            raise ValueError(
                f"{where}: more than {VENDOR_BYTES} bytes of objects of its own that PDOs may "
                f"carry, or {MORE_BYTES} of others: leave the column pdo empty where it is not used"
            )
        at = self.free + gap
        self.free, self.left = at + size, self.left - gap - size
        return at


def _own_size(address: tuple[int, int], row: dict[str, str]) -> int:
    """Bytes of the record that a row needs, including alignment; 0 if it has a field."""
    code = FORMATS.get(row["data_type"], "")
    own = code and not row["field"] and row["access"] != "const"
    return SIZES[code] + SIZES[code] - 1 if own and parameter_place(*address) is None else 0


def _object(row, where, index, subindex, area, offset, stored) -> Object:
    code = FORMATS[row["data_type"]]
    allowed = None
    default, plus, _ = row["default"].partition("+node_id")
    low, high = _type_range(code)
    if stored:
        low, high = max(low, _type_range(stored)[0]), min(high, _type_range(stored)[1])
    if row["min"].startswith("{"):
        allowed = _set(row["min"], where)
    elif row["min"]:
        low = max(low, float(integer(row["min"], where, "min")))
    if row["max"]:
        high = min(high, float(integer(row["max"], where, "max")))
    if not code and row["data_type"] in LENGTHS:
        _check_number(default, row["data_type"], where)
    if code:
        default = float(default or 0) if code in REAL else integer(default or "0", where, "default")
        if not low <= default <= high or (allowed is not None and default not in allowed):
            raise ValueError(f"{where}: default {default} is out of range [{low:.0f}, {high:.0f}]")
        if plus and code not in REAL and default + LAST_NODE > _type_range(code)[1]:
            raise ValueError(f"{where}: default {row['default']} does not fit {row['data_type']}")
        if area == "constant" and row["pdo"]:
            raise ValueError(f"{where}: a constant cannot be mapped to a PDO")
    hook = row["hook"]
    if not code and not hook and (row["access"] in ("rw", "wo") or row["data_type"] not in TEXTS):
        hook = TEXT_BYTES
    return Object(
        index, subindex, row["name"], row["object_type"], row["data_type"], row["access"],
        row["pdo"], row["unit"], low, high, allowed, default, row["storable"] == "yes",
        row["section"], row["note"], area, offset, row["when"], hook, bool(plus), where,
        stored=stored,
    )


def _check_number(default: str, data_type: str, where: str) -> None:
    """Refuse an impossible default of a number that is stored as bytes."""
    try:
        int(default or "0", 0)
    except ValueError:
        raise ValueError(f"{where}: default {default!r} is not of type {data_type}") from None


def address(text: str, where: str) -> tuple[int, int]:
    """Index and sub-index, written as 6040:00. Raises ValueError with file and line."""
    match = re.fullmatch(r"([0-9A-Fa-f]{4}):([0-9A-Fa-f]{2})", text)
    if not match:
        raise ValueError(f"{where}: {text!r} is not an address like 201A:01")
    return int(match[1], 16), int(match[2], 16)


def _set(text: str, where: str) -> frozenset[int]:
    """``{0;2..5;254}``."""
    values: set[int] = set()
    for part in text.strip("{}").split(";"):
        first, _, last = part.partition("..")
        low = integer(first, where, "min")
        high = integer(last, where, "min") if last else low
        if not 0 <= high - low < LARGEST_SET:
            raise ValueError(
                f"{where}: min {text!r}: {part} is not a range of {LARGEST_SET} values"
            )
        values.update(range(low, high + 1))
    return frozenset(values)


def _type_range(code: str) -> tuple[float, float]:
    if not code or code in REAL:
        return -np.inf, np.inf
    info = np.iinfo(np.dtype("<" + code))
    return float(info.min), float(info.max)


def _field(field: str, data_type: str, where: str) -> tuple[int, str]:
    """Byte offset of `name` or `name[i]` in the `od` half of the record, and its format.

    The format is empty if the object has the same size.
    """
    match = re.fullmatch(r"(\w+)(?:\[(\d+)\])?", field)
    if not match or match[1] not in OD.fields:  # type: ignore[operator]
        raise ValueError(f"{where}: the record has no field od.{field}")
    kind, offset = OD.fields[match[1]][:2]  # type: ignore[index]
    base, shape = kind.base, kind.shape
    if bool(shape) != bool(match[2]) or (shape and int(match[2]) >= shape[0]):
        raise ValueError(f"{where}: od.{match[1]} has the shape {shape}, not {field!r}")
    code = FORMATS[data_type]
    if not same_number(code, base.char) and np.dtype(f"<{code}") != base:
        raise ValueError(f"{where}: od.{match[1]} is {base.name}, not {data_type}")
    stored = "" if SIZES[code] == base.itemsize else base.char
    return offset + int(match[2] or 0) * base.itemsize, stored


def same_number(code: str, other: str) -> bool:
    """Whether two formats are integers of at most 32 bits, which are interchangeable."""
    return {code, other} <= {*"BbHhIi"}


def read_faults(path: Path, variant: str = "") -> tuple[Fault, ...]:
    """The faults of a variant. Raises ValueError with file, line and reason."""
    faults: list[Fault] = []
    for row, where in lines_of(path, FAULT_COLUMNS):
        if row.get("variant", "") not in ("", variant):
            continue
        if len(faults) == FAULT_ROWS:
            raise ValueError(f"{where}: a model has at most {FAULT_ROWS} faults")
        for column, known in (("cause", Cause), ("reaction", Reaction)):
            if (row[column] or "NONE") not in {"NONE", *known.__members__}:
                raise ValueError(f"{where}: {column} {row[column]!r} is none of {[*known]}")
        faults.append(
            Fault(
                integer(row["emcy_code"] or "0x1000", where, "emcy_code", 16),  # generic error
                integer(row["main"], where, "main", 8) if row["main"] else None,
                integer(row["sub"], where, "sub", 8) if row["sub"] else None,
                row["meaning"],
                integer(row["error_register_bit"] or "0", where, "error_register_bit", 3),
                Cause[row["cause"] or "NONE"],
                Reaction[row["reaction"] or "IGNORE"],
                row["changeable"] != "no",
                row["section"],
                len(faults),
            )
        )
    return tuple(faults)


def with_sections(objects: dict[tuple[int, int], Object], sections: dict[str, str]):
    """The objects with sections of the model's own manual, and the base's section as a note.

    `sections` maps sections of the base's manual to those of the model's; others become "".
    """
    for address, row in objects.items() if sections else ():
        own = sections.get(row.section, "")
        if own != row.section:
            note = f"{row.note}; inferred from the base, {row.section or 'no section'}"
            objects[address] = replace(row, section=own, note=note.removeprefix("; "))
    return objects
