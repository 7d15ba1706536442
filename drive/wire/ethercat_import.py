"""Makes a drive model from an ESI file, an EEPROM image, or a connected slave.

Sources: ETG.2000 (ESI), ETG.2010 (SII).

They describe the drive on EtherCAT: identity, PDOs, sync managers, mailboxes, FMMUs and clocks. ESI
files, and slaves with SDO information, also provide the dictionary; without one, the objects are
those of `generic`. Anything that could not be used as it stands is a repair in the README of the
folder.
"""

import base64
import csv
import io
import json
from collections.abc import Container, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

from ..canopen.eds_import import NEEDED, NEEDS, PERIOD, _Import
from ..canopen.sheet import Entry, Sheet
from ..drive import Drive
from ..ethercat import sii
from ..ethercat.controller.record import SII_BYTES
from ..ethercat.description import (
    FIXED,
    INPUTS,
    OUTPUTS,
    UNASSIGNED,
    Description,
    Mailboxes,
    Pdo,
    SyncManager,
    describe,
)
from ..ethercat.description import Entry as PdoEntry
from ..ethercat.esi_reader import EsiObject, read_esi
from ..ethercat.segment import Segment
from ..ethercat.slave import Slave
from ..kernel.process_data import ENTRIES
from ..model.drive_toml import BUSES
from ..model.ethercat import MEMORY, PROTOCOLS
from ..model.files import content
from ..model.made import PDO_COLUMNS, ModelFolder, Repair, check_place, line, write
from ..model.model import load
from ..model.rows import FORMATS, SIZES
from ..statements import data_sheet

SOURCE = "EtherCAT"
LONGEST = BUSES["ethercat"]  # bits of a PDO
LARGEST = SII_BYTES  # of an EEPROM
ENOUGH = 4096  # bytes for what a model writes into one
NAMED = 16  # bytes that an entry and its name take in it, about
COMMUNICATION = (range(0x1400, 0x1C40), range(0x10F1, 0x10F2))  # made from the PDOs and `generic`
PADDING = 0x5FF0  # our object for bits of a PDO that no object of ours has (inferred)
ACCESS = {"": "", "R": "w", "T": "r", "RT": ""}  # of CiA 306 behind rw, by PDO mapping
# registers of slave controllers by name: type, revision, FMMUs, sync managers, RAM, ports, features
CHIPS: dict[str, dict[int, bytes]] = {
    "et1100": {0x00: b"\x11", 0x04: b"\x08", 0x05: b"\x08", 0x06: b"\x08", 0x08: b"\xfc\x00"},
    "lan9252": {0x00: b"\xc0\x02", 0x04: b"\x03", 0x05: b"\x04", 0x06: b"\x04", 0x08: b"\xcc\x01"},
    # an IP core in an FPGA that emulates its EEPROM, as a Kollmorgen AKD shows it (observed)
    "emulated": {0x00: b"\x04", 0x01: b"\x02", 0x04: b"\x04", 0x05: b"\x09", 0x06: b"\x08",
                 0x07: b"\x0f", 0x08: b"\x84\x01", 0x0140: b"\x08\x0c", 0x0502: b"\x20"},
}
ASKED = {0x0000: 9, 0x0140: 2, 0x0502: 1}  # registers of a live slave: address and bytes


@dataclass(frozen=True)
class Imported:
    """The result of an import."""

    folder: Path
    name: str
    objects: int  # of the maker's file; 0: those of `generic`
    pdos: tuple[int, int]
    repairs: tuple[Repair, ...]


@dataclass
class _Source:
    """The content of a description, whatever its source."""

    device: Description
    vendor: str
    objects: list[EsiObject]
    repairs: list[Repair]
    name: str
    command: str
    registers: dict[int, bytes]
    notes: list[str]
    image: bytes = b""  # of the EEPROM, where it was read


def import_esi(
    path: Path, folder: Path, *, device: str | None = None, chip: str = "et1100"
) -> Imported:
    """Make a drive model in `folder`, which must not exist, or be empty, from an ESI file.

    Args:
        path: the file.
        folder: of the model.
        device: one of several in it: type, name or product code.
        chip: slave controller, a key of `CHIPS`, since the file does not name it.

    Raises:
        ValueError: the file is not the ESI of a drive (with file and line), or the folder is not
            empty.
    """
    check_place(folder)
    file = read_esi(path, device)
    notes = [f"Slave controller: `inferred`, {chip}; the file does not say. --chip names another."]
    return _made(
        _Source(file.device, file.vendor, file.objects, file.repairs, path.name,
                "servogym drives --from-esi", CHIPS[chip], notes), folder, path,
    )


