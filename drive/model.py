"""A drive model: a folder with `drive.toml`, `objects.csv`, `pdo.csv` and `faults.csv`.

The folder is all there is to a model; the kernel reads its numbers and flags from the record. A row
that cannot be right is refused when the model is loaded, with file, line and reason.
"""

import functools
import tomllib
from dataclasses import dataclass, replace
from importlib import resources
from pathlib import Path
from typing import Any

from .homing import NUMBERS
from .process_data import MAX_BITS
from .record import FIELDS, OD
from .rows import Fault, Mapping, Object, read_faults, read_objects, read_pdos
from .words import MODE_ABBREVIATION, Mode

# Departures from the standard a model may declare: fields of the record that the kernel reads, and
# flags of the Python around it.
_FIRST = [name for name, *_ in FIELDS].index("older_factor_group")
_LAST = [name for name, *_ in FIELDS].index("history_depth")
KERNEL_QUIRKS = tuple(name for name, *_ in FIELDS[_FIRST : _LAST + 1])
QUIRKS = (
    *KERNEL_QUIRKS,
    "load_at_once",  # 1011h acts at once and needs the power stage off
    "pdo_needs_stop",  # PDO parameters may only change outside NMT operational
    "cyclic_event",  # transmission type 254 sends with the inhibit time as period
    "transmit_masks",  # 2014h-2017h choose the bits whose change sends a TPDO
    "emcy_internal_code",  # bytes 6 and 7 of an EMCY are the manufacturer's fault number
    "shortest_gap_of_tpdo_2",  # ms between two of them, whatever the inhibit time says
    "identifier_needs_valid_bit",  # bit 30 of PDO identifiers always reads 1
)
# field bus -> longest PDO in bits
BUSES = {"can": MAX_BITS, "ethercat": 512}
# [units] of drive.toml: field of the record, value without an entry
UNITS = {"position_gain": 1e-3, "velocity_gain": 1e-6, "temperature": 0.1}
MODES = {abbreviation: mode for mode, abbreviation in MODE_ABBREVIATION.items()}


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
    units: dict[str, float]
    fixed: dict[str, Any]  # values of `od` fields that the model has no object for
    bus: str  # key of `BUSES`
    axes: int  # drives in one housing, with consecutive node-ids
    objects: dict[tuple[int, int], Object]
    names: dict[str, Object]
    rpdos: tuple[Mapping, ...]
    tpdos: tuple[Mapping, ...]
    faults: tuple[Fault, ...]

    def __reduce__(self):
        return load, (self.name if self.folder == _builtin() / self.name else str(self.folder),)

    def fault_key(self, code: int, cause: int) -> int:
        """Manufacturer's number of a fault, main part in the high byte; 0 if it has none.

        Of several rows with the error code that of the cause counts, else the first.
        """
        rows = [fault for fault in self.faults if fault.code == code and fault.main is not None]
        for fault in sorted(rows, key=lambda fault: fault.cause != cause):
            return (fault.main or 0) << 8 | (fault.sub or 0)
        return 0

    def power_on(self, axis: Any) -> None:
        """Fill a zeroed record with what the model fixes and the factory defaults."""
        axis.position_period = self.cycle_time["position"]
        axis.velocity_period = self.cycle_time["velocity"]
        axis.velocity_cycles = round(self.cycle_time["position"] / self.cycle_time["velocity"])
        axis.torque_time_constant = self.torque_time_constant
        for name, value in self.units.items():
            setattr(axis, f"{name}_unit", value)
        for name in KERNEL_QUIRKS:
            setattr(axis, name, self.quirk(name))
        axis.supported_modes = sum(1 << (mode - 1) for mode in self.modes)
        axis.ambient_temperature = 25.0
        axis.enable_input = 1
        axis.terminals = 0x03  # S1IND and S2IND are wired to 24 V
        axis.sto_input = 1
        for fault in reversed(self.faults):  # of two rows with one cause the first counts
            axis.fault_code[fault.cause] = fault.code
            axis.fault_number[fault.cause] = (fault.main or 0) << 4 | (fault.sub or 0)
            axis.fault_register[fault.cause] = 1 | 1 << fault.register
        self.set_reactions(axis)
        for name, value in self.fixed.items():
            if isinstance(value, list):
                getattr(axis.od, name)[: len(value)] = value
            else:
                setattr(axis.od, name, value)
        axis.parameters_changed = 1

    def set_reactions(self, axis: Any) -> None:
        """The reactions of faults.csv; of two rows with one cause the first counts."""
        for fault in reversed(self.faults):
            axis.od.fault_reaction[fault.cause] = fault.reaction

    @property
    def homes_here(self) -> int:
        """Homing method on the current position: 37, or 35 where only the older number is known."""
        return 37 if 37 in self.homing_methods else 35

    def quirk(self, name: str) -> int:
        """Value of a departure from the standard, 0 where the model has none."""
        return self.quirks[name].value if name in self.quirks else 0


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
    toml = last = _read_toml(folder / "drive.toml")
    files = [folder]
    while "based_on" in last:  # another model, with what this one says instead
        files.append(load(last["based_on"]).folder)
        last = _read_toml(files[-1] / "drive.toml")
        toml = _merged(last, toml)
    file = {
        name: next((f / name for f in files if (f / name).is_file()), folder / name)
        for name in ("objects.csv", "pdo.csv", "faults.csv")
    }
    reader = _Toml(folder / "drive.toml", toml)
    objects = _changed(read_objects(file["objects.csv"]), toml, reader.path)
    rpdos, tpdos = read_pdos(file["pdo.csv"], objects, BUSES[reader.bus()])
    microseconds = reader.cycle_times()
    motor = reader.numbers("motor", ("torque_time_constant_us", "rotor_inertia_kgm2"))
    capabilities = reader.table("capabilities")
    reader.known("quirks", QUIRKS)
    reader.known("fixed", OD.names or ())
    reader.known("units", UNITS)
    for kind, known in (("modes", MODES), ("homing_methods", NUMBERS)):
        for name in capabilities.get(kind, ()):
            if name not in known:
                raise ValueError(f"{reader.path}: unknown {kind} {name!r}, known: {[*known]}")
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
        units=UNITS | toml.get("units", {}),
        fixed=toml.get("fixed", {}),
        bus=reader.bus(),
        axes=int(toml.get("axes", 1)),
        objects=objects,
        names={row.name: row for row in objects.values()},
        rpdos=rpdos,
        tpdos=tpdos,
        faults=read_faults(file["faults.csv"]),
    )


