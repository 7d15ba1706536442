"""Facts of a real AKD's slave controller and EEPROM, answered by a model made from such an EEPROM.

`golden.akd_eeprom` says what is known of the image and what is inferred.
"""

import struct

import pytest
from golden.akd_eeprom import NAMES, SERIAL, real_eeprom
from wired import O, P, S, Wired

from servogym.drive.ethercat import sii
from servogym.drive.ethercat.mailbox import Kind
from servogym.drive.imports.ethercat import import_sii


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
