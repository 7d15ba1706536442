"""Reads an electronic data sheet (EDS, CiA 306) or device configuration (DCF) as it is found.

Manufacturers' files depart from CiA 306 in many ways that other readers tolerate: an object is
listed but has no section, a section is not listed, an INTEGER16 is 65535, or the text has the
encoding of an editor. All of these are read, and each is recorded as a `Repair` with line, object,
content of the file, value used, and reason. A file that cannot be read is refused with the line.
"""

import re
from dataclasses import dataclass, field
from pathlib import Path

from ..model.files import content
from ..model.made import Repair

LARGEST = 8 * 2**20  # bytes of a file; 10,000 objects have two
LONGEST = 4096  # characters of a value
MOST_SUBS = 254  # sub-indices behind 0
LISTS = ("mandatoryobjects", "optionalobjects", "manufacturerobjects")
COMMISSIONING = ("devicecomissioning", "devicecommissioning")  # CiA 306 spells it with one m
VAR, ARRAY, RECORD, DOMAIN = 0x7, 0x8, 0x9, 0x2
UNSIGNED8, UNSIGNED32, DOMAIN_TYPE = 0x05, 0x07, 0x0F
KINDS = {VAR: "VAR", ARRAY: "ARRAY", RECORD: "RECORD", DOMAIN: "VAR"}
_SECTION = re.compile(r"\[([^\];]*)(\]?)")
_OBJECT = re.compile(r"(?:0x)?([0-9a-f]{4})(?:sub(?:0x)?([0-9a-f]{1,2}))?(value|name|denotation)?")
_NODE = re.compile(r"\$?\s*NODE_?ID", re.I)


@dataclass
class Entry:
    """An object of an electronic data sheet, with its texts unchanged."""

    index: int
    subindex: int
    name: str
    kind: str  # VAR, ARRAY or RECORD
    data_type: int  # number of CiA 301
    access: str
    mappable: bool
    default: str
    low: str
    high: str
    line: int
    group: str = ""  # name of the array or record

    @property
    def where(self) -> str:
        """The address of the object."""
        return f"{self.index:04X}h:{self.subindex:02X}h"


@dataclass
class Sheet:
    """The content of an electronic data sheet, and its repairs."""

    path: Path
    entries: dict[tuple[int, int], Entry] = field(default_factory=dict)
    info: dict[str, dict[str, str]] = field(default_factory=dict)  # sections that are not objects
    repairs: list[Repair] = field(default_factory=list)
    node_id: int | None = None  # of a DCF

    def tell(self, line: int, where: str, says: str, taken: str, why: str) -> None:
        """Note a repair."""
        self.repairs.append(Repair(line, where, says, taken, why))

    def text(self, section: str, key: str) -> str:
        """A value of [FileInfo], [DeviceInfo] and the like, empty where there is none."""
        return self.info.get(section.lower(), {}).get(key.lower(), "")


def number(text: str) -> tuple[int, bool]:
    """Parse a number of an EDS file; -> the number, and whether the node-id is added to it.

    Raises ValueError if the text is not a number.
    """
    plain, per_node = _NODE.subn("", text.strip().strip('"'))
    plain = plain.replace(" ", "").strip("+") or ("0" if per_node else "")
    found = re.fullmatch(r"([+-]?)(?:0x([0-9a-f]+)|([0-9a-f]+)h|(\d+))(?:[ul]+)?", plain, re.I)
    if found is None:
        if re.fullmatch(r"[+-]?\d+\.0*", plain):
            return int(float(plain)), bool(per_node)
        raise ValueError(f"{text!r} is not a number")
    sign, prefixed, suffixed, decimal = found.groups()
    value = int(decimal) if decimal else int(prefixed or suffixed, 16)
    return -value if sign == "-" else value, bool(per_node)


def read_sheet(path: Path) -> Sheet:
    """Read an EDS or a DCF.

    Raises:
        ValueError: the file is not an EDS; with the line if there is one.
        OSError: the file cannot be read.
    """
    sheet = Sheet(path)
    sections = _sections(_decoded(sheet, content(path, "an EDS", LARGEST)), sheet)
    objects: dict[int, dict[int | None, _Section]] = {}
    extras: dict[tuple[int, str], _Section] = {}
    for section in sections:
        found = _OBJECT.fullmatch(section.name)
        if found is None:
            sheet.info.setdefault(section.name, {}).update(section.values)
            continue
        index, sub, extra = int(found[1], 16), found[2], found[3]
        if extra:
            extras[index, extra] = section
        elif index >= 0x1000:
            objects.setdefault(index, {})[None if sub is None else int(sub, 16)] = section
    if not objects:
        line = sections[0].line if sections else 1
        raise ValueError(
            f"{path}, line {line}: no section of an object, such as [1000], follows: it is not an "
            "EDS of CiA 306"
        )
    _listed(sheet, objects)
    for index in sorted(objects):
        _object(sheet, index, objects[index], extras)
    _commissioned(sheet)
    return sheet


