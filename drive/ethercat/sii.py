"""SII: the EEPROM image of a slave, made from its description and parsed back (ETG.2010).

Words are little-endian; addresses are those of words. 0000h-003Fh have fixed places, from 0040h on
categories follow one another: type, length in words, content; FFFFh ends the list.
"""

import struct
from enum import IntEnum

from ..model.model import DriveModel
from .description import DcMode, Description, Entry, Mailboxes, Pdo, SyncManager, describe

CONFIGURED = 14  # bytes that the checksum covers: what the slave controller loads by itself
ALIAS = 8  # byte address of the configured station alias, word 4
CATEGORIES = 0x80  # byte address of the first category, word 40h
END = 0xFFFF
VENDOR_SPECIFIC = 0x0800  # first category type of the vendor
POLYNOMIAL, START = 0x07, 0xFF  # of the checksum: x^8 + x^2 + x + 1
KIBIBIT = 128  # bytes


class Category(IntEnum):
    """Category types: ETG.2010, table 6."""

    STRINGS = 10
    DATA_TYPES = 20
    GENERAL = 30
    FMMU = 40
    SYNC_MANAGER = 41
    TXPDO = 50
    RXPDO = 51
    DC = 60


_FIXED = struct.Struct(
    "<HHHH"  # PDI control, PDI configuration, SYNC impulse, PDI configuration 2
    "H4xH"  # alias, reserved, checksum
    "IIII"  # vendor, product, revision, serial number
    "HHHH"  # delays of execution and of ports, reserved
    "HHHHHHHH"  # bootstrap out and in, standard out and in: start, length
    "H66xHH"  # protocols, reserved, size, version
)
_GENERAL = struct.Struct("<BBBBxBBBBBBBhBxHH12x")
_SYNC_MANAGER = struct.Struct("<HHBBBB")
_PDO = struct.Struct("<HBBBBH")
_ENTRY = struct.Struct("<HBBBBH")
_DC = struct.Struct("<IIIhHhBB4x")


def checksum(data: bytes | bytearray) -> int:
    """CRC of 8 bits over what the slave controller loads."""
    crc = START
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = (crc << 1 ^ POLYNOMIAL) & 0xFF if crc & 0x80 else crc << 1
    return crc


class EepromTooSmall(ValueError):
    """What a device says does not fit into its EEPROM."""


class _Strings:
    """The list of strings; others refer to them by their place, from 1 on."""

    def __init__(self) -> None:
        self.known: list[str] = []

    def number(self, text: str) -> int:
        """Place of a text, which is entered if it is new; 0 is not a text."""
        if not text:
            return 0
        if text not in self.known:
            self.known.append(text)
        return self.known.index(text) + 1

    def pack(self) -> bytes:
        """Content of the category."""
        parts = [text.encode("latin-1") for text in self.known]
        return bytes([len(parts)]) + b"".join(bytes([len(part)]) + part for part in parts)


