"""A drive model made from somebody's EDS (CiA 306): a folder that every command takes.

The EDS says which objects there are, their types, ranges, defaults and PDOs; not what the drive
does. What the profile knows, with the type it has there, behaves as in the model `generic`; the
rest are objects that keep what is written. The folder's README says which is which.
"""

import configparser
import csv
import json
import re
import shutil
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import canopen
from canopen.objectdictionary import ODVariable, datatypes

from ..drive import Drive
from ..kernel.words import MODE_ABBREVIATION
from ..model.files import content
from ..model.model import load
from ..model.pdo import mapping_entry
from ..model.rows import FORMATS, Object
from ..objects.abort import SdoAbort

LARGEST = 2_000_000  # bytes
MOST = 6000  # objects
LISTS = ("MandatoryObjects", "OptionalObjects", "ManufacturerObjects")
NEEDED = (0x1000, 0x6040, 0x6041)
TYPES = {
    number: name
    for name in FORMATS
    if (number := getattr(datatypes, name, None)) is not None
}  # fmt: skip
COLUMNS = ("index", "subindex", "name", "object_type", "data_type", "access", "pdo", "unit", "min",
           "max", "default", "storable", "section", "note", "field", "when", "hook")  # fmt: skip
# access of CiA 306 -> of a row, and where it may be mapped
ACCESS = {
    "ro": ("ro", "tx"), "wo": ("wo", "rx"), "rw": ("rw", "rxtx"), "rww": ("rw", "rx"),
    "rwr": ("rw", "tx"), "const": ("const", ""),
}  # fmt: skip
SOURCE = "EDS"


@dataclass(frozen=True)
class Imported:
    """What became of an EDS."""

    folder: Path
    objects: int
    unknown: tuple[str, ...]  # objects that only keep what is written
    left_out: tuple[str, ...]  # objects of a type the emulator does not have


def import_eds(eds: Path, folder: Path) -> Imported:
    """Make a drive model in `folder`, which must not exist, or be empty.

    Raises:
        ValueError: the file is no EDS of a CiA 402 drive, or there is no place for the folder.
    """
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise ValueError(f"{folder} is there already: choose a folder that is new or empty")
    if not folder.parent.is_dir():
        raise ValueError(f"{folder}: there is no folder {folder.parent}; make it first")
    od = _parsed(eds)
    made = Path(tempfile.mkdtemp(dir=folder.parent, prefix=f".{folder.name}."))
    try:
        summary = _write(od, made, eds)
        try:
            Drive(made)
        except (ValueError, SdoAbort) as error:
            raise ValueError(f"{eds}: {str(error).replace(str(made), str(folder))}") from None
        if folder.exists():
            folder.rmdir()
        made.chmod(0o755)
        made.rename(folder)
    except BaseException:
        shutil.rmtree(made, ignore_errors=True)
        raise
    return Imported(folder, *summary)


def _parsed(eds: Path) -> canopen.ObjectDictionary:
    if not eds.exists():
        raise ValueError(f"{eds}: there is no such file")
    data = content(eds, "an EDS", LARGEST)
    if b"\0" in data:
        raise ValueError(f"{eds}: it is binary, not the text of an EDS (CiA 306)")
    lists = configparser.RawConfigParser(strict=False)
    with tempfile.TemporaryDirectory() as place:
        copy = Path(place) / "drive.eds"  # by its suffix canopen knows what it is
        copy.write_text(data.decode("utf-8", "replace"), encoding="utf-8")
        try:
            lists.read(copy, encoding="utf-8")
            od = canopen.import_od(str(copy))
            listed = {
                int(value, 0) for name in LISTS for key, value in lists.items(name) if key.isdigit()
            }
        except Exception as error:  # canopen raises anything
            reason = str(error).splitlines()[0].replace(str(copy), "") if str(error) else ""
            reason = f"{type(error).__name__}: {reason}"
            raise ValueError(f"{eds}: it is no EDS of CiA 306 ({reason[:120]})") from None
    missing = sorted(listed - set(od))
    if missing:
        raise ValueError(
            f"{eds}: {missing[0]:04X}h is listed, but its section is missing: is it complete?"
        )
    for index in NEEDED:
        if index not in od:
            raise ValueError(f"{eds}: it has no {index:04X}h: it is not that of a CiA 402 drive")
    return od


