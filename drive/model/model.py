"""A drive model: a folder with `drive.toml`, `objects.csv`, `pdo.csv` and `faults.csv`.

The folder is all there is to a model; the kernel reads its numbers and flags from the record. A row
that cannot be right is refused when the model is loaded, with file, line and reason.
"""

import functools
import math
import re
import tomllib
from collections.abc import Iterable
from dataclasses import dataclass, replace
from importlib import metadata, resources
from pathlib import Path
from typing import Any

import numpy as np

from ..kernel.faults import Cause
from ..kernel.process_data import MAX_BITS
from ..kernel.record import FIELDS, OD, Axis
from ..kernel.words import Mode
from .capabilities import read_capabilities, with_capabilities
from .ethercat import EtherCat, need_assignment, read_ethercat
from .near import near
from .pdo import Mapping, read_pdos
from .rows import (
    Cells,
    Fault,
    Object,
    own_stored,
    read_cells,
    read_faults,
    read_objects,
    read_text,
    referred,
    with_sections,
)

# Departures from the standard a model may declare: fields of the record that the kernel reads, and
# flags of the Python around it.
_FIRST = [name for name, *_ in FIELDS].index("older_factor_group")
_LAST = [name for name, *_ in FIELDS].index("history_depth")
KERNEL_QUIRKS = tuple(name for name, *_ in FIELDS[_FIRST : _LAST + 1])
QUIRKS = {name: text for name, _, _, text, *_ in FIELDS if name in KERNEL_QUIRKS} | {
    "load_at_once": "1: 1011h acts at once and needs the power stage off",
    "pdo_needs_stop": "1: PDO parameters may only change outside NMT operational",
    "cyclic_event": "1: transmission type 254 sends with the inhibit time as period",
    "transmit_masks": "1: 2014h-2017h choose the bits whose change sends a TPDO",
    "emcy_internal_code": "1: bytes 6 and 7 of an EMCY are the manufacturer's fault number",
    "only_faults_are_told": "1: a lost connection sends an EMCY only with 6007h = 1",
    "rpdo_counts_syncs": "1: an RPDO of type n is used at every n-th SYNC",
    "upload_without_size": "1: an expedited upload of 2001h-2FFFh is answered by 42h",
    "writes_are_stored": "1: what can be stored is stored with each write",
    "shortest_gap_of_tpdo_2": "ms between two of them, whatever the inhibit time says",
    "alias_saves": "1: a station alias that is written makes the drive save its parameters",
    "empty_history_reads_0": "1: a field of 1003h without an error reads 0 instead of 08000024h",
    "identifier_needs_valid_bit": "1: bit 30 of PDO identifiers always reads 1",
}
KINDS: dict[str, type] = {  # of what drive.toml may say
    "title": str, "standard": str, "based_on": str, "objects_of": str, "axes": int, "buses": list,
    "without": list, "cycle_time_us": dict, "motor": dict, "capabilities": dict, "quirks": dict,
    "fixed": dict, "units": dict, "defaults": dict, "abort_codes": dict, "sections": dict,
}  # fmt: skip
KEYS = {  # of the tables whose keys no other table of this file lists
    "cycle_time_us": ("current", "velocity", "position"),
    "motor": ("torque_time_constant_us", "rotor_inertia_kgm2"),
    "capabilities": ("modes", "homing_methods"),
}
STANDARD = "generic"  # its objects.csv has the objects of CiA 301 and CiA 402
ENTRY_POINTS = "servogym.drives"  # of other packages: a name, and the folder it stands for
BUSES = {"can": MAX_BITS, "ethercat": 512}  # field bus -> longest PDO in bits
ETHERCAT_FILES = ("ethercat.toml", "ethercat_objects.csv", "ethercat_pdo.csv")
COMMANDS = {"can": "`servogym node`", "ethercat": "`servogym ethercat`"}  # what puts it there
# [units] of drive.toml: field of the record, value without an entry
UNITS = {"position_gain": 1e-3, "velocity_gain": 1e-6, "temperature": 0.1}
WITHOUT_POSITION = (
    Mode.VELOCITY, Mode.PROFILE_VELOCITY, Mode.PROFILE_TORQUE,
    Mode.CYCLIC_SYNC_VELOCITY, Mode.CYCLIC_SYNC_TORQUE,
)  # fmt: skip


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
    based_on: Path | None  # folder of the model whose files hold where this one says nothing
    title: str
    standard: str
    cycle_time: dict[str, float]  # "current", "velocity", "position" (s)
    torque_time_constant: float  # (s)
    rotor_inertia: float  # (kg·m²)
    modes: tuple[Mode, ...]
    homing_methods: tuple[int, ...]
    quirks: dict[str, Quirk]
    abort_codes: dict[int, int]  # what the manual prints in place of a code of CiA 301
    units: dict[str, float]
    fixed: dict[str, Any]  # values of `od` fields that the model has no object for
    buses: tuple[str, ...]  # keys of `BUSES`: the field buses there are for it
    bus: str  # the one this model is on; objects and PDOs are those it has there
    ethercat: EtherCat | None  # on that bus only
    axes: int  # drives in one housing, with consecutive node-ids
    objects: dict[tuple[int, int], Object]
    names: dict[str, Object]
    rpdos: tuple[Mapping, ...]
    tpdos: tuple[Mapping, ...]
    faults: tuple[Fault, ...]
    own_stored: tuple[tuple[int, int, int], ...]  # `rows.own_stored`

    def __reduce__(self):
        own = self.folder == _builtin().get(self.name)
        return load, (self.name if own else str(self.folder), self.bus)

    def fault_key(self, code: int, cause: int, node: int = 0) -> int:
        """Manufacturer's number of a fault, main part in the high byte; 0 if it has none.

        Of several rows with the error code that of the cause counts, else the first. The low byte
        of a lost connection is the `node` whose heartbeat is missing, if that is how it was lost.
        """
        rows = [fault for fault in self.faults if fault.code == code and fault.main is not None]
        for fault in sorted(rows, key=lambda fault: fault.cause != cause):
            lost = node if fault.cause is Cause.CONNECTION else 0
            return (fault.main or 0) << 8 | (lost or fault.sub or 0)
        return 0

    def power_on(self, axis: Axis) -> None:
        """Fill a zeroed record with what the model fixes and the factory defaults."""
        axis.position_period = self.cycle_time["position"]
        axis.velocity_period = self.cycle_time["velocity"]
        axis.velocity_cycles = round(self.cycle_time["position"] / self.cycle_time["velocity"])
        axis.torque_time_constant = self.torque_time_constant
        for name, value in self.units.items():
            setattr(axis, f"{name}_unit", value)
        for name in KERNEL_QUIRKS:
            setattr(axis, name, self.quirk(name))
        vendor = OD.fields["vendor"][1]  # type: ignore[index]
        for j, (offset, size, kind) in enumerate(self.own_stored):
            axis.own_place[j], axis.own_size[j], axis.own_kind[j] = offset - vendor, size, kind
        axis.supported_modes = sum(1 << (mode - 1) for mode in self.modes)
        axis.ambient_temperature = 25.0
        axis.enable_input = 1
        axis.terminals = 0x03  # S1IND and S2IND are wired to 24 V
        axis.sto_input = 1
        codes, numbers, registers = axis.fault_code, axis.fault_number, axis.fault_register
        for fault in reversed(self.faults):  # of two rows with one cause the first counts
            codes[fault.cause] = fault.code
            numbers[fault.cause] = (fault.main or 0) << 4 | (fault.sub or 0)
            registers[fault.cause] = 1 | 1 << fault.register
        self.set_reactions(axis)
        for name, value in self.fixed.items():
            if isinstance(value, list):
                getattr(axis.od, name)[: len(value)] = value
            else:
                setattr(axis.od, name, value)
        axis.parameters_changed = 1

    def set_reactions(self, axis: Axis) -> None:
        """The reactions of faults.csv; of two rows with one cause the first counts."""
        reactions = axis.od.fault_reaction
        for fault in reversed(self.faults):
            reactions[fault.cause] = fault.reaction

    @property
    def homes_here(self) -> int:
        """Homing method on the current position: 37, or 35 where only the older number is known."""
        return 37 if 37 in self.homing_methods else 35

    @property
    def positions(self) -> bool:
        """Whether the drive has a mode with a position controller, other than an inverter."""
        return any(mode not in WITHOUT_POSITION for mode in self.modes)

    def number(self, name: str) -> Object:
        """The object of this name. Raises ValueError where the model has none, or a string."""
        row = self.names.get(name)
        if row is None or not row.format:
            numbers = [each for each, row in self.names.items() if row.format]
            hint = near(name, numbers, "see objects.csv of the model, or ask by index")
            raise ValueError(f"{self.name} has no number {name!r}: {hint}")
        return row

    def quirk(self, name: str) -> int:
        """Value of a departure from the standard, 0 where the model has none."""
        return self.quirks[name].value if name in self.quirks else 0


