"""ESI: the device description file of a slave, written from its description.

Format: EtherCATInfo of ETG.2000. The dictionary in it is that of the model, so what a
configuration tool knows offline is what the drive answers online. `esi_reader` reads such files.
"""

from dataclasses import dataclass
from xml.etree import ElementTree

from ..model.ethercat import DATA_LINK_LAYER, IDENTIFICATION
from ..model.ethercat import PROTOCOLS as PROTOCOL_NAMES
from ..model.model import DriveModel
from ..model.rows import DATA_TYPES
from ..objects.mapping import described
from . import sii
from .description import (
    FIXED,
    UNASSIGNED,
    DcMode,
    Description,
    Pdo,
    describe,
)
from .sdo_info import bits, members, object_name

# number of a data type -> its name in ESI
TYPES = {
    0x01: "BOOL", 0x02: "SINT", 0x03: "INT", 0x04: "DINT", 0x05: "USINT", 0x06: "UINT",
    0x07: "UDINT", 0x08: "REAL", 0x0C: "TIME_OF_DAY", 0x0D: "TIME_DIFFERENCE", 0x10: "INT24",
    0x11: "LREAL", 0x12: "INT40", 0x13: "INT48", 0x14: "INT56", 0x15: "LINT", 0x16: "UINT24",
    0x18: "UINT40", 0x19: "UINT48", 0x1A: "UINT56", 0x1B: "ULINT",
}
STRINGS = {0x09: "STRING", 0x0A: "OCTET_STRING", 0x0B: "UNICODE_STRING", 0x0F: "OCTET_STRING"}
SM_KINDS = {1: "MBoxOut", 2: "MBoxIn", 3: "Outputs", 4: "Inputs"}
FMMU_KINDS = {0: "Unused", 1: "Outputs", 2: "Inputs", 3: "MBoxState"}
# bits of the CoE details -> attribute of the element CoE
COE = {0x02: "SdoInfo", 0x04: "PdoAssign", 0x08: "PdoConfig", 0x10: "PdoUpload",
       0x20: "CompleteAccess"}
PROTOCOLS = {name: 1 << PROTOCOL_NAMES.index(name) for name in ("EoE", "CoE", "FoE")}
PROFILE = 402
CONFIG = 14  # bytes of the SII that the slave controller loads
_MAPPABLE = {"": "", "rx": "R", "tx": "T", "rxtx": "RT"}


@dataclass(frozen=True)
class EsiEntry:
    """An entry of the dictionary in the file."""

    index: int
    subindex: int
    name: str
    data_type: int  # number of CiA 301
    bits: int
    access: str  # ro, wo, rw
    pdo: str  # "", R, T, RT: mappable to RPDO and TPDO


@dataclass(frozen=True)
class Esi:
    """A file: the device, its vendor's name, and the dictionary by address."""

    device: Description
    vendor: str
    profile: int
    dictionary: dict[tuple[int, int], EsiEntry]
    names: dict[int, str]  # of objects
    eeprom: bytes  # the first bytes of the SII, for the slave controller


def of_model(model: DriveModel) -> Esi:
    """The file of a model with an EtherCAT face, as a value."""
    device = describe(model)
    assert model.ethercat is not None
    dictionary = {
        (row.index, row.subindex): EsiEntry(
            row.index, row.subindex, row.name, DATA_TYPES[row.data_type], bits(row),
            "ro" if row.access == "const" else row.access, _MAPPABLE[row.pdo],
        )
        for row in described(model)
    }
    names = {index: object_name(rows) for index, rows in members(model).items()}
    image = sii.of_model(model)
    return Esi(device, model.ethercat.vendor, PROFILE, dictionary, names, image[:CONFIG])


# ------------------------------------------------------------------------ write


def _sub(parent: ElementTree.Element, tag: str, text: object = None, **attributes: object):
    element = ElementTree.SubElement(parent, tag, {k: str(v) for k, v in attributes.items()})
    if text is not None:
        element.text = str(text)
    return element


def _hex(value: int, digits: int = 4) -> str:
    return f"#x{value:0{digits}X}"


def type_name(data_type: int, bits: int) -> str:
    """Name of a data type; strings say their length (byte)."""
    if data_type in STRINGS:
        return f"{STRINGS[data_type]}({bits // 8})"
    return TYPES[data_type]


