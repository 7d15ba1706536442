"""A model made from an ESI file or an EEPROM image is the drive that the file describes."""

import dataclasses
import re
import shutil

import pytest

from servogym.drive.drive import Drive
from servogym.drive.ethercat import esi, sii
from servogym.drive.ethercat.bus import Bus
from servogym.drive.ethercat.description import describe
from servogym.drive.ethercat.master import EtherCatMaster
from servogym.drive.ethercat.segment import Segment
from servogym.drive.ethercat.slave import Slave
from servogym.drive.imports.ethercat import CHIPS, import_esi, import_sii
from servogym.drive.model.model import load
from servogym.drive.objects.abort import Abort, SdoAbort
from servogym.envs import linear_axis
from servogym.training import cli

MODELS = ("generic", "kollmorgen_akd", "festo_cmmp_as")
COMMANDS = {0x40: 6, 0x21: 7, 0x23: 15, 0x27: 15}


def pdos(rows):
    """Content of PDOs, without the names."""
    return {
        p.index: (p.sync_manager, [(e.index, e.subindex, e.bits) for e in p.entries]) for p in rows
    }


def same(device, of):
    """Whether two descriptions agree in what a master sees, names and EEPROM's size apart."""
    for field in dataclasses.fields(of):
        if field.name in ("rpdos", "tpdos"):
            assert pdos(getattr(device, field.name)) == pdos(getattr(of, field.name))
        elif field.name not in ("vendor_strings", "serial_number", "ds402_channels", "size",
                                "eoe_details", "fmmus", "flags", "version"):
            assert getattr(device, field.name) == getattr(of, field.name), field.name


@pytest.mark.parametrize("model", MODELS)
def test_what_is_made_from_our_esi_describes_itself_as_the_model_does(tmp_path, model):
    file = tmp_path / "drive.xml"
    file.write_text(esi.write(esi.of_model(load(model, "ethercat"))), "utf-8")
    made = import_esi(file, tmp_path / "mine")
    own, of = load(tmp_path / "mine", "ethercat"), load(model, "ethercat")
    same(describe(own), describe(of))
    told = {address: (row.data_type, row.access) for address, row in own.objects.items()}
    for address, row in of.objects.items():
        if address[0] in (0x10F1, 0x1C32, 0x1C33) or 0x1400 <= address[0] < 0x1C14:
            continue
        assert address in told, f"{address[0]:04X}h:{address[1]:02X}h"
        assert told[address][0] == row.data_type
    assert made.pdos == (len(of.rpdos), len(of.tpdos))


@pytest.mark.parametrize("model", MODELS)
def test_what_is_made_from_our_eeprom_describes_itself_as_the_model_does(tmp_path, model):
    file = tmp_path / "drive.bin"
    file.write_bytes(sii.of_model(load(model, "ethercat")))
    import_sii(file, tmp_path / "mine")
    same(describe(load(tmp_path / "mine", "ethercat")), describe(load(model, "ethercat")))
    readme = (tmp_path / "mine" / "README.md").read_text()
    assert "servogym drives --from-sii" in readme
    assert "those of the model `generic`" in readme


def test_the_makers_eeprom_is_kept_to_the_bit(tmp_path):
    """Names with capital letters, strings that nobody refers to: a master compares the words."""
    ours = describe(load("kollmorgen_akd", "ethercat"))
    change = dataclasses.replace

    def named(pdo):
        entries = tuple(change(e, name=e.name.replace("_", " ").title()) for e in pdo.entries)
        return change(pdo, name=f"M {pdo.index:X}", entries=entries)

    image = sii.pack(change(ours, rpdos=tuple(map(named, ours.rpdos)),
                            tpdos=tuple(map(named, ours.tpdos))))
    file, folder = tmp_path / "drive.bin", tmp_path / "mine"
    file.write_bytes(image)
    import_sii(file, folder)
    model = load(folder, "ethercat")
    assert sii.of_model(model) == image
    assert sii.of_model(model, 7) == sii.with_alias(image, 7)
    master = EtherCatMaster(Bus(Segment([Slave(Drive(folder))])))
    master.to_op()
    assert b"M 1A00" in image
    assert master.slaves[0].read_sii()[: len(image)] == image
    other = shutil.copytree(folder, tmp_path / "other")
    data = other / "ethercat.toml"
    data.write_text(re.sub('image = ".*"', 'image = "?"', data.read_text()))
    with pytest.raises(ValueError, match=r"ethercat.toml: sii\.image is not in base64"):
        load(other, "ethercat")