@functools.cache
def _builtin() -> dict[str, Path]:
    """Folders of the models that come with the laboratory, by name."""
    folder = Path(str(resources.files("servogym.assets"))) / "drives"
    return {path.parent.name: path.parent.resolve() for path in folder.glob("*/drive.toml")}


def model_names() -> list[str]:
    """Names of the models that come with the laboratory."""
    return sorted(_builtin())


def foreign_names() -> list[str]:
    """Names of the models that other packages declare, as entry points ``servogym.drives``."""
    return sorted({point.name for point in metadata.entry_points(group=ENTRY_POINTS)})


def load(model: "str | Path | DriveModel", bus: str | None = None) -> DriveModel:
    """A model by name, or from the path of a folder of your own.

    A name is one of this package, or an entry point ``servogym.drives`` of another: a module whose
    folder it is, or an object that is the path. `bus` is "can" or "ethercat", without it the first
    one the model has. What a drive does is the same on both; only its communication objects and
    PDOs differ.

    Raises ValueError, naming the known models or buses, or file, line and reason of a wrong row.
    """
    if not isinstance(model, (str, Path, DriveModel)):
        raise ValueError(
            f"drive = {model!r}: give a drive model by name, as folder or loaded; the names are "
            f"{', '.join(model_names())}"
        )
    if isinstance(model, DriveModel):
        return model if bus in (None, model.bus) else _load(model.folder, bus)
    return _load(_folder(model), bus)


