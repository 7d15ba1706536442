"""A drive model: a folder with `drive.toml`, `objects.csv`, `pdo.csv` and `faults.csv`.

The folder is the whole model; the kernel reads its numbers and flags from the record. Loading
refuses an impossible row with file, line and reason.
"""

import functools
from dataclasses import dataclass, replace
from importlib import metadata, resources
from pathlib import Path
from typing import Any

from ..kernel.faults import Cause
from ..kernel.homing import METHODS, Method, with_own
from ..kernel.record import OD, Axis
from ..kernel.words import Mode, ModeWords, mode_bit, mode_words
from .capabilities import read_capabilities, read_own_modes, with_capabilities
from .drive_toml import BUSES, KERNEL_QUIRKS, KEYS, QUIRKS, UNITS, Toml, merged, read_toml
from .ethercat import EtherCat, need_assignment, read_ethercat
from .homing import FILE as HOMING_FILE
from .homing import read_homing
from .names import hint
from .pdo import Mapping, read_pdos
from .rows import (
    Cells,
    Fault,
    Object,
    own_stored,
    read_cells,
    read_faults,
    read_objects,
    referred,
    with_sections,
)

STANDARD = "generic"  # its objects.csv has the objects of CiA 301 and CiA 402
ENTRY_POINTS = "servogym.drives"  # of other packages: a name, and the folder it stands for
ETHERCAT_FILES = ("ethercat.toml", "ethercat_objects.csv", "ethercat_pdo.csv")
COMMANDS = {"can": "`servogym node`", "ethercat": "`servogym ethercat`"}  # to serve it
WITHOUT_POSITION = (
    Mode.VELOCITY, Mode.PROFILE_VELOCITY, Mode.PROFILE_TORQUE,
    Mode.CYCLIC_SYNC_VELOCITY, Mode.CYCLIC_SYNC_TORQUE,
)


@dataclass(frozen=True)
class Quirk:
    """A departure from the standard, with its section of the manual."""

    value: int
    source: str


@dataclass(frozen=True, eq=False)
class DriveModel:
    """The immutable description of a drive, shared by all drives of the model."""

    name: str
    folder: Path
    based_on: Path | None  # folder of the base model
    title: str
    standard: str
    cycle_time: dict[str, float]  # "current", "velocity", "position" (s)
    torque_time_constant: float  # (s)
    rotor_inertia: float  # (kg·m²)
    modes: tuple[Mode, ...]
    homing_methods: tuple[int, ...]
    own_homing: dict[int, Method]  # from its homing.csv
    own_modes: dict[int, ModeWords]  # from `[modes]` of its drive.toml
    quirks: dict[str, Quirk]
    abort_codes: dict[int, int]  # code of CiA 301 -> code that the manual prints instead
    units: dict[str, float]
    fixed: dict[str, Any]  # values of `od` fields without an object
    buses: tuple[str, ...]  # keys of `BUSES`: its field buses
    bus: str  # the one of these that determines objects and PDOs
    ethercat: EtherCat | None  # None on other buses
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

    @functools.cached_property
    def more(self) -> int:
        """Size of the objects beyond the record (bytes)."""
        beyond = [row.offset + row.size for row in self.objects.values() if row.area == "more"]
        return max(beyond, default=0)

    def fault_key(self, code: int, cause: int, node: int = 0) -> int:
        """Manufacturer's number of a fault, with the main part in the high byte; 0 if it has none.

        Of several rows with the error code, the row of the cause counts, otherwise the first one.
        The low byte of a lost connection is the `node` whose heartbeat is missing, if that is the
        reason.
        """
        rows = [fault for fault in self.faults if fault.code == code and fault.main is not None]
        for fault in sorted(rows, key=lambda fault: fault.cause != cause):
            lost = node if fault.cause is Cause.CONNECTION else 0
            return (fault.main or 0) << 8 | (lost or fault.sub or 0)
        return 0

    def power_on(self, axis: Axis) -> None:
        """Fill a zeroed record with the constants and factory defaults of the model."""
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
        with_own(axis, self.own_homing)
        axis.supported_modes = sum(1 << mode_bit(mode) for mode in self.modes)
        axis.ambient_temperature = 25.0
        axis.enable_input = 1
        axis.terminals = 0x03  # S1IND and S2IND are wired to 24 V
        axis.sto_input = 1
        codes, numbers, registers = axis.fault_code, axis.fault_number, axis.fault_register
        for fault in reversed(self.faults):  # of several rows with a cause the first counts
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

    def mode_name(self, mode: int) -> str:
        """Name of a mode in drive.toml, or the standard's abbreviation."""
        return mode_words(mode, self.own_modes).name

    def set_reactions(self, axis: Axis) -> None:
        """Set the reactions of faults.csv; of several rows with a cause the first counts."""
        reactions = axis.od.fault_reaction
        for fault in reversed(self.faults):
            reactions[fault.cause] = fault.reaction

    def search(self, method: int) -> Method | None:
        """The legs of a homing method, None for one without a search."""
        return self.own_homing.get(method) or METHODS.get(method)

    @property
    def homes_here(self) -> int:
        """Method of homing on the current position: 37, or 35 in models with the older number."""
        return 37 if 37 in self.homing_methods else 35

    @property
    def positions(self) -> bool:
        """Whether the drive has a mode with a position controller, unlike a frequency inverter."""
        return any(mode not in WITHOUT_POSITION for mode in self.modes)

    def number(self, name: str) -> Object:
        """The numeric object of this name. Raises ValueError if the model has none."""
        row = self.names.get(name)
        if row is None or not row.format:
            numbers = [each for each, row in self.names.items() if row.format]
            remark = hint(name, numbers, "see objects.csv of the model, or ask by index")
            raise ValueError(f"{self.name} has no number {name!r}: {remark}")
        return row

    def quirk(self, name: str) -> int:
        """Value of a departure from the standard, 0 if the model has none."""
        return self.quirks[name].value if name in self.quirks else 0


