"""Makes rows of objects.csv out of the dictionary of an EDS, an ESI file or a slave.

An object that the profile defines, with a type that can hold its values, behaves as in the model
`generic`. Any other object keeps what is written to it. A value that cannot be used as it stands is
reported as a repair.
"""

import functools
import re
from typing import Any

from ..canopen.sheet import Entry, Sheet, number
from ..kernel.process_data import ENTRIES, parameter_place
from ..model.made import line
from ..model.model import DriveModel, load
from ..model.rows import (
    DATA_TYPES,
    FORMATS,
    LAST_NODE,
    LENGTHS,
    REAL,
    SIZES,
    Cells,
    Object,
    read_cells,
    same_number,
)

NEEDED = (0x6040, 0x6041)  # nothing is a CiA 402 drive without them
RESOLUTION, GEAR, FEED = 0x608F, 0x6091, 0x6092
PERIOD = 0x60C2
_TYPES = {number: name for name, number in DATA_TYPES.items()}
# access type of CiA 306 -> access type of a row, and the PDOs that can map the object
_ACCESS = {
    "ro": ("ro", "tx"), "wo": ("wo", "rx"), "rw": ("rw", "rxtx"), "rww": ("rw", "rx"),
    "rwr": ("rw", "tx"), "const": ("const", ""),
}
SOURCE = "EDS"  # of a row, as its section
_COMMUNICATION = range(0x1000, 0x2000)
_MANUFACTURER = range(0x2000, 0x6000)  # these mean something else in the file of each manufacturer
_GAINS = (0x60F6, 0x60F7, 0x60F9, 0x60FB)  # their units are the manufacturer's
_VELOCITY_RESOLUTION = 0x6090  # in the profile it shares its bytes with 608Fh, in files it does not
_PDO_TYPES = {1: "UNSIGNED32", 2: "UNSIGNED8", 3: "UNSIGNED16", 5: "UNSIGNED16", 6: "UNSIGNED8"}
# objects in which a 0 says that no value has been configured yet; nothing moves with it
_UNSET = (0x6072, 0x6073, 0x6075, 0x6076, RESOLUTION, GEAR, FEED, 0x6096, 0x6097, PERIOD)
_LONGEST_TEXT = 4096


@functools.cache
def _generic_cells() -> Cells:
    return read_cells(load("generic").folder / "objects.csv")


def _cells_of(row: Object) -> dict[str, str]:
    """The cells of an object of `generic`; a list that grows with its model has those of sub 1."""
    cells = _generic_cells()
    return (cells.get((row.index, row.subindex)) or cells[row.index, 1])[0]