def _variables(od: canopen.ObjectDictionary) -> Iterator[tuple[ODVariable, str]]:
    """Objects with their object type."""
    for index in sorted(od):
        item = od[index]
        if isinstance(item, ODVariable):
            if index >= 0x1000:
                yield item, "VAR"
            continue
        kind = "ARRAY" if isinstance(item, canopen.objectdictionary.ODArray) else "RECORD"
        for subindex in sorted(item.subindices):
            yield item.subindices[subindex], kind


def _write(
    od: canopen.ObjectDictionary, folder: Path, eds: Path
) -> tuple[int, tuple[str, ...], tuple[str, ...]]:
    base = load("generic")
    rows: list[dict[str, Any]] = []
    unknown: list[str] = []
    left_out: list[str] = []
    names: set[str] = set()
    for variable, kind in _variables(od):
        address = variable.index, variable.subindex
        shown = f"{address[0]:04X}h:{address[1]:02X} {_text(variable.name)}"
        data_type = TYPES.get(variable.data_type)
        if data_type is None:
            left_out.append(shown)
            continue
        known: Object | None = base.objects.get(address)
        if known is not None and known.data_type != data_type:
            known = None
        name = known.name if known else _name(variable, names)
        names.add(name)
        rows.append(_row(variable, kind, data_type, known, name))
        if known is None and not 0x1000 <= variable.index < 0x2000:
            unknown.append(shown)
    if len(rows) > MOST:
        raise ValueError(f"{eds}: {len(rows)} objects are more than {MOST}")
    with (folder / "objects.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, COLUMNS, restval="")
        writer.writeheader()
        writer.writerows(rows)
    _write_pdos(od, folder / "pdo.csv")
    title = _text(od.device_information.product_name or eds.stem) or "drive"
    supported = od.get(0x6502)
    bits = getattr(supported, "default", None) or 0
    modes = [MODE_ABBREVIATION[m] for m in base.modes if bits >> (m - 1) & 1]
    without = sorted({f"{index:04X}h" for index, _ in base.objects})
    lines = [
        f"# From {_text(eds.name)}; see README.md for what is inferred.",
        f"title = {json.dumps(title)}", 'based_on = "generic"', 'buses = ["can"]',
        f"without = {json.dumps(without)} # objects.csv has all there are",
    ]  # fmt: skip
    listed = getattr(od.get(0x60E3), "subindices", {})
    said = {row.default for subindex, row in listed.items() if subindex}
    methods = [method for method in base.homing_methods if method in said]
    if modes or methods:
        lines += ["", "[capabilities] # 6502h, 60E3h"]
    if modes:
        lines.append(f"modes = {json.dumps(modes)}")
    if methods:
        lines.append(f"homing_methods = {json.dumps(methods)}")
    (folder / "drive.toml").write_text("\n".join(lines) + "\n", encoding="utf-8")
    (folder / "README.md").write_text(
        _readme(title, eds, bool(modes), bool(methods), unknown, left_out), encoding="utf-8"
    )
    return len(rows), tuple(unknown), tuple(left_out)


def _row(
    variable: ODVariable, kind: str, data_type: str, known: Object | None, name: str
) -> dict[str, Any]:  # fmt: skip
    access, pdo = ACCESS.get(variable.access_type, ("rw", "rxtx"))
    code = FORMATS[data_type]
    row: dict[str, Any] = {
        "index": f"0x{variable.index:04X}", "subindex": f"0x{variable.subindex:02X}",
        "name": name, "object_type": kind, "access": access, "section": SOURCE,
        "pdo": pdo if variable.pdo_mappable and access != "const" else "-",
    }  # fmt: skip
    row |= {} if known else {"data_type": data_type, "note": "unknown: keeps what is written"}
    if not known:
        row["pdo"] = row["pdo"].strip("-")
        row["storable"] = "yes" if access == "rw" else ""
    if known and known.area == "constant" and access != "const":
        row["access"] = known.access if known.access == "const" else access
        row["pdo"] = "-"
    default = _default(variable)
    if not code:
        row["default"] = _text(str(variable.default or "")) or ("-" if known else "")
        return row
    low, high = variable.min, variable.max
    if code != "f" and low is not None and high is not None and low <= high:
        number = variable.default if isinstance(variable.default, int) else 0
        if low <= number <= high:
            row["min"], row["max"] = low, high
    row["default"] = default if default else ("" if known else "0")
    return row


def _default(variable: ODVariable) -> str:
    raw = str(getattr(variable, "default_raw", "") or "")
    if variable.relative or "$NODEID" in raw.upper():
        found = re.search(r"0[xX][0-9a-fA-F]+|\b\d+\b", re.sub(r"\$NODEID", "", raw, flags=re.I))
        return f"{found[0] if found else 0}+node_id"
    return "" if variable.default is None else str(variable.default)


def _identifier(variable: ODVariable | None) -> str:
    """COB-ID of a PDO in the form of pdo.csv; without one it is off."""
    text = _default(variable) if variable is not None else ""
    number, plus, node = (text or "0x80000000").partition("+")
    return f"0x{int(number, 0):08X}{plus}{node}"


def _write_pdos(od: canopen.ObjectDictionary, path: Path) -> None:
    """The PDOs as the EDS has them by default, in the form of pdo.csv."""
    rows = []
    for direction, first in (("rx", 0x1400), ("tx", 0x1800)):
        number = 0
        while first + number in od and first + 0x200 + number in od:
            parameters: Any = od[first + number]
            mapping: Any = od[first + 0x200 + number]
            value = {s: parameters.subindices.get(s) for s in (1, 2, 3)}
            common = [
                direction, number + 1,
                _identifier(value[1]),
                (_default(value[2]) if value[2] else "") or "255",
                (_default(value[3]) if value[3] else "") or "0",
            ]  # fmt: skip
            count = mapping.subindices[0].default or 0
            entries = [
                int(mapping.subindices[s].default or 0)
                for s in range(1, count + 1)
                if s in mapping.subindices
            ]
            for position, entry in enumerate(filter(None, entries), 1):
                index, subindex, bits = mapping_entry(entry)
                rows.append([*common, position, f"0x{index:04X}", f"0x{subindex:02X}", bits, "",
                             SOURCE])  # fmt: skip
            if not any(entries):
                rows.append([*common, "", "", "", "", "empty", SOURCE])
            number += 1
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["direction", "number", "cob_id", "transmission_type", "inhibit_time",
                         "position", "index", "subindex", "bits", "note", "section"])  # fmt: skip
        writer.writerows(rows)