def import_sii(path: Path, folder: Path, *, chip: str = "et1100") -> Imported:
    """Make a drive model from an EEPROM image; arguments and errors as for `import_esi`."""
    check_place(folder)
    try:
        image = content(path, "an image of an EEPROM")
    except OSError as error:
        raise ValueError(f"{path}: {error.strerror or error}") from None
    device, word = _unpacked(image, path), sii.unended(image)
    repairs = [Repair(0, f"EEPROM, word {word:04X}h", "the image ends without FFFFh", "no more",
                      "a master finds no end of the categories")] if word else []
    notes = [f"Slave controller: `inferred`, {chip}; the image does not say. --chip names another."]
    return _made(
        _Source(device, f"vendor {device.vendor_id:08X}h", [], repairs, path.name,
                "servogym drives --from-sii", CHIPS[chip], notes, image), folder, path,
    )


def import_slave(interface: str, folder: Path, *, position: int = 0) -> Imported:
    """Make a drive model from a connected slave, which is taken to PRE_OP and not written to.

    Args:
        interface: such as ``eth0``; needs pysoem and permission for raw sockets.
        folder: of the model.
        position: of the slave on the segment, from 0 on.

    Raises:
        ValueError: no such slave. ImportError, ConnectionError: as `SoemMaster`.
    """
    from .soem import SoemMaster

    check_place(folder)
    master = SoemMaster(interface)
    try:
        slaves = master.scan()
        if not 0 <= position < len(slaves):
            raise ValueError(f"-i {interface}: {len(slaves)} slaves answer, none at {position}")
        slave = slaves[position]
        image = slave.read_sii()
        device = _unpacked(image, Path(f"{interface}, slave {position}"))
        found = [*slave.objects()]
        registers = {address: slave.read(address, size) for address, size in ASKED.items()}
    finally:
        master.close()
    notes = [
        "Slave controller: registers 0000h-0008h, 0140h and 0502h as the slave shows them.",
        "Defaults are the values the slave had when it was asked." if found else
        "Its dictionary does not tell itself (no SDO information).",
    ]
    return _made(
        _Source(device, f"vendor {device.vendor_id:08X}h", found, [],
                f"slave {position} on {interface}", "servogym drives --from-slave", registers,
                notes, image), folder, Path(interface),
    )


def _unpacked(image: bytes, path: Path) -> Description:
    try:
        return sii.unpack(image)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None


# ----------------------------------------------------------------------- folder


def _find_pdos(source: _Source) -> None:
    """Where a description lists no PDOs they are those of its dictionary or of `generic`."""
    device = source.device
    if device.rpdos or device.tpdos or not device.protocols >> PROTOCOLS.index("CoE") & 1:
        return
    values = {(row.index, row.subindex): row for row in source.objects}
    rpdos, tpdos = _listed(values, 0x1600, OUTPUTS), _listed(values, 0x1A00, INPUTS)
    whose = "those of its objects 1600h and 1A00h on"
    if not (rpdos or tpdos):
        usual = describe(load("generic", "ethercat"))
        rpdos, tpdos = _possible(usual.rpdos, values), _possible(usual.tpdos, values)
        whose = "`inferred`, those of `generic`"
    source.device = replace(device, rpdos=rpdos, tpdos=tpdos)
    source.notes.append(f"PDOs: {whose}; its description lists none.")


