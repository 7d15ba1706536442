"""`ethercat.toml` of a drive model: what it is on EtherCAT, read and checked.

SII, ESI, 1C00h and the AL state machine are made from it; objects and PDOs are those of the CSVs.
"""

import base64
import tomllib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from . import foreign
from .rows import Object

PROTOCOLS = ("AoE", "EoE", "CoE", "FoE", "SoE", "VoE")  # a bit of word 1Ch of the SII each
# flags of the category general: the mailbox can be repeated, 0134h shows the identification
DATA_LINK_LAYER, IDENTIFICATION = 0x04, 0x08
MAILBOX_HEADER = 16  # bytes before the data of a normal SDO: the shortest mailbox has more
SII_HEADER = 128  # bytes of an EEPROM before its categories
MAPPABLE = [4, 4]  # Kollmorgen AKD 5.5
MEMORY = 0x1000, 0x3000  # process data memory of the slave controller, first and behind


@dataclass(frozen=True)
class DcMode:
    """A way to synchronise that the model offers."""

    name: str
    assign_activate: int  # for registers 0980h and 0981h
    cycle_factor0: int = 0  # of SYNC0: periods of the bus


@dataclass(frozen=True)
class Al:
    """How the state machine departs from the standard's."""

    bootstrap: bool = True
    by_edge: bool = False  # bit 4 of AL Control acknowledges by its rising edge only
    init_acknowledges: bool = True  # a request of INIT acknowledges without bit 4
    codes: dict[str, int] = field(default_factory=dict)  # own numbers, by name of `AlStatusCode`


@dataclass(frozen=True)
class EtherCat:
    """A model on EtherCAT; mailboxes are start and length of out, start and length of in."""

    name: str
    order: str
    group: str
    vendor: str
    mailbox: tuple[int, int, int, int]
    bootstrap: tuple[int, int, int, int]
    shortest: int  # bytes of a mailbox that a master may choose
    protocols: tuple[str, ...]
    coe_details: int  # 1 SDO, 2 information, 4 assignment, 8 mapping, 20h complete access
    start: tuple[int, int]  # of outputs and inputs
    length: int  # bytes, at most, of each
    control: tuple[int, int]  # control byte of sync managers 2 and 3
    mailbox_control: tuple[int, int]  # and of 0 and 1
    fmmu: tuple[int, ...]
    sii_size: int  # bytes
    sii_version: int
    pdi_control: int
    pdi_configuration: int
    strings: tuple[tuple[int, str], ...]  # categories of the vendor
    eoe_details: int  # of the category general
    flags: int  # of the category general
    ds402_channels: int  # of the category general
    image: bytes  # of the maker's EEPROM; empty: it is made from the model
    registers: dict[int, bytes]  # of the slave controller, by address
    cycle_ns: int  # shortest cycle with SYNC0; all are multiples of it
    exact_period: bool  # the cycle has to be that of 60C2h
    late_limit: int  # set-points that may be missed one after the other, 0: any number
    error_settings: bool  # 10F1h
    hop_delay_ns: int  # from one port to the other
    modes: tuple[DcMode, ...]
    al: Al
    mappable: tuple[int, int]  # RPDOs and TPDOs that a master may map; they come first
    fixed_alone: bool  # a PDO that cannot be mapped is assigned without another
    excludes: dict[int, tuple[int, ...]]  # PDO -> those it cannot be assigned with

    @property
    def complete_access(self) -> bool:
        """Whether CoE details offer complete access."""
        return bool(self.coe_details & 0x20)

    @property
    def information(self) -> bool:
        """Whether CoE details offer SDO information."""
        return bool(self.coe_details & 0x02)


TABLES: dict[str, tuple[str, ...]] = {
    "": ("name", "order", "group", "vendor", "without"),
    "mailbox": ("standard", "bootstrap", "shortest", "protocols", "coe_details"),
    "process_data": ("start", "length", "control", "mailbox_control", "fmmu"),
    "sii": (
        "size", "version", "pdi_control", "pdi_configuration", "strings", "eoe_details", "flags",
        "ds402_channels", "image",
    ),
    "pdo": ("mappable", "fixed_alone", "excludes"),
    "dc": ("cycle_ns", "exact_period", "late_limit", "hop_delay_ns", "error_settings", "modes"),
    "al": ("bootstrap", "by_edge", "init_acknowledges", "codes"),
}