def _read_toml(path: Path) -> dict[str, Any]:
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except tomllib.TOMLDecodeError as error:
        raise ValueError(f"{path}: {error}") from None


def _merged(base: dict[str, Any], own: dict[str, Any]) -> dict[str, Any]:
    """Tables of `base` with the entries of `own` in place of theirs."""
    return base | {
        key: base.get(key, {}) | value if isinstance(value, dict) else value
        for key, value in own.items()
    }


def _changed(objects: dict[tuple[int, int], Object], toml: dict[str, Any], path: Path):
    """The objects without those of `without`, with the values of `defaults` (by name)."""
    left = {a: row for a, row in objects.items() if f"{a[0]:04X}h" not in toml.get("without", ())}
    names = {row.name: address for address, row in left.items()}
    for name, value in toml.get("defaults", {}).items():
        if name not in names:
            raise ValueError(f"{path}: defaults.{name}: there is no such object")
        left[names[name]] = replace(left[names[name]], default=value)
    return left


@dataclass
class _Toml:
    path: Path
    data: dict[str, Any]

    def table(self, name: str) -> dict[str, Any]:
        if not isinstance(self.data.get(name), dict):
            raise ValueError(f"{self.path}: the table [{name}] is missing")
        return self.data[name]

    def known(self, name: str, known) -> None:
        """Refuse a key of a table that means nothing."""
        for key in self.data.get(name, {}):
            if key not in known:
                raise ValueError(f"{self.path}: {name}.{key} is unknown, use of {', '.join(known)}")

    def bus(self) -> str:
        """The field bus, "can" where nothing is said."""
        bus = self.data.get("bus", "can")
        if bus not in BUSES:
            raise ValueError(f"{self.path}: unknown bus {bus!r}, known: {', '.join(BUSES)}")
        return bus

    def cycle_times(self) -> dict[str, float]:
        """Cycle times (µs); the position cycle is a multiple of the velocity cycle."""
        times = self.numbers("cycle_time_us", ("current", "velocity", "position"))
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
