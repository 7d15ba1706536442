"""Makes a drive model, a folder that every command accepts, from an EDS or DCF (CiA 306).

The file lists the objects with types, ranges, defaults and PDOs, but not the behaviour. Objects of
the profile that have its type behave as in the model `generic`; the others store what is written.
`sheet` reads the file, `made` writes the folder, and this module makes a row of each object.
Anything that could not be used as it stands is a repair in the README of the folder.
"""

import functools
import re
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any, ClassVar

from ..kernel.factors.units import FRACTION_LIMIT
from ..kernel.process_data import DUMMY_BITS, ENTRIES, MAX_BITS, MAX_PDOS, parameter_place
from ..kernel.record import VENDOR_BYTES
from ..kernel.words import MODE_ABBREVIATION, Mode, mode_bit
from ..model.made import ModelFolder, Repair, check_place, line, write
from ..model.model import DriveModel, load
from ..model.pdo import mapping_entry
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
from ..objects.abort import SdoAbort
from ..statements import data_sheet
from .sheet import Entry, Sheet, number, read_sheet

MOST = 1 << 16  # objects
NEEDED = (0x6040, 0x6041)
TYPES = {number: name for name, number in DATA_TYPES.items()}
# access of CiA 306 -> of a row, and where it may be mapped
ACCESS = {
    "ro": ("ro", "tx"), "wo": ("wo", "rx"), "rw": ("rw", "rxtx"), "rww": ("rw", "rx"),
    "rwr": ("rw", "tx"), "const": ("const", ""),
}
SOURCE = "EDS"
OFF = 0x8000_0000  # bit of an identifier: not valid
MAKERS = range(0x2000, 0x6000)  # objects of the maker, which mean something else in each file
GAINS = (0x60F6, 0x60F7, 0x60F9, 0x60FB)  # each maker has units of its own for them
PDO_TYPES = {1: "UNSIGNED32", 2: "UNSIGNED8", 3: "UNSIGNED16", 5: "UNSIGNED16", 6: "UNSIGNED8"}
PREDEFINED = {"rx": (0x200, 0x300, 0x400, 0x500), "tx": (0x180, 0x280, 0x380, 0x480)}
SECOND = 0x6090  # shares its bytes with 608Fh in the profile, and says something else in a file
RESOLUTION, GEAR, FEED = 0x608F, 0x6091, 0x6092
PERIOD, LONGEST_PERIOD = 0x60C2, 0.1  # s; inferred: a bus is quicker
# set-point in an RPDO -> mode (inferred)
SET_POINTS = {0x607A: Mode.CYCLIC_SYNC_POSITION, 0x60FF: Mode.CYCLIC_SYNC_VELOCITY,
              0x6071: Mode.CYCLIC_SYNC_TORQUE}
VELOCITY_UNIT, VELOCITY_FACTOR, REVOLUTIONS_PER_MINUTE = 0x60A9, 0x6096, 0xB447
# where 0 says that the maker's tool has not set it yet, and nothing moves with it
UNSET = (0x6072, 0x6073, 0x6075, 0x6076, RESOLUTION, GEAR, FEED, 0x6096, 0x6097, 0x60C2)
# modes by what a master needs for them, where 6502h does not say (inferred)
NEEDS = {
    Mode.PROFILE_POSITION: (0x607A, 0x6081), Mode.VELOCITY: (0x6042,),
    Mode.PROFILE_VELOCITY: (0x60FF,), Mode.PROFILE_TORQUE: (0x6071,), Mode.HOMING: (0x6098,),
    Mode.INTERPOLATED_POSITION: (0x60C1,), Mode.CYCLIC_SYNC_POSITION: (0x607A, 0x60C2),
    Mode.CYCLIC_SYNC_VELOCITY: (0x60FF, 0x60C2), Mode.CYCLIC_SYNC_TORQUE: (0x6071, 0x60C2),
}


