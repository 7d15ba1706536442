"""The device description file of every model: ETG.2000."""

import dataclasses
import random
import re
from xml.etree import ElementTree

import pytest
from wired import P, Wired

from servogym.drive.ethercat import esi, sii
from servogym.drive.ethercat.description import describe
from servogym.drive.ethercat.esi_reader import read_esi
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
    )


@pytest.fixture
def read(tmp_path):
    """What the reader of makers' files makes of a text or of bytes."""

    def read(text):
        path = tmp_path / "drive.xml"
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return read_esi(path)

    return read


def test_11_a_file_is_read_back_row_by_row_and_nothing_is_repaired(model, read):
    wanted = esi.of_model(model)
    found = read(esi.write(wanted))
    assert found.device == in_both(wanted.device)
    assert found.vendor == wanted.vendor
    for ours, theirs in zip(wanted.device.rpdos + wanted.device.tpdos,
                            found.device.rpdos + found.device.tpdos, strict=True):
        assert theirs.excludes == ours.excludes
    rows = {(o.index, o.subindex): (o.name, o.data_type, o.access, o.mapping)
            for o in found.objects}
    assert rows == {
        address: (row.name, row.data_type, row.access, row.pdo)
        for address, row in wanted.dictionary.items()
    }
    assert {o.index: o.group for o in found.objects} == wanted.names
    assert found.repairs == []


def test_14_the_file_the_eeprom_and_the_dictionary_say_the_same(model, read):
    written = esi.write(esi.of_model(model))
    file = read(written)
    image = sii.unpack(sii.of_model(model))
    assert in_both(file.device) == in_both(image)
    assert f"<ConfigData>{sii.of_model(model)[:14].hex().upper()}<" in written
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
    for entry in file.objects:
        slot = slave.drive.objects.slots[entry.index, entry.subindex]
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
        (BOMB, "line 2: a document type"),
        ('<!DOCTYPE x SYSTEM "file:///etc/passwd"><x/>', "line 1: a document type"),
        ("<EtherCATInfo>", "line 1: no XML"),
        ("", "line 1: no XML"),
        ("<Other/>", "line 1: the root of an ESI file is EtherCATInfo"),
        ("<EtherCATInfo/>", "line 1: there is no Device"),
    ],
)
def test_a_file_that_is_none_is_refused_with_line_and_reason(text, reason, read):
    with pytest.raises(ValueError, match=reason):
        read(text)


def test_random_damage_is_read_or_refused(read):
    text = esi.write(esi.of_model(load("festo_cmmp_as", "ethercat")))
    generator = random.Random(11)
    for _ in range(60):
        at = generator.randrange(len(text))
        damaged = text[:at] + chr(generator.randrange(32, 127)) + text[at + 1 :]
        try:
            read(damaged)
        except ValueError:
            continue


def test_14_the_command_writes_file_or_eeprom(tmp_path, capsys):
    path = tmp_path / "akd.xml"
    assert cli.main(["esi", "kollmorgen_akd", "-o", str(path)]) == 0
    found = read_esi(path)
    assert found.device.product_code == 0x00414B44
    told = " ".join(capsys.readouterr().out.split())
    assert f"{len({o.index for o in found.objects})} objects of kollmorgen_akd" in told
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
def test_the_command_refuses_in_one_line(tmp_path, refused, model, out, reason):
    assert reason in refused(["esi", model, "-o", str(tmp_path / out)])


ORDER = {  # of children; from EtherCATInfo.xsd and EtherCATBase.xsd, Schema version 1.3
    "EtherCATInfo": "Vendor Descriptions", "Descriptions": "Groups Devices",
    "Device": "Type Name Info GroupType Profile Fmmu Sm RxPdo TxPdo Mailbox Dc Eeprom",
    "Dictionary": "DataTypes Objects", "DataType": "Name BitSize SubItem",
    "SubItem": "SubIdx Name Type BitSize BitOffs Flags", "Flags": "Access PdoMapping Backup",
    "Object": "Index Name Type BitSize Flags", "Entry": "Index SubIndex BitLen Name DataType",
}
NUMBERS = ("Index", "SubIndex", "SubIdx", "AssignActivate", "Id", "Exclude")


def test_a_file_keeps_the_order_the_keys_and_the_patterns_of_the_schema(model):
    """Rules of the ETG's schema that were read from it; the whole schema is not at hand."""
    root = ElementTree.fromstring(esi.write(esi.of_model(model)))
    for tag, order in ORDER.items():
        places = {name: n for n, name in enumerate(order.split())}
        found = [one for one in root.iter(tag) if len(one)]  # an entry has a DataType of text
        assert found, tag
        for one in found:
            given = [places[child.tag] for child in one]
            assert given == sorted(given), tag
    types = [one.findtext("Name") for one in root.iter("DataType") if len(one)]
    assert len(types) == len(set(types)), "DataTypeKey"
    for one in root.iter("DataType"):
        names = [item.findtext("Name") for item in one.findall("SubItem")]
        assert len(names) == len(set(names)), "SubItemKey"
    assert {item.findtext("Type") for item in root.iter("SubItem")} <= {*types}, "SubItemTypeRef"
    for tag in NUMBERS:
        for one in root.iter(tag):
            assert re.fullmatch(r"[+-]?[0-9]+|#x[0-9a-fA-F]+", one.text), (tag, one.text)
    assert {one.text for one in root.iter("PdoMapping")} <= {"T", "R", "TR", "RT"}
    assert {one.text for one in root.iter("Access")} <= {"ro", "wo", "rw"}
    assert all(one.get("Physics") for one in root.iter("Device"))