def test_an_eeprom_that_lists_no_pdos_has_those_of_generic(tmp_path):
    """Nor sync managers, nor an end mark: a stepper drive has been seen that holds no more."""
    ours = describe(load("kollmorgen_akd", "ethercat"))
    file, folder = tmp_path / "drive.bin", tmp_path / "mine"
    file.write_bytes(sii.pack(ours)[: sii.CATEGORIES])
    made = import_sii(file, folder)
    own, usual = describe(load(folder, "ethercat")), describe(load("generic", "ethercat"))
    assert (pdos(own.rpdos), pdos(own.tpdos)) == (pdos(usual.rpdos), pdos(usual.tpdos))
    assert (own.vendor_id, own.mailbox) == (ours.vendor_id, ours.mailbox)
    assert "word 0040h: the image ends without FFFFh" in str(made.repairs[0])
    assert "PDOs: `inferred`, those of `generic`" in (folder / "README.md").read_text()
    master = EtherCatMaster(Bus(Segment([Slave(Drive(folder))])))
    master.to_op()


def as_objects(text, form):
    """The same file with its PDOs as objects of the dictionary, and none in the description.

    ETG.1000.6, 5.6.7.4: an entry of 1600h or 1A00h is index, sub-index and length in bits of an
    object, from the highest byte on; one of 1C12h or 1C13h is the index of a PDO.
    """
    lists = {0x1C12: ([], "UINT", 16), 0x1C13: ([], "UINT", 16)}
    for pdo in re.findall(r"<[RT]xPdo.*?</[RT]xPdo>", text, re.S):
        text = text.replace(pdo, "")
        index, *rest = (int(n, 16) for n in re.findall(r"<Index>#?x?(\w+)</Index>", pdo))
        subs = [int(n) for n in re.findall(r"<SubIndex>(\d+)", re.sub(
            r"(</Index>)(\s*<BitLen>)", r"\1<SubIndex>0</SubIndex>\2", pdo))]
        bits = [int(n) for n in re.findall(r"<BitLen>(\d+)", pdo)]
        if manager := re.search(r'Sm="(\d)"', pdo):
            lists[0x1C10 + int(manager[1])][0].append(index)
        lists[index] = ([o << 16 | s << 8 | b for o, s, b in zip(rest, subs, bits, strict=True)],
                        "UDINT", 32)
    types = objects = ""
    for index, (entries, of, bits) in lists.items():
        items = [(len(entries), "USINT", 8), *((entry, of, bits) for entry in entries)]
        types += f"<DataType><Name>DT{index:X}</Name><BitSize>{sum(b for *_, b in items)}</BitSize>"
        objects += (f"<Object><Index>#x{index:X}</Index><Name>List</Name><Type>DT{index:X}</Type>"
                    f"<BitSize>0</BitSize><Info>")
        for n, (value, name, size) in enumerate(items):
            types += (f"<SubItem><SubIdx>{n}</SubIdx><Name>{n}</Name><Type>{name}</Type>"
                      f"<BitSize>{size}</BitSize><BitOffs>0</BitOffs></SubItem>")
            given = form(value, size // 8)
            objects += f"<SubItem><Name>{n}</Name><Info>{given}</Info></SubItem>"
        types, objects = f"{types}</DataType>", f"{objects}</Info></Object>"
    text = text.replace("</DataTypes>", f"{types}</DataTypes>")
    return text.replace("</Objects>", f"{objects}</Objects>")


@pytest.mark.parametrize("form", [
    lambda value, size: f"<DefaultData>{value.to_bytes(size, 'little').hex()}</DefaultData>",
    lambda value, size: f"<DefaultValue>{value}</DefaultValue>",
    lambda value, size: f"<DefaultValue>#x{value:X}</DefaultValue>",
], ids=["bytes", "decimal", "hexadecimal"])
def test_pdos_that_only_the_dictionary_lists_are_the_same(foreign, tmp_path, form):
    import_esi(foreign, tmp_path / "sd1")
    foreign.write_bytes(as_objects(FOREIGN, form).encode("latin-1"))
    made = import_esi(foreign, tmp_path / "listed")
    found, wanted = (describe(load(tmp_path / name, "ethercat")) for name in ("listed", "sd1"))
    assert pdos(found.rpdos) == pdos(wanted.rpdos)
    assert pdos(found.tpdos) == pdos(wanted.tpdos)
    assert made.pdos == (1, 1)  # 1700h has too many entries, as in the description
    assert "those of its objects 1600h" in (tmp_path / "listed" / "README.md").read_text()


def test_a_dictionary_without_pdos_has_those_of_generic_as_far_as_it_has_the_objects(
    foreign, tmp_path
):
    text = re.sub(r"<([RT]xPdo).*?</\1>", "", FOREIGN, flags=re.S)
    foreign.write_bytes(text.encode("latin-1"))
    import_esi(foreign, tmp_path / "mine")
    own = describe(load(tmp_path / "mine", "ethercat"))
    mapped = {entry.index for pdo in own.rpdos + own.tpdos for entry in pdo.entries}
    assert {0x6040, 0x6041, 0x607A, 0x6064} <= mapped
    assert all(f"<Index>#x{index:X}</Index>" in text for index in mapped)
    assert "PDOs: `inferred`, those of `generic`" in (tmp_path / "mine" / "README.md").read_text()
    machine = linear_axis(load(tmp_path / "mine", "ethercat"))
    EtherCatMaster(Bus(Segment([Slave(machine.drives["x"])]), [machine])).to_op()


@pytest.mark.parametrize("chip", CHIPS)
def test_the_chip_that_is_named_is_the_one_a_master_sees(tmp_path, chip):
    file = tmp_path / "drive.bin"
    file.write_bytes(sii.of_model(load("generic", "ethercat")))
    import_sii(file, tmp_path / "mine", chip=chip)
    master = EtherCatMaster(Bus(Segment([Slave(Drive(tmp_path / "mine"))])))
    master.to_op()
    for address, value in CHIPS[chip].items():
        if address != 0x0502:
            assert master.slaves[0].read(address, len(value)) == value
    assert bool(master.slaves[0].number(0x0502, 1) & 0x20) == (chip == "emulated")


# a file as makers write them: Latin-1, CDATA, arrays, DefaultData, gaps, bits, two devices
FOREIGN = """<?xml version="1.0" encoding="iso-8859-1"?>
<EtherCATInfo xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance" Version="1.2">
 <Vendor><Id>#x00000ABC</Id><Name LcId="1033">M\xfcller Antriebe</Name></Vendor>
 <Descriptions><Groups><Group><Type>Drives</Type><Name>Drives</Name></Group></Groups>
 <Devices>
  <Device Physics="YY"><Type ProductCode="#x1" RevisionNo="#x1">Gateway</Type></Device>
  <Device Physics="YY ">
   <Type ProductCode="#x00020001" RevisionNo="#x00000007"><![CDATA[SD-1]]></Type>
   <Name LcId="1031"><![CDATA[Servo SD-1 <400 W>]]></Name>
   <GroupType>Drives</GroupType>
   <Profile><ProfileNo>402</ProfileNo><Dictionary>
    <DataTypes>
     <DataType><Name>UDINT</Name><BitSize>32</BitSize></DataType>
     <DataType><Name>DT2100ARR</Name><BaseType>INT</BaseType><BitSize>48</BitSize>
      <ArrayInfo><LBound>1</LBound><Elements>3</Elements></ArrayInfo></DataType>
     <DataType><Name>DT2100</Name><BitSize>64</BitSize>
      <SubItem><SubIdx>0</SubIdx><Name>SubIndex 000</Name><Type>USINT</Type><BitSize>8</BitSize>
       <BitOffs>0</BitOffs></SubItem>
      <SubItem><Name>Elements</Name><Type>DT2100ARR</Type><BitSize>48</BitSize>
       <BitOffs>16</BitOffs></SubItem></DataType>
     <DataType><Name>ENUM_MODE</Name><BaseType>SINT</BaseType><BitSize>8</BitSize></DataType>
    </DataTypes>
    <Objects>
     <Object><Index>#x1000</Index><Name>Device type</Name><Type>UDINT</Type><BitSize>32</BitSize>
      <Info><DefaultData>92010200</DefaultData></Info><Flags><Access>ro</Access></Flags></Object>
     <Object><Index>#x2100</Index><Name>Gains</Name><Type>DT2100</Type><BitSize>64</BitSize>
      <Info><SubItem><Name>SubIndex 000</Name><Info><DefaultData>03</DefaultData></Info></SubItem>
       <SubItem><Name>P</Name><Info><DefaultData>9cff</DefaultData></Info></SubItem>
       <SubItem><Name>I</Name><Info><DefaultValue>#x0010</DefaultValue></Info></SubItem></Info>
      <Flags><Access>rw</Access></Flags></Object>
     <Object><Index>#x6040</Index><Name>Controlword</Name><Type>UINT</Type><BitSize>16</BitSize>
      <Flags><Access>rw</Access><PdoMapping>r</PdoMapping></Flags></Object>
     <Object><Index>#x6041</Index><Name>Statusword</Name><Type>UINT</Type><BitSize>16</BitSize>
      <Flags><Access>ro</Access><PdoMapping>T</PdoMapping></Flags></Object>
     <Object><Index>#x6060</Index><Name>Modes of operation</Name><Type>ENUM_MODE</Type>
      <BitSize>8</BitSize><Info><DefaultData>08</DefaultData></Info>
      <Flags><Access>rw</Access><PdoMapping>R</PdoMapping></Flags></Object>
     <Object><Index>#x6061</Index><Name>Mode display</Name><Type>SINT</Type><BitSize>8</BitSize>
      <Flags><Access>ro</Access><PdoMapping>T</PdoMapping></Flags></Object>
     <Object><Index>#x6064</Index><Name>Position</Name><Type>DINT</Type><BitSize>32</BitSize>
      <Flags><Access>ro</Access><PdoMapping>T</PdoMapping></Flags></Object>
     <Object><Index>#x607A</Index><Name>Target</Name><Type>DINT</Type><BitSize>32</BitSize>
      <Flags><Access>rw</Access><PdoMapping>R</PdoMapping></Flags></Object>
     <Object><Index>#x60C2</Index><Name>Period</Name><Type>USINT</Type><BitSize>8</BitSize>
      <Flags><Access>readwrite</Access></Flags></Object>
    </Objects></Dictionary></Profile>
   <Fmmu>Outputs</Fmmu><Fmmu>Inputs</Fmmu><Fmmu>DynamicOutputs</Fmmu>
   <Sm MinSize="34" MaxSize="256" DefaultSize="256" StartAddress="#x1000" ControlByte="#x26"
    Enable="1">MBoxOut</Sm>
   <Sm DefaultSize="256" StartAddress="#x1400" ControlByte="#x22" Enable="1">MBoxIn</Sm>
   <Sm StartAddress="#x1800" ControlByte="#x64" Enable="1"/>
   <Sm StartAddress="#x1c00" ControlByte="#x20" Enable="1"/>
   <RxPdo Sm="2"><Index>#x1600</Index><Name>Out</Name><Exclude>#x1601</Exclude>
    <Entry><Index>#x6040</Index><SubIndex>0</SubIndex><BitLen>16</BitLen><Name>CW</Name>
     <DataType>UINT</DataType></Entry>
    <Entry><Index>#x607A</Index><SubIndex>0</SubIndex><BitLen>32</BitLen><DataType>DINT</DataType></Entry>
    <Entry><Index>#x6060</Index><SubIndex>0</SubIndex><BitLen>8</BitLen><DataType>SINT</DataType></Entry>
    <Entry><Index>#x0</Index><BitLen>8</BitLen></Entry></RxPdo>
   <RxPdo Fixed="1"><Index>#x1700</Index><Name>Much</Name>
    %s</RxPdo>
   <TxPdo Sm="3"><Index>#x1A00</Index><Name>In</Name>
    <Entry><Index>#x6041</Index><SubIndex>0</SubIndex><BitLen>16</BitLen><DataType>UINT</DataType></Entry>
    <Entry><Index>#x6064</Index><SubIndex>0</SubIndex><BitLen>32</BitLen><DataType>DINT</DataType></Entry>
    <Entry><Index>#x6061</Index><SubIndex>0</SubIndex><BitLen>8</BitLen><DataType>SINT</DataType></Entry>
    <Entry><Index>#x60FD</Index><SubIndex>1</SubIndex><BitLen>1</BitLen><DataType>BIT</DataType></Entry>
    <Entry><Index>0</Index><BitLen>7</BitLen></Entry></TxPdo>
   <Mailbox DataLinkLayer="true">
    <CoE SdoInfo="true" PdoAssign="1" CompleteAccess="false"/></Mailbox>
   <Dc><OpMode><Name>DC</Name><AssignActivate>#x300</AssignActivate>
    <CycleTimeSync0 Factor="1">0</CycleTimeSync0></OpMode></Dc>
   <Eeprom><ByteSize>1024</ByteSize><ConfigData>080E</ConfigData></Eeprom>
  </Device></Devices></Descriptions></EtherCATInfo>
""" % ("<Entry><Index>#x6040</Index><BitLen>16</BitLen></Entry>" * 17)


@pytest.fixture
def foreign(tmp_path):
    file = tmp_path / "maker.xml"
    file.write_bytes(FOREIGN.encode("latin-1"))
    return file


def test_a_makers_file_becomes_a_drive_that_an_unmodified_master_enables_and_moves(
    foreign, tmp_path
):
    import_esi(foreign, tmp_path / "sd1")
    machine = linear_axis(load(tmp_path / "sd1", "ethercat"))
    bus = Bus(Segment([Slave(machine.drives["x"])]), [machine])
    master = EtherCatMaster(bus)
    (slave,) = master.scan()
    device = slave.description
    assert (device.vendor_id, device.product_code, device.revision_number) == (0xABC, 0x20001, 7)
    assert device.name == "Servo SD-1 <400 W>"
    master.to_op()
    assert (len(slave.outputs), len(slave.inputs)) == (8, 8)
    drive = machine.drives["x"]
    begin = drive.read("position_actual_value")
    target = begin
    for n in range(1500):
        word = COMMANDS.get(drive.read("statusword") & 0x6F, 6)
        target += 20 if n > 500 else 0
        slave.outputs[:] = (
            word.to_bytes(2, "little") + target.to_bytes(4, "little", signed=True) + b"\x08\0"
        )
        assert master.cycle()
    assert drive.read("statusword") & 0x6F == 0x27
    assert drive.read("position_actual_value") - begin > 15_000
    assert int.from_bytes(slave.inputs[2:6], "little", signed=True) - begin > 15_000


def test_each_departure_of_a_makers_file_is_a_row_of_its_readme(foreign, tmp_path):
    made = import_esi(foreign, tmp_path / "sd1")
    told = {(repair.where, repair.says) for repair in made.repairs}
    for expected in (
        ("Device", "2 devices"), ("Fmmu", "DynamicOutputs"), ("Sm 2", "no name"),
        ("60C2h:00h", "access readwrite"), ("1600h", "8 bits: gaps or parts of bytes"),
        ("1A00h", "8 bits: gaps or parts of bytes"), ("1700h", "17 entries"),
    ):
        assert expected in told
    readme = (tmp_path / "sd1" / "README.md").read_text("utf-8")
    for repair in made.repairs:
        assert repair.says[:40] in readme
    rows = dict(re.findall(r"^\| (\d+) \| (\S+)", readme, re.M))
    assert all(FOREIGN.splitlines()[int(line) - 1] for line in rows), "lines of the file"


def test_defaults_and_arrays_of_a_makers_file_are_read_by_sdo(foreign, tmp_path):
    import_esi(foreign, tmp_path / "sd1")
    master = EtherCatMaster(Bus(Segment([Slave(Drive(tmp_path / "sd1"))])))
    (slave,) = master.scan()
    master.to_preop()
    assert [slave.upload(0x2100, n) for n in range(4)] == [3, 0xFF9C, 16, 0]
    assert slave.upload(0x1000) == 0x00020192
    assert slave.upload(0x1018, 1) == 0xABC


# of each direction fixed ones; more than 16 entries; bits of the maker's
MANY = "".join(
    f"<Entry><Index>#x{0x2600 + n:X}</Index><BitLen>16</BitLen></Entry>"
    f"<Entry><Index>#x{0x2500 + n:X}</Index><BitLen>1</BitLen></Entry>"
    "<Entry><Index>0</Index><BitLen>7</BitLen></Entry>" for n in range(18)
)
PDOS = f"""<EtherCATInfo><Vendor><Id>1</Id></Vendor><Descriptions><Devices><Device>
<Type ProductCode="#x1">D</Type><Sm>MBoxOut</Sm><Sm>MBoxIn</Sm><Sm>Outputs</Sm><Sm>Inputs</Sm>
<RxPdo Fixed="1" Sm="2"><Index>#x1600</Index><Exclude>#x1605</Exclude><Entry><Index>#x6040</Index>
 <BitLen>16</BitLen></Entry></RxPdo>
<RxPdo Fixed="1" Sm="2"><Index>#x1601</Index><Entry><Index>#x607A</Index><BitLen>32</BitLen></Entry>
</RxPdo>
<RxPdo><Index>#x1605</Index><Entry><Index>#x6060</Index><BitLen>8</BitLen></Entry></RxPdo>
<TxPdo Fixed="1" Sm="3"><Index>#x1A03</Index><Entry><Index>#x6041</Index><BitLen>16</BitLen></Entry>
 {MANY}<Entry><Index>#x6064</Index><BitLen>32</BitLen></Entry></TxPdo>
<Mailbox><CoE SdoInfo="1" PdoAssign="1"/></Mailbox></Device></Devices></Descriptions></EtherCATInfo>
"""


@pytest.fixture
def alternatives(tmp_path):
    """The one slave of a file with fixed, mappable and excluding PDOs, in PRE_OP."""
    file = tmp_path / "pdos.xml"
    file.write_text(PDOS)
    import_esi(file, tmp_path / "pdos")
    master = EtherCatMaster(Bus(Segment([Slave(Drive(tmp_path / "pdos"))])))
    (slave,) = master.scan()
    master.to_preop()
    return slave


def assigned(slave, pdos):
    """What the slave says of an assignment of RPDOs: 0, or the abort code."""
    try:
        slave.assign(pdos, [0x1A03])
    except SdoAbort as refused:
        return refused.code
    return 0


def test_fixed_pdos_stay_fixed_and_several_are_assigned_at_once(alternatives):
    assert [alternatives.upload(0x1C12, n) for n in range(3)] == [2, 0x1600, 0x1601]
    assert (alternatives.size(2), alternatives.size(3)) == (6, 2 + 18 * 3 + 4)
    for pdo in (0x1600, 0x1601):
        with pytest.raises(SdoAbort) as refused:
            alternatives.mailbox.download(pdo, 0, b"\0")
        assert refused.value.code == Abort.READ_ONLY


def test_a_mappable_pdo_that_is_not_the_first_is_mapped(alternatives):
    alternatives.mailbox.download(0x1C12, 0, b"\0")
    alternatives.mailbox.download(0x1605, 0, b"\0")
    alternatives.mailbox.download(0x1605, 1, (0x60FF0020).to_bytes(4, "little"))
    alternatives.mailbox.download(0x1605, 0, b"\1")
    assert assigned(alternatives, [0x1605]) == 0
    assert alternatives.upload(0x1605, 1) == 0x60FF0020
    assert alternatives.upload(0x1600, 1) == 0x60400010
    assert alternatives.size(2) == 4


def test_pdos_that_exclude_one_another_are_refused(alternatives):
    assert assigned(alternatives, [0x1605, 0x1600]) == Abort.PARAMETER_INCOMPATIBLE
    assert assigned(alternatives, [0x1605, 0x1601]) == 0


def test_letters_that_the_eeprom_does_not_carry_are_left_out_and_told(tmp_path):
    """A device type of them alone was a UnicodeEncodeError (2 of 3,000 damaged files)."""
    file = tmp_path / "letters.xml"
    file.write_text(PDOS.replace(">D</Type>", ">\u4f3a\u670d SD-1 \xb5</Type>"), encoding="utf-8")
    made = import_esi(file, tmp_path / "mine")
    assert load(tmp_path / "mine", "ethercat").ethercat.order == "SD-1 \xb5"
    assert "Type" in {row.where for row in made.repairs}
    file.write_text(PDOS.replace(">D</Type>", ">\u4f3a\u670d</Type>"), encoding="utf-8")
    import_esi(file, tmp_path / "other")
    assert load(tmp_path / "other", "ethercat").ethercat.order == "drive"


def test_a_controlword_that_is_no_variable_is_told_as_a_dictionary_without_it(tmp_path):
    """It was refused as "not the EDS of a CiA 402 drive", under the file's name alone."""
    rows = "".join(
        f"<Object><Index>#x{index:X}</Index><Type>DT</Type><BitSize>32</BitSize></Object>"
        for index in (0x6040, 0x6041)
    )
    parts = "".join(
        f"<SubItem><SubIdx>{n}</SubIdx><Name>n</Name><Type>UINT</Type><BitSize>16</BitSize>"
        "</SubItem>" for n in range(2)
    )
    kind = f"<DataType><Name>DT</Name><BitSize>32</BitSize>{parts}</DataType>"
    own = f"<DataTypes>{kind}</DataTypes><Objects>{rows}</Objects>"
    profile = f"<Profile><Dictionary>{own}</Dictionary></Profile>"
    file = tmp_path / "records.xml"
    file.write_text(PDOS.replace("<Sm>MBoxOut", f"{profile}<Sm>MBoxOut", 1))
    made = import_esi(file, tmp_path / "mine")
    assert "dictionary" in {row.where for row in made.repairs}


def test_where_6060h_is_read_only_the_mode_is_that_of_the_set_point(tmp_path):
    rows = "".join(
        f"<Object><Index>#x{index:X}</Index><Type>{kind}</Type><BitSize>{bits}</BitSize>"
        f"<Info><DefaultData>00</DefaultData></Info><Flags><Access>ro</Access></Flags></Object>"
        for index, kind, bits in ((0x6040, "UINT", 16), (0x6041, "UINT", 16), (0x6060, "SINT", 8),
                                  (0x6064, "UDINT", 32), (0x607A, "UDINT", 32))
    )
    file = tmp_path / "one_mode.xml"
    profile = f"<Profile><Dictionary><Objects>{rows}</Objects></Dictionary></Profile>"
    file.write_text(PDOS.replace("<Sm>MBoxOut", f"{profile}<Sm>MBoxOut", 1))
    made = import_esi(file, tmp_path / "mine")
    assert ("6060h:00h", "default 0", "8") in {(r.where, r.says, r.taken) for r in made.repairs}
    machine = linear_axis(load(tmp_path / "mine", "ethercat"))
    master = EtherCatMaster(Bus(Segment([Slave(machine.drives["x"])]), [machine]))
    (slave,) = master.scan()
    master.to_op()
    drive, begin = machine.drives["x"], machine.drives["x"].read("position_actual_value")
    for n in range(1500):
        word = COMMANDS.get(drive.read("statusword") & 0x6F, 6)
        target = begin + max(n - 500, 0) * 20
        slave.outputs[:] = word.to_bytes(2, "little") + target.to_bytes(4, "little", signed=True)
        assert master.cycle()
    assert drive.read("position_actual_value") - begin > 15_000


def test_another_device_of_the_file_is_named(foreign, tmp_path):
    with pytest.raises(ValueError, match=r"no device 'SD-2' in it, choose one of Gateway"):
        import_esi(foreign, tmp_path / "a", device="SD-2")
    assert import_esi(foreign, tmp_path / "b", device="sd-1").name == "Servo SD-1 <400 W>"


BOMB = (
    '<?xml version="1.0"?><!DOCTYPE x [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;">]>'
    "<EtherCATInfo>&b;</EtherCATInfo>"
)
EXTERNAL = (
    '<?xml version="1.0"?><!DOCTYPE x [<!ENTITY a SYSTEM "file:///etc/passwd">]>'
    "<EtherCATInfo>&a;</EtherCATInfo>"
)


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"", "line 1: no XML"),
        (b"\x7fELF\0\0\0", "line 1: no XML"),
        (b"hello", "line 1: no XML"),
        (FOREIGN.encode("latin-1")[:3000], "no XML: unclosed token"),
        (FOREIGN.encode("latin-1").replace(b"</Profile>", b"</Profil>"), "no XML: mismatched tag"),
        (BOMB.encode(), "line 1: a document type or entities of its own"),
        (EXTERNAL.encode(), "line 1: a document type or entities of its own"),
        (b"<html/>", "line 1: the root of an ESI file is EtherCATInfo, not html"),
        (b"<EtherCATInfo/>", "line 1: there is no Device in it"),
        (b"<EtherCATInfo>\n<Descriptions><Devices>\n<Device/></Devices></Descriptions>"
         b"</EtherCATInfo>", "line 3: no device with a controlword"),
        (b"<a>" * 200, "more than 100 elements in one another"),
        (FOREIGN.encode("utf-16"), "no XML"),
    ],
)
def test_what_is_no_esi_is_one_line_with_file_and_line(tmp_path, refused, content, says):
    file = tmp_path / "drive.xml"
    file.write_bytes(content)
    error = refused(["drives", "--from-esi", str(file), "-o", str(tmp_path / "mine")])
    assert str(file) in error
    assert says in error
    assert not (tmp_path / "mine").exists()