@dataclass(frozen=True)
class Imported:
    """The result of an import."""

    folder: Path
    objects: int
    unknown: tuple[str, ...]  # objects that only keep what is written
    left_out: tuple[str, ...]
    repairs: tuple[Repair, ...]
    node_id: int | None  # of a DCF


def import_eds(eds: Path, folder: Path, *, strict: bool = False) -> Imported:
    """Make a drive model in `folder`, which must not exist, or be empty.

    Args:
        eds: the EDS or DCF.
        folder: of the model.
        strict: refuse a file that needs a repair; for authors of EDS files.

    Raises:
        ValueError: the file is not an EDS of a CiA 402 drive, it needs repairs and `strict` forbids
            them, or the folder is not empty.
    """
    if not eds.exists():
        raise ValueError(f"{eds}: there is no such file")
    check_place(folder)
    sheet = read_sheet(eds)
    made = _Import(sheet).made()
    if strict and made.repairs:
        listed = "\n".join(f"{eds}, {repair}" for repair in made.repairs)
        raise ValueError(f"{listed}\n{eds}: {len(made.repairs)} departures from CiA 306 (--strict)")
    try:
        write(made, folder, data_sheet)
    except SdoAbort as error:
        raise ValueError(f"{eds}: {error}") from None
    except ValueError as error:
        raise ValueError(f"{eds}: {error}") from None
    return Imported(
        folder, len(made.objects), tuple(made.unknown), tuple(made.left_out), tuple(made.repairs),
        sheet.node_id,
    )


@functools.cache
def _cells() -> Cells:
    """The rows of `generic`, as they are written."""
    return read_cells(load("generic").folder / "objects.csv")