def _listed(values: dict[tuple[int, int], EsiObject], first: int, manager: int) -> tuple[Pdo, ...]:
    """PDOs of a direction, out of the values of a dictionary (ETG.1000.6, 5.6.7.4)."""

    def numbers(index: int) -> list[int]:
        def value(subindex: int) -> int:
            text = values[index, subindex].default if (index, subindex) in values else ""
            try:
                return int(text, 16 if text[:2] == "0x" else 10)
            except ValueError:
                return 0

        return [value(n) for n in range(1, min(value(0), 254) + 1)]

    assigned, pdos = numbers(0x1C10 + manager), []
    for index in sorted({index for index, _ in values if first <= index < first + 0x200}):
        entries = tuple(PdoEntry(row >> 16, row >> 8 & 0xFF, row & 0xFF, 0)
                        for row in numbers(index))
        fixed = all(values[index, n].access == "ro" for n in range(2) if (index, n) in values)
        if entries:
            pdos.append(Pdo(index, values[min(a for a in values if a[0] == index)].group,
                            manager if index in assigned else UNASSIGNED, FIXED * fixed, entries))
    return tuple(pdos)


def _possible(pdos: Sequence[Pdo], values: Container[tuple[int, int]]) -> tuple[Pdo, ...]:
    """PDOs with those of their entries that a dictionary has; all, if it is not that of a drive."""
    if not all((index, 0) in values for index in NEEDED):
        return tuple(pdos)
    kept = ((pdo, tuple(e for e in pdo.entries if (e.index, e.subindex) in values)) for pdo in pdos)
    return tuple(replace(pdo, entries=entries) for pdo, entries in kept if entries)


def _made(source: _Source, folder: Path, path: Path) -> Imported:
    _find_pdos(source)
    title = line(source.device.name or source.device.order or path.stem) or "drive"
    maker = _Maker(source, title)
    made = maker.made()
    try:
        try:
            write(made, folder, _check)
        except sii.EepromTooSmall:
            maker.least = ENOUGH  # our names of PDOs and objects are longer than the maker's
            made.more["ethercat.toml"] = maker.ethercat_toml()
            write(made, folder, _check)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None
    count = len(source.objects)
    return Imported(folder, title, count, maker.counts, tuple(made.repairs))


def _check(place: Path) -> str:
    """Check that the folder makes a slave that a segment accepts; -> its data sheet."""
    Segment([Slave(Drive(load(place, "ethercat")))])
    return data_sheet(place)