@dataclass
class _Section:
    name: str  # in small letters
    line: int
    values: dict[str, str] = field(default_factory=dict)  # keys in small letters

    def get(self, key: str) -> str:
        return self.values.get(key, "")


def _decoded(sheet: Sheet, data: bytes) -> str:
    for mark, encoding in ((b"\xff\xfe", "utf-16"), (b"\xfe\xff", "utf-16")):
        if data.startswith(mark):
            sheet.tell(1, "file", "UTF-16", "the text", "CiA 306 files are ASCII")
            return data.decode(encoding, "replace")
    if b"\0" in data:
        line = data.count(b"\n", 0, data.index(b"\0")) + 1
        raise ValueError(
            f"{sheet.path}, line {line}: it is binary, not the text of an EDS (CiA 306)"
        )
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        sheet.tell(line, "file", f"byte {data[error.start]:02X}h", "read as Windows-1252",
                   "it is neither ASCII nor UTF-8")
        return data.decode("cp1252", "replace")


def _sections(text: str, sheet: Sheet) -> list[_Section]:
    """The sections in their order; a second one of a name goes on with the first."""
    found: dict[str, _Section] = {}
    current: _Section | None = None
    for line, raw in enumerate(text.splitlines(), 1):
        row = raw.strip()
        if not row or row[0] in ";#":
            continue
        if row.startswith("["):
            header = _SECTION.match(row)
            name, closed = (header[1].strip().lower(), header[2]) if header else ("", "")
            if not closed:
                sheet.tell(line, f"[{name}]", row[:40], f"[{name}]", "the ] is missing")
            if name in found:
                sheet.tell(line, f"[{name}]", "a second time", "both together",
                           "a section occurs once")
            current = found.setdefault(name, _Section(name, line))
            continue
        key, equals, value = row.partition("=")
        if not equals or current is None:
            sheet.tell(line, "file", row[:40], "nothing", "it is neither [section] nor key=value")
            continue
        value = value.partition(";")[0].strip()
        if len(value) > LONGEST:
            sheet.tell(line, f"[{current.name}] {key}", f"{len(value)} characters",
                       f"the first {LONGEST}", "longer than any object")
            value = value[:LONGEST]
        current.values[key.strip().lower()] = value
    return [*found.values()]


def _listed(sheet: Sheet, objects: dict[int, dict[int | None, _Section]]) -> None:
    """Compare the lists of objects with the sections there are."""
    listed: set[int] = set()
    for name in LISTS:
        for key, value in sheet.info.get(name, {}).items():
            if key.isdigit():
                try:
                    listed.add(number(value)[0])
                except ValueError:
                    sheet.tell(0, f"[{name}] {key}", value, "nothing", "it is not an index")
    for index in sorted(listed - objects.keys()):
        sheet.tell(0, f"{index:04X}h", "listed", "left out", "it has no section")
    for index in sorted(objects.keys() - listed) if listed else ():
        line = min(section.line for section in objects[index].values())
        sheet.tell(line, f"{index:04X}h", "not listed", "used", "it has a section")


