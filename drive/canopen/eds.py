"""`servogym eds`: the electronic data sheet of a drive model (CiA 306), written by `canopen`.

The file contains what `objects.csv` and `pdo.csv` contain, so a configuration tool, or
``canopen.RemoteNode(1, "drive.eds")``, knows every object of the emulated drive.
"""

import configparser
import io
import math
import re
import warnings
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import canopen
import canopen.objectdictionary as dictionary
from canopen.objectdictionary import datatypes

from ..kernel.process_data import DUMMY_BITS
from ..kernel.record import OD
from ..model.model import DriveModel, Object, load
from ..objects.hooks.act import SINGLE
from ..objects.mapping import described

BITRATES = (10_000, 20_000, 50_000, 125_000, 250_000, 500_000, 800_000, 1_000_000)  # bit/s
BITRATE = 1_000_000  # bit/s in a DCF: what `servogym node` has where nothing else is said
LSS_SUPPORTED = True  # CiA 305
GROUPS = {0x1003: "pre_defined_error_field"}  # name of an object whose sub-index 0 has its own
VENDOR = OD.fields["vendor"][1]  # type: ignore[index]  # from here on: objects without a field
ASCII = str.maketrans(
    {"µ": "u", "·": "*", "²": "^2", "³": "^3", "°": "deg", "–": "-", "−": "-", ";": ","}
)
# what CiA 306 wants to be in [FileInfo], in its order and spelling
FILE_INFO = ("FileName", "FileVersion", "FileRevision", "EDSVersion", "Description",
             "CreationTime", "CreationDate", "CreatedBy",
             "ModificationTime", "ModificationDate", "ModifiedBy")

# access and direction of a mapping -> AccessType of CiA 306: rww process output, rwr process input
ACCESS = {("rw", "rx"): "rww", ("rw", "tx"): "rwr"}


def object_dictionary(
    model: str | Path | DriveModel, node_id: int | None = None, *, in_file: bool = False
) -> canopen.ObjectDictionary:
    """A drive model as the `canopen` library knows it.

    Args:
        model: name, folder or loaded model.
        node_id: 1..127; with it, every object has the value that the drive has after power-on.
        in_file: only what a file can describe, see `rows`.

    Raises:
        ValueError: unknown model, node-id out of range, a text that CiA 306 cannot carry.
    """
    model = load(model)
    if node_id is not None and not 1 <= node_id <= 127:
        raise ValueError(f"node_id = {node_id} is out of range 1..127")
    od = canopen.ObjectDictionary()
    od.node_id = node_id
    od.bitrate = None if node_id is None else BITRATE
    _device_information(od, model)
    for index, bits in DUMMY_BITS.items():  # [DummyUsage]: RPDOs may have gaps
        dummy = dictionary.ODVariable(f"Dummy{index:04d}", index)
        dummy.data_type = index
        dummy.access_type = "const"
        assert len(dummy) == bits
        od.add_object(dummy)
    objects: dict[int, list[Object]] = {}
    for row in rows(model, in_file):
        objects.setdefault(row.index, []).append(row)
    names = {members[0].name for members in objects.values() if _is_variable(members)}
    for index, members in objects.items():
        if _is_variable(members):
            od.add_object(_variable(members[0], node_id))
            continue
        array = any(row.object_type == "ARRAY" for row in members)
        kind = dictionary.ODArray if array else dictionary.ODRecord
        group = kind(_group_name(members[0], names), index)
        for row in members:
            group.add_member(_variable(row, node_id))
        od.add_object(group)
        names.add(group.name)
    return od


def rows(model: DriveModel, in_file: bool = True) -> list[Object]:
    """The objects that the data sheet describes: all of the model except two kinds.

    In an EDS, sub-index 0 is the number of entries, UNSIGNED8 (CiA 306; dcfchk refuses any other
    type), so data set 0 of the Bonfiglioli ACT is left out if `in_file`. Data set 5 of its
    parameters that exist only once (VAR) is always left out.
    """
    found = described(model)
    single = {
        row.index
        for row in found
        if (row.subindex, row.object_type) == (0, "VAR") and row.hook in SINGLE
    }
    groups = {row.index for row in found if row.subindex} - single
    return [
        row
        for row in found
        if (row.subindex and row.index in groups)
        or (
            not row.subindex
            and (not in_file or row.index not in groups or row.data_type == "UNSIGNED8")
        )
    ]


def _is_live(row: Object) -> bool:
    """Whether an object reports what the drive measures or does, which has no default."""
    computed = bool(row.hook) or row.offset < VENDOR
    return row.access == "ro" and row.area == "axis" and computed and not row.default


def _is_variable(members: list[Object]) -> bool:
    return [(row.subindex, row.object_type) for row in members] == [(0, "VAR")]


def _group_name(first: Object, names: set[str]) -> str:
    """Name of an array or record; the rows of a model name only what is in it."""
    name = GROUPS.get(first.index, first.name.removesuffix("_entries"))
    name = name.replace("_number_of_mapped_objects", "_mapping")
    if first.area == "constant" and re.fullmatch(r"[rt]pdo\d+", name):
        name += "_communication"
    # in canopen a name leads to one object only
    return f"{name}_{first.index:04X}h" if name in names else name