def test_latin_1_without_a_declaration_is_taken_and_told(tmp_path):
    file = tmp_path / "drive.xml"
    file.write_bytes(FOREIGN.split("\n", 1)[1].encode("latin-1"))
    made = import_esi(file, tmp_path / "mine")
    assert any(repair.where == "encoding" for repair in made.repairs)


@pytest.mark.parametrize("encoding", ["gb2312", "shift_jis", "windows-1252", "utf-16", "UTF-8"])
def test_an_encoding_that_is_declared_is_that_of_the_file(tmp_path, encoding):
    name = "\u5e7f\u5dde" if encoding in ("gb2312", "shift_jis") else "M\xfcller"
    text = FOREIGN.replace("iso-8859-1", encoding).replace("M\xfcller", name)
    file = tmp_path / "drive.xml"
    file.write_bytes(text.encode(encoding))
    import_esi(file, tmp_path / "mine")
    assert load(tmp_path / "mine", "ethercat").ethercat.vendor == f"{name} Antriebe"


@pytest.mark.parametrize("number", ["255", "256", "5632", "65535", "65536", "-1"])
def test_a_sub_index_is_a_byte_or_a_repair(tmp_path, number):
    text = esi.write(esi.of_model(load("generic", "ethercat")))
    head, found, tail = text.partition("<SubIdx>2</SubIdx>")
    assert found
    file = tmp_path / "drive.xml"
    file.write_text(f"{head}<SubIdx>{number}</SubIdx>{tail}")
    made = import_esi(file, tmp_path / "mine")
    assert any(repair.says == number for repair in made.repairs) == (number != "255")
    Drive(load(made.folder, "ethercat"))


