"""Facts of a real AKD's slave controller and EEPROM, answered by a model made from such an EEPROM.

No EEPROM of a real drive is at hand as a file. This image is ours with what is known of a real one:
its serial number, and its names as a public test of an EEPROM reader lists them (ethercrab,
`src/subdevice/eeprom.rs`). Which PDO comes first and the PDOs' own names are `inferred`.
"""

import dataclasses
import struct

import pytest
from wired import O, P, S, Wired

from servogym.drive.ethercat import sii
from servogym.drive.ethercat.description import describe
from servogym.drive.ethercat.mailbox import Kind
from servogym.drive.model.model import load
from servogym.drive.wire.ethercat_import import import_sii

NAMES = {
    0x6041: "Statusword", 0x6063: "Position actual internal value",
    0x2050: "Second position feedback", 0x606C: "Velocity actual value", 0x60FD: "Digital inputs",
    0x60F4: "Following error actual value", 0x20A0: "Latch 1p", 0x6077: "Torque actual value",
    0x20A5: "Latch statusword", 0x3470: "AIN.VALUE", 0x20A1: "Latch 1n", 0x20A6: "Latch 1 pn",
    0x6064: "Position actual value", 0x20A7: "Latch 2 pn", 0x6040: "Controlword",
    0x60C1: "1st set-point", 0x60FF: "Target velocity", 0x20A4: "Latch controlword",
    0x60B2: "Torque offset", 0x60FE: "Physical outputs", 0x6072: "Max torque",
    0x20B8: "ClearDigInputChangedBit", 0x607A: "Target position", 0x3470_03: "AOUT.VALUE write",
}
SERIAL = 2575499411


def real_eeprom():
    """The image."""
    ours, change = describe(load("kollmorgen_akd", "ethercat")), dataclasses.replace

    def named(pdos, name):
        return tuple(change(pdo, name=name, entries=tuple(
            change(e, name=NAMES.get(e.index << 8 | e.subindex, NAMES[e.index]))
            for e in pdo.entries
        )) for pdo in pdos)

    return sii.pack(change(ours, serial_number=SERIAL, rpdos=named(ours.rpdos, "Outputs"),
                           tpdos=named(ours.tpdos, "Inputs")))


@pytest.fixture(scope="module")
def image():
    return real_eeprom()


@pytest.fixture(scope="module")
def folder(image, tmp_path_factory):
    place = tmp_path_factory.mktemp("akd")
    (place / "akd.bin").write_bytes(image)
    import_sii(place / "akd.bin", place / "mine", chip="emulated")
    return place / "mine"


@pytest.fixture
def akd(folder):
    return Wired(folder)


def eeprom(akd, word):
    """What a read of the EEPROM interface brings: its bytes, and whether they are 8."""
    akd.write(0x0502, struct.pack("<HI", 0x0100, word))
    while akd.register(0x0502) & 0x8000:
        pass
    return akd.read(0x0508, 4).data, bool(akd.register(0x0502) & 0x40)


def words(akd):
    """The EEPROM as a master reads it, four bytes each time."""
    return b"".join(eeprom(akd, word)[0] for word in range(0, 1024, 2))


REGISTERS = {  # address, bytes -> what a real AKD says
    "type and revision": (0x0000, 2, 0x0204), "features": (0x0008, 2, 0x0184),
    "PDI": (0x0140, 2, 0x0C08), "EEPROM is emulated": (0x0502, 2, 0x0020),
}


@pytest.mark.parametrize("fact", REGISTERS)
def test_a_register_is_that_of_the_real_drive(akd, fact):
    address, size, value = REGISTERS[fact]
    assert akd.register(address, size) == value


def test_the_eeprom_gives_four_bytes_at_a_time_and_the_words_of_the_maker(akd, image):
    assert eeprom(akd, 8) == (struct.pack("<I", 0x6A), False)
    assert words(akd)[: len(image)] == image


SII = {
    "DS402 channels": ("ds402_channels", 1), "flags": ("flags", 0x05),
    "EoE details": ("eoe_details", 3), "FMMU 3": ("fmmus", (1, 2, 3, 0xFF)),
    "vendor": ("vendor_id", 0x6A), "product": ("product_code", 0x00414B44),
    "serial": ("serial_number", SERIAL),
    "CoE details": ("coe_details", 0x0D), "protocols": ("protocols", 0x0E),
}


@pytest.mark.parametrize("fact", SII)
def test_a_word_of_the_eeprom_is_that_of_the_real_drive(akd, fact):
    name, value = SII[fact]
    assert getattr(sii.unpack(words(akd)), name) == value


def test_names_have_their_capital_letters(akd):
    device = sii.unpack(words(akd))
    names = {entry.name for pdo in device.rpdos + device.tpdos for entry in pdo.entries}
    assert names == {*NAMES.values()}


@pytest.mark.parametrize("mailbox", [0, 1])
def test_the_status_of_a_mailbox_is_00h_or_01h(akd, mailbox):
    """0805h + 8 n: nothing but whether an interrupt of a write (bit 0) stands is set."""
    akd.to(P)
    assert akd.register(0x0805 + 8 * mailbox, 1) in (0x00, 0x01)


def test_an_address_is_taken_and_announced(akd):
    akd.to(P)
    mac, address = bytes.fromhex("020000000001"), bytes([192, 168, 9, 5])
    request = struct.pack("<HH", 0x0102, 0) + b"\x03\0\0\0" + mac + address[::-1]
    assert akd.send(Kind.EOE, request) == 1
    assert akd.fetch() == (Kind.EOE, b"\3\0\0\0")
    kind, body = akd.fetch()
    assert (kind, body[16:18]) == (Kind.EOE, b"\x08\x06")


def test_it_comes_to_op(akd):
    akd.to(P, S, O)
    assert akd.slave.state == O