def _variable(row: Object, node_id: int | None) -> dictionary.ODVariable:
    variable: Any = dictionary.ODVariable(_text(row, row.name), row.index, row.subindex)
    variable.data_type = getattr(datatypes, row.data_type)
    variable.access_type = ACCESS.get((row.access, row.pdo), row.access)
    variable.pdo_mappable = bool(row.pdo)
    if row.format and not row.real:
        variable.min, variable.max = _integer_range(row)
    if _is_live(row):
        return variable
    # The library writes negative numbers as 0x-5 and then skips them when reading; and only
    # default_raw keeps the form with $NODEID.
    variable.default_raw = _literal(row, row.default, row.per_node)
    variable.relative = row.per_node
    variable.default = row.default
    if row.per_node:
        variable.default += node_id or 0
    if node_id is not None:
        variable.value = variable.default
        variable.value_raw = _literal(row, variable.value)
    return variable


def _integer_range(row: Object) -> tuple[int, int]:
    """Limits as integers; the floats of a model round those of 64 bits up out of the type."""
    bits = 8 * row.size
    signed = row.data_type.startswith("INTEGER")
    low, high = (-(1 << bits - 1), (1 << bits - 1) - 1) if signed else (0, (1 << bits) - 1)
    return max(low, math.ceil(row.minimum)), min(high, math.floor(row.maximum))


def _literal(row: Object, value: int | float | str, per_node: bool = False) -> str:
    """A value as CiA 306 writes it: decimal where signed, else hexadecimal."""
    if isinstance(value, str):
        return _text(row, value)
    if row.real:
        return repr(value)
    if row.data_type.startswith("INTEGER"):
        return str(value)
    return f"{'$NODEID+' * per_node}0x{value:0{2 * row.size}X}"


def _text(row: Object, text: str) -> str:
    """Refuse what the file would not carry to its reader: CiA 306 is ASCII, ; begins a comment."""
    if not text.isascii() or not text.isprintable() or ";" in text or text != text.strip():
        raise ValueError(
            f"{row.index:04X}h:{row.subindex:02X}h: {text!r} cannot stand in an EDS; in "
            "objects.csv use printable ASCII characters, no ';' and no blanks at the ends"
        )
    return text


def _ascii(text: str) -> str:
    """Reduce a text that is not read back to the characters that CiA 306 permits."""
    return text.translate(ASCII).encode("ascii", "replace").decode()


def _device_information(od: canopen.ObjectDictionary, model: DriveModel) -> None:
    def identity(subindex: int) -> int:
        row = model.objects.get((0x1018, subindex))
        return int(row.default) if row else 0

    info = od.device_information
    info.allowed_baudrates = set(BITRATES)
    info.vendor_name = "servogym, an emulated drive"
    info.vendor_number = identity(1)
    info.product_name = _ascii(model.title)
    info.product_number = identity(2)
    info.revision_number = identity(3)
    info.order_code = _ascii(model.name)
    info.simple_boot_up_master = False
    info.simple_boot_up_slave = True
    info.granularity = 8  # bits of the smallest thing a PDO can map
    info.dynamic_channels_supported = False
    info.group_messaging = False
    info.nr_of_RXPDO = len(model.rpdos)
    info.nr_of_TXPDO = len(model.tpdos)
    info.LSS_supported = LSS_SUPPORTED


def write(model: str | Path | DriveModel, path: Path, node_id: int | None = None) -> int:
    """Write the EDS of a model, or with a node-id its DCF; -> number of objects (rows).

    Raises:
        ValueError: unknown model, wrong node-id or suffix, a text that CiA 306 cannot carry.
        OSError: the file cannot be written.
    """
    model = load(model)
    suffix = ".eds" if node_id is None else ".dcf"
    if path.suffix.lower() != suffix:  # what canopen goes by when it reads
        raise ValueError(f"-o {path}: the name of the file has to end with {suffix}")
    text = io.StringIO()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # datetime.utcnow in the library
        dictionary.export_od(object_dictionary(model, node_id, in_file=True), text, suffix[1:])
    file = configparser.RawConfigParser()
    file.optionxform = str  # type: ignore[assignment,method-assign]
    file.read_string(text.getvalue())
    _complete(file, model, path.name, node_id)
    with path.open("w", encoding="ascii", newline="\r\n") as target:
        file.write(target, space_around_delimiters=False)
    return len(rows(model))


def _complete(
    file: configparser.RawConfigParser, model: DriveModel, name: str, node_id: int | None
) -> None:
    """Add what CiA 306 requires and the library omits or writes incorrectly.

    Its [FileInfo] has the month in place of the minute, and every later file of a process repeats
    the values of the first one; both are corrected. The library does not write the rest at all.
    """
    now = datetime.now(UTC)
    time, date = now.strftime("%I:%M%p"), now.strftime("%m-%d-%Y")
    what = "EDS" if node_id is None else f"DCF of node {node_id}"
    values = (_ascii(name), "1", "0", "4.0", _ascii(f"{what}: {model.title}"),
              time, date, "servogym", time, date, "servogym")
    file["FileInfo"] = dict(zip(FILE_INFO, values, strict=True))
    file["DeviceInfo"]["CompactPDO"] = "0"
    if node_id is not None:
        serial = model.objects.get((0x1018, 4))
        file["DeviceComissioning"].update(
            NodeName=_ascii(f"{model.name}_{node_id}"), NetNumber="1", NetworkName="servogym",
            CANopenManager="0", LSS_SerialNumber=str(serial.default if serial else 0),
        )
