"""A drive model: a folder with `drive.toml`, `objects.csv`, `pdo.csv` and `faults.csv`.

The folder is all there is to a model; the kernel reads its numbers and flags from the record. A row
that cannot be right is refused when the model is loaded, with file, line and reason.
"""

import csv
import functools
import re
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from .faults import Cause, Reaction
from .homing import NUMBERS
from .process_data import ENTRIES, MAX_BITS
from .record import OD, VENDOR_BYTES
from .words import MODE_ABBREVIATION, Mode

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
}
SIZES = {"B": 1, "b": 1, "H": 2, "h": 2, "I": 4, "i": 4, "Q": 8, "q": 8, "f": 4, "": 0}
ACCESS = ("ro", "wo", "rw", "const")
PDO_USE = ("", "rx", "tx", "rxtx")
QUIRKS = ("older_factor_group",)  # flags a model may raise; each is a field of the record
MODES = {abbreviation: mode for mode, abbreviation in MODE_ABBREVIATION.items()}


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
    area: str  # "axis", "rpdo", "tpdo" or "constant"
    offset: int
    when: str
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
    meaning: str
    register: int
    cause: Cause
    reaction: Reaction
    section: str


@dataclass(frozen=True)
class Quirk:
    """A departure from the standard, with where the manual says so."""

    value: int
    source: str


@dataclass(frozen=True, eq=False)
class DriveModel:
    """Everything that makes a drive the one it is; shared by all its drives, never changed."""

    name: str
    folder: Path
    title: str
    standard: str
    cycle_time: dict[str, float]  # "current", "velocity", "position" (s)
    torque_time_constant: float  # (s)
    rotor_inertia: float  # (kg·m²)
    modes: tuple[Mode, ...]
    homing_methods: tuple[int, ...]
    quirks: dict[str, Quirk]
    objects: dict[tuple[int, int], Object]
    names: dict[str, Object]
    rpdos: tuple[Mapping, ...]
    tpdos: tuple[Mapping, ...]
    faults: tuple[Fault, ...]

    def __reduce__(self):
        return load, (self.name if self.folder == _builtin() / self.name else str(self.folder),)

    def power_on(self, axis: Any) -> None:
        """Fill a zeroed record with what the model fixes and the factory defaults."""
        axis.position_period = self.cycle_time["position"]
        axis.velocity_period = self.cycle_time["velocity"]
        axis.velocity_cycles = round(self.cycle_time["position"] / self.cycle_time["velocity"])
        axis.torque_time_constant = self.torque_time_constant
        for name, quirk in self.quirks.items():
            setattr(axis, name, quirk.value)
        axis.supported_modes = sum(1 << (mode - 1) for mode in self.modes)
        axis.ambient_temperature = 25.0
        axis.enable_input = 1
        axis.sto_input = 1
        for fault in self.faults:
            axis.fault_code[fault.cause] = fault.code
            axis.fault_register[fault.cause] = 1 | 1 << fault.register
            axis.od.fault_reaction[fault.cause] = fault.reaction
        axis.parameters_changed = 1


def _builtin() -> Path:
    return Path(str(resources.files("servogym.assets"))) / "drives"


def model_names() -> list[str]:
    """Names of the models that come with the laboratory."""
    return sorted(path.parent.name for path in _builtin().glob("*/drive.toml"))


def load(model: "str | Path | DriveModel") -> DriveModel:
    """A model by name, or from the path of a folder of your own.

    Raises ValueError, naming the known models, or the file, line and reason of a wrong row.
    """
    if isinstance(model, DriveModel):
        return model
    folder = _builtin() / str(model)
    if str(model) not in model_names():
        folder = Path(model)
        if not (folder / "drive.toml").is_file():
            known = ", ".join(model_names())
            raise ValueError(
                f"unknown drive model {str(model)!r}: choose one of {known}, "
                "or give the path of a folder with drive.toml, objects.csv, pdo.csv, faults.csv"
            )
    return _load(folder.resolve())