def pack(device: Description) -> bytes:
    """The image of a device, filled up with FFh to its size.

    Raises EepromTooSmall where it does not fit, ValueError where a text cannot be carried.
    """
    strings = _Strings()
    try:
        contents = _categories(device, strings)
        body = b"".join(
            struct.pack("<HH", kind, (len(content) + 1) // 2) + content + b"\0" * (len(content) % 2)
            for kind, content in contents
        )
        head = _fixed(device)
    except (ValueError, struct.error) as error:  # a text too long, a number too large
        raise ValueError(f"SII of {device.name!r}: {error}") from None
    image = head + body + struct.pack("<H", END)
    if len(image) > device.size:
        raise EepromTooSmall(
            f"the SII of {device.name!r} needs {len(image)} bytes, its EEPROM has {device.size}: "
            "set sii.size in ethercat.toml"
        )
    return image.ljust(device.size, b"\xff")


def _fixed(device: Description) -> bytes:
    standard, bootstrap = device.mailbox, device.bootstrap
    image = bytearray(
        _FIXED.pack(
            device.pdi_control, device.pdi_configuration, 0, 0, device.alias, 0,
            device.vendor_id, device.product_code, device.revision_number, device.serial_number,
            0, 0, 0, 0,
            bootstrap.out_start, bootstrap.out_length, bootstrap.in_start, bootstrap.in_length,
            standard.out_start, standard.out_length, standard.in_start, standard.in_length,
            device.protocols, device.size // KIBIBIT - 1, device.version,
        )
    )
    image[CONFIGURED] = checksum(image[:CONFIGURED])
    return bytes(image)


def _categories(device: Description, strings: _Strings) -> list[tuple[int, bytes]]:
    number = strings.number
    general = _GENERAL.pack(
        number(device.group), 0, number(device.order), number(device.name),
        device.coe_details, device.foe_details, device.eoe_details, 0, device.ds402_channels, 0,
        device.flags, 0, number(device.group), device.physical_ports, 0,
    )
    managers = b"".join(
        _SYNC_MANAGER.pack(sm.start, sm.length, sm.control, 0, sm.enable, sm.kind)
        for sm in device.sync_managers
    )
    clocks = b"".join(
        _DC.pack(
            mode.cycle_time0, mode.shift_time0, mode.shift_time1, mode.cycle_factor1,
            mode.assign_activate, mode.cycle_factor0, number(mode.name), 0,
        )
        for mode in device.dc_modes
    )
    tpdos, rpdos = _pdos(device.tpdos, number), _pdos(device.rpdos, number)
    contents: list[tuple[int, bytes]] = [
        (Category.STRINGS, strings.pack()),
        (Category.GENERAL, general),
        (Category.FMMU, bytes(device.fmmus)),
        (Category.SYNC_MANAGER, managers),
        (Category.TXPDO, tpdos),
        (Category.RXPDO, rpdos),
        (Category.DC, clocks),
    ]
    contents += [(kind, text.encode("latin-1")) for kind, text in device.vendor_strings]
    return [(kind, content) for kind, content in contents if content]


def _pdos(pdos: tuple[Pdo, ...], number) -> bytes:
    content = b""
    for pdo in pdos:
        content += _PDO.pack(
            pdo.index, len(pdo.entries), pdo.sync_manager, 0, number(pdo.name), pdo.flags
        )
        for entry in pdo.entries:
            content += _ENTRY.pack(
                entry.index, entry.subindex, number(entry.name), entry.data_type, entry.bits, 0
            )
    return content


# ------------------------------------------------------------------------ parse


def unpack(image: bytes) -> Description:
    """What an image says. Raises ValueError with the word at which it cannot be right."""
    if len(image) < CATEGORIES:
        raise ValueError(f"word {len(image) // 2:04X}h: the SII ends here, it has "
                         f"{CATEGORIES} bytes or more")
    (
        pdi_control, pdi_configuration, _, _, alias, check,
        vendor, product, revision, serial, _, _, _, _,
        boot_out, boot_out_length, boot_in, boot_in_length,
        out, out_length, in_, in_length, protocols, size, version,
    ) = _FIXED.unpack_from(image)
    if check & 0xFF != checksum(image[:CONFIGURED]):
        raise ValueError(f"word {CONFIGURED // 2:04X}h: checksum {check & 0xFF:02X}h of the SII, "
                         f"not {checksum(image[:CONFIGURED]):02X}h")
    places = _split(image)
    found = {kind: image[at:end] for kind, (at, end) in places.items()}
    texts = _texts(image, *places.get(Category.STRINGS, (0, 0)))

    def text(number: int) -> str:
        if number > len(texts):
            at = places.get(Category.STRINGS, (CATEGORIES, 0))[0]
            raise ValueError(f"word {at // 2:04X}h: {len(texts)} strings of the SII, and string "
                             f"{number} is named")
        return texts[number - 1] if number else ""

    general = _GENERAL.unpack_from(found.get(Category.GENERAL, b"").ljust(_GENERAL.size, b"\0"))
    group, _, order, name, coe, foe, eoe, _, channels, _, flags, _, _, ports, _ = general
    return Description(
        vendor_id=vendor,
        product_code=product,
        revision_number=revision,
        serial_number=serial,
        name=text(name),
        order=text(order),
        group=text(group),
        mailbox=Mailboxes(out, out_length, in_, in_length),
        bootstrap=Mailboxes(boot_out, boot_out_length, boot_in, boot_in_length),
        protocols=protocols,
        coe_details=coe,
        foe_details=foe,
        eoe_details=eoe,
        flags=flags,
        ds402_channels=channels,
        physical_ports=ports,
        fmmus=tuple(found.get(Category.FMMU, b"")),
        sync_managers=tuple(
            SyncManager(start, length, control, enable, kind)
            for start, length, control, _, enable, kind in _each(
                _SYNC_MANAGER, found.get(Category.SYNC_MANAGER, b"")
            )
        ),
        tpdos=_parse_pdos(image, *places.get(Category.TXPDO, (0, 0)), text),
        rpdos=_parse_pdos(image, *places.get(Category.RXPDO, (0, 0)), text),
        dc_modes=tuple(
            DcMode(text(label), activate, cycle, shift0, shift1, factor0, factor1)
            for cycle, shift0, shift1, factor1, activate, factor0, label, _ in _each(
                _DC, found.get(Category.DC, b"")
            )
        ),
        pdi_control=pdi_control,
        pdi_configuration=pdi_configuration,
        alias=alias,
        version=version,
        size=(size + 1) * KIBIBIT,
        vendor_strings=tuple(
            (kind, content.rstrip(b"\0").decode("latin-1"))
            for kind, content in found.items()
            if VENDOR_SPECIFIC <= kind < END
        ),
    )


def unended(image: bytes) -> int:
    """The word at which an image ends without FFFFh behind its categories, 0: it has one."""
    at = max([CATEGORIES, *(end for _, end in _split(image).values())])
    return 0 if image[at : at + 2] == b"\xff\xff" else at // 2


def _split(image: bytes) -> dict[int, tuple[int, int]]:
    """Begin and end of each category's content.

    The end of the image may stand for FFFFh: drives have been seen whose EEPROM holds nothing
    behind word 3Fh, or zeros (type 0 is no category).
    """
    found: dict[int, tuple[int, int]] = {}
    at = CATEGORIES
    while at < len(image):
        where = f"word {at // 2:04X}h"
        if at + 2 > len(image):
            raise ValueError(f"{where}: the SII ends within a word")
        (kind,) = struct.unpack_from("<H", image, at)
        if kind == END:
            break
        if at + 4 > len(image):
            raise ValueError(f"{where}: category {kind} of the SII has no length")
        (words,) = struct.unpack_from("<H", image, at + 2)
        end = at + 4 + 2 * words
        if end > len(image):
            raise ValueError(f"{where}: category {kind} of the SII goes beyond its end")
        if kind:
            found[kind] = at + 4, end
        at = end
    return found


def _texts(image: bytes, at: int, end: int) -> list[str]:
    texts, count = [], image[at] if at < end else 0
    at += 1
    for _ in range(count):
        if at >= end or at + 1 + image[at] > end:
            raise ValueError(f"word {at // 2:04X}h: strings of the SII go beyond their category")
        texts.append(image[at + 1 : at + 1 + image[at]].decode("latin-1"))
        at += 1 + image[at]
    return texts


def _each(code: struct.Struct, content: bytes):
    return code.iter_unpack(content[: len(content) // code.size * code.size])


def _parse_pdos(image: bytes, at: int, end: int, text) -> tuple[Pdo, ...]:
    pdos = []
    while at + _PDO.size <= end:
        index, count, manager, _, name, flags = _PDO.unpack_from(image, at)
        at, behind = at + _PDO.size, at + _PDO.size + count * _ENTRY.size
        if behind > end:
            raise ValueError(f"word {at // 2:04X}h: PDO {index:04X}h of the SII goes beyond its "
                             "category")
        entries = tuple(
            Entry(i, s, bits, data_type, text(label))
            for i, s, label, data_type, bits, _ in _ENTRY.iter_unpack(image[at:behind])
        )
        pdos.append(Pdo(index, text(name), manager, flags, entries))
        at = behind
    return tuple(pdos)


def with_alias(image: bytes, alias: int) -> bytes:
    """The image with another station alias, and its checksum."""
    changed = bytearray(image)
    struct.pack_into("<H", changed, ALIAS, alias)
    changed[CONFIGURED] = checksum(changed[:CONFIGURED])
    return bytes(changed)


def alias_of(image: bytes) -> int | None:
    """The station alias of an image, None where its checksum does not hold."""
    if len(image) <= CONFIGURED or image[CONFIGURED] != checksum(image[:CONFIGURED]):
        return None
    return int(struct.unpack_from("<H", image, ALIAS)[0])


def of_model(model: DriveModel, alias: int = 0) -> bytes:
    """The image of a model, the maker's if it has one.

    Raises ValueError where it does not fit the EEPROM.
    """
    if model.ethercat is not None and model.ethercat.image:
        return with_alias(model.ethercat.image, alias) if alias else model.ethercat.image
    return pack(describe(model, alias))
