"""`ethercat.toml` of a drive model: its description as an EtherCAT slave, read and checked.

SII, ESI, 1C00h and the AL state machine follow from it; objects and PDOs come from the CSV files.
"""

import base64
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, NamedTuple

from . import foreign
from .rows import Object

PROTOCOLS = ("AoE", "EoE", "CoE", "FoE", "SoE", "VoE")  # a bit of word 1Ch of the SII each
# flags of the category general: the mailbox can be repeated, 0134h shows the identification
DATA_LINK_LAYER, IDENTIFICATION = 0x04, 0x08
MAILBOX_HEADER = 16  # bytes before the data of a normal SDO: the shortest mailbox has more
SII_HEADER = 128  # bytes of an EEPROM before its categories
MEMORY = 0x1000, 0x3000  # process data memory of the slave controller, first and behind


@dataclass(frozen=True)
class DcMode:
    """A synchronisation mode that the model offers."""

    name: str
    assign_activate: int  # for registers 0980h and 0981h
    cycle_factor0: int = 0  # of SYNC0: periods of the bus


class Key(NamedTuple):
    """The place of a value in the file, and its type."""

    table: str  # "" for the file itself
    name: str
    kind: type
    default: Any = None  # None: the key is mandatory
    numbers: int | None = None  # length of a list of numbers; 0: any length


def _key(table: str, name: str, kind: type, default: Any = None, numbers: int | None = None) -> Any:
    """A field of a dataclass that is read from the file."""
    return field(metadata={"key": Key(table, name, kind, default, numbers)})


@dataclass(frozen=True)
class Al:
    """Departures of the AL state machine from the standard."""

    bootstrap: bool = _key("al", "bootstrap", bool, True)
    # bit 4 of AL Control acknowledges by its rising edge only
    by_edge: bool = _key("al", "by_edge", bool, False)
    # a request of INIT acknowledges without bit 4
    init_acknowledges: bool = _key("al", "init_acknowledges", bool, True)
    codes: Mapping[str, int] = _key("al", "codes", dict, {})  # by name of `AlStatusCode`


@dataclass(frozen=True)
class EtherCat:
    """An EtherCAT slave; mailboxes are start and length of the output, then of the input."""

    name: str = _key("", "name", str)
    order: str = _key("", "order", str)
    group: str = _key("", "group", str)
    vendor: str = _key("", "vendor", str)
    without: tuple[str, ...] = _key("", "without", list, [])  # objects on CAN only, as "1005h"
    # of the slave controller, by address
    registers: dict[int, bytes] = _key("", "registers", dict, {})  # noqa: RUF009
    mailbox: tuple[int, int, int, int] = _key("mailbox", "standard", list, numbers=4)
    bootstrap: tuple[int, int, int, int] = _key("mailbox", "bootstrap", list, numbers=4)
    shortest: int = _key("mailbox", "shortest", int)  # bytes of a mailbox that a master may choose
    protocols: tuple[str, ...] = _key("mailbox", "protocols", list)
    # 1 SDO, 2 information, 4 assignment, 8 mapping, 20h complete access
    coe_details: int = _key("mailbox", "coe_details", int)
    start: tuple[int, int] = _key("process_data", "start", list, numbers=2)  # of outputs and inputs
    length: int = _key("process_data", "length", int)  # bytes, at most, of each
    # control bytes of sync managers 2 and 3, and of 0 and 1
    control: tuple[int, int] = _key("process_data", "control", list, numbers=2)
    mailbox_control: tuple[int, int] = _key("process_data", "mailbox_control", list, numbers=2)
    fmmu: tuple[int, ...] = _key("process_data", "fmmu", list, numbers=0)
    sii_size: int = _key("sii", "size", int)  # bytes
    sii_version: int = _key("sii", "version", int, 1)
    pdi_control: int = _key("sii", "pdi_control", int, 0)
    pdi_configuration: int = _key("sii", "pdi_configuration", int, 0)
    strings: tuple[tuple[int, str], ...] = _key("sii", "strings", dict, {})  # vendor's categories
    # of the category general; details without a value say whether there is EoE
    eoe_details: int = _key("sii", "eoe_details", int, -1)
    flags: int = _key("sii", "flags", int, DATA_LINK_LAYER | IDENTIFICATION)
    ds402_channels: int = _key("sii", "ds402_channels", int, 0)
    image: bytes = _key("sii", "image", str, "")  # of the maker's EEPROM; empty: from the model
    cycle_ns: int = _key("dc", "cycle_ns", int)  # shortest cycle with SYNC0; all are multiples
    exact_period: bool = _key("dc", "exact_period", bool, False)  # the cycle has to be 60C2h
    # set-points that may be missed one after the other, 0: any number
    late_limit: int = _key("dc", "late_limit", int, 0)
    error_settings: bool = _key("dc", "error_settings", bool, False)  # 10F1h
    hop_delay_ns: int = _key("dc", "hop_delay_ns", int)  # from one port to the other
    modes: tuple[DcMode, ...] = _key("dc", "modes", list)
    # RPDOs and TPDOs that a master may map; they come first (Kollmorgen AKD 5.5)
    mappable: tuple[int, int] = _key("pdo", "mappable", list, [4, 4], numbers=2)
    # whether a PDO that cannot be mapped is assigned without another
    fixed_alone: bool = _key("pdo", "fixed_alone", bool, True)
    excludes: Mapping[int, tuple[int, ...]] = _key("pdo", "excludes", dict, {})
    al: Al = field(default_factory=Al)

    @property
    def complete_access(self) -> bool:
        """Whether CoE details offer complete access."""
        return bool(self.coe_details & 0x20)

    @property
    def information(self) -> bool:
        """Whether CoE details offer SDO information."""
        return bool(self.coe_details & 0x02)