def _folder(model: str | Path, beside: Path | None = None) -> Path:
    """The folder of a model; a path is looked for from the folder `beside`, too."""
    if str(model) in _builtin():
        return _builtin()[str(model)]
    folder = Path(model)
    if beside is not None and (beside / folder / "drive.toml").exists():
        folder = beside / folder
    elif len(folder.parts) == 1 and (
        points := metadata.entry_points(group=ENTRY_POINTS, name=str(model))
    ):  # a name, no path: to look through all packages takes a while
        folder = _declared(next(iter(points)))
    if not (folder / "drive.toml").exists():
        hint = near(str(model), [*model_names(), *foreign_names()])
        raise ValueError(
            f"unknown drive model {str(model)!r}: {hint}, "
            "or give the path of a folder with drive.toml, objects.csv, pdo.csv, faults.csv"
        )
    return folder.resolve()


def _ancestors(folder: Path) -> list[tuple[Path, dict[str, Any]]]:
    """The folder and those it is based on, each with its drive.toml."""
    files = [(folder, _read_toml(folder / "drive.toml"))]
    while "based_on" in files[-1][1]:
        base = _folder(files[-1][1]["based_on"], files[-1][0])
        if base in (folder for folder, _ in files):
            raise ValueError(f"{files[-1][0] / 'drive.toml'}: based_on leads back to {base.name!r}")
        files.append((base, _read_toml(base / "drive.toml")))
    return files


