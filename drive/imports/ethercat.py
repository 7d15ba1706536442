"""Makes a drive model from the description of an EtherCAT slave: an ESI file or an EEPROM image.

Sources: ETG.2000 (ESI), ETG.2010 (SII).

A description contains what the drive is on EtherCAT: identity, PDOs, sync managers, mailboxes,
FMMUs and clocks. ESI files, and slaves with SDO information, also provide the dictionary; without
one, the objects are those of `generic`. Anything that could not be used as it stands is a repair in
the README of the folder.
"""

import csv
import io
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from ..canopen.sheet import Entry, Sheet
from ..drive import Drive
from ..ethercat import sii
from ..ethercat.description import INPUTS, OUTPUTS, Description
from ..ethercat.esi_reader import EsiObject, read_esi
from ..ethercat.segment import Segment
from ..ethercat.slave import Slave
from ..model.files import content
from ..model.made import PDO_COLUMNS, ModelFolder, Repair, check_place, line, write
from ..model.model import load
from ..statements import data_sheet
from .dictionary import NEEDS, fill
from .ethercat_pdos import EthercatPdos, assignment, with_pdos
from .ethercat_toml import ENOUGH, EthercatToml
from .rows import NEEDED, PERIOD, ObjectRows

# registers of slave controllers by name: type, revision, FMMUs, sync managers, RAM, ports, features
CHIPS: dict[str, dict[int, bytes]] = {
    "et1100": {0x00: b"\x11", 0x04: b"\x08", 0x05: b"\x08", 0x06: b"\x08", 0x08: b"\xfc\x00"},
    "lan9252": {0x00: b"\xc0\x02", 0x04: b"\x03", 0x05: b"\x04", 0x06: b"\x04", 0x08: b"\xcc\x01"},
    # an IP core in an FPGA that emulates its EEPROM, as a Kollmorgen AKD shows it (observed)
    "emulated": {0x00: b"\x04", 0x01: b"\x02", 0x04: b"\x04", 0x05: b"\x09", 0x06: b"\x08",
                 0x07: b"\x0f", 0x08: b"\x84\x01", 0x0140: b"\x08\x0c", 0x0502: b"\x20"},
}
_COMMUNICATION = (range(0x1400, 0x1C40), range(0x10F1, 0x10F2))  # made from PDOs and `generic`
_IDENTITY = 0x1018
_ACCESS = {"": "", "R": "w", "T": "r", "RT": ""}  # of CiA 306 behind rw, by PDO mapping
# the cycle of process data is the period of set-points; many files omit 60C2h (inferred)
_NEEDS = {mode: tuple({*indices} - {PERIOD}) for mode, indices in NEEDS.items()}


@dataclass(frozen=True)
class Imported:
    """The result of an import."""

    folder: Path
    name: str
    objects: int  # of the manufacturer's dictionary; 0: those of `generic`
    pdos: tuple[int, int]
    repairs: tuple[Repair, ...]


@dataclass
class Source:
    """The content of a description, whatever its source."""

    device: Description
    name: str  # of the file or the slave
    command: str
    registers: Mapping[int, bytes]  # of the slave controller
    notes: list[str]
    vendor: str
    objects: list[EsiObject] = field(default_factory=list)
    repairs: list[Repair] = field(default_factory=list)
    image: bytes = b""  # of the EEPROM, if it was read


def import_esi(
    path: Path, folder: Path, *, device: str | None = None, chip: str = "et1100"
) -> Imported:
    """Make a drive model from an ESI file.

    Args:
        path: the file.
        folder: of the model; must not exist, or be empty.
        device: one of several in the file: type, name or product code.
        chip: slave controller, a key of `CHIPS`, since the file does not name it.

    Raises:
        ValueError: the file is not the ESI of a drive (with file and line), or the folder is not
            empty.
    """
    check_place(folder)
    file = read_esi(path, device)
    notes = [_chip_note(chip, "file")]
    return import_source(
        Source(file.device, path.name, "servogym drives --from-esi", CHIPS[chip], notes,
               file.vendor, file.objects, file.repairs), folder, path,
    )


def import_sii(path: Path, folder: Path, *, chip: str = "et1100") -> Imported:
    """Make a drive model from an EEPROM image; arguments and errors as for `import_esi`."""
    check_place(folder)
    try:
        image = content(path, "an image of an EEPROM")
    except OSError as error:
        raise ValueError(f"{path}: {error.strerror or error}") from None
    device, word = unpacked(image, path), sii.unended(image)
    repairs = [Repair(0, f"EEPROM, word {word:04X}h", "the image ends without FFFFh", "no more",
                      "a master would not find the end of the categories")] if word else []
    notes = [_chip_note(chip, "image")]
    return import_source(
        Source(device, path.name, "servogym drives --from-sii", CHIPS[chip], notes,
               f"vendor {device.vendor_id:08X}h", repairs=repairs, image=image), folder, path,
    )


def _chip_note(chip: str, source: str) -> str:
    return (f"Slave controller: `inferred`, {chip}; the {source} does not name one. --chip selects "
            "another.")


def unpacked(image: bytes, path: Path) -> Description:
    """The description in an EEPROM image. Raises ValueError naming file and word."""
    try:
        return sii.unpack(image)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None