KEYS = [of.metadata["key"] for kind in (EtherCat, Al) for of in fields(kind) if of.metadata]
TABLES = {key.table: [each.name for each in KEYS if each.table == key.table] for key in KEYS}


class _Reader:
    """The file, with errors that name it and the key."""

    def __init__(self, path: Path):
        self.path = path
        try:
            self.data: dict[str, Any] = tomllib.loads(foreign.text(path, "a file of a model"))
        except (tomllib.TOMLDecodeError, OSError, RecursionError) as error:
            raise ValueError(f"{path}: {error}") from None
        for table, keys in TABLES.items():
            found = self.data.get(table, {}) if table else self.data
            if not isinstance(found, dict):
                raise self.error(f"[{table}] is not a table")
            known = keys if table else [*keys, *filter(None, TABLES)]
            for key in found:
                if key not in known:
                    place = f"{table}.{key}" if table else key
                    raise self.error(f"{place} is unknown, use of {', '.join(known)}")

    def error(self, text: str) -> ValueError:
        """An error that names the file."""
        return ValueError(f"{self.path}: {text}")

    def get(self, key: Key) -> Any:
        """The value of a key; a list of numbers as a tuple."""
        found = self.data.get(key.table, {}) if key.table else self.data
        value = found.get(key.name, key.default)
        place = f"{key.table}.{key.name}" if key.table else key.name
        right = isinstance(value, key.kind) and (key.kind is bool or not isinstance(value, bool))
        if not right or (key.kind is int and key.name in found and not 0 <= value < 1 << 32):
            number = key.kind is int
            what = "a whole number of 0 or more" if number else f"of type {key.kind.__name__}"
            raise self.error(f"{place} = {value!r} is not {what}")
        if key.numbers is None:
            return value
        right = all(isinstance(v, int) and 0 <= v <= 0xFFFF for v in value)
        if not right or key.numbers not in (0, len(value)):
            wanted = f"{key.numbers} numbers" if key.numbers else "numbers"
            raise self.error(f"{place} = {value!r} is not a list of {wanted} 0..FFFFh")
        return tuple(value)

    def values(self, kind: type) -> dict[str, Any]:
        """The values of the fields of a dataclass."""
        rows = [of for of in fields(kind) if of.metadata]
        return {of.name: self.get(of.metadata["key"]) for of in rows}

    def keyed(self, table: dict[str, Any], place: str) -> dict[int, Any]:
        """A table whose keys are addresses."""
        try:
            return {int(key, 0): value for key, value in table.items()}
        except ValueError as error:
            raise self.error(f"{place}: {error}") from None