@functools.cache
def _cells(folder: Path, referring: tuple[Path, ...] = ()) -> Cells:
    """The rows of a model's objects.csv, on top of those of the model it is based on.

    `referring` are the models on the way here; one that comes back to them is refused.
    """
    if folder in referring:
        raise ValueError(f"{folder / 'drive.toml'}: objects_of leads back to {folder.name!r}")
    referring = (*referring, folder)
    base, *more = _ancestors(folder)
    path, toml = base
    cells = _cells(more[0][0], referring) if more else {}
    for index in toml.get("without", ()):
        if not any(f"{known:04X}h" == index for known, _ in cells):
            raise ValueError(f"{path / 'drive.toml'}: without: the base has no object {index!r}")
    cells = {a: row for a, row in cells.items() if f"{a[0]:04X}h" not in toml.get("without", ())}
    if not (path / "objects.csv").exists():
        if not more:
            raise ValueError(f"{path} has no objects.csv: write it, or say based_on in drive.toml")
        return cells
    standard = _folder(toml.get("objects_of", STANDARD), path)
    return referred(
        read_cells(path / "objects.csv"),
        cells,
        {} if standard == folder else _cells(standard, referring),
    )


def _declared(point: metadata.EntryPoint) -> Path:
    """The folder an entry point stands for."""
    try:
        found = point.load()
        file = getattr(found, "__file__", None)
        folder = Path(file).parent if file else Path(found)
    except Exception as error:
        raise ValueError(
            f"drive model {point.name!r}: its entry point {point.value} fails "
            f"({type(error).__name__}: {error})"
        ) from error
    if not (folder / "drive.toml").exists():
        raise ValueError(
            f"drive model {point.name!r}: its entry point {point.value} is {folder}, "
            "where there is no drive.toml"
        )
    return folder


@functools.cache
def _load(folder: Path, bus: str | None) -> DriveModel:
    ancestors = _ancestors(folder)
    toml: dict[str, Any] = {}
    for _, own in reversed(ancestors):  # another model, with what this one says instead
        toml = _merged(toml, own)
    file = {
        name: next((f / name for f, _ in ancestors if (f / name).exists()), folder / name)
        for name in ("pdo.csv", "faults.csv", *ETHERCAT_FILES)
    }
    reader = _Toml(folder / "drive.toml", toml)
    buses = reader.buses()
    if bus is None:
        return _load(folder, buses[0])
    if bus not in buses:
        raise ValueError(
            f"drive {folder.name!r} is not for {bus}, but for {' and '.join(buses)}: "
            f"use {' or '.join(COMMANDS[name] for name in buses)}"
        )
    ethercat, cells = None, _cells(folder)
    missing: tuple[str, ...] = ()
    if bus == "ethercat":
        ethercat, missing = read_ethercat(file["ethercat.toml"])
        if file["ethercat_objects.csv"].exists():
            cells = referred(read_cells(file["ethercat_objects.csv"]), cells, {})
        if file["ethercat_pdo.csv"].exists():
            file["pdo.csv"] = file["ethercat_pdo.csv"]
    objects = {  # on every bus at the same place of the record
        a: row for a, row in read_objects(cells).items() if f"{a[0]:04X}h" not in missing
    }
    if bus == "ethercat":
        need_assignment(objects, folder / "objects.csv")
    modes, methods = read_capabilities(reader.table("capabilities"), reader.path)
    objects = with_capabilities(objects, modes, methods)
    objects = with_sections(_with_defaults(objects, toml, reader.path), toml.get("sections", {}))
    rpdos, tpdos = read_pdos(file["pdo.csv"], objects, BUSES[bus])
    for row in objects.values():
        number = {"rpdo": len(rpdos), "tpdo": len(tpdos)}.get(row.area)
        if number is not None and row.index & 0x1FF >= number and bus == "can":
            raise ValueError(f"{row.where}: {file['pdo.csv']} has only {number} {row.area}s")
    microseconds = reader.cycle_times()
    motor = reader.numbers("motor", KEYS["motor"])
    reader.known("quirks", QUIRKS)
    reader.known("fixed", OD.names or ())
    reader.known("units", UNITS)
    return DriveModel(
        name=folder.name,
        folder=folder,
        based_on=ancestors[1][0] if len(ancestors) > 1 else None,
        title=toml.get("title", folder.name),
        standard=toml.get("standard", ""),
        cycle_time={name: value * 1e-6 for name, value in microseconds.items()},
        torque_time_constant=motor["torque_time_constant_us"] * 1e-6,
        rotor_inertia=motor["rotor_inertia_kgm2"],
        modes=modes,
        homing_methods=methods,
        quirks={k: Quirk(int(v["value"]), v["source"]) for k, v in toml.get("quirks", {}).items()},
        abort_codes={int(k[:-1], 16): v["value"] for k, v in toml.get("abort_codes", {}).items()},
        units=UNITS | toml.get("units", {}),
        fixed=toml.get("fixed", {}),
        buses=buses,
        bus=bus,
        ethercat=ethercat,
        axes=int(toml.get("axes", 1)),
        objects=objects,
        names={row.name: row for row in objects.values()},
        rpdos=rpdos,
        tpdos=tpdos,
        faults=read_faults(file["faults.csv"]),
        own_stored=own_stored(objects) if "values_keep_meaning" in toml.get("quirks", {}) else (),
    )