class _Maker(_Import):
    """One description on its way to a model."""

    # the cycle of process data is the period of set-points; makers leave 60C2h out (inferred)
    needs: ClassVar = {mode: tuple({*indices} - {PERIOD}) for mode, indices in NEEDS.items()}

    def __init__(self, source: _Source, title: str):
        sheet = Sheet(Path(source.name), repairs=source.repairs)
        for row in source.objects:
            if not any(row.index in indices for indices in COMMUNICATION):
                sheet.entries[row.index, row.subindex] = _entry(row)
        super().__init__(sheet)
        self.result.title, self.result.command = title, source.command
        self.source = source
        self.whole = all(
            (index, 0) in sheet.entries and sheet.entries[index, 0].kind == "VAR"
            for index in NEEDED
        )
        self.counts = (0, 0)
        self._padding = 0
        self.least = 0  # bytes of the EEPROM
        self._assigned: dict[int, list[int]] = {}
        self._mappable_pdos: list[int] = []  # of each direction

    def made(self) -> ModelFolder:
        """The model."""
        made = self.result
        if self.whole:
            super().made()
        else:
            if self.sheet.entries:
                self.sheet.tell(0, "dictionary", f"{len(self.sheet.entries)} objects without 6040h "
                                "and 6041h", "those of generic", "no drive works so")
                self.sheet.entries.clear()
            self._pdos()
            made.objects = [self.rows[address] for address in sorted(self.rows)]
            made.notes = ["Objects: `inferred`, those of the model `generic`, and what PDOs map "
                          "beside them: there is no dictionary. A slave with SDO information tells "
                          "its own: --from-slave."]
        made.toml["buses"] = ["ethercat"]
        made.toml["defaults"] = self._identity()
        made.pdos = None
        made.more = {
            "ethercat.toml": self.ethercat_toml(),
            "ethercat_objects.csv": self._ethercat_objects(),
            "ethercat_pdo.csv": _table(self.pdos),
        }
        made.notes += self.source.notes
        return made

    def _identity(self) -> dict[str, int]:
        device = self.source.device
        numbers = (device.vendor_id, device.product_code, device.revision_number,
                   device.serial_number)
        names = [self.base.objects[0x1018, n].name for n in range(1, 5)]
        if self.whole:
            for n, number in enumerate(numbers, 1):
                if (0x1018, n) not in self.rows:
                    self._take(Entry(0x1018, n, names[n - 1], "RECORD", 0x07, "ro", False,
                                     str(number), "", "", 0))
            self.result.objects = [self.rows[address] for address in sorted(self.rows)]
        return {name: n & 0xFFFFFFFF for name, n in zip(names, numbers, strict=True)}

    # -------------------------------------------------------------------- PDOs

    def _pdos(self) -> None:
        self.pdos = []
        device, counts = self.source.device, []
        for direction, manager, pdos in (("rx", 2, device.rpdos), ("tx", 3, device.tpdos)):
            kept = [(pdo, entries) for pdo in pdos
                    if (entries := self._mapped(direction, pdo)) is not None]
            order = sorted(kept, key=lambda row: row[0].flags & FIXED)  # those that are mappable
            self._mappable_pdos.append(sum(not pdo.flags & FIXED for pdo, _ in kept))
            self._write(direction, order)
            self._assigned[manager] = self._chosen(manager, order)
            counts.append(len(order))
        self.counts = counts[0], counts[1]

    def _repair(self, where: str, says: object, taken: object, why: str) -> None:
        self.result.tell(0, where, says, taken, why)

    def _mapped(self, direction: str, pdo: Pdo) -> list[tuple[int, int, int]] | None:
        """Convert entries for the model; None if the PDO is left out, which is reported."""
        where = f"{pdo.index:04X}h"
        area = range(0x1600, 0x1A00) if direction == "rx" else range(0x1A00, 0x1C00)
        if pdo.index not in area:
            self._repair(where, "a PDO", "left out", "no PDO of this direction lies there")
            return None
        entries: list[tuple[int, int, int]] = []
        loose = 0  # bits that no object of ours carries, before the next that one does

        def fill() -> None:
            nonlocal loose
            if loose:
                entries.extend(self._padded(direction, -(-loose // 8)))
                self._repair(where, f"{loose} bits: gaps or parts of bytes", "objects that do "
                             "nothing", "PDOs are whole objects here")
            loose = 0

        for entry in pdo.entries:
            whole = loose % 8 == 0 and entry.index and entry.bits % 8 == 0
            if whole and self._mappable(direction, entry):
                fill()
                entries.append((entry.index, entry.subindex, entry.bits))
            else:
                loose += entry.bits
        fill()
        if len(entries) > ENTRIES:
            entries = self._shorter(direction, where, entries)
        if len(entries) > ENTRIES or sum(bits for *_, bits in entries) > LONGEST:
            self._repair(where, f"{len(entries)} entries", "left out",
                         f"at most {ENTRIES} entries and {LONGEST} bits here")
            return None
        return entries

    def _shorter(
        self, direction: str, where: str, entries: list[tuple[int, int, int]]
    ) -> list[tuple[int, int, int]]:
        """Limit the entries of a PDO: adjacent manufacturer-specific objects become one gap."""
        own = [entry[:2] not in self.base.objects for entry in entries]
        at = len(entries)
        while at and len(entries) > ENTRIES:
            end = at
            while at and own[at - 1]:
                at -= 1
            if end - at > 1:
                bits = sum(bits for *_, bits in entries[at:end])
                names = ", ".join(f"{i:04X}h:{s:02X}h" for i, s, _ in entries[at:end])
                entries[at:end] = self._padded(direction, bits // 8)
                self._repair(where, names, "objects that do nothing",
                             f"at most {ENTRIES} entries here")
            at -= bool(at)
        return entries

    def _padded(self, direction: str, size: int) -> list[tuple[int, int, int]]:
        entries = []
        while size:
            part = next(part for part in (8, 4, 2, 1) if part <= size)
            size -= part
            self._padding += 1
            index, subindex = PADDING + self._padding // 255, self._padding % 255 + 1
            code = {1: 0x05, 2: 0x06, 4: 0x07, 8: 0x1B}[part]
            self._take(Entry(index, subindex, f"padding {self._padding}", "RECORD", code,
                             "rw" if direction == "rx" else "ro", True, "", "", "", 0))
            entries.append((index, subindex, 8 * part))
        return entries

    def _mappable(self, direction: str, entry: Any) -> bool:
        """Whether an object can be mapped in this length; a missing object is created."""
        address = entry.index, entry.subindex
        row, known = self.rows.get(address), None
        if row is None and not self.whole:
            known = self.base.objects.get(address)
        if row is None and known is not None and 8 * known.size == entry.bits:
            if direction not in known.pdo:
                pdo = "rxtx" if known.pdo else direction
                self.rows[address] = {"index": f"0x{entry.index:04X}", "pdo": pdo,
                                      "subindex": f"0x{entry.subindex:02X}"}
            return True
        if row is None:
            code = {8: 0x05, 16: 0x06, 32: 0x07, 64: 0x1B}.get(entry.bits)
            if code is None:
                return False
            data_type = entry.data_type or code
            self._take(Entry(entry.index, entry.subindex, entry.name or "mapped", "VAR", data_type,
                             "rw" if direction == "rx" else "ro", True, "", "", "", 0))
            row = self.rows.get(address)
        if row is None or row.get("access") == "const":
            return False
        if "data_type" in row:
            letter = FORMATS[row["data_type"]]
            if not letter or 8 * SIZES[letter] != entry.bits:
                return False
        if direction not in row["pdo"]:
            row["pdo"] = "rxtx" if row["pdo"] else direction
        return True

    def _write(self, direction: str, order: Sequence[tuple[Pdo, list[tuple[int, int, int]]]]):
        for number, (pdo, entries) in enumerate(order, 1):
            head = (direction, number, f"0x{pdo.index:04X}", 0, 0)
            for place, (index, subindex, bits) in enumerate(entries, 1):
                self.pdos.append((*head, place, f"0x{index:04X}", f"0x{subindex:02X}", bits,
                                  line(pdo.name), SOURCE))
            if not entries:
                self.pdos.append((*head, "", "", "", "", line(pdo.name), SOURCE))

    def _chosen(self, manager: int, order: Sequence[tuple[Pdo, Any]]) -> list[int]:
        """The PDOs that are assigned by default, as 1C12h and 1C13h accept them here."""
        places = {pdo.index: n for n, (pdo, _) in enumerate(order)}
        wanted = [p.index for p in (*self.source.device.rpdos, *self.source.device.tpdos)
                  if p.sync_manager == manager]
        found = sorted((index for index in wanted if index in places), key=places.__getitem__)
        where = f"{0x1C10 + manager:04X}h"
        if not found and order and wanted:
            index = order[0][0].index
            self._repair(where, "PDOs that were left out", f"{index:04X}h", "the first is left")
            return [index]
        apart = {row.index: row.excludes for row, _ in order}
        if wrong := [i for i in found if {*apart[i]} & {*found}]:
            self._repair(where, ", ".join(f"{i:04X}h" for i in found), f"{found[0]:04X}h",
                         f"{wrong[0]:04X}h excludes others of them")
            return found[:1]
        return found

    # ------------------------------------------------------------------- files

    def ethercat_toml(self) -> str:
        """The file ethercat.toml, with everything but objects and PDOs."""
        device, usual = self.source.device, load("generic", "ethercat").ethercat
        assert usual is not None
        mailbox = self._mailboxes(device.mailbox, usual.mailbox, "mailbox")
        has_boot = device.bootstrap != Mailboxes(0, 0, 0, 0)
        boot = self._mailboxes(device.bootstrap, mailbox, "bootstrap") if has_boot else (0, 0, 0, 0)
        managers = {manager.kind: manager for manager in device.sync_managers}
        start, length = self._buffers(managers, mailbox, usual.start)
        protocols = [p for n, p in enumerate(PROTOCOLS) if device.protocols >> n & 1]
        if "CoE" not in protocols:
            self._repair("Mailbox", "no CoE", "CoE", "the model has no other way to its objects")
            protocols.append("CoE")
        details = device.coe_details or 0x0D
        size = self._eeprom()
        control = [managers[kind].control if kind in managers else usual_
                   for kind, usual_ in ((3, 0x24), (4, 0x20))]
        boxes = [managers[kind].control if kind in managers else usual_
                 for kind, usual_ in ((1, 0x26), (2, 0x22))]
        modes = ", ".join(
            f"{{ name = {self._carried('a mode of SYNC', mode.name, f'mode {n}')}, "
            f"assign_activate = 0x{mode.assign_activate & 0x7FFF:04X}, "
            f"cycle_factor0 = {max(mode.cycle_factor0, 0)} }}"
            for n, mode in enumerate(device.dc_modes, 1)
        )
        # the controller loads its PDI control from the EEPROM (ETG.1000.4)
        loaded = {0x0140: device.pdi_control.to_bytes(2, "little")} if device.pdi_control else {}
        registers = loaded | self.source.registers
        lines = [
            f"# From {line(self.source.name)}; see README.md for what is inferred.",
            f"name = {self._carried('Name', device.name, 'drive')}",
            f"order = {self._carried('Type', device.order, 'drive')}",
            f"group = {self._carried('GroupType', device.group, 'Drive')}",
            f"vendor = {json.dumps(line(self.source.vendor) or 'unknown')}",
            "", "[mailbox]",
            f"standard = {[*mailbox]}", f"bootstrap = {[*boot]}",
            f"shortest = {min(34, mailbox[1], mailbox[3])}",
            f"protocols = {json.dumps(protocols)}", f"coe_details = 0x{details:02X}",
            "", "[process_data]",
            f"start = {[*start]}", f"length = {length}", f"control = {control}",
            f"mailbox_control = {boxes}",
            f"fmmu = {[*(device.fmmus or usual.fmmu)]}",
            "", "[sii]",
            f"size = {size}", f"version = {device.version}",
            f"pdi_control = 0x{device.pdi_control:04X}",
            f"pdi_configuration = 0x{device.pdi_configuration:04X}",
            f"eoe_details = {device.eoe_details}", f"flags = 0x{device.flags:02X}",
            f"ds402_channels = {device.ds402_channels}",
            *self._image(size), "", "[registers]",
            *(f'0x{address:04X} = "{value.hex().upper()}"' for address, value in registers.items()),
            "", "[pdo]",
            f"mappable = {self._mappable_pdos}", "fixed_alone = false",
            f"excludes = {{ {self._excludes()} }}",
            "", "[dc]",
            "cycle_ns = 500_000 # inferred, that of generic",
            "late_limit = 7 # inferred, that of generic",
            "hop_delay_ns = 500 # inferred", "error_settings = true # inferred",
            f"modes = [{modes}]",
            "", "[al]", f"bootstrap = {json.dumps(has_boot)}",
        ]
        return "\n".join(lines) + "\n"

    def _carried(self, where: str, text: str, otherwise: str) -> str:
        """A text for the EEPROM, which carries Latin-1 alone (`sii`), as TOML."""
        whole = line(text)
        kept = whole.encode("latin-1", "ignore").decode("latin-1").strip() or otherwise
        if whole and kept != whole:
            self._repair(where, whole, kept, "the EEPROM carries no other letters")
        return json.dumps(kept)

    def _image(self, size: int) -> list[str]:
        """The manufacturer's EEPROM image, unless something in it had to be repaired."""
        image = self.source.image
        if not image or len(image) > size or self.result.repairs:
            return []
        text = base64.b64encode(image).decode()
        return ["# the maker's; without the next line one is made from this folder",
                f'image = "{text}"']

    def _excludes(self) -> str:
        rows = [(pdo.index, pdo.excludes) for pdo in (*self.source.device.rpdos,
                *self.source.device.tpdos) if pdo.excludes]
        return ", ".join(f"0x{index:04X} = {[*others]}" for index, others in rows)

    def _mailboxes(
        self, boxes: Mailboxes, usual: tuple[int, ...], name: str
    ) -> tuple[int, int, int, int]:
        """Start and length of both mailboxes; the usual ones if those described do not fit."""
        out, out_length, into, in_length = found = (
            boxes.out_start, boxes.out_length, boxes.in_start, boxes.in_length
        )
        inside = all(MEMORY[0] <= start < start + length <= MEMORY[1]
                     for start, length in ((out, out_length), (into, in_length)))
        apart = out + out_length <= into or into + in_length <= out
        if inside and apart and min(out_length, in_length) > 16:
            return found
        self._repair(name, f"{out:04X}h {out_length}, {into:04X}h {in_length}",
                     f"{usual[0]:04X}h {usual[1]}, {usual[2]:04X}h {usual[3]}",
                     "it lies in no memory, or is too short for SDO")
        return usual[0], usual[1], usual[2], usual[3]

    def _buffers(
        self, managers: dict[int, SyncManager], mailbox: Sequence[int], usual: Sequence[int]
    ) -> tuple[tuple[int, int], int]:
        """Start of outputs and inputs, and the number of bytes available for each."""
        starts = [managers[kind].start if kind in managers else 0 for kind in (3, 4)]
        boxes = [(mailbox[0], mailbox[1]), (mailbox[2], mailbox[3])]
        need = max(8, *(self._size(manager) for manager in (2, 3)))

        def room(pair: Sequence[int]) -> int:
            if not all(MEMORY[0] <= start < MEMORY[1] for start in pair) or pair[0] == pair[1]:
                return 0
            ends = [start for start, _ in boxes] + [*pair, MEMORY[1]]
            inside = any(b <= s < b + n for s in pair for b, n in boxes)
            return 0 if inside else min(min(e for e in ends if e > s) - s for s in pair)

        if (length := room(starts)) < need:
            free = max(b + n for b, n in boxes)
            pair = next((p for p in (usual, (free, free + 1024)) if room(p) >= need), None)
            if pair is None:
                raise ValueError(f"no place for {need} bytes of process data beside the mailboxes")
            self._repair("Sm 2, Sm 3", ", ".join(f"{s:04X}h" for s in starts),
                         ", ".join(f"{s:04X}h" for s in pair),
                         f"{need} bytes do not lie there")
            starts, length = [*pair], room(pair)
        return (starts[0], starts[1]), min(length, 1024)

    def _size(self, manager: int) -> int:
        """Bytes of the PDOs of a direction that are assigned, or of the longest."""
        direction = ("rx", "tx")[manager - 2]
        bits: dict[int, int] = {}
        for row in self.pdos:
            if row[0] == direction and row[8] != "":
                bits[int(row[2], 0)] = bits.get(int(row[2], 0), 0) + row[8]
        assigned = sum(bits.get(index, 0) for index in self._assigned[manager])
        return max([assigned, *bits.values()], default=0) // 8

    def _eeprom(self) -> int:
        """A size sufficient for the generated content, at least that of the description."""
        device = self.source.device
        size = device.size if 256 <= device.size <= LARGEST and device.size % 128 == 0 else 0
        image = replace(device, size=1 << 16)
        try:
            used = len(sii.pack(image).rstrip(b"\xff")) + NAMED * self._padding
        except ValueError:
            used = ENOUGH
        taken = (
            max(size, self.least, min(-(-used // 1024) * 1024, ENOUGH))
            if (used > size or self.least)
            else size
        )
        if taken != device.size:
            self._repair("Eeprom", f"{device.size} bytes", f"{taken}", "the image needs them, or "
                         "there is no such size here")
        return taken

    def _ethercat_objects(self) -> str:
        """Objects of `generic` for EtherCAT, with the PDOs that are assigned."""
        path = load("generic", "ethercat").folder / "ethercat_objects.csv"
        with path.open(newline="", encoding="utf-8") as file:
            reader = csv.DictReader(file)
            columns, rows = reader.fieldnames or [], [*reader]
        for row in rows:
            index, subindex = int(row["index"], 0), int(row["subindex"], 0)
            if index in (0x1C12, 0x1C13):
                pdos = self._assigned[index - 0x1C10]
                value = [len(pdos), *pdos, *[0] * 254][subindex]
                row["default"] = f"{value:#06x}" if subindex else str(value)
        return _csv(columns, rows)


def _entry(row: EsiObject) -> Entry:
    access = row.access if row.access != "rw" else f"rw{ACCESS[row.mapping]}"
    return Entry(
        row.index, row.subindex, row.name, row.kind, row.data_type, access, bool(row.mapping),
        row.default, row.low, row.high, row.line, row.group,
    )


def _table(rows: list[tuple[Any, ...]]) -> str:
    return _csv(PDO_COLUMNS, [dict(zip(PDO_COLUMNS, row, strict=True)) for row in rows])


def _csv(columns: Sequence[str], rows: Sequence[dict[str, Any]]) -> str:
    text = io.StringIO()
    writer = csv.DictWriter(text, [*columns], lineterminator="\n", restval="")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()
