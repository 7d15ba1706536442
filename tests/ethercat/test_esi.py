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


# EtherCATInfo.xsd and EtherCATBase.xsd, version 1.14 (ETG.2000, 1.0.10): children of an element, as
# a regular expression. `PARENT/TAG` where elements of a name differ.
IMAGE = "(Image16x14|ImageFile16x14|ImageData16x14)?"
FLAGS = "Access? Category? PdoMapping? SafetyMapping? Attribute?"
INFO = """(DefaultString? | MinData? MaxData? DefaultData? | MinValue? MaxValue? DefaultValue?
    | SubItem*) DisplayName? Unit?"""
PDO = "Index Name+ Exclude* Entry* ExcludedSm*"
CHILDREN = {
    "EtherCATInfo": "InfoReference* Vendor Descriptions",
    "Vendor": f"Id Name+ Comment* URL* DescriptionURL? {IMAGE} VendorSpecific?",
    "Descriptions": "Groups Devices Modules?", "Groups": "Group*", "Devices": "Device*",
    "Group": f"Type Name+ Comment* {IMAGE} VendorSpecific?",
    "Device": f"""Type HideType* AlternativeType* SubDevice* Name+ Comment* URL* Info? GroupType
        Profile* Fmmu* Sm* Su* RxPdo* TxPdo* Mailbox? Dc? Slots? ESC? Eeprom? {IMAGE}
        VendorSpecific?""",
    "Device/Info": """Electrical? StateMachine? Mailbox? EtherCATController? (Port){0,4}
        (ExecutionUnit){0,2} VendorSpecific? StationAliasSupported? IdentificationAdo?
        IdentificationReg134? DeviceFeature*""",
    "Profile": """ProfileNo? AddInfo? (ChannelCount | ChannelInfo+)? (DictionaryFile | Dictionary)?
        (DiagFile* | DiagMessages) VendorSpecific?""",
    "Dictionary": "UnitTypes? DataTypes? Objects", "DataTypes": "DataType*", "Objects": "Object*",
    "DataTypes/DataType": """Index? Name BaseType? Comment* BitSize
        ((ArrayInfo){0,3} | SubItem* | EnumInfo*) Properties? Xml?""",
    "ArrayInfo": "LBound Elements", "EnumInfo": "Text+ Enum Comment*",
    "DataType/SubItem": """SubIdx? Name DisplayName* Type Comment* BitSize BitOffs
        (DefaultString | DefaultData | MinValue? MaxValue? DefaultValue?) Flags? Property* Xml?""",
    "SubItem/Flags": f"{FLAGS} Backup? Setting?",
    "Object": "Index Name+ Comment* Type BitSize Info? Flags? Properties? Xml?",
    "Object/Flags": f"{FLAGS} Transition? SdoAccess? Backup? Setting?",
    "Object/Info": INFO, "SubItem/Info": INFO, "Info/SubItem": "Name Info",
    "RxPdo": PDO, "TxPdo": PDO, "Entry": "Index SubIndex? BitLen Name* Comment? DataType?",
    "Mailbox": "AoE? EoE? CoE? FoE? SoE? VoE? VendorSpecific?",
    "EoE": "InitCmd*", "CoE": "Object* InitCmd*", "FoE": "",
    "Dc": "OpMode* VendorSpecific?",
    "OpMode": """Name Desc? AssignActivate CycleTimeSync0? ShiftTimeSync0? CycleTimeSync1?
        ShiftTimeSync1? Sm* VendorSpecific?""",
    "Eeprom": "(Data | ByteSize ConfigData BootStrap? Category*) VendorSpecific?",
}
NUMBER, INT, BYTES = "[+-]?[0-9]+|#x[0-9a-fA-F]+", "[+-]?[0-9]{1,10}", "([0-9a-fA-F]{2})*"
TRUTH, ANY = "true|false|0|1", r"(?s:.*)"
TEXTS = {  # of elements without children
    **dict.fromkeys(("Id", "Index", "SubIndex", "SubIdx", "Exclude", "AssignActivate", "MinValue",
                     "MaxValue", "DefaultValue", "Unit"), NUMBER),
    **dict.fromkeys(("ProfileNo", "BitSize", "BitOffs", "BitLen", "ByteSize", "CycleTimeSync0",
                     "ShiftTimeSync0", "CycleTimeSync1", "ShiftTimeSync1", "Backup", "LBound",
                     "Elements", "Enum"), INT),
    **dict.fromkeys(("ConfigData", "BootStrap", "Data", "DefaultData", "MinData", "MaxData"),
                    BYTES),
    **dict.fromkeys(("Name", "Type", "GroupType", "Fmmu", "Sm", "Entry/DataType", "DefaultString",
                     "DisplayName", "BaseType", "Comment", "URL", "Text"), ANY),
    "IdentificationReg134": TRUTH, "Access": "ro|rw|wo", "Category": "[moc]",
    "PdoMapping": "T|R|TR|RT|t|r|tr|rt",
}
ATTRIBUTES = {
    "EtherCATInfo": {"Version": ANY}, "Vendor": {"FileVersion": INT},
    "Device": {"Physics": "[YKH, ]{0,4}"},
    "Device/Type": dict.fromkeys(("ProductCode", "RevisionNo", "SerialNo"), NUMBER),
    "Device/Sm": dict.fromkeys(("MinSize", "MaxSize", "DefaultSize", "StartAddress", "ControlByte",
                                "Enable"), NUMBER),
    "RxPdo": {"Fixed": TRUTH, "Mandatory": TRUTH, "Sm": INT},
    "TxPdo": {"Fixed": TRUTH, "Mandatory": TRUTH, "Sm": INT},
    "Mailbox": {"DataLinkLayer": TRUTH},
    "CoE": dict.fromkeys(("SdoInfo", "PdoAssign", "PdoConfig", "PdoUpload", "CompleteAccess"),
                         TRUTH),
    "CycleTimeSync0": {"Factor": INT}, "CycleTimeSync1": {"Factor": INT},
}