def _object(sheet: Sheet, index: int, parts: dict[int | None, _Section], extras: dict) -> None:
    """The entries of an index."""
    head = parts.get(None)
    subs = {sub: section for sub, section in parts.items() if sub is not None}
    if head is None:
        first = subs[min(subs)]
        head = _Section(f"{index:04x}", first.line, {"objecttype": str(RECORD)})
        sheet.tell(first.line, f"{index:04X}h", "no section", "a record", "it has sub-indices")
    kind = _small(sheet, head, "objecttype", VAR)
    compact = _small(sheet, head, "compactsubobj", 0)
    name = head.get("parametername")
    if compact:
        _compact(sheet, index, head, min(compact, MOST_SUBS), subs, extras)
    if subs and kind in (VAR, DOMAIN):
        sheet.tell(head.line, f"{index:04X}h", "a variable", "a record", "it has sub-indices")
        kind = RECORD
    if kind in (ARRAY, RECORD) and not subs and head.get("datatype"):
        sheet.tell(head.line, f"{index:04X}h", KINDS[kind].lower(), "a variable",
                   "it has no sub-indices, and a data type")
        kind = VAR
    if kind not in KINDS:
        sheet.tell(head.line, f"{index:04X}h", f"object type {kind}", "left out",
                   "it is not an object of a device")
        return
    if kind in (VAR, DOMAIN):
        _entry(sheet, index, 0, head, "VAR", DOMAIN_TYPE if kind == DOMAIN else None, "")
        return
    if not subs:
        sheet.tell(head.line, f"{index:04X}h", "no sub-index", "left out", "it is empty")
        return
    if 0 not in subs:
        sheet.tell(head.line, f"{index:04X}h:00h", "missing", str(max(subs)),
                   "every array and record has its number of entries")
        subs[0] = _Section("", head.line, {
            "parametername": "Number of entries", "datatype": "5", "accesstype": "const",
            "defaultvalue": str(max(subs)),
        })
    for sub in sorted(subs):
        _entry(sheet, index, sub, subs[sub], KINDS[kind], None, name)


def _compact(sheet: Sheet, index: int, head: _Section, count: int, subs: dict, extras: dict):
    """CompactSubObj: so many entries of one type, with [1003Name] and [1003Value] beside it."""
    names = extras.get((index, "name"), _Section("", 0)).values
    values = extras.get((index, "value"), _Section("", 0)).values
    shared = {k: v for k, v in head.values.items() if k not in ("compactsubobj", "objecttype")}
    # one that is a list of up to so many entries has a number of entries that can be written
    writable = 0x1600 <= index < 0x1800 or 0x1A00 <= index < 0x1C00
    filled = [int(key) for key, value in values.items() if key.isdigit() and value]
    entries = max(filled, default=0) if writable else count
    subs.setdefault(0, _Section("", head.line, {
        "parametername": "NrOfObjects", "datatype": "5", "defaultvalue": str(entries),
        "accesstype": "rw" if writable else "ro",
    }))
    for n in range(1, count + 1):
        own = {"parametername": names.get(str(n), f"{head.get('parametername')}{n}")}
        if values.get(str(n)):
            own["defaultvalue"] = values[str(n)]
        subs.setdefault(n, _Section("", head.line, shared | own))


def _entry(
    sheet: Sheet, index: int, sub: int, section: _Section, kind: str, data_type: int | None,
    group: str,
) -> None:
    where = f"{index:04X}h:{sub:02X}h"
    if data_type is None:
        data_type = _small(sheet, section, "datatype", 0)
    if not data_type:
        if sub:
            sheet.tell(section.line, where, "no data type", "left out", "its length is not known")
            return
        data_type = UNSIGNED8 if kind != "VAR" else UNSIGNED32
        sheet.tell(section.line, where, "no data type", f"{data_type:02X}h", "the usual type there")
    access = section.get("accesstype").lower()
    if access not in ("ro", "wo", "rw", "rww", "rwr", "const"):
        taken = "ro" if sub == 0 and kind != "VAR" else "rw"
        sheet.tell(section.line, where, f"access {access!r}", taken, "it is not an access type")
        access = taken
    value = section.get("parametervalue")
    default = section.get("defaultvalue")
    # a DCF says what the drive was given; an identifier that follows the node-id goes on doing so
    follows = _NODE.search(default) is not None
    sheet.entries[index, sub] = Entry(
        index, sub, section.get("parametername"), kind, data_type, access,
        _small(sheet, section, "pdomapping", 0) != 0, value if value and not follows else default,
        section.get("lowlimit"), section.get("highlimit"), section.line, group,
    )


def _small(sheet: Sheet, section: _Section, key: str, otherwise: int) -> int:
    """A number of a section."""
    text = section.get(key)
    if not text:
        return otherwise
    try:
        return number(text)[0]
    except ValueError:
        sheet.tell(
            section.line, f"[{section.name}] {key}", text, str(otherwise), "it is not a number"
        )
        return otherwise


def _commissioned(sheet: Sheet) -> None:
    """The node-id of a DCF."""
    for name in COMMISSIONING:
        text = sheet.text(name, "NodeID")
        try:
            node_id = number(text)[0] if text else 0
        except ValueError:
            sheet.tell(0, f"[{name}] NodeID", text, "none", "it is not a number")
            continue
        if 1 <= node_id <= 127:
            sheet.node_id = node_id