@pytest.mark.parametrize("encoding", ["iso-885-1", "rot13", "base64", "x" * 39])
def test_an_encoding_that_there_is_not_is_one_line(tmp_path, capsys, encoding):
    file = tmp_path / "drive.xml"
    file.write_bytes(FOREIGN.replace("iso-8859-1", encoding).encode("latin-1"))
    assert cli.main(["drives", "--from-esi", str(file), "-o", str(tmp_path / "mine")]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert f"line 1: no XML: encoding {encoding!r}" in error


@pytest.mark.parametrize(
    "data", [b"utf\0", b"utf-8\n<?xml version=", b"utf-" + b"9" * 45, b"gb2312"],
    ids=["nul", "lines", "long", "behind a mark"],
)
def test_an_encoding_that_only_the_parser_or_a_codec_refuses_is_one_line(tmp_path, data):
    """Found by damaged files: 14 of 100,000."""
    file = tmp_path / "drive.xml"
    text = FOREIGN.encode("latin-1", "replace").replace(b"iso-8859-1", data, 1)
    file.write_bytes(b"\xef\xbb\xbf" * (data == b"gb2312") + text)
    with pytest.raises(ValueError, match="line 1: no XML") as error:
        import_esi(file, tmp_path / "mine")
    assert str(error.value).startswith(str(file))
    assert "\n" not in str(error.value)


def test_a_hundred_megabytes_are_refused_and_not_held(tmp_path, capsys):
    file = tmp_path / "large.xml"
    with file.open("wb") as stream:
        stream.truncate(100_000_000)
    assert cli.main(["drives", "--from-esi", str(file), "-o", str(tmp_path / "mine")]) == 2
    assert "at most 33554432" in capsys.readouterr().err


@pytest.mark.parametrize("cut", [0, 1, 64, 127, 129, 130, 500, 900])
def test_a_part_of_an_eeprom_is_one_line(tmp_path, refused, cut):
    file = tmp_path / "drive.bin"
    file.write_bytes(sii.of_model(load("kollmorgen_akd", "ethercat"))[:cut])
    error = refused(["drives", "--from-sii", str(file), "-o", str(tmp_path / "mine")])
    assert str(file) in error
    assert not (tmp_path / "mine").exists()


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--from-esi", "a.xml"], "-o FOLDER belong together"),
        (["--from-esi", "a.xml", "--from-sii", "b.bin", "-o", "c"], "choose one"),
        (["--from-esi", "nowhere.xml", "-o", "c"], "nowhere.xml: No such file"),
    ],
)
def test_a_mistake_is_one_line(tmp_path, monkeypatch, refused, arguments, says):
    monkeypatch.chdir(tmp_path)
    error = refused(["drives", *arguments])
    assert says in error