@functools.cache
def _load(folder: Path) -> DriveModel:
    try:
        toml = tomllib.loads((folder / "drive.toml").read_text(encoding="utf-8"))
    except tomllib.TOMLDecodeError as error:
        raise ValueError(f"{folder / 'drive.toml'}: {error}") from None
    reader = _Toml(folder / "drive.toml", toml)
    objects = _read_objects(folder / "objects.csv")
    names = {row.name: row for row in objects.values()}
    rpdos, tpdos = _read_pdos(folder / "pdo.csv", objects)
    microseconds = reader.numbers("cycle_time_us", ("current", "velocity", "position"))
    ratio = microseconds["position"] / microseconds["velocity"]
    if ratio < 1 or ratio != int(ratio):
        raise ValueError(
            f"{reader.path}: cycle_time_us.position = {microseconds['position']} is not a whole "
            f"multiple of cycle_time_us.velocity = {microseconds['velocity']}"
        )
    for name in toml.get("quirks", {}):
        if name not in QUIRKS:
            raise ValueError(f"{reader.path}: unknown quirk {name!r}, known: {', '.join(QUIRKS)}")
    motor = reader.numbers("motor", ("torque_time_constant_us", "rotor_inertia_kgm2"))
    capabilities = reader.table("capabilities")
    for name in capabilities.get("modes", ()):
        if name not in MODES:
            raise ValueError(f"{reader.path}: unknown mode {name!r}, known: {', '.join(MODES)}")
    for method in capabilities.get("homing_methods", ()):
        if method not in NUMBERS:
            raise ValueError(f"{reader.path}: unknown homing method {method}, known: {NUMBERS}")
    return DriveModel(
        name=folder.name,
        folder=folder,
        title=toml.get("title", folder.name),
        standard=toml.get("standard", ""),
        cycle_time={name: value * 1e-6 for name, value in microseconds.items()},
        torque_time_constant=motor["torque_time_constant_us"] * 1e-6,
        rotor_inertia=motor["rotor_inertia_kgm2"],
        modes=tuple(MODES[name] for name in capabilities.get("modes", ())),
        homing_methods=tuple(capabilities.get("homing_methods", ())),
        quirks={k: Quirk(int(v["value"]), v["source"]) for k, v in toml.get("quirks", {}).items()},
        objects=objects,
        names=names,
        rpdos=rpdos,
        tpdos=tpdos,
        faults=_read_faults(folder / "faults.csv"),
    )


@dataclass
class _Toml:
    path: Path
    data: dict[str, Any]

    def table(self, name: str) -> dict[str, Any]:
        if not isinstance(self.data.get(name), dict):
            raise ValueError(f"{self.path}: the table [{name}] is missing")
        return self.data[name]

    def numbers(self, name: str, keys: tuple[str, ...]) -> dict[str, float]:
        table = self.table(name)
        for key in keys:
            value = table.get(key)
            if not isinstance(value, int | float) or not 0 <= value < 1e9:
                raise ValueError(f"{self.path}: {name}.{key} = {value!r} is not a number >= 0")
        return {key: float(table[key]) for key in keys}


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


def _read_objects(path: Path) -> dict[tuple[int, int], Object]:
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
        size = SIZES[FORMATS[row["data_type"]]]
        area, offset = "axis", 0
        if row["field"]:
            offset = _field_offset(row["field"], row["data_type"], where)
        elif row["data_type"] == "VISIBLE_STRING" or row["access"] == "const":
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
        allowed = frozenset(_integer(v, where, "min") for v in row["min"].strip("{}").split(";"))
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
        row["section"], row["note"], area, offset, row["when"], bool(plus),
    )  # fmt: skip


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
    if base != np.dtype("<" + FORMATS[data_type]):
        raise ValueError(f"{where}: od.{match[1]} is {base.name}, not {data_type}")
    return offset + int(match[2] or 0) * base.itemsize


def _read_pdos(path: Path, objects) -> tuple[tuple[Mapping, ...], tuple[Mapping, ...]]:
    found: dict[str, dict[int, Mapping]] = {"rx": {}, "tx": {}}
    for row, where in _rows(path):
        direction = row["direction"].lower()
        if direction not in found:
            raise ValueError(f"{where}: direction {row['direction']!r} is neither rx nor tx")
        number = _integer(row["number"], where, "number")
        before = found[direction].get(number)
        entries = before.entries if before else ()
        if row["index"]:  # a row without one is a PDO that is free for mapping
            entries = (*entries, _pdo_entry(row, where, direction, objects))
        if sum(bits for _, _, bits in entries) > MAX_BITS or len(entries) > ENTRIES:
            raise ValueError(f"{where}: PDO {number} is longer than {MAX_BITS} bits")
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


def _pdo_entry(row, where, direction, objects) -> tuple[int, int, int]:
    index, subindex, bits = (
        _integer(row[key], where, key) for key in ("index", "subindex", "bits")
    )
    target = objects.get((index, subindex))
    if target is None or direction not in target.pdo or target.size * 8 != bits:
        raise ValueError(
            f"{where}: {index:04X}h:{subindex:02X}h with {bits} bits cannot be mapped to a "
            f"{direction} PDO"
        )
    return index, subindex, bits


def _read_faults(path: Path) -> tuple[Fault, ...]:
    faults = []
    for row, where in _rows(path):
        for column, known in (("cause", Cause), ("reaction", Reaction)):
            if row[column] not in known.__members__:
                raise ValueError(f"{where}: {column} {row[column]!r} is none of {[*known]}")
        faults.append(
            Fault(
                _integer(row["emcy_code"], where, "emcy_code"),
                row["meaning"],
                _integer(row["error_register_bit"] or "0", where, "error_register_bit"),
                Cause[row["cause"]],
                Reaction[row["reaction"]],
                row["section"],
            )
        )
    return tuple(faults)
