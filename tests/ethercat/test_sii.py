"""The EEPROM image of every model: ETG.2010."""

import dataclasses
import random
import shutil
import struct

import pytest
from wired import P, Wired

from servogym.drive.ethercat import sii
from servogym.drive.ethercat.description import describe
from servogym.drive.model.model import load

MODELS = ("generic", "festo_cmmp_as", "kollmorgen_akd")


@pytest.fixture(scope="module", params=MODELS)
def model(request):
    return load(request.param, "ethercat")


def word(image, address):
    return struct.unpack_from("<H", image, 2 * address)[0]


def test_the_checksum_is_the_remainder_of_the_polynomial():
    for data in (bytes(14), b"123456789", bytes(range(14))):
        assert sii.checksum(data) == crc(data)


def crc(data):
    """The same as polynomial division bit by bit: x^8 + x^2 + x + 1, beginning with FFh."""
    register = 0xFF
    for bit in (byte >> n & 1 for byte in data for n in range(7, -1, -1)):
        top = register >> 7 ^ bit
        register = register << 1 & 0xFF ^ (0x07 if top else 0)
    return register


def test_11_an_image_says_what_the_model_is(model):
    image = sii.of_model(model, alias=7)
    assert sii.unpack(image) == describe(model, alias=7)


def test_11_an_image_has_its_size_checksum_and_end(model):
    image = sii.of_model(model, alias=0x1234)
    assert len(image) == (word(image, 0x3E) + 1) * 128
    assert word(image, 7) == crc(image[:14])
    assert word(image, 4) == 0x1234
    used = image.rstrip(b"\xff")
    assert len(used) < len(image)
    at = 0x80
    while word(image, at // 2) != 0xFFFF:
        at += 4 + 2 * word(image, at // 2 + 1)
    assert set(image[at:]) == {0xFF}, "FFFFh ends the categories, and nothing follows"


def test_the_image_of_the_akd_has_what_a_real_one_had():
    image = sii.of_model(load("kollmorgen_akd", "ethercat"))
    assert (word(image, 0), word(image, 1)) == (0x0009, 0x0800)
    assert struct.unpack_from("<III", image, 0x10) == (0x6A, 0x00414B44, 2)
    for bootstrap in (0x14, 0x18):
        assert [word(image, bootstrap + n) for n in range(4)] == [0x1800, 1024, 0x1C00, 1024]
    assert word(image, 0x1C) == 0x000E
    assert (word(image, 0x3E), word(image, 0x3F)) == (15, 1)
    device = sii.unpack(image)
    assert (device.name, device.order, device.group) == ("AKD EtherCAT Drive (CoE)", "AKD", "Drive")
    assert device.coe_details == 0x0D
    assert device.fmmus == (1, 2, 3, 0xFF)
    assert (device.ds402_channels, device.flags, device.eoe_details) == (1, 0x05, 3)
    assert [(sm.start, sm.control) for sm in device.sync_managers] == [
        (0x1800, 0x26), (0x1C00, 0x22), (0x1100, 0x24), (0x1140, 0x20)
    ]
    assert [(mode.name, mode.assign_activate) for mode in device.dc_modes] == [
        ("DcSync", 0x0300), ("DcOff", 0x0000)
    ]
    flags = {pdo.index: pdo.flags for pdo in device.rpdos + device.tpdos}
    assert {flag for index, flag in flags.items() if index & 0xF00 in (0x700, 0xB00)} == {0x0010}
    assert {flag for index, flag in flags.items() if index & 0xF00 in (0x600, 0xA00)} == {0}
    assert [pdo.index for pdo in device.assigned(2) + device.assigned(3)] == [0x1701, 0x1B01]


# observed.md: entries of the PDOs that differ from the manual, or are not in it
AKD_PDOS = {
    0x1600: [(0x6040, 0, 16)],
    0x1601: [],
    0x1A00: [(0x6041, 0, 16)],
    0x1A03: [],
    0x1B01: [(0x6063, 0, 32), (0x6041, 0, 16)],
    0x1B21: [(0x6063, 0, 32), (0x6041, 0, 16)],
    0x1B24: [(0x6064, 0, 32), (0x6041, 0, 16)],
    0x1724: [(0x607A, 0, 32), (0x6040, 0, 16), (0x60B2, 0, 16)],
    0x1720: [(0x6040, 0, 16), (0x60C1, 1, 32), (0x20A4, 0, 16), (0x60B2, 0, 16), (0x60FE, 1, 32)],
    0x1723: [(0x6040, 0, 16), (0x60C1, 1, 32), (0x20A4, 0, 16), (0x60B2, 0, 16), (0x60FE, 1, 32),
             (0x20B8, 0, 16)],
    0x1725: [(0x6040, 0, 16), (0x607A, 0, 32), (0x60FE, 1, 32), (0x60B2, 0, 16), (0x3470, 3, 16),
             (0x6072, 0, 16)],
    0x1B26: [(0x6041, 0, 16), (0x6064, 0, 32), (0x6077, 0, 16), (0x60FD, 0, 32), (0x3470, 4, 16),
             (0x60F4, 0, 32)],
    0x1B25: [(0x6063, 0, 32), (0x2050, 0, 32), (0x20A7, 0, 32), (0x60FD, 0, 32), (0x60F4, 0, 32),
             (0x20A6, 0, 32), (0x6041, 0, 16), (0x6077, 0, 16), (0x20A5, 0, 16), (0x3470, 4, 16)],
} | {
    pdo: [(0x6063, 0, 32), (0x2050, 0, 32), (0x606C, 0, 32), (0x60FD, 0, 32), (0x60F4, 0, 32),
          (latch, 0, 32), (0x6041, 0, 16), (0x6077, 0, 16), (0x20A5, 0, 16), (0x3470, 4, 16)]
    for pdo, latch in ((0x1B20, 0x20A0), (0x1B22, 0x20A1), (0x1B23, 0x20A6))
}


@pytest.mark.parametrize("pdo", AKD_PDOS, ids="{:04X}h".format)
def test_the_pdos_of_the_akd_have_the_entries_of_a_real_one(pdo):
    device = sii.unpack(sii.of_model(load("kollmorgen_akd", "ethercat")))
    found = {p.index: p.entries for p in device.rpdos + device.tpdos}
    assert [(e.index, e.subindex, e.bits) for e in found[pdo]] == AKD_PDOS[pdo]


def test_sizes_of_the_image_are_those_of_the_drive(model):
    device = sii.unpack(sii.of_model(model))
    slave = Wired(model.name)
    sizes = [sum(pdo.bits for pdo in device.assigned(n)) // 8 for n in (2, 3)]
    assert sizes == [slave.drive.rpdo_size, slave.drive.tpdo_size]
    assert sizes == [manager.length for manager in device.sync_managers[2:]]


@pytest.mark.parametrize("name", ["generic", "kollmorgen_akd"])
def test_34_every_pdo_that_may_be_assigned_has_the_size_of_the_image_and_reaches_safe_op(name):
    device = sii.unpack(sii.of_model(load(name, "ethercat")))
    slave = Wired(name)
    for rpdo, tpdo in zip(device.rpdos, device.tpdos[: len(device.rpdos)], strict=True):
        slave.request(1)
        slave.to(P)
        slave.assign([rpdo.index], [tpdo.index])
        assert (slave.drive.rpdo_size, slave.drive.tpdo_size) == (rpdo.bits // 8, tpdo.bits // 8)
        slave.to(4)
    for pdo in device.tpdos[len(device.rpdos) :]:
        slave.request(2)
        slave.assign([device.rpdos[0].index], [pdo.index])
        assert slave.drive.tpdo_size == pdo.bits // 8
        slave.to(4)


# ------------------------------------------------------------------------- alias


def write_alias(slave, alias, *, checksum=True):
    """As a master does: words 0-7 with the new alias and its checksum, one word at a time."""
    image = sii.with_alias(slave.slave._pdi.sii, alias)
    slave.write(0x0500, [0x00])  # the EEPROM is the master's
    for number in (4, 7)[: 1 + checksum]:
        slave.write(0x0508, image[2 * number : 2 * number + 2])
        slave.write(0x0502, struct.pack("<HI", 0x0201, number))


def test_13_an_alias_that_a_master_has_written_lasts(tmp_path):
    path = tmp_path / "drive.json"
    slave = Wired("generic", parameter_file=path)
    assert slave.register(0x0012) == 0
    write_alias(slave, 0x0042)
    assert slave.register(0x0012) == 0, "not before the next start"
    slave.power_cycle()
    assert slave.register(0x0012) == 0x0042
    assert Wired("generic", parameter_file=path).register(0x0012) == 0x0042
    slave = Wired("generic", parameter_file=path).to(P)
    assert slave.write32(0x1011, 1, 0x64616F6C) == 0
    assert Wired("generic", parameter_file=path).register(0x0012) == 0x0042, "no parameter"


def test_an_alias_without_its_checksum_is_not_kept(tmp_path):
    path = tmp_path / "drive.json"
    slave = Wired("generic", parameter_file=path)
    write_alias(slave, 0x0042, checksum=False)
    assert Wired("generic", parameter_file=path).register(0x0012) == 0


def test_writing_the_alias_makes_the_akd_save_its_parameters(tmp_path):
    path = tmp_path / "drive.json"
    for model, kept in (("generic", False), ("kollmorgen_akd", True)):
        slave = Wired(model, parameter_file=path)
        slave.drive.write("following_error_window", 4711)
        write_alias(slave, 5)
        other = Wired(model, parameter_file=path)
        assert (other.drive.read("following_error_window") == 4711) == kept
        path.unlink()


# ------------------------------------------------------------------------ refusals


def test_an_image_that_does_not_fit_is_refused_with_the_way_out(tmp_path):
    folder = tmp_path / "small"
    shutil.copytree(load("generic").folder, folder)
    path = folder / "ethercat.toml"
    path.write_text(path.read_text(encoding="utf-8").replace("size = 4096", "size = 512"))
    with pytest.raises(ValueError, match=r"needs \d+ bytes, its EEPROM has 512: set sii.size"):
        sii.of_model(load(folder, "ethercat"))


def test_a_text_that_no_eeprom_can_carry_is_refused(model):
    for name in ("x" * 256, "Größe ≥ 1"):
        with pytest.raises(ValueError, match="SII of"):
            sii.pack(dataclasses.replace(describe(model), name=name))


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda image: image[:100], "128 bytes or more"),
        (lambda image: bytes([image[0] ^ 1]) + image[1:], "checksum"),
        (lambda image: image[:0x82] + b"\xff\x7f" + image[0x84:], "beyond its end"),
        (lambda image: image[: len(image.rstrip(b"\xff")) + 1], "ends within a word"),
    ],
)
def test_a_damaged_image_is_refused(model, change, reason):
    with pytest.raises(ValueError, match=reason):
        sii.unpack(change(sii.of_model(model)))


@pytest.mark.parametrize("behind", [b"", bytes(4), bytes(1920)])
def test_the_end_of_an_image_may_stand_for_its_end_mark(model, behind):
    """A stepper drive has been seen that holds words 00h to 3Fh, and nothing or zeros behind."""
    image = sii.of_model(model)[: sii.CATEGORIES] + behind
    device = sii.unpack(image)
    assert (device.vendor_id, device.mailbox) == (describe(model).vendor_id,
                                                  describe(model).mailbox)
    assert (device.sync_managers, device.rpdos) == ((), ())
    assert sii.unended(image) == sii.CATEGORIES // 2
    assert not sii.unended(sii.of_model(model))


def test_random_damage_is_read_or_refused(model):
    generator = random.Random(5)
    image = sii.of_model(model)
    for _ in range(3000):
        damaged = bytearray(image)
        for _ in range(generator.randrange(1, 8)):
            damaged[generator.randrange(16, len(image))] = generator.randrange(256)
        try:
            sii.unpack(bytes(damaged))
        except ValueError:
            continue


def test_a_category_of_strings_without_a_byte_has_none():
    image = bytearray(sii.CATEGORIES) + struct.pack("<HHH", sii.Category.STRINGS, 0, sii.END)
    image[sii.CONFIGURED] = sii.checksum(image[: sii.CONFIGURED])
    assert sii.unpack(bytes(image)).name == ""