def _read_toml(path: Path) -> dict[str, Any]:
    try:
        toml = tomllib.loads(read_text(path))
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise ValueError(f"{path}: {error}") from None
    _refuse_unknown(toml, KINDS, path)
    for key, kind in KINDS.items():
        if not isinstance(toml.get(key, kind()), kind):
            raise ValueError(f"{path}: {key} = {toml[key]!r} is no {kind.__name__}")
    for table, keys in KEYS.items():
        _refuse_unknown(toml.get(table, {}), keys, path, f"{table}.")
    if not 1 <= toml.get("axes", 1) <= 127:
        raise ValueError(f"{path}: axes = {toml['axes']} is out of range 1..127")
    for name, quirk in toml.get("quirks", {}).items():
        if name not in QUIRKS:
            continue  # told with the known ones
        fits = isinstance(quirk, dict) and isinstance(quirk.get("source"), str)
        if not fits or not isinstance(quirk.get("value"), int) or abs(quirk["value"]) >= 1 << 31:
            raise ValueError(f'{path}: quirks.{name} is not like {{ value = 1, source = "5.1" }}')
    for name, code in toml.get("abort_codes", {}).items():
        value = code.get("value") if isinstance(code, dict) else None
        if not re.fullmatch("[0-9A-F]{8}h", name) or not isinstance(value, int):
            raise ValueError(
                f"{path}: abort_codes.{name} is not like "
                '"06090031h" = { value = 0x06090030, source = "8.7" }'
            )
        if not 0 < value < 1 << 32:
            raise ValueError(f"{path}: abort_codes.{name} = {value} has more than 32 bits")
    for name in ("modes", "homing_methods"):
        if not isinstance(toml.get("capabilities", {}).get(name, []), list):
            raise ValueError(f"{path}: capabilities.{name} is no list")
    for name, value in toml.get("units", {}).items():
        if not isinstance(value, int | float) or not 0 < value < 1e9:
            raise ValueError(f"{path}: units.{name} = {value!r} is no number above 0")
    for name, value in toml.get("fixed", {}).items():
        if name in (OD.names or ()) and not _fits(value, OD[name]):
            raise ValueError(f"{path}: fixed.{name} = {value!r} does not fit {OD[name]}")
    return toml