def _text(text: str) -> str:
    """In one line, printable."""
    return "".join(c for c in " ".join(str(text).split()) if c.isprintable())[:120]


def _name(variable: ODVariable, taken: set[str]) -> str:
    parent: Any = variable.parent
    own = variable.name if variable.subindex == 0 else f"{parent.name}_{variable.name}"
    name = re.sub(r"[^a-z0-9]+", "_", own.lower()).strip("_") or "object"
    name = name if not name[0].isdigit() else f"object_{name}"
    generic = load("generic").names
    if name in taken or name in generic:
        name = f"{name}_{variable.index:04x}_{variable.subindex:02x}"
    return name


def _readme(
    title: str, eds: Path, modes: bool, methods: bool, unknown: list[str], left_out: list[str]
) -> str:  # fmt: skip
    def listed(items: list[str]) -> str:
        return "\n".join(f"- {item}" for item in items) or "- none"

    methods_from = "from 60E3h" if methods else "`inferred`: those of `generic`, 60E3h names none"
    modes_from = "from 6502h" if modes else "`inferred`: those of `generic`, 6502h has no default"
    return f"""# {title}

Made from `{_text(eds.name)}` by `servogym drives --from-eds`. An EDS tells objects, types, ranges,
defaults and PDOs. It does not tell what the drive does.

- Behaviour of the objects that CiA 402 knows: `inferred`, as the model `generic`.
- Cycle times, motor, faults: `inferred`, those of `generic`. Correct them in
  `drive.toml`.
- Modes of operation: {modes_from}. Homing methods: {methods_from}.
- Units of the gains, and what 1010h stores of the drive's own objects: `inferred`.

## Unknown: objects that keep what is written and do nothing

{listed(unknown)}

## Left out: of a type the emulator does not have

{listed(left_out)}
"""
