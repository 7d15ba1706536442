"""Reads ESI files of any manufacturer (ETG.2000) leniently: departures are reported, not refused.

Files may contain several devices, manufacturer-specific data types, arrays, defaults as bytes, sync
managers without a name, or an encoding other than the declared one. A file that cannot be read is
refused with the line.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from xml.parsers import expat

from ..model.ethercat import DATA_LINK_LAYER, IDENTIFICATION
from ..model.files import content
from ..model.made import Repair
from . import esi
from .description import FIXED, UNASSIGNED, DcMode, Description, Entry, Mailboxes, Pdo, SyncManager
from .esi import COE, FMMU_KINDS, PROTOCOLS, SM_KINDS

LARGEST = 32 << 20  # bytes of a file; makers' files of many devices have 20 MB
VARIABLE, ARRAY, RECORD = "VAR", "ARRAY", "RECORD"
# name of a data type -> number of CiA 301
TYPES = {name: number for number, name in esi.TYPES.items()} | {
    "BIT": 0x01, "BYTE": 0x05, "WORD": 0x06, "DWORD": 0x07, "LWORD": 0x1B, "BITARR8": 0x05,
    "BITARR16": 0x06, "BITARR32": 0x07, "STRING": 0x09, "VISIBLE_STRING": 0x09,
    "OCTET_STRING": 0x0F, "UNICODE_STRING": 0x0F,
    # as `ethercat xml` of IgH's master names them
    "INT8": 0x02, "INT16": 0x03, "INT32": 0x04, "INT64": 0x15,
    "UINT8": 0x05, "UINT16": 0x06, "UINT32": 0x07, "UINT64": 0x1B,
}
UNSIGNED = {8: 0x05, 16: 0x06, 32: 0x07, 64: 0x1B}
TEXT = 0x09
CONTROL = {1: 0x26, 2: 0x22, 3: 0x24, 4: 0x20}  # control byte of a sync manager by its use
_TRUE = ("1", "true")
DECLARED = re.compile(rb"""\s*<\?xml[^>]{0,200}?encoding\s*=\s*["']([^"']{1,40})["'][^>]*\?>""")
KNOWN_ENCODINGS = ("utf-8", "utf-16", "iso-8859-1", "us-ascii")  # to the parser itself


class EsiError(ValueError):
    """A file that is refused, with its name and the line."""


class _Element(ElementTree.Element):
    """An element that knows its line."""

    line = 0


@dataclass
class EsiObject:
    """An entry of the dictionary, its values as texts."""

    index: int
    subindex: int
    name: str
    group: str  # name of the array or record
    kind: str  # VAR, ARRAY, RECORD
    data_type: int
    access: str
    mapping: str  # "", R, T, RT
    default: str
    low: str
    high: str
    line: int


@dataclass
class EsiFile:
    """The description of one device in a file."""

    device: Description
    vendor: str
    objects: list[EsiObject]
    repairs: list[Repair] = field(default_factory=list)


def read_esi(path: Path, device: str | None = None) -> EsiFile:
    """Read one device of a file.

    Args:
        path: the file.
        device: its type, name or product code (``#x00414B44``); the first drive if not given.

    Raises:
        ValueError: the file is not an ESI, is truncated or too large, defines entities, or does
            not contain the device; with file and line.
    """
    return _Reader(path).read(device)


class _Reader:
    """One file."""

    def __init__(self, path: Path):
        self.path = path
        self.repairs: list[Repair] = []
        try:
            data = content(path, "an ESI file", LARGEST)
        except OSError as error:
            raise ValueError(f"{path}: {error.strerror or error}") from None
        self.root = self._tree(data)

    def tell(self, element: Any, where: str, says: object, taken: object, why: str) -> None:
        """Note a repair."""
        line = getattr(element, "line", 0)
        self.repairs.append(Repair(line, where, str(says), str(taken), why))

    def error(self, line: int, text: str) -> EsiError:
        """Return an error with file and line."""
        return EsiError(f"{self.path}, line {line}: {text}")

    # -------------------------------------------------------------------- XML

    def _tree(self, data: bytes) -> ElementTree.Element:
        declared = DECLARED.match(data)
        name = declared[1].decode("ascii", "replace") if declared else ""
        if declared and name.lower() not in KNOWN_ENCODINGS:  # such as gb2312
            try:
                text = data.decode(name)
            except (LookupError, ValueError) as error:
                why = " ".join(str(error).split())
                raise self.error(1, f"no XML: encoding {name!r}: {why}") from None
            data = text[text.find("?>") + 2 :].encode()
        try:
            return self._parsed(data, None)
        except expat.ExpatError as error:
            if error.code == 4 and b"encoding" not in data[:200]:  # an invalid token
                try:
                    root = self._parsed(data, "iso-8859-1")
                except expat.ExpatError:
                    pass
                else:
                    self.tell(None, "encoding", "none declared, and no UTF-8", "ISO 8859-1",
                              "every byte is a character of it")
                    return root
            raise self.error(error.lineno, f"no XML: {expat.ErrorString(error.code)}") from None
        except EsiError:
            raise
        except (LookupError, ValueError) as error:  # of an encoding that only the parser saw
            raise self.error(1, f"no XML: {error}") from None

    def _parsed(self, data: bytes, encoding: str | None) -> ElementTree.Element:
        builder = ElementTree.TreeBuilder(element_factory=_Element)
        parser = expat.ParserCreate(encoding)
        parser.buffer_text = True
        depth = 0

        def refuse(*_: object) -> None:
            raise self.error(
                parser.CurrentLineNumber, "a document type or entities of its own: take them out"
            )

        def start(tag: str, attributes: dict[str, str]) -> None:
            nonlocal depth
            depth += 1
            if depth > 100:
                raise self.error(parser.CurrentLineNumber, "more than 100 elements in one another")
            element = builder.start(tag.rpartition(":")[2], attributes)
            element.line = parser.CurrentLineNumber  # type: ignore[attr-defined]

        def end(tag: str) -> None:
            nonlocal depth
            depth -= 1
            builder.end(tag.rpartition(":")[2])

        parser.StartElementHandler, parser.EndElementHandler = start, end
        parser.CharacterDataHandler = builder.data
        parser.StartDoctypeDeclHandler = parser.EntityDeclHandler = refuse
        parser.Parse(data, True)
        return builder.close()

    def _number(
        self, text: str | None, element: Any, what: str, otherwise: int = 0, bits: int = 16,
        low: int = 0,
    ) -> int:
        """Parse ``#x1C12``, ``0x1C12`` or ``7186``; invalid or too long numbers are reported."""
        text = (text or "").strip()
        if not text:
            return otherwise
        try:
            prefixed = text[:2].lower() in ("#x", "0x")
            value = int(text[2:], 16) if prefixed else int(text)
        except ValueError:
            self.tell(element, what, text[:40], otherwise, "it is not a number")
            return otherwise
        if not low <= value < 1 << bits:
            self.tell(element, what, text[:40], otherwise, f"it is not in {low}..{(1 << bits) - 1}")
            return otherwise
        return value

    # ----------------------------------------------------------------- devices

    def read(self, wanted: str | None) -> EsiFile:
        """Read the chosen device."""
        if self.root.tag != "EtherCATInfo":
            line = getattr(self.root, "line", 1)
            raise self.error(line, f"the root of an ESI file is EtherCATInfo, not {self.root.tag}")
        devices = self.root.findall("Descriptions/Devices/Device")
        if not devices:
            raise self.error(getattr(self.root, "line", 1), "there is no Device in it")
        device = self._chosen(devices, wanted)
        described = self._describe(device)
        vendor = (self.root.findtext("Vendor/Name") or "").strip()
        objects = [*self._objects(device)]
        return EsiFile(described, vendor, objects, self.repairs)

    def _chosen(self, devices: list[ElementTree.Element], wanted: str | None):
        def called(device: ElementTree.Element) -> list[str]:
            kind = device.find("Type")
            product = kind.get("ProductCode", "") if kind is not None else ""
            return [_text(device, "Type"), _text(device, "Name"), product]

        if wanted is not None:
            for device in devices:
                if wanted.lower() in (name.lower() for name in called(device)):
                    return device
            known = "; ".join(" / ".join(filter(None, called(d))) for d in devices[:12])
            raise ValueError(f"{self.path}: no device {wanted!r} in it, choose one of {known}")
        drives = [device for device in devices if self._is_drive(device)]
        if not drives:
            line = getattr(devices[0], "line", 1)
            raise self.error(
                line, "no device with a controlword (6040h): it is not a CiA 402 drive"
            )
        if len(devices) > 1:
            self.tell(drives[0], "Device", f"{len(devices)} devices", _text(drives[0], "Type"),
                      "the first that is a drive; --device names another")
        return drives[0]

    def _is_drive(self, device: ElementTree.Element) -> bool:
        indices = [
            *device.iterfind("RxPdo/Entry/Index"),
            *device.iterfind("Profile/Dictionary/Objects/Object/Index"),
        ]
        return any((e.text or "").strip().lower() in ("#x6040", "24640") for e in indices)

    def _describe(self, device: ElementTree.Element) -> Description:
        kind = device.find("Type")
        attributes = kind.attrib if kind is not None else {}
        if not attributes.get("ProductCode"):
            self.tell(device, "Type", "no ProductCode", "0", "the identity lacks it")
        managers = self._managers(device)
        mailbox = device.find("Mailbox")
        offered = {child.tag: child for child in mailbox} if mailbox is not None else {}
        coe, details = offered.get("CoE"), 0
        if coe is not None:
            details = 1 | sum(_flag(coe, name, bit) for bit, name in COE.items())
        config = self._bytes(device, "Eeprom/ConfigData")
        boot = self._bytes(device, "Eeprom/BootStrap").ljust(8, b"\0")
        words = [int.from_bytes(boot[at : at + 2], "little") for at in range(0, 8, 2)]
        ports = {"Y": 1, "K": 3, "H": 2}
        physics = device.get("Physics") or ""
        by_kind = {manager.kind: manager for manager in managers}
        out, into = by_kind.get(1), by_kind.get(2)
        size = self._number(
            device.findtext("Eeprom/ByteSize"), device, "Eeprom/ByteSize", 2048, 32
        )
        return Description(
            vendor_id=self._number(self.root.findtext("Vendor/Id"), self.root, "Vendor/Id", 0, 32),
            product_code=self._number(attributes.get("ProductCode"), kind, "ProductCode", 0, 32),
            revision_number=self._number(attributes.get("RevisionNo"), kind, "RevisionNo", 0, 32),
            serial_number=self._number(attributes.get("SerialNo"), kind, "SerialNo", 0, 32),
            name=_text(device, "Name") or _text(device, "Type"),
            order=_text(device, "Type"),
            group=_text(device, "GroupType") or "Drive",
            mailbox=Mailboxes(out.start, out.length, into.start, into.length)
            if out and into
            else Mailboxes(0, 0, 0, 0),
            bootstrap=Mailboxes(*words),
            protocols=sum(bit for name, bit in PROTOCOLS.items() if name in offered),
            coe_details=details,
            foe_details=int("FoE" in offered),
            eoe_details=int("EoE" in offered),
            flags=_flag(mailbox, "DataLinkLayer", DATA_LINK_LAYER)
            | IDENTIFICATION * (_text(device, "Info/IdentificationReg134").lower() in _TRUE),
            physical_ports=sum(ports.get(p, 0) << 4 * n for n, p in enumerate(physics[:4])),
            fmmus=tuple(self._fmmu(fmmu) for fmmu in device.iterfind("Fmmu")),
            sync_managers=managers,
            tpdos=tuple(self._pdo(pdo) for pdo in device.iterfind("TxPdo")),
            rpdos=tuple(self._pdo(pdo) for pdo in device.iterfind("RxPdo")),
            dc_modes=tuple(self._mode(mode) for mode in device.iterfind("Dc/OpMode")),
            pdi_control=int.from_bytes(config[:2], "little"),
            pdi_configuration=int.from_bytes(config[2:4], "little"),
            size=size,
        )

    def _bytes(self, device: ElementTree.Element, path: str) -> bytes:
        element = device.find(path)
        text = "".join((element.text or "").split()) if element is not None else ""
        try:
            return bytes.fromhex(text)
        except ValueError:
            self.tell(element, path, text[:40], "none", "these are not bytes")
            return b""

    def _managers(self, device: ElementTree.Element) -> tuple[SyncManager, ...]:
        kinds = {name.lower(): kind for kind, name in SM_KINDS.items()}
        found = []
        for n, sm in enumerate(device.iterfind("Sm")):
            text = (sm.text or "").strip()
            kind = kinds.get(text.lower(), 0)
            if not kind:
                kind = n + 1 if n < len(SM_KINDS) else 0
                self.tell(sm, f"Sm {n}", text or "no name", SM_KINDS.get(kind, "unused"),
                          "sync managers come in this order")
            found.append(
                SyncManager(
                    self._number(sm.get("StartAddress"), sm, f"Sm {n}"),
                    self._number(sm.get("DefaultSize"), sm, f"Sm {n}"),
                    self._number(sm.get("ControlByte"), sm, f"Sm {n}", CONTROL.get(kind, 0), 8),
                    self._number(sm.get("Enable"), sm, f"Sm {n}", 1, 8), kind,
                )
            )
        return tuple(found)

    def _fmmu(self, element: ElementTree.Element) -> int:
        text = (element.text or "").strip()
        for kind, name in FMMU_KINDS.items():
            if text.lower() == name.lower():
                return kind
        self.tell(element, "Fmmu", text or "no name", FMMU_KINDS[0], "there is no such use")
        return 0

    def _pdo(self, element: ElementTree.Element) -> Pdo:
        index = self._number(element.findtext("Index"), element, "PDO")
        where = f"{index:04X}h"
        manager = element.get("Sm")
        entries = []
        for line in element.iterfind("Entry"):
            bits = self._number(line.findtext("BitLen"), line, where)
            target = self._number(line.findtext("Index"), line, where)
            subindex = self._number(line.findtext("SubIndex"), line, where, 0, 8)
            data_type = self._type(line, _text(line, "DataType"), bits, where) if target else 0
            entries.append(Entry(target, subindex, bits, data_type, _text(line, "Name")))
        return Pdo(
            index, _text(element, "Name"),
            UNASSIGNED if manager is None else self._number(
                manager, element, where, UNASSIGNED, 8
            ),
            _flag(element, "Fixed", FIXED), tuple(entries),
            tuple(self._number(e.text, e, where) for e in element.iterfind("Exclude")),
        )

    def _mode(self, element: ElementTree.Element) -> DcMode:
        def number(path: str) -> int:
            return self._number(element.findtext(path), element, f"OpMode {path}", 0, 31, -1 << 31)

        def factor(path: str) -> int:
            found = element.find(path)
            return 0 if found is None else self._number(
                found.get("Factor"), found, path, 0, 15, -1 << 15
            )

        return DcMode(
            _text(element, "Name"), number("AssignActivate"), number("CycleTimeSync0"),
            number("ShiftTimeSync0"), number("ShiftTimeSync1"), factor("CycleTimeSync0"),
            factor("CycleTimeSync1"),
        )

    # -------------------------------------------------------------- dictionary

    def _type(self, element: Any, name: str, bits: int, where: str) -> int:
        """Number of a data type; for an unknown name, that of a type with its length."""
        plain = name.partition("(")[0].strip().upper()
        if plain in TYPES:
            return TYPES[plain]
        if plain.startswith("ARRAY"):
            return 0x0F
        if plain.startswith("BIT") and plain[3:].isdecimal():
            return 0x01 if bits == 1 else 0x05
        known = UNSIGNED.get(bits)
        if known is None:
            self.tell(element, where, name or f"{bits} bits", "OCTET_STRING", "an unknown type")
            return 0x0F
        self.tell(element, where, name or "no data type", f"unsigned, {bits} bits",
                  "an unknown type of this length")
        return known

    def _objects(self, device: ElementTree.Element) -> Iterator[EsiObject]:
        dictionary = device.find("Profile/Dictionary")
        if dictionary is None:
            return
        types = {_text(kind, "Name"): kind for kind in dictionary.iterfind("DataTypes/DataType")}
        seen: set[tuple[int, int]] = set()
        for element in dictionary.iterfind("Objects/Object"):
            index = self._number(element.findtext("Index"), element, "Object")
            if not 0x1000 <= index <= 0xFFFF:
                self.tell(element, f"{index:X}h", "an object", "left out", "no object lies there")
                continue
            for found in self._of_object(element, index, types):
                if (index, found.subindex) not in seen:
                    seen.add((index, found.subindex))
                    yield found

    def _of_object(
        self, element: ElementTree.Element, index: int, types: dict[str, ElementTree.Element]
    ) -> Iterator[EsiObject]:
        name = _text(element, "Name") or f"object {index:04X}h"
        kind = types.get(_text(element, "Type"))
        items = kind.findall("SubItem") if kind is not None else []
        infos = element.findall("Info/SubItem")
        if not items:
            yield self._entry(element, element, element, index, 0, name, name, VARIABLE, types)
            return
        place = 0
        for item in items:
            inner = types.get(_text(item, "Type"))
            array = inner.find("ArrayInfo") if inner is not None else None
            if array is None:
                subindex = self._number(
                    item.findtext("SubIdx"), item, f"{index:04X}h", place & 0xFF, 8
                )
                info = infos[place] if place < len(infos) else None
                label = _text(item, "Name") or f"{subindex:02X}"
                yield self._entry(item, info, element, index, subindex, label, name, RECORD, types)
                place += 1
                continue
            assert inner is not None
            first = self._number(array.findtext("LBound"), array, f"{index:04X}h", 1)
            count = self._number(array.findtext("Elements"), array, f"{index:04X}h")
            for n in range(min(count, 255 - min(first, 255))):
                info = infos[place] if place < len(infos) else None
                label = (_text(info, "Name") if info is not None else "") or f"{first + n:02X}"
                yield self._entry(
                    item, info, element, index, first + n, label, name, ARRAY, types,
                    base=_text(inner, "BaseType"),
                )
                place += 1

    def _entry(
        self, item: ElementTree.Element, info: ElementTree.Element | None,
        parent: ElementTree.Element, index: int, subindex: int, name: str, group: str, kind: str,
        types: dict[str, ElementTree.Element], base: str = "",
    ) -> EsiObject:
        where = f"{index:04X}h:{subindex:02X}h"
        type_name = base or _text(item, "Type")
        own = types.get(type_name)
        bits = self._number(item.findtext("BitSize"), item, where)
        if own is not None:
            bits = self._number(own.findtext("BitSize"), own, where, bits)
            type_name = _text(own, "BaseType") or type_name
        data_type = self._type(item, type_name, bits, where)
        flags = item.find("Flags")
        flags = parent.find("Flags") if flags is None else flags
        access = _text(flags, "Access").lower() if flags is not None else ""
        mapping = _text(flags, "PdoMapping").upper() if flags is not None else ""
        if access not in ("ro", "wo", "rw"):
            if access:
                self.tell(item, where, f"access {access}", "rw", "there is no such access")
            access = "rw" if access else "ro"
        values = {
            what: self._value(info, what, data_type, where) for what in ("Default", "Min", "Max")
        }
        return EsiObject(
            index, subindex, name, group, kind, data_type, access,
            "".join(letter for letter in "RT" if letter in mapping),
            values["Default"], values["Min"], values["Max"], getattr(item, "line", 0),
        )

    def _value(
        self, info: ElementTree.Element | None, what: str, data_type: int, where: str
    ) -> str:
        """A value as a text: of DefaultData (bytes), or DefaultValue and DefaultString."""
        holder = info.find("Info") if info is not None else None
        if holder is None:
            return ""
        data = "".join(_text(holder, f"{what}Data").split())
        if data:
            try:
                raw = bytes.fromhex(data)
            except ValueError:
                self.tell(info, where, f"{what}Data {data[:40]}", "none", "these are not bytes")
                return ""
            if data_type == TEXT:
                return raw.rstrip(b"\0").decode("latin-1")
            return str(int.from_bytes(raw[:8], "little")) if data_type != 0x0F else ""
        text = _text(holder, f"{what}Value") or _text(holder, f"{what}String")
        return f"0x{text[2:]}" if text[:2].lower() == "#x" else text


def _text(element: Any, path: str) -> str:
    return " ".join((element.findtext(path) or "").split())


def _flag(element: Any, name: str, value: int) -> int:
    """`value` where an attribute is true."""
    return value if element is not None and (element.get(name) or "").lower() in _TRUE else 0
