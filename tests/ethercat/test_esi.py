"""The device description file of every model: ETG.2000."""

import dataclasses
import random

import pytest
from wired import P, Wired

from servogym.drive.ethercat import esi, sii
from servogym.drive.ethercat.description import describe
from servogym.drive.model.model import load
from servogym.training import cli

MODELS = ("generic", "festo_cmmp_as", "kollmorgen_akd")
ACCESS = {"const": "ro", "ro": "ro", "rw": "rw", "wo": "wo"}


@pytest.fixture(scope="module", params=MODELS)
def model(request):
    return load(request.param, "ethercat")


def in_both(device):
    """What file and EEPROM both carry."""
    return dataclasses.replace(
        device, serial_number=0, vendor_strings=(), alias=0, version=1, ds402_channels=0,
        eoe_details=min(device.eoe_details, 1),
        fmmus=tuple(0 if kind == 0xFF else kind for kind in device.fmmus),
        flags=device.flags & 0x0C,
    )  # fmt: skip


def test_11_a_file_is_parsed_back_row_by_row(model):
    wanted = esi.of_model(model)
    found = esi.parse(esi.write(wanted))
    assert found == dataclasses.replace(wanted, device=in_both(wanted.device))


def test_14_the_file_the_eeprom_and_the_dictionary_say_the_same(model):
    file = esi.parse(esi.write(esi.of_model(model)))
    image = sii.unpack(sii.of_model(model))
    assert in_both(file.device) == in_both(image)
    assert file.eeprom == sii.of_model(model)[:14]
    slave = Wired(model.name).to(P)
    identity = (image.vendor_id, image.product_code, image.revision_number, image.serial_number)
    for n, value in enumerate(identity, 1):
        assert int.from_bytes(slave.upload(0x1018, n), "little") == value
    for pdo in image.rpdos + image.tpdos:
        words = [e.index << 16 | e.subindex << 8 | e.bits for e in pdo.entries]
        assert slave.upload(pdo.index) == bytes([len(words)])
        for n, word in enumerate(words, 1):
            assert int.from_bytes(slave.upload(pdo.index, n), "little") == word
    for n, index in ((2, 0x1C12), (3, 0x1C13)):
        count = slave.upload(index)[0]
        listed = [int.from_bytes(slave.upload(index, k + 1), "little") for k in range(count)]
        assert listed == [pdo.index for pdo in image.assigned(n)]
    for (index, subindex), entry in file.dictionary.items():
        slot = slave.drive.objects.slots[index, subindex]
        assert entry.name == slot.row.name
        assert entry.access == ACCESS[slot.row.access]


def test_a_model_for_can_has_no_such_file():
    with pytest.raises(ValueError, match="use `servogym node`"):
        load("metronix_ars2000", "ethercat")
    with pytest.raises(ValueError, match='bus="ethercat"'):
        describe(load("generic"))


BOMB = """<?xml version="1.0"?>
<!DOCTYPE lolz [<!ENTITY a "ha"><!ENTITY b "&a;&a;&a;&a;">]>
<EtherCATInfo>&b;</EtherCATInfo>"""


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (BOMB, "no document type"),
        ('<!DOCTYPE x SYSTEM "file:///etc/passwd"><x/>', "no document type"),
        ("<EtherCATInfo>", "no XML"),
        ("", "no XML"),
        ("<Other/>", "EtherCATInfo"),
        ("<EtherCATInfo/>", "no Descriptions/Devices/Device"),
    ],
)
def test_a_file_that_is_none_is_refused_with_the_reason(text, reason):
    with pytest.raises(ValueError, match=reason):
        esi.parse(text)


def test_random_damage_is_parsed_or_refused():
    text = esi.write(esi.of_model(load("festo_cmmp_as", "ethercat")))
    generator = random.Random(11)
    for _ in range(60):
        at = generator.randrange(len(text))
        damaged = text[:at] + chr(generator.randrange(32, 127)) + text[at + 1 :]
        try:
            esi.parse(damaged)
        except ValueError:
            continue


def test_14_the_command_writes_file_or_eeprom(tmp_path, capsys):
    path = tmp_path / "akd.xml"
    assert cli.main(["esi", "kollmorgen_akd", "-o", str(path)]) == 0
    found = esi.parse(path.read_bytes())
    assert found.device.product_code == 0x00414B44
    told = " ".join(capsys.readouterr().out.split())
    assert f"{len(found.names)} objects of kollmorgen_akd" in told
    path = tmp_path / "akd.bin"
    assert cli.main(["esi", "kollmorgen_akd", "-o", str(path)]) == 0
    assert sii.unpack(path.read_bytes()) == describe(load("kollmorgen_akd", "ethercat"))


@pytest.mark.parametrize(
    ("model", "out", "reason"),
    [
        ("metronix_ars2000", "x.xml", "not for ethercat"),
        ("generic", "x.pdf", "has to end with .xml or .bin"),
        ("nobody", "x.xml", "unknown drive model"),
    ],
)
def test_the_command_refuses_in_one_line(tmp_path, capsys, model, out, reason):
    assert cli.main(["esi", model, "-o", str(tmp_path / out)]) == 2
    error = capsys.readouterr().err
    assert reason in error
    assert error.count("\n") == 1