class ObjectRows:
    """The rows of objects.csv that are made from a sheet.

    Args:
        sheet: the dictionary; it also receives the repairs.
    """

    def __init__(self, sheet: Sheet):
        self.sheet = sheet
        self.base: DriveModel = load("generic")
        self.rows: dict[tuple[int, int], dict[str, Any]] = {}
        self.unknown: list[str] = []  # objects that only keep what is written to them
        self.left_out: list[str] = []
        self._names: set[str] = set()

    @property
    def sorted(self) -> list[dict[str, Any]]:
        """The rows in the order of their addresses."""
        return [self.rows[address] for address in sorted(self.rows)]

    def _known(self, entry: Entry) -> Object | None:
        """The object of the profile that an entry is; None if it is another one."""
        known = self.base.objects.get((entry.index, entry.subindex))
        if known is None or entry.index in _GAINS or entry.index == _VELOCITY_RESOLUTION:
            return None
        if entry.index in _MANUFACTURER and entry.name != known.name:
            return None  # another maker's, unless the file is one of ours
        if known.object_type == "VAR" and entry.kind != "VAR":
            self.sheet.tell(entry.line, entry.where, entry.kind.lower(), "it keeps what is written",
                            f"{known.name} of the profile is a variable")
            return None
        return known

    def take(self, entry: Entry) -> None:
        """Make the row of an entry, or note that it is left out."""
        address = entry.index, entry.subindex
        shown = f"{entry.index:04X}h:{entry.subindex:02X} {line(entry.name)}"
        known = self._known(entry)
        data_type = self._data_type(entry, known)
        if data_type is None:
            self.left_out.append(shown)
            return
        field = _cells_of(known)["field"] if known else ""
        if known is not None and data_type != known.data_type:
            if field and self._is_number_of(data_type, known):
                pass  # the same number in more or fewer bytes
            elif known.index in NEEDED or known.name in ("modes_of_operation", "target_position"):
                self.sheet.tell(entry.line, entry.where, data_type, known.data_type,
                                "the profile defines this type, and nothing works without it")
                data_type = known.data_type
            else:
                self.sheet.tell(entry.line, entry.where, data_type, "it keeps what is written",
                                f"{known.name} of the profile is an {known.data_type}")
                known, field = None, ""
        self.rows[address] = self._row(entry, data_type, known)
        if known is None and entry.index not in _COMMUNICATION:
            self.unknown.append(shown)

    def _is_number_of(self, data_type: str, known: Object) -> bool:
        """Whether a number of the profile can stand in another type, with its sign."""
        code = FORMATS[data_type]
        if data_type == "BOOLEAN" or not same_number(code, known.format):
            return False
        return SIZES[code] == known.size or code.islower() or int(known.default) >= 0

    def _data_type(self, entry: Entry, known: Object | None) -> str | None:
        """The name of the data type; None if the object is left out, which is reported."""
        place = parameter_place(entry.index, entry.subindex)
        if place is not None:
            mapping = bool(entry.index & 0x200)
            if mapping and entry.subindex > ENTRIES:
                self.sheet.tell(entry.line, entry.where, "a mapping entry", "left out",
                                f"a PDO has at most {ENTRIES} entries here")
                return None
            usual = ("UNSIGNED32" if entry.subindex else "UNSIGNED8") if mapping else (
                _PDO_TYPES.get(entry.subindex, "UNSIGNED8" if entry.subindex == 0 else "")
            )
            found = _TYPES.get(entry.data_type, "")
            if usual and found != usual:
                self.sheet.tell(entry.line, entry.where, found or f"{entry.data_type:02X}h", usual,
                                "CiA 301 defines this type for PDOs")
            return usual or _TYPES.get(entry.data_type)
        data_type = _TYPES.get(entry.data_type)
        if data_type is None:
            if known is not None and known.index in NEEDED:
                data_type = known.data_type
            self.sheet.tell(entry.line, entry.where, f"data type {entry.data_type:02X}h",
                            data_type or "left out", "there is no such type in CiA 301")
        return data_type

    def _row(self, entry: Entry, data_type: str, known: Object | None) -> dict[str, Any]:
        access, pdo = _ACCESS[entry.access]
        code = FORMATS[data_type]
        own = _cells_of(known) if known else {}
        if known is not None:
            if known.access == "const" and (own["field"] or access == "ro"):
                access, pdo = "const", ""
            elif known.access == "ro" and access in ("rw", "wo"):
                self.sheet.tell(entry.line, entry.where, entry.access, "ro",
                                "the drive sets it")
                access, pdo = "ro", "tx"
        place = parameter_place(entry.index, entry.subindex)
        name = known.name if known else self._name(entry)
        self._names.add(name)
        row: dict[str, Any] = {
            "index": f"0x{entry.index:04X}", "subindex": f"0x{entry.subindex:02X}", "name": name,
            "object_type": entry.kind, "data_type": data_type, "access": access,
            "pdo": pdo if entry.mappable and code and place is None else "", "section": SOURCE,
        }
        for column in ("unit", "storable", "field", "when", "hook", "note"):
            row[column] = own.get(column, "")
        if known is None:
            row["note"] = "" if entry.index in _COMMUNICATION else "unknown: keeps what is written"
            row["storable"] = "yes" if access == "rw" and code else ""
        if not code:
            row["default"] = self._text_default(entry, data_type)
            return row
        self._numbers(entry, row, data_type, known, own)
        return row

    def _text_default(self, entry: Entry, data_type: str) -> str:
        if data_type not in LENGTHS:
            text = line(entry.default, _LONGEST_TEXT)
            if not text.isascii():
                self.sheet.tell(entry.line, entry.where, text, "its ASCII characters",
                                "a VISIBLE_STRING holds no others")
            return text.encode("ascii", "ignore").decode()
        try:
            return str(number(entry.default)[0] if entry.default else 0)
        except ValueError:
            self.sheet.tell(
                entry.line, entry.where, entry.default, "0", f"it is not of type {data_type}"
            )
            return "0"

    def _numbers(
        self, entry: Entry, row: dict[str, Any], data_type: str, known: Object | None, own: Any
    ) -> None:
        """Default and range of a number, such that the default lies in the range."""
        if FORMATS[data_type] in REAL:
            try:
                value = float(entry.default or 0)
                if value != value:
                    raise ValueError
                row["default"] = str(value)
            except ValueError:
                self.sheet.tell(entry.line, entry.where, entry.default, "0", "it is not a number")
                row["default"] = "0"
            return
        span = lowest, highest = _reach(data_type, known)
        default, per_node = self._number(entry, entry.default, data_type, "default value", span)
        low, _ = self._number(entry, entry.low, data_type, "low limit", span)
        high, _ = self._number(entry, entry.high, data_type, "high limit", span)
        if low is not None and high is not None and (low > high or low == high == 0):
            self.sheet.tell(entry.line, entry.where, f"limits {low}..{high}", "none",
                            "no value lies within them")
            low = high = None
        low = lowest if low is None else low
        high = highest if high is None else high
        if default is None:
            default = held(int(known.default), data_type) if known is not None else 0
            default = min(max(default if low <= default <= high else 0, low), high)
            per_node = known.per_node if known is not None else False
        elif per_node and default + LAST_NODE > highest:
            self.sheet.tell(entry.line, entry.where, f"{default} and the node-id", str(default),
                            f"an {data_type} cannot hold the sum")
            per_node, low, high = False, min(low, default), max(high, default)
        elif not per_node and not low <= default <= high:
            self.sheet.tell(entry.line, entry.where, f"default {default}, limits {low}..{high}",
                            "limits that include it", "a drive starts with its default")
            low, high = min(low, default), max(high, default)
        allowed = ""
        if known is not None and not per_node and held(default, known.data_type) == default:
            default, low, high, allowed = self._as_profile(
                entry, known, own, default, low, high, span
            )
        row["min"] = allowed or (low if low != lowest else "")
        row["max"] = high if high != highest else ""
        row["default"] = f"{default:#x}+node_id" if per_node else str(default)

    def _as_profile(
        self, entry: Entry, known: Object, own: Any, default: int, low: int, high: int,
        reach: tuple[int, int],
    ) -> tuple[int, int, int, str]:
        """Limit the range to values that the profile defines; 0 often means no limit."""
        span = _span(known.data_type)
        least, most = max(known.minimum, span[0]), min(known.maximum, span[1])
        possible = least <= default <= most
        possible = possible and (known.allowed is None or default in known.allowed)
        unset = default == 0 and known.index in _UNSET
        if not possible and not unset and (entry.low or entry.high):
            return default, low, high, ""  # the file knows more values than the profile
        if not possible:
            factory = min(max(int(known.default), reach[0]), reach[1])
            self.sheet.tell(entry.line, entry.where, f"default {default}", str(factory),
                            f"{known.name} of the profile does not have this value")
            low, high, default = min(low, factory), max(high, factory), factory
        if known.allowed is not None:
            return default, low, high, own["min"]
        if least > low and least <= default:
            low = int(least)
        if most < high and most >= default:
            high = int(most)
        return default, low, high, ""

    def _number(
        self, entry: Entry, text: str, data_type: str, what: str, span: tuple[int, int]
    ) -> tuple[int | None, bool]:
        """A number that data type and drive can hold; None if there is none."""
        if not text:
            return None, False
        try:
            value, per_node = number(text)
        except ValueError:
            self.sheet.tell(
                entry.line, entry.where, f"{what} {text!r}", "none", "it is not a number"
            )
            return None, False
        if span[0] <= value <= span[1]:
            return value, per_node
        lowest, highest = _span(data_type)
        if lowest <= value <= highest:
            taken = min(max(value, span[0]), span[1])
            self.sheet.tell(entry.line, entry.where, f"{what} {text}", str(taken),
                            f"the drive can hold {span[0]}..{span[1]}")
            return taken, per_node
        bits = 8 * SIZES[FORMATS[data_type]]
        if lowest < 0 <= value < 1 << bits:  # 65535 of an INTEGER16 is -1
            signed = max(value - (1 << bits), span[0])
            if not text.lower().startswith("0x"):
                self.sheet.tell(entry.line, entry.where, f"{what} {text}", str(signed),
                                f"the bits of an {data_type}")
            return signed, per_node
        if lowest == 0 and -(1 << bits - 1) <= value < 0:
            taken = min(value + (1 << bits), span[1])
        else:
            taken = min(max(value, span[0]), span[1])
        self.sheet.tell(entry.line, entry.where, f"{what} {text}", str(taken),
                        f"an {data_type} can hold {lowest}..{highest}")
        return taken, per_node

    def _name(self, entry: Entry) -> str:
        own = entry.name if entry.subindex == 0 else f"{entry.group}_{entry.name}"
        name = re.sub(r"[^a-z0-9]+", "_", own.lower()).strip("_")[:80] or "object"
        name = name if not name[0].isdigit() else f"object_{name}"
        if name in self._names or name in self.base.names:
            name = f"{name}_{entry.index:04x}_{entry.subindex:02x}"
        return name

    def default(self, index: int, subindex: int) -> int | None:
        """The default of an integer; None if it depends on the node-id, or is no integer."""
        row = self.rows.get((index, subindex))
        if row is None or "+" in row["default"] or FORMATS[row["data_type"]] in ("", *REAL):
            return None
        return int(row["default"])

    def stated(self, index: int, subindex: int) -> int | None:
        """The default in the file itself, not the one substituted from the profile."""
        entry = self.sheet.entries.get((index, subindex))
        return self.default(index, subindex) if entry is not None and entry.default else None

    def replace_default(self, index: int, subindex: int, value: int, why: str) -> None:
        """Give an object another default, and note why."""
        row, entry = self.rows[index, subindex], self.sheet.entries[index, subindex]
        value = held(value, row["data_type"])
        self.sheet.tell(entry.line, entry.where, f"default {row['default']}", str(value), why)
        self.set_default(row, value)

    def set_default(self, row: dict[str, Any], value: int) -> None:
        """Put a default into a row; a limit that excludes it goes."""
        row["default"] = str(value)
        for column, beyond in (("min", -1), ("max", 1)):
            if isinstance(bound := row.get(column), int) and beyond * (value - bound) > 0:
                row[column] = ""

    def is_process_data(self, address: tuple[int, int]) -> bool:
        """Whether a PDO can map an object: a number that can change, no parameter of a PDO."""
        row = self.rows[address]
        number = FORMATS[row["data_type"]] and row["access"] != "const"
        return bool(number) and parameter_place(*address) is None


def _span(data_type: str) -> tuple[int, int]:
    """Least and greatest value of an integer type."""
    code = FORMATS[data_type]
    bits = 8 * SIZES[code]
    if data_type == "BOOLEAN":
        return 0, 255  # what a drive takes for true differs
    return (-(1 << bits - 1), (1 << bits - 1) - 1) if code.islower() else (0, (1 << bits) - 1)


def _reach(data_type: str, known: Object | None) -> tuple[int, int]:
    """The values that an object of a type can have, if the drive stores it as in the profile."""
    low, high = _span(data_type)
    if known is None or SIZES[FORMATS[data_type]] == known.size:
        return low, high
    least, most = _span(known.data_type)
    return max(low, least), min(high, most)


def held(value: int, data_type: str) -> int:
    """Convert a number of the profile to a type of the file: same bits, or nearest value."""
    low, high = _span(data_type)
    bits = high - low + 1
    if -bits // 2 <= value < bits:
        return (value - low) % bits + low
    return min(max(value, low), high)