def breaches(element, parent=""):
    """Where an element departs from the schema, or stands in none of the tables."""
    where = f"{parent}/{element.tag}"
    model, text, known = (
        table.get(where, table.get(element.tag)) for table in (CHILDREN, TEXTS, ATTRIBUTES)
    )
    if model is not None:
        text = r"\s*"
        names = "".join(f"{child.tag} " for child in element)
        if not re.fullmatch(re.sub(r"\w*[A-Za-z]\w*", r"(?:\g<0>[ ])", model), names, re.X):
            yield f"{where}: {names}"
    elif len(element):
        yield f"{where} has children"
    if not re.fullmatch(text or "(?!)", element.text or ""):
        yield f"{where}: {element.text}"
    for name, value in element.attrib.items():
        if not re.fullmatch((known or {}).get(name, "(?!)"), value):
            yield f"{where} {name}={value}"
    for child in element:
        yield from breaches(child, element.tag)


def test_a_file_keeps_the_schema(model):
    """Children, attributes and texts of every element; the keys and their references."""
    root = ElementTree.fromstring(esi.write(esi.of_model(model)))
    assert [*breaches(root)] == []
    assert all(one.get("Physics") is not None for one in root.iter("Device"))
    types = [one.findtext("Name") for one in root.iterfind(".//DataTypes/DataType")]
    assert len(types) == len(set(types)), "DataTypeKey"
    for one in root.iterfind(".//DataTypes/DataType"):
        names = [item.findtext("Name") for item in one.findall("SubItem")]
        assert len(names) == len(set(names)), "SubItemKey"
    for path in ("SubItem", "Object"):
        assert {one.findtext("Type") for one in root.iter(path)} <= {*types}, f"{path}: its Type"


@pytest.mark.parametrize(
    ("of", "to"),
    [
        ("<GroupType>Drive</GroupType>", ""),
        ("<ProfileNo>402</ProfileNo>", "<ProfileNo>#x192</ProfileNo>"),
        ("<Index>#x6040</Index>", "<Index>6040h</Index>"),
        ("<Vendor>", "<Vendor><Name>first</Name>"),
        ("<Eeprom>", "<Eeprom><Category/>"),
        ("<Mailbox ", '<Mailbox Own="1" '),
        ("<Access>ro</Access>", "<Access>const</Access>"),
        ("<Dc>", "<Clock/><Dc>"),
    ],
)
def test_a_departure_from_the_schema_is_found(of, to):
    text = esi.write(esi.of_model(load("generic", "ethercat")))
    assert of in text
    assert [*breaches(ElementTree.fromstring(text.replace(of, to, 1)))]