def write(esi: Esi) -> str:
    """The text of a file."""
    device = esi.device
    root = ElementTree.Element("EtherCATInfo", Version="1.6")
    vendor = _sub(root, "Vendor")
    _sub(vendor, "Id", _hex(device.vendor_id, 8))
    _sub(vendor, "Name", esi.vendor)
    descriptions = _sub(root, "Descriptions")
    group = _sub(_sub(descriptions, "Groups"), "Group")
    _sub(group, "Type", device.group)
    _sub(group, "Name", device.group)
    physics = "".join(
        {0: " ", 1: "Y", 3: "K"}.get(device.physical_ports >> 4 * n & 0xF, " ") for n in range(4)
    ).rstrip()
    element = _sub(_sub(descriptions, "Devices"), "Device", Physics=physics)
    _sub(
        element, "Type", device.order, ProductCode=_hex(device.product_code, 8),
        RevisionNo=_hex(device.revision_number, 8),
    )
    _sub(element, "Name", device.name)
    if device.flags & IDENTIFICATION:
        _sub(_sub(element, "Info"), "IdentificationReg134", "true")
    _sub(element, "GroupType", device.group)
    profile = _sub(element, "Profile")
    _sub(profile, "ProfileNo", esi.profile)
    _dictionary(_sub(profile, "Dictionary"), esi)
    for kind in device.fmmus:
        _sub(element, "Fmmu", FMMU_KINDS.get(kind, FMMU_KINDS[0]))
    for manager in device.sync_managers:
        _sub(
            element, "Sm", SM_KINDS[manager.kind], DefaultSize=manager.length,
            StartAddress=_hex(manager.start), ControlByte=_hex(manager.control, 2),
            Enable=manager.enable,
        )
    for tag, pdos in (("RxPdo", device.rpdos), ("TxPdo", device.tpdos)):
        for pdo in pdos:
            _pdo(element, tag, pdo)
    link = "true" if device.flags & DATA_LINK_LAYER else "false"
    mailbox = _sub(element, "Mailbox", DataLinkLayer=link)
    if device.protocols & PROTOCOLS["EoE"]:
        _sub(mailbox, "EoE")
    if device.protocols & PROTOCOLS["CoE"]:
        details = {name: int(bool(device.coe_details & bit)) for bit, name in COE.items()}
        _sub(mailbox, "CoE", **details)
    if device.protocols & PROTOCOLS["FoE"]:
        _sub(mailbox, "FoE")
    if device.dc_modes:
        clocks = _sub(element, "Dc")
        for mode in device.dc_modes:
            _dc_mode(clocks, mode)
    eeprom = _sub(element, "Eeprom")
    _sub(eeprom, "ByteSize", device.size)
    _sub(eeprom, "ConfigData", esi.eeprom.hex().upper())
    boot = device.bootstrap
    words = (boot.out_start, boot.out_length, boot.in_start, boot.in_length)
    data = b"".join(word.to_bytes(2, "little") for word in words)
    _sub(eeprom, "BootStrap", data.hex().upper())
    ElementTree.indent(root)
    text = ElementTree.tostring(root, encoding="unicode")
    return f'<?xml version="1.0" encoding="utf-8"?>\n{text}\n'


def _pdo(parent: ElementTree.Element, tag: str, pdo: Pdo) -> None:
    attributes = {"Fixed": 1} if pdo.flags & FIXED else {}
    if pdo.sync_manager != UNASSIGNED:
        attributes["Sm"] = pdo.sync_manager
    element = _sub(parent, tag, **attributes)
    _sub(element, "Index", _hex(pdo.index))
    _sub(element, "Name", pdo.name)
    for other in pdo.excludes:
        _sub(element, "Exclude", _hex(other))
    for entry in pdo.entries:
        line = _sub(element, "Entry")
        _sub(line, "Index", _hex(entry.index))
        if entry.index:
            _sub(line, "SubIndex", entry.subindex)
        _sub(line, "BitLen", entry.bits)
        if entry.index:
            _sub(line, "Name", entry.name)
            _sub(line, "DataType", type_name(entry.data_type, entry.bits))


def _dc_mode(parent: ElementTree.Element, mode: DcMode) -> None:
    element = _sub(parent, "OpMode")
    _sub(element, "Name", mode.name)
    _sub(element, "AssignActivate", _hex(mode.assign_activate))
    _sub(element, "CycleTimeSync0", mode.cycle_time0, Factor=mode.cycle_factor0)
    _sub(element, "ShiftTimeSync0", mode.shift_time0)
    _sub(element, "CycleTimeSync1", 0, Factor=mode.cycle_factor1)
    _sub(element, "ShiftTimeSync1", mode.shift_time1)


def _dictionary(parent: ElementTree.Element, esi: Esi) -> None:
    """Data types first: the simple ones, and one for each object with sub-indices."""
    types, objects = _sub(parent, "DataTypes"), _sub(parent, "Objects")
    simple = {type_name(e.data_type, e.bits): e.bits for e in esi.dictionary.values()}
    for name, length in sorted(simple.items()):
        element = _sub(types, "DataType")
        _sub(element, "Name", name)
        _sub(element, "BitSize", length)
    by_index: dict[int, list[EsiEntry]] = {}
    for address in sorted(esi.dictionary):
        by_index.setdefault(address[0], []).append(esi.dictionary[address])
    for index, entries in by_index.items():
        element = _sub(objects, "Object")
        _sub(element, "Index", _hex(index))
        _sub(element, "Name", esi.names[index])
        if [(0, esi.names[index])] == [(entry.subindex, entry.name) for entry in entries]:
            _sub(element, "Type", type_name(entries[0].data_type, entries[0].bits))
            _sub(element, "BitSize", entries[0].bits)
            _flags(element, entries[0])
            continue
        kind = f"DT{index:04X}"
        size = _record_type(types, kind, entries)
        _sub(element, "Type", kind)
        _sub(element, "BitSize", size)
        _sub(_sub(element, "Flags"), "Access", "rw")


def _record_type(types: ElementTree.Element, kind: str, entries: list[EsiEntry]) -> int:
    """The data type of an object with sub-indices, -> its size in bits."""
    element = _sub(types, "DataType")
    _sub(element, "Name", kind)
    size = _sub(element, "BitSize")
    offset = 0
    for entry in entries:
        line = _sub(element, "SubItem")
        _sub(line, "SubIdx", entry.subindex)
        _sub(line, "Name", entry.name)
        _sub(line, "Type", type_name(entry.data_type, entry.bits))
        _sub(line, "BitSize", entry.bits)
        _sub(line, "BitOffs", offset)
        _flags(line, entry)
        # sub-index 0 takes 16 bits, as in complete access
        offset += 16 if entry.subindex == 0 and entry.bits == 8 else entry.bits
    size.text = str(offset)
    return offset


def _flags(parent: ElementTree.Element, entry: EsiEntry) -> None:
    flags = _sub(parent, "Flags")
    _sub(flags, "Access", entry.access)
    if entry.pdo:
        _sub(flags, "PdoMapping", entry.pdo)