class _Import:
    """One file on its way to a model."""

    needs: ClassVar = NEEDS  # objects of each mode

    def __init__(self, sheet: Sheet):
        self.sheet = sheet
        self.base: DriveModel = load("generic")
        self.cells = _cells()
        self.rows: dict[tuple[int, int], dict[str, Any]] = {}
        self.names: set[str] = set()
        self.pdos: list[tuple[Any, ...]] = []
        self.rpm = False  # velocities are in 1/min
        title = line(sheet.text("DeviceInfo", "ProductName") or sheet.path.stem) or "drive"
        self.result = ModelFolder(title, sheet.path.name, "servogym drives --from-eds")
        self.result.repairs = sheet.repairs

    def made(self) -> ModelFolder:
        """The model. Raises ValueError where the file is not that of a CiA 402 drive."""
        sheet, made = self.sheet, self.result
        for index in NEEDED:
            if (index, 0) not in sheet.entries or sheet.entries[index, 0].kind != "VAR":
                missing = [r for r in sheet.repairs if r.where == f"{index:04X}h"]
                reason = "is listed, but has no section: is the file complete?" if missing else ""
                raise ValueError(
                    f"{sheet.path}, line {_last(sheet)}: {index:04X}h "
                    + (reason or "is missing: it is not the EDS of a CiA 402 drive")
                )
        if len(sheet.entries) > MOST:
            raise ValueError(f"{sheet.path}: {len(sheet.entries)} objects, at most {MOST}")
        for entry in sheet.entries.values():
            self._take(entry)
        self._factors()
        self._period()
        self._pdos()
        self._place()
        made.objects = [self.rows[address] for address in sorted(self.rows)]
        made.pdos = self.pdos
        indices = sorted({f"{index:04X}h" for index, _ in self.base.objects})
        made.toml = {"buses": ["can"], "without": indices} | made.toml
        self._capabilities()
        self._notes()
        made.repairs.sort(key=lambda repair: repair.line)
        return made

    # --------------------------------------------------------------- objects

    def _known(self, entry: Entry) -> Object | None:
        """What the profile defines for an object."""
        known = self.base.objects.get((entry.index, entry.subindex))
        if known is None or entry.index in GAINS or entry.index == SECOND:
            return None
        if entry.index in MAKERS and entry.name != known.name:
            return None  # another maker's, unless the file is one of ours
        if known.object_type == "VAR" and entry.kind != "VAR":
            self.sheet.tell(entry.line, entry.where, entry.kind.lower(), "it keeps what is written",
                            f"{known.name} of the profile is a variable")
            return None
        return known

    def _take(self, entry: Entry) -> None:
        address = entry.index, entry.subindex
        shown = f"{entry.index:04X}h:{entry.subindex:02X} {line(entry.name)}"
        known = self._known(entry)
        data_type = self._data_type(entry, known)
        if data_type is None:
            self.result.left_out.append(shown)
            return
        field = self.cells[address][0]["field"] if known else ""
        if known is not None and data_type != known.data_type:
            if field and self._is_number_of(data_type, known):
                pass  # the same number in more or fewer bytes
            elif known.index in NEEDED or known.name in ("modes_of_operation", "target_position"):
                self.sheet.tell(entry.line, entry.where, data_type, known.data_type,
                                "the profile has it so, and nothing works without it")
                data_type = known.data_type
            else:
                self.sheet.tell(entry.line, entry.where, data_type, "it keeps what is written",
                                f"{known.name} of the profile is an {known.data_type}")
                known, field = None, ""
        self.rows[address] = self._row(entry, data_type, known)
        if known is None and not 0x1000 <= entry.index < 0x2000:
            self.result.unknown.append(shown)

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
                                f"a PDO has {ENTRIES} at most here")
                return None
            usual = ("UNSIGNED32" if entry.subindex else "UNSIGNED8") if mapping else (
                PDO_TYPES.get(entry.subindex, "UNSIGNED8" if entry.subindex == 0 else "")
            )
            found = TYPES.get(entry.data_type, "")
            if usual and found != usual:
                self.sheet.tell(entry.line, entry.where, found or f"{entry.data_type:02X}h", usual,
                                "CiA 301 says so for PDOs")
            return usual or TYPES.get(entry.data_type)
        data_type = TYPES.get(entry.data_type)
        if data_type is None:
            if known is not None and known.index in NEEDED:
                data_type = known.data_type
            self.sheet.tell(entry.line, entry.where, f"data type {entry.data_type:02X}h",
                            data_type or "left out", "there is no such type in CiA 301")
        return data_type

    def _row(self, entry: Entry, data_type: str, known: Object | None) -> dict[str, Any]:
        access, pdo = ACCESS[entry.access]
        code = FORMATS[data_type]
        own = self.cells[entry.index, entry.subindex][0] if known else {}
        if known is not None:
            if known.access == "const" and (own["field"] or access == "ro"):
                access, pdo = "const", ""
            elif known.access == "ro" and access in ("rw", "wo"):
                self.sheet.tell(entry.line, entry.where, entry.access, "ro", "the drive makes it")
                access, pdo = "ro", "tx"
        name = known.name if known else self._name(entry)
        self.names.add(name)
        row: dict[str, Any] = {
            "index": f"0x{entry.index:04X}", "subindex": f"0x{entry.subindex:02X}", "name": name,
            "object_type": entry.kind, "data_type": data_type, "access": access,
            "pdo": pdo if entry.mappable and code else "", "section": SOURCE,
        }
        for column in ("unit", "storable", "field", "when", "hook", "note"):
            row[column] = own.get(column, "")
        if known is None:
            row["note"] = "" if 0x1000 <= entry.index < 0x2000 else "unknown: keeps what is written"
            row["storable"] = "yes" if access == "rw" and code else ""
        if not code:
            row["default"] = self._text_default(entry, data_type)
            return row
        self._numbers(entry, row, data_type, known, own)
        return row

    def _text_default(self, entry: Entry, data_type: str) -> str:
        if data_type not in LENGTHS:
            text = line(entry.default, 4096)
            if not text.isascii():
                self.sheet.tell(entry.line, entry.where, text, "its ASCII characters",
                                "a VISIBLE_STRING has no others")
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
                            "no value lies in them")
            low = high = None
        low = lowest if low is None else low
        high = highest if high is None else high
        if default is None:
            default = _held(int(known.default), data_type) if known is not None else 0
            default = min(max(default if low <= default <= high else 0, low), high)
            per_node = known.per_node if known is not None else False
        elif per_node and default + LAST_NODE > highest:
            self.sheet.tell(entry.line, entry.where, f"{default} and the node-id", str(default),
                            f"an {data_type} does not hold the sum")
            per_node, low, high = False, min(low, default), max(high, default)
        elif not per_node and not low <= default <= high:
            self.sheet.tell(entry.line, entry.where, f"default {default}, limits {low}..{high}",
                            "limits that have it", "a drive has its own default")
            low, high = min(low, default), max(high, default)
        allowed = ""
        if known is not None and not per_node and _held(default, known.data_type) == default:
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
        unset = default == 0 and known.index in UNSET
        if not possible and not unset and (entry.low or entry.high):
            return default, low, high, ""  # the file knows more values than the profile
        if not possible:
            factory = min(max(int(known.default), reach[0]), reach[1])
            self.sheet.tell(entry.line, entry.where, f"default {default}", str(factory),
                            f"{known.name} of the profile cannot be that")
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
                            f"the drive holds {span[0]}..{span[1]}")
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
                        f"an {data_type} has {lowest}..{highest}")
        return taken, per_node

    def _name(self, entry: Entry) -> str:
        own = entry.name if entry.subindex == 0 else f"{entry.group}_{entry.name}"
        name = re.sub(r"[^a-z0-9]+", "_", own.lower()).strip("_")[:80] or "object"
        name = name if not name[0].isdigit() else f"object_{name}"
        if name in self.names or name in self.base.names:
            name = f"{name}_{entry.index:04x}_{entry.subindex:02x}"
        return name

    # ----------------------------------------------------------------- units

    def _default(self, index: int, subindex: int) -> int | None:
        row = self.rows.get((index, subindex))
        if row is None or "+" in row["default"] or FORMATS[row["data_type"]] in ("", *REAL):
            return None  # not there, follows the node-id, or no integer
        return int(row["default"])

    def _said(self, index: int, subindex: int) -> int | None:
        """The default in the file itself, not the one substituted from the profile."""
        entry = self.sheet.entries.get((index, subindex))
        return self._default(index, subindex) if entry is not None and entry.default else None

    def _set(self, index: int, subindex: int, value: int, why: str) -> None:
        """Another default for an object of the factor group."""
        row, entry = self.rows[index, subindex], self.sheet.entries[index, subindex]
        value = _held(value, row["data_type"])
        self.sheet.tell(entry.line, entry.where, f"default {row['default']}", str(value), why)
        row["default"] = str(value)
        for column, beyond in (("min", -1), ("max", 1)):
            if isinstance(bound := row.get(column), int) and beyond * (value - bound) > 0:
                row[column] = ""

    def _factors(self) -> None:
        """Use the profile for objects of the factor group that are missing or 1 in the file."""
        usual = int(self.base.objects[RESOLUTION, 1].default)
        increments, turns = self._default(RESOLUTION, 1), self._default(RESOLUTION, 2)
        if increments is not None and increments <= 1:
            self._set(RESOLUTION, 1, usual, "no encoder has one increment")
            increments = usual
        increments, turns = increments or usual, turns or 1
        self._velocity_unit(increments)
        feed, per = self._default(FEED, 1), self._default(FEED, 2)
        if feed is None:
            self.result.toml.setdefault("fixed", {})["feed_constant"] = [increments, turns]
            feed, per = increments, turns
        elif feed <= 1 and (per or 1) == 1:
            self._set(FEED, 1, increments, "a position unit is then an increment")
            feed = increments
        gear = self._default(GEAR, 1) or 1, self._default(GEAR, 2) or 1
        if (FEED, 2) not in self.rows and (FEED, 1) in self.rows:
            per = 1
        fraction = Fraction(turns, increments) * Fraction(gear[1], gear[0])
        fraction *= Fraction(feed, per or 1)
        too_long = max(fraction.numerator, fraction.denominator) > FRACTION_LIMIT
        if too_long and (FEED, 1) in self.rows:
            self._set(FEED, 1, increments, "with the others it makes no exact fraction")

    def _velocity_unit(self, increments: int) -> None:
        """Read the velocity unit from 60A9h, usually 1/min with a power of ten (CiA 303-2)."""
        unit = self._default(VELOCITY_UNIT, 0) or 0
        power = (unit >> 24 ^ 0x80) - 0x80  # a signed byte
        if unit >> 8 & 0xFFFF != REVOLUTIONS_PER_MINUTE or not -6 <= power <= 0:
            return
        # position units are increments here, where the file says nothing else
        factor = increments, 60 * 10**-power
        if (VELOCITY_FACTOR, 1) not in self.rows:
            self.result.toml.setdefault("fixed", {})["velocity_factor"] = [*factor]
        elif self._default(VELOCITY_FACTOR, 1) == self._default(VELOCITY_FACTOR, 2) == 1:
            for subindex, value in enumerate(factor, 1):
                self._set(VELOCITY_FACTOR, subindex, value, "60A9h says 1/min")
        else:
            return
        self.rpm = True

    def _period(self) -> None:
        """The period of the set-points (60C2h), unless it is one that no master uses."""
        value, index = self._default(PERIOD, 1), self._default(PERIOD, 2)
        if value is None or index is None:
            return
        if not (self.rows[PERIOD, 1]["field"] and self.rows[PERIOD, 2]["field"]):
            return  # of another type: nothing follows from it
        index = _held(index, "INTEGER8")
        if index <= 0 and value * 10.0**index <= LONGEST_PERIOD:
            return
        for subindex in (1, 2):
            usual = int(self.base.objects[PERIOD, subindex].default)
            if (value, index)[subindex - 1] != usual:
                self._set(
                    PERIOD, subindex, usual, f"nobody sends set-points every {value}e{index} s"
                )

    # ------------------------------------------------------------------ PDOs

    def _pdos(self) -> None:
        """The default PDOs of the file, in the form of pdo.csv."""
        there = [index for index, _ in self.rows if 0x1400 <= index < 0x1C00]
        for direction, first in (("rx", 0x1400), ("tx", 0x1800)):
            found = [index & 0x1FF for index in there if index & 0xFC00 == first & 0xFC00]
            numbers = [n for n in found if n < MAX_PDOS]
            for n in range(max(numbers, default=-1) + 1):
                self._mapping(direction, first, n)
                self._pdo(direction, first, n)
        if not there:  # CompactPDO, or none is described: the predefined connection set
            for direction, key in (("rx", "NrOfRXPDO"), ("tx", "NrOfTXPDO")):
                try:
                    count = number(self.sheet.text("DeviceInfo", key) or "0")[0]
                except ValueError:
                    count = 0
                for n, identifier in enumerate(PREDEFINED[direction][:count]):
                    self.pdos.append((direction, n + 1, f"0x{identifier:X}+node_id", 255, 0,
                                             "", "", "", "", "empty", "inferred"))

    def _mapping(self, direction: str, first: int, n: int) -> None:
        """The mapping of a PDO; empty, but configurable, if the file does not contain it."""
        mapping = first + 0x200 + n
        if (first + n, 1) not in self.rows or (mapping, 0) in self.rows:
            return
        self.result.tell(0, f"{mapping:04X}h", f"nothing, and {first + n:04X}h is there", "empty",
                         "a master reads both of a PDO")
        for subindex in range(9):
            code = 0x07 if subindex else 0x05
            self._take(Entry(mapping, subindex, f"{direction} mapping", "RECORD", code, "rw",
                             False, "0", "", "", 0))

    def _pdo(self, direction: str, first: int, n: int) -> None:
        def value(subindex: int, otherwise: int) -> int:
            found = self._default(first + n, subindex)
            return otherwise if found is None else found

        count = self._default(first + 0x200 + n, 0) or 0
        words = [
            self._default(first + 0x200 + n, s) or 0 for s in range(1, min(count, ENTRIES) + 1)
        ]
        entries = self._entries(direction, first + 0x200 + n, [w for w in words if w])
        common = (direction, n + 1, self._identifier(direction, first + n, n),
                  value(2, 255), value(3, 0))
        for position, (index, subindex, bits) in enumerate(entries, 1):
            self.pdos.append((*common, position, f"0x{index:04X}", f"0x{subindex:02X}", bits,
                                     "", SOURCE))
        if not entries:
            self.pdos.append((*common, "", "", "", "", "empty", SOURCE))
        given = {0: len(entries)} | {
            s: i << 16 | sub << 8 | b for s, (i, sub, b) in enumerate(entries, 1)
        }
        for subindex in range(ENTRIES + 1):  # what the row says is what pdo.csv says
            row = self.rows.get((first + 0x200 + n, subindex))
            if row is not None:
                row["default"] = str(given.get(subindex, 0))

    def _identifier(self, direction: str, index: int, n: int) -> str:
        row = self.rows.get((index, 1))
        text = row["default"] if row else str(OFF)
        base, plus, _ = text.partition("+")
        cob_id, node_id = int(base, 0) & 0xFFFF_FFFF, self.sheet.node_id
        own = PREDEFINED[direction][n] if n < 4 else 0
        if not plus and node_id is not None and own and cob_id & 0x7FF == own + node_id:
            cob_id, plus = cob_id - node_id, "+"  # of a DCF: it follows the node-id
        if row is not None:
            row["default"] = f"{cob_id:#x}+node_id" if plus else str(cob_id)
        return f"0x{cob_id:08X}{'+node_id' if plus else ''}"

    def _entries(self, direction: str, index: int, words: list[int]) -> list[tuple[int, int, int]]:
        """The mapped objects that exist, in their own length."""
        entries: list[tuple[int, int, int]] = []
        total = 0
        for n, word in enumerate(words, 1):
            target, subindex, bits = mapping_entry(word)
            where = f"{index:04X}h:{n:02X}h"
            row = self.rows.get((target, subindex))
            written = self.sheet.entries.get((index, n))
            at = written.line if written else 0
            if direction == "rx" and DUMMY_BITS.get(target) == bits and subindex == 0:
                own = bits
            elif row is None or not FORMATS[row["data_type"]] or row["access"] == "const":
                self.sheet.tell(at, where, f"{word:08X}h", "left out", "no such object is mappable")
                continue
            else:
                own = 8 * SIZES[FORMATS[row["data_type"]]]
                if direction not in row["pdo"]:
                    self.sheet.tell(at, where, f"{word:08X}h, of an object that is not mappable",
                                    "mappable", "it is mapped")
                    row["pdo"] = "rxtx" if row["pdo"] else direction
            if own != bits:
                self.sheet.tell(at, where, f"{bits} bits", f"{own} bits", "the object has them")
            if total + own > MAX_BITS:
                self.sheet.tell(at, where, f"{word:08X}h", "left out", f"beyond {MAX_BITS} bits")
                continue
            total += own
            entries.append((target, subindex, own))
        return entries

    def _place(self) -> None:
        """Make objects without a default PDO unmappable if the record has no room for them."""
        used = {(int(row[6], 0), int(row[7], 0)) for row in self.pdos if row[6] != ""}
        room, lost = VENDOR_BYTES, 0
        order = sorted(self.rows, key=lambda address: (address not in used, address))
        for address in order:
            row = self.rows[address]
            own = row["pdo"] and not row["field"] and parameter_place(*address) is None
            if not own or row["access"] == "const":
                continue
            size = 2 * SIZES[FORMATS[row["data_type"]]]  # with what its alignment may take
            if size > room:
                row["pdo"] = ""
                lost += 1
            else:
                room -= size
        if lost:
            why = f"a PDO reaches {VENDOR_BYTES} bytes of a maker's objects"
            self.result.tell(0, "PDOs", f"{lost} more objects can be mapped", "they cannot", why)

    # --------------------------------------------------------------- the rest

    def _capabilities(self) -> None:
        bits = self._said(0x6502, 0) or 0
        standard = [mode for mode in self.base.modes if mode > 0]
        modes = [mode for mode in standard if bits >> mode_bit(mode) & 1]
        indices = {index for index, _ in self.rows}
        self.modes_said = bool(modes)
        if not modes:
            modes = [m for m in standard if indices.issuperset(self.needs.get(m, ()))]
        said = {self._said(0x60E3, n) for n in range(1, 255)}
        methods = [method for method in self.base.homing_methods if method in said]
        self.methods_said = bool(methods)
        if (mode := self._mode(modes)) is not None:
            modes = sorted({*modes, mode})
        table: dict[str, Any] = {}
        if modes:
            table["modes"] = [MODE_ABBREVIATION[mode] for mode in modes]
        if methods:
            table["homing_methods"] = methods
        self.result.toml["capabilities"] = table

    def _mode(self, modes: list[Mode]) -> Mode | None:
        """The mode of a drive with a read-only 6060h, from the set-point in its RPDOs."""
        row = self.rows.get((0x6060, 0))
        if row is not None and row["access"] not in ("ro", "const"):
            return None
        mapped = {int(pdo[6], 0) for pdo in self.pdos if pdo[0] == "rx" and pdo[6] != ""}
        mode = next((mode for index, mode in SET_POINTS.items() if index in mapped), None)
        if mode is not None and row is None:
            self.sheet.tell(0, "6060h", "missing", str(int(mode)), "its PDO has this set-point")
            self.result.toml.setdefault("fixed", {})["modes_of_operation"] = int(mode)
            return mode
        if mode is None or row is None or int(row["default"]) in modes:
            return None
        self._set(0x6060, 0, int(mode), "it is read-only, and its PDO has this set-point")
        return mode

    def _notes(self) -> None:
        made, node_id = self.result, self.sheet.node_id
        methods = "from 60E3h" if self.methods_said else (
            "`inferred`: those of `generic`, 60E3h names none")
        modes = "from 6502h" if self.modes_said else (
            "`inferred`: those whose objects are there, 6502h has no default")
        units = (
            "from 608Fh, 6091h, 6092h"
            if (FEED, 1) in self.rows
            else ("`inferred`: a position unit is an increment of the encoder, 6092h is missing")
        )
        velocity = " Velocities: in 1/min, as 60A9h says." if self.rpm else ""
        made.notes = [
            "An EDS tells objects, types, ranges, defaults and PDOs. It does not tell what the "
            "drive does: behaviour of the objects that CiA 402 knows is `inferred`, that of the "
            "model `generic`.",
            "Cycle times, motor, faults: `inferred`, those of `generic`. Correct them in "
            "`drive.toml`.",
            f"Modes of operation: {modes}. Homing methods: {methods}.",
            f"Units: {units}.{velocity} Gains, what 1010h stores of the drive's own objects: "
            "`inferred`.",
        ]
        if node_id is not None:
            made.notes.append(
                f"A DCF of node {node_id}: defaults are its values; serve it with `--node-id "
                f"{node_id}`."
            )


def _last(sheet: Sheet) -> int:
    return max((entry.line for entry in sheet.entries.values()), default=1)


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
    if known is None or SIZES[FORMATS[data_type]] <= known.size:
        return low, high
    least, most = _span(known.data_type)
    return max(low, least), min(high, most)


def _held(value: int, data_type: str) -> int:
    """Convert a number of the profile to a type of the file: same bits, or nearest value."""
    low, high = _span(data_type)
    bits = high - low + 1
    if -bits // 2 <= value < bits:
        return (value - low) % bits + low
    return min(max(value, low), high)