@functools.cache
def _builtin() -> dict[str, Path]:
    """Folders of the models in this package by name."""
    folder = Path(str(resources.files("servogym.assets"))) / "drives"
    return {path.parent.name: path.parent.resolve() for path in folder.glob("*/drive.toml")}


def model_names() -> list[str]:
    """Names of the models in this package."""
    return sorted(_builtin())


def foreign_names() -> list[str]:
    """Names of models that other packages offer as entry points ``servogym.drives``."""
    return sorted({point.name for point in metadata.entry_points(group=ENTRY_POINTS)})


def load(model: "str | Path | DriveModel", bus: str | None = None) -> DriveModel:
    """Load a model by name, or from the path of a folder.

    A name is that of a model in this package, or an entry point ``servogym.drives`` of another: a
    module in the folder, or an object that is its path. `bus` is "can" or "ethercat", by default
    the first one of the model. A drive behaves the same on both; only its communication objects and
    PDOs differ.

    Raises ValueError that names the known models or buses, or file, line and reason of a wrong row.
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
    """The folder of a model; a path may be relative to the folder `beside`."""
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
        remark = hint(str(model), [*model_names(), *foreign_names()])
        raise ValueError(
            f"unknown drive model {str(model)!r}: {remark}, "
            "or give the path of a folder with drive.toml, objects.csv, pdo.csv, faults.csv"
        )
    return folder.resolve()


def _ancestors(folder: Path) -> list[tuple[Path, dict[str, Any]]]:
    """The folder and those of its base models, each with its drive.toml."""
    files = [(folder, read_toml(folder / "drive.toml"))]
    while "based_on" in files[-1][1]:
        base = _folder(files[-1][1]["based_on"], files[-1][0])
        if base in (folder for folder, _ in files):
            raise ValueError(f"{files[-1][0] / 'drive.toml'}: based_on leads back to {base.name!r}")
        files.append((base, read_toml(base / "drive.toml")))
    return files


@functools.cache
def _cells(folder: Path, referring: tuple[Path, ...] = ()) -> Cells:
    """The rows of a model's objects.csv, merged with those of its base model.

    `referring` are the models that led here; a reference back to one of them is refused.
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
        read_cells(path / "objects.csv"), cells,
        {} if standard == folder else _cells(standard, referring),
    )


def _declared(point: metadata.EntryPoint) -> Path:
    """The folder of an entry point."""
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
    for _, own in reversed(ancestors):  # keys of a model replace those of its base
        toml = merged(toml, own)
    file = {
        name: next((f / name for f, _ in ancestors if (f / name).exists()), folder / name)
        for name in ("pdo.csv", "faults.csv", HOMING_FILE, *ETHERCAT_FILES)
    }
    reader = Toml(folder / "drive.toml", toml)
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
        ethercat = read_ethercat(file["ethercat.toml"])
        missing = ethercat.without
        if file["ethercat_objects.csv"].exists():
            cells = referred(read_cells(file["ethercat_objects.csv"]), cells, {})
        if file["ethercat_pdo.csv"].exists():
            file["pdo.csv"] = file["ethercat_pdo.csv"]
    objects = {  # at the same place of the record on every bus
        a: row for a, row in read_objects(cells).items() if f"{a[0]:04X}h" not in missing
    }
    if bus == "ethercat":
        need_assignment(objects, folder / "objects.csv")
    own_homing = read_homing(file[HOMING_FILE])
    own_modes = read_own_modes(toml.get("modes", {}), reader.path)
    modes, methods = read_capabilities(
        reader.table("capabilities"), reader.path, own_modes, own_homing
    )
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
        own_homing=own_homing,
        own_modes=own_modes,
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
        faults=read_faults(file["faults.csv"], toml.get("variant", "")),
        own_stored=own_stored(objects) if "values_keep_meaning" in toml.get("quirks", {}) else (),
    )


def _with_defaults(objects: dict[tuple[int, int], Object], toml: dict[str, Any], path: Path):
    """The objects with the defaults of the table `defaults`, by name."""
    names = {row.name: address for address, row in objects.items()}
    for name, value in toml.get("defaults", {}).items():
        if name not in names:
            raise ValueError(f"{path}: defaults.{name}: there is no such object")
        row = objects[names[name]]
        number = isinstance(value, int) or (row.real and isinstance(value, float))
        fits = row.minimum <= value <= row.maximum if number and row.format else False
        if not fits and not (isinstance(value, str) and not row.format):
            raise ValueError(f"{path}: defaults.{name} = {value!r} does not fit {row.data_type}")
        objects[names[name]] = replace(row, default=value)
    return objects