def import_source(source: Source, folder: Path, path: Path) -> Imported:
    """Make the folder of a model; `path` is named in errors.

    Raises ValueError if no drive can be made of the description.
    """
    source.device, note = with_pdos(source.device, source.objects)
    source.notes += [note] * bool(note)
    title = line(source.device.name or source.device.order or path.stem) or "drive"
    made = ModelFolder(title, Path(source.name).name, source.command, repairs=source.repairs)
    objects = ObjectRows(_sheet(source))
    whole = all((index, 0) in objects.sheet.entries
                and objects.sheet.entries[index, 0].kind == "VAR" for index in NEEDED)
    pdos = EthercatPdos(source.device, objects, whole=whole)
    try:
        if whole:
            fill(made, objects, pdos.make, _NEEDS)
            _add_identity(made, objects, source.device)
        else:
            _fill_from_generic(made, objects, pdos)
        made.toml |= {"buses": ["ethercat"], "defaults": _identity(objects, source.device)}
        made.pdos = None
        made.notes += source.notes
        made.more = {
            "ethercat_objects.csv": _ethercat_objects(pdos),
            "ethercat_pdo.csv": _csv(PDO_COLUMNS, map(asdict, pdos.rows)),
        }
        _write(made, folder, source, pdos)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None
    return Imported(folder, title, len(source.objects), pdos.counts, tuple(made.repairs))


def _sheet(source: Source) -> Sheet:
    """The dictionary of a description, as that of an EDS."""
    sheet = Sheet(Path(source.name), repairs=source.repairs)
    for row in source.objects:
        if not any(row.index in indices for indices in _COMMUNICATION):
            access = row.access if row.access != "rw" else f"rw{_ACCESS[row.mapping]}"
            sheet.entries[row.index, row.subindex] = Entry(
                row.index, row.subindex, row.name, row.kind, row.data_type, access,
                bool(row.mapping), row.default, row.low, row.high, row.line, row.group,
            )
    return sheet


def _fill_from_generic(made: ModelFolder, objects: ObjectRows, pdos: EthercatPdos) -> None:
    """Fill in a model without the dictionary of a drive: only what PDOs map beside `generic`."""
    entries = objects.sheet.entries
    if entries:
        made.tell(0, "dictionary", f"{len(entries)} objects without 6040h and 6041h",
                  "those of generic", "no drive works without them")
        entries.clear()
    pdos.make()
    made.objects = objects.sorted
    made.unknown, made.left_out = objects.unknown, objects.left_out
    made.notes = ["Objects: `inferred`, those of the model `generic`, and any others that PDOs "
                  "map, since there is no dictionary. A slave with SDO information provides "
                  "its own: --from-slave."]


def _identity(objects: ObjectRows, device: Description) -> dict[str, int]:
    """The identity object (1018h) by the names of its objects."""
    numbers = (device.vendor_id, device.product_code, device.revision_number, device.serial_number)
    return {objects.base.objects[_IDENTITY, n].name: number & 0xFFFFFFFF
            for n, number in enumerate(numbers, 1)}


def _add_identity(made: ModelFolder, objects: ObjectRows, device: Description) -> None:
    """Give a dictionary without an identity object one, which every slave has."""
    for n, (name, number) in enumerate(_identity(objects, device).items(), 1):
        if (_IDENTITY, n) not in objects.rows:
            objects.take(Entry(_IDENTITY, n, name, "RECORD", 0x07, "ro", False, str(number),
                               "", "", 0))
    made.objects = objects.sorted


def _write(made: ModelFolder, folder: Path, source: Source, pdos: EthercatPdos) -> None:
    """Write the folder; with a larger EEPROM if the image of the model needs it."""
    toml = EthercatToml(source.device, pdos, made.repairs)
    before = len(made.repairs)

    def write_with(least: int) -> None:
        del made.repairs[before:]
        made.more["ethercat.toml"] = toml.text(
            source.name, source.vendor, source.registers, source.image, least,
        )
        write(made, folder, _check)

    try:
        write_with(0)
    except sii.EepromTooSmall:
        write_with(ENOUGH)  # our names of PDOs and objects are longer than the manufacturer's


def _check(place: Path) -> str:
    """Check that the folder makes a slave that a segment accepts; -> its data sheet."""
    Segment([Slave(Drive(load(place, "ethercat")))])
    return data_sheet(place)


def _ethercat_objects(pdos: EthercatPdos) -> str:
    """Objects of `generic` for EtherCAT, with the PDOs that are assigned."""
    path = load("generic", "ethercat").folder / "ethercat_objects.csv"
    with path.open(newline="", encoding="utf-8") as file:
        reader = csv.DictReader(file)
        columns, rows = reader.fieldnames or [], [*reader]
    assigned = {assignment(manager): pdos.assigned[manager] for manager in (OUTPUTS, INPUTS)}
    for row in rows:
        index, subindex = int(row["index"], 0), int(row["subindex"], 0)
        if index in assigned:
            value = [len(assigned[index]), *assigned[index], *[0] * 254][subindex]
            row["default"] = f"{value:#06x}" if subindex else str(value)
    return _csv(columns, rows)


def _csv(columns: Sequence[str], rows: Iterable[Mapping[str, Any]]) -> str:
    text = io.StringIO()
    writer = csv.DictWriter(text, [*columns], lineterminator="\n", restval="")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()