class _Reader:
    """The file, with refusals that name it and the key."""

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
            known = (*keys, *TABLES, "registers") if not table else keys
            for key in found:
                if key not in known:
                    place = f"{table}.{key}" if table else key
                    raise self.error(f"{place} is unknown, use of {', '.join(filter(None, known))}")

    def error(self, text: str) -> ValueError:
        """A refusal that names the file."""
        return ValueError(f"{self.path}: {text}")

    def get(self, table: str, key: str, kind: type, default: Any = None) -> Any:
        """A value of a type; without a default it has to be there."""
        found = self.data.get(table, {}) if table else self.data
        value = found.get(key, default)
        right = isinstance(value, kind) and (kind is bool or not isinstance(value, bool))
        if not right or (kind is int and not 0 <= value < 1 << 32):
            place = f"{table}.{key}" if table else key
            what = "a whole number of 0 or more" if kind is int else f"of type {kind.__name__}"
            raise self.error(f"{place} = {value!r} is not {what}")
        return value

    def numbers(
        self, table: str, key: str, count: int | None = None, default: list[int] | None = None
    ) -> tuple[int, ...]:
        """A list of numbers."""
        values = self.get(table, key, list, default)
        right = all(isinstance(v, int) and 0 <= v <= 0xFFFF for v in values)
        if not right or (count is not None and len(values) != count):
            wanted = "numbers" if count is None else f"{count} numbers"
            raise self.error(f"{table}.{key} = {values!r} is not a list of {wanted} 0..FFFFh")
        return tuple(values)

    def keyed(self, table: dict[str, Any], place: str) -> dict[int, Any]:
        """A table whose keys are addresses."""
        try:
            return {int(key, 0): value for key, value in table.items()}
        except ValueError as error:
            raise self.error(f"{place}: {error}") from None


def read_ethercat(path: Path) -> tuple[EtherCat, tuple[str, ...]]:
    """What a model is on EtherCAT, and the objects it does not have there (as "1005h").

    Raises ValueError with file, key and reason.
    """
    reader = _Reader(path)
    get, numbers = reader.get, reader.numbers
    protocols = tuple(get("mailbox", "protocols", list))
    for protocol in protocols:
        if protocol not in PROTOCOLS:
            raise reader.error(f"protocol {protocol!r} is unknown, use of {', '.join(PROTOCOLS)}")
    registers = {}
    for address, text in reader.keyed(get("", "registers", dict, {}), "registers").items():
        try:
            registers[address] = bytes.fromhex(text)
        except (TypeError, ValueError):
            raise reader.error(f"registers.{address:#06x} = {text!r} are not bytes") from None
        if not 0 <= address <= MEMORY[0] - len(registers[address]):
            raise reader.error(f"registers.{address:#06x} is not a register")
    strings = reader.keyed(get("sii", "strings", dict, {}), "sii.strings")
    without = tuple(get("", "without", list, []))
    codes = get("al", "codes", dict, {})
    excludes = reader.keyed(get("pdo", "excludes", dict, {}), "pdo.excludes")
    for others in excludes.values():
        if not isinstance(others, list) or not all(type(other) is int for other in others):
            raise reader.error(f"pdo.excludes: {others!r} is not a list of PDOs")
    for place, values, kind in (
        ("sii.strings", strings.values(), str),
        ("without", without, str),
        ("al.codes", codes.values(), int),
    ):
        for value in values:
            if not isinstance(value, kind):
                raise reader.error(f"{place}: {value!r} is not of type {kind.__name__}")
    ethercat = EtherCat(
        name=get("", "name", str),
        order=get("", "order", str),
        group=get("", "group", str),
        vendor=get("", "vendor", str),
        mailbox=numbers("mailbox", "standard", 4),  # type: ignore[arg-type]
        bootstrap=numbers("mailbox", "bootstrap", 4),  # type: ignore[arg-type]
        shortest=get("mailbox", "shortest", int),
        protocols=protocols,
        coe_details=get("mailbox", "coe_details", int),
        start=numbers("process_data", "start", 2),  # type: ignore[arg-type]
        length=get("process_data", "length", int),
        control=numbers("process_data", "control", 2),  # type: ignore[arg-type]
        mailbox_control=numbers("process_data", "mailbox_control", 2),  # type: ignore[arg-type]
        fmmu=numbers("process_data", "fmmu"),
        sii_size=get("sii", "size", int),
        sii_version=get("sii", "version", int, 1),
        pdi_control=get("sii", "pdi_control", int, 0),
        pdi_configuration=get("sii", "pdi_configuration", int, 0),
        strings=tuple(sorted(strings.items())),
        eoe_details=get("sii", "eoe_details", int, int("EoE" in protocols)),
        flags=get("sii", "flags", int, DATA_LINK_LAYER | IDENTIFICATION),
        ds402_channels=get("sii", "ds402_channels", int, 0),
        image=_image(reader),
        registers=registers,
        cycle_ns=get("dc", "cycle_ns", int),
        exact_period=get("dc", "exact_period", bool, False),
        late_limit=get("dc", "late_limit", int, 0),
        error_settings=get("dc", "error_settings", bool, False),
        hop_delay_ns=get("dc", "hop_delay_ns", int),
        modes=tuple(_mode(reader, row) for row in get("dc", "modes", list)),
        al=Al(
            bootstrap=get("al", "bootstrap", bool, True), by_edge=get("al", "by_edge", bool, False),
            init_acknowledges=get("al", "init_acknowledges", bool, True), codes=codes,
        ),
        mappable=numbers("pdo", "mappable", 2, MAPPABLE),  # type: ignore[arg-type]
        fixed_alone=get("pdo", "fixed_alone", bool, True),
        excludes={pdo: tuple(others) for pdo, others in excludes.items()},
    )
    _check(reader, ethercat)
    return ethercat, without


def _image(reader: _Reader) -> bytes:
    try:
        return base64.b64decode(reader.get("sii", "image", str, ""), validate=True)
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
    """Buffers lie in the memory and do not overlap; the EEPROM has a size there is."""
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