def _refuse_unknown(table: dict[str, Any], known: Iterable[str], path: Path, of: str = "") -> None:
    """Refuse a key that means nothing: most often one that is spelt in another way."""
    for key in table:
        if key not in known:
            raise ValueError(f"{path}: {of}{key} is unknown: {near(key, known)}")


def _fits(value: Any, kind: np.dtype) -> bool:
    """Whether a value of drive.toml, or a list of them, can stand in a field of the record."""
    values = value if isinstance(value, list) else [value]
    room = kind.shape[0] if kind.shape else 1
    if isinstance(value, list) != bool(kind.shape) or len(values) > room:
        return False
    if any(isinstance(v, bool) or not isinstance(v, int | float) for v in values):
        return False
    if kind.base.kind == "f":
        return all(math.isfinite(v) for v in values)
    low, high = np.iinfo(kind.base).min, np.iinfo(kind.base).max
    return all(isinstance(v, int) and low <= v <= high for v in values)


def _merged(base: dict[str, Any], own: dict[str, Any]) -> dict[str, Any]:
    """Tables of `base` with the entries of `own` in place of theirs."""
    return base | {
        key: base[key] | value if isinstance(value, dict) and isinstance(base.get(key), dict)
        else value
        for key, value in own.items()
    }  # fmt: skip


def _with_defaults(objects: dict[tuple[int, int], Object], toml: dict[str, Any], path: Path):
    """The objects with the values of the table `defaults`, by name."""
    names = {row.name: address for address, row in objects.items()}
    for name, value in toml.get("defaults", {}).items():
        if name not in names:
            raise ValueError(f"{path}: defaults.{name}: there is no such object")
        row = objects[names[name]]
        number = isinstance(value, int) or (row.format == "f" and isinstance(value, float))
        fits = row.minimum <= value <= row.maximum if number and row.format else False
        if not fits and not (isinstance(value, str) and not row.format):
            raise ValueError(f"{path}: defaults.{name} = {value!r} does not fit {row.data_type}")
        objects[names[name]] = replace(row, default=value)
    return objects


@dataclass
class _Toml:
    path: Path
    data: dict[str, Any]

    def table(self, name: str) -> dict[str, Any]:
        if not isinstance(self.data.get(name), dict):
            raise ValueError(f"{self.path}: the table [{name}] is missing")
        return self.data[name]

    def known(self, name: str, known: Iterable[str]) -> None:
        """Refuse a key of a table that means nothing."""
        _refuse_unknown(self.data.get(name, {}), known, self.path, f"{name}.")

    def buses(self) -> tuple[str, ...]:
        """The field buses, "can" where nothing is said."""
        buses = self.data.get("buses", ["can"])
        if not isinstance(buses, list) or not buses:
            raise ValueError(f'{self.path}: buses = {buses!r} is no list like ["can"]')
        for bus in buses:
            if bus not in BUSES:
                raise ValueError(f"{self.path}: unknown bus {bus!r}, known: {', '.join(BUSES)}")
        return tuple(buses)

    def cycle_times(self) -> dict[str, float]:
        """Cycle times (µs); the position cycle is a multiple of the velocity cycle."""
        times = self.numbers("cycle_time_us", KEYS["cycle_time_us"])
        ratio = times["position"] / times["velocity"] if times["velocity"] else 0.0
        if ratio < 1 or ratio != int(ratio):
            raise ValueError(
                f"{self.path}: cycle_time_us.position = {times['position']} is not a whole "
                f"multiple of cycle_time_us.velocity = {times['velocity']}"
            )
        return times

    def numbers(self, name: str, keys: tuple[str, ...]) -> dict[str, float]:
        table = self.table(name)
        for key in keys:
            value = table.get(key)
            if not isinstance(value, int | float) or not 0 <= value < 1e9:
                raise ValueError(f"{self.path}: {name}.{key} = {value!r} is not a number >= 0")
        return {key: float(table[key]) for key in keys}