def read_ethercat(path: Path) -> EtherCat:
    """Read an ethercat.toml. Raises ValueError with file, key and reason."""
    reader = _Reader(path)
    found, al = reader.values(EtherCat), reader.values(Al)
    for protocol in found["protocols"]:
        if protocol not in PROTOCOLS:
            raise reader.error(f"protocol {protocol!r} is unknown, use of {', '.join(PROTOCOLS)}")
    for name, place in (("registers", "registers"), ("strings", "sii.strings"),
                        ("excludes", "pdo.excludes")):
        found[name] = reader.keyed(found[name], place)
    for others in found["excludes"].values():
        if not isinstance(others, list) or not all(type(other) is int for other in others):
            raise reader.error(f"pdo.excludes: {others!r} is not a list of PDOs")
    for place, values, kind in (
        ("sii.strings", found["strings"].values(), str),
        ("without", found["without"], str),
        ("al.codes", al["codes"].values(), int),
    ):
        for value in values:
            if not isinstance(value, kind):
                raise reader.error(f"{place}: {value!r} is not of type {kind.__name__}")
    if found["eoe_details"] < 0:
        found["eoe_details"] = int("EoE" in found["protocols"])
    ethercat = EtherCat(**found | {
        "protocols": tuple(found["protocols"]),
        "without": tuple(found["without"]),
        "registers": _registers(reader, found["registers"]),
        "strings": tuple(sorted(found["strings"].items())),
        "image": _image(reader, found["image"]),
        "modes": tuple(_mode(reader, row) for row in found["modes"]),
        "excludes": {pdo: tuple(others) for pdo, others in found["excludes"].items()},
        "al": Al(**al),
    })
    _check(reader, ethercat)
    return ethercat


def _registers(reader: _Reader, table: dict[int, Any]) -> dict[int, bytes]:
    registers = {}
    for address, text in table.items():
        try:
            registers[address] = bytes.fromhex(text)
        except (TypeError, ValueError):
            raise reader.error(f"registers.{address:#06x} = {text!r} are not bytes") from None
        if not 0 <= address <= MEMORY[0] - len(registers[address]):
            raise reader.error(f"registers.{address:#06x} is not a register")
    return registers


def _image(reader: _Reader, text: str) -> bytes:
    try:
        return base64.b64decode(text, validate=True)
    except ValueError as error:
        raise reader.error(f"sii.image is not in base64: {error}") from None


def _mode(reader: _Reader, row: Any) -> DcMode:
    try:
        mode = DcMode(**row)
    except TypeError as error:
        raise reader.error(f"dc.modes: {error}") from None
    if not isinstance(mode.name, str) or not all(
        isinstance(value, int) and 0 <= value <= 0x7FFF
        for value in (mode.assign_activate, mode.cycle_factor0)
    ):
        raise reader.error(f"dc.modes: {row!r} is not a name with numbers of 0 or more")
    return mode


def _check(reader: _Reader, ethercat: EtherCat) -> None:
    """Refuse buffers outside of the memory or overlapping, and impossible EEPROM sizes."""
    out, out_length, in_, in_length = ethercat.mailbox
    buffers = [(out, out_length, "mailbox out"), (in_, in_length, "mailbox in")]
    buffers += [
        (start, ethercat.length, name)
        for start, name in zip(ethercat.start, ("outputs", "inputs"), strict=True)
    ]
    for n, (start, length, name) in enumerate(buffers):
        if not MEMORY[0] <= start < start + length <= MEMORY[1]:
            raise reader.error(f"{name}: {start:04X}h with {length} bytes is outside the memory")
        for other, other_length, other_name in buffers[:n]:
            if start < other + other_length and other < start + length:
                raise reader.error(f"{name} overlaps with {other_name}")
    if min(out_length, in_length) < ethercat.shortest or ethercat.shortest <= MAILBOX_HEADER:
        raise reader.error(
            f"mailbox.shortest = {ethercat.shortest} is not in {MAILBOX_HEADER + 1}.."
            f"{min(out_length, in_length)}"
        )
    if 0 < len(ethercat.image) < SII_HEADER or len(ethercat.image) > ethercat.sii_size:
        raise reader.error(f"sii.image has {len(ethercat.image)} bytes, the EEPROM takes "
                           f"{SII_HEADER}..{ethercat.sii_size}")
    if ethercat.sii_size % 128 or not 256 <= ethercat.sii_size <= 65536:
        raise reader.error(f"sii.size = {ethercat.sii_size} is not a multiple of 128 up to 65536")


def need_assignment(objects: dict[tuple[int, int], Object], path: Path) -> None:
    """Refuse a model whose 1C12h or 1C13h, which assign its PDOs, lacks a row it counts."""
    for index in (0x1C12, 0x1C13):
        listed = int(objects[index, 0].default) if (index, 0) in objects else 0
        for subindex in range(listed + 1):
            if (index, subindex) not in objects:
                raise ValueError(
                    f"{path}: {index:04X}h:{subindex:02X}h is missing, which assigns PDOs on "
                    "EtherCAT: add the row here or in ethercat_objects.csv"
                )
