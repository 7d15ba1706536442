"""`drive.toml` of a drive model: its keys, and errors that name file, key and similar names."""

import math
import re
import tomllib
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..kernel import record
from ..kernel.process_data import MAX_BITS
from ..kernel.record import OD
from . import foreign
from .names import hint

# Departures from the standard that a model may declare: fields of the record that the kernel reads,
# and flags that only Python reads.
KERNEL_QUIRKS = tuple(name for name, *_ in record.QUIRKS)
QUIRKS = {name: meaning for name, _, _, meaning in record.QUIRKS} | {
    "load_at_once": "1: 1011h acts at once and needs the power stage off",
    "pdo_needs_stop": "1: PDO parameters may only change outside NMT operational",
    "cyclic_event": "1: transmission type 254 sends with the inhibit time as period",
    "transmit_masks": "1: 2014h-2017h choose the bits whose change sends a TPDO",
    "emcy_internal_code": "1: bytes 6 and 7 of an EMCY are the manufacturer's fault number",
    "only_faults_are_told": "1: a lost connection sends an EMCY only with 6007h = 1",
    "rpdo_counts_syncs": "1: an RPDO of type n is used at every n-th SYNC",
    "upload_without_size": "1: an expedited upload of 2001h-2FFFh is answered by 42h",
    "writes_are_stored": "1: what can be stored is stored with each write",
    "shortest_gap_of_tpdo_2": "ms between two of them, even with a shorter inhibit time",
    "alias_saves": "1: a station alias that is written makes the drive save its parameters",
    "empty_history_reads_0": "1: a field of 1003h without an error reads 0 instead of 08000024h",
    "identifier_needs_valid_bit": "1: bit 30 of PDO identifiers always reads 1",
}
KINDS: dict[str, type] = {  # types of the keys
    "title": str, "standard": str, "based_on": str, "objects_of": str, "variant": str, "axes": int,
    "buses": list,
    "without": list, "cycle_time_us": dict, "motor": dict, "capabilities": dict, "modes": dict,
    "quirks": dict,
    "fixed": dict, "units": dict, "defaults": dict, "abort_codes": dict, "sections": dict,
}
KEYS = {  # of the tables whose keys are not listed elsewhere
    "cycle_time_us": ("current", "velocity", "position"),
    "motor": ("torque_time_constant_us", "rotor_inertia_kgm2"),
    "capabilities": ("modes", "homing_methods"),
}
BUSES = {"can": MAX_BITS, "ethercat": 512}  # field bus -> longest PDO in bits
# [units] of drive.toml: field of the record, value without an entry
UNITS = {"position_gain": 1e-3, "velocity_gain": 1e-6, "temperature": 0.1}


def read_toml(path: Path) -> dict[str, Any]:
    """Read one drive.toml and check it on its own. Raises ValueError with file and key."""
    try:
        toml = tomllib.loads(foreign.text(path, "a file of a model"))
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise ValueError(f"{path}: {error}") from None
    refuse_unknown(toml, KINDS, path)
    for key, kind in KINDS.items():
        if not isinstance(toml.get(key, kind()), kind):
            raise ValueError(f"{path}: {key} = {toml[key]!r} is not of type {kind.__name__}")
    for table, keys in KEYS.items():
        refuse_unknown(toml.get(table, {}), keys, path, f"{table}.")
    if not 1 <= toml.get("axes", 1) <= 127:
        raise ValueError(f"{path}: axes = {toml['axes']} is out of range 1..127")
    for name, quirk in toml.get("quirks", {}).items():
        if name not in QUIRKS:
            continue  # refused later, with the known ones
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
            raise ValueError(f"{path}: capabilities.{name} is not a list")
    for name, value in toml.get("units", {}).items():
        if not isinstance(value, int | float) or not 0 < value < 1e9:
            raise ValueError(f"{path}: units.{name} = {value!r} is not a number above 0")
    for name, value in toml.get("fixed", {}).items():
        if name in (OD.names or ()) and not _fits(value, OD[name]):
            raise ValueError(f"{path}: fixed.{name} = {value!r} does not fit {OD[name]}")
    return toml


def refuse_unknown(table: dict[str, Any], known: Iterable[str], path: Path, of: str = "") -> None:
    """Refuse an unknown key, which is most often a misspelt one."""
    for key in table:
        if key not in known:
            raise ValueError(f"{path}: {of}{key} is unknown: {hint(key, known)}")


def _fits(value: Any, kind: np.dtype) -> bool:
    """Whether a value of drive.toml, or a list of values, fits a field of the record."""
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


def merged(base: dict[str, Any], own: dict[str, Any]) -> dict[str, Any]:
    """The tables of `base`, in which entries of `own` replace those of the same name."""
    return base | {
        key: base[key] | value if isinstance(value, dict) and isinstance(base.get(key), dict)
        else value
        for key, value in own.items()
    }


@dataclass
class Toml:
    """A drive.toml merged with those it is based on, and checks of the result."""

    path: Path
    data: dict[str, Any]

    def table(self, name: str) -> dict[str, Any]:
        """A mandatory table."""
        if not isinstance(self.data.get(name), dict):
            raise ValueError(f"{self.path}: the table [{name}] is missing")
        return self.data[name]

    def known(self, name: str, known: Iterable[str]) -> None:
        """Refuse an unknown key of a table."""
        refuse_unknown(self.data.get(name, {}), known, self.path, f"{name}.")

    def buses(self) -> tuple[str, ...]:
        """The field buses, "can" by default."""
        buses = self.data.get("buses", ["can"])
        if not isinstance(buses, list) or not buses:
            raise ValueError(f'{self.path}: buses = {buses!r} is not a list like ["can"]')
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
        """Mandatory numbers of a table, each 0 or more."""
        table = self.table(name)
        for key in keys:
            value = table.get(key)
            if not isinstance(value, int | float) or not 0 <= value < 1e9:
                raise ValueError(f"{self.path}: {name}.{key} = {value!r} is not a number >= 0")
        return {key: float(table[key]) for key in keys}
