"""What stops other makers' data sheets: each departure alone, and files that have many of them.

The texts are ours; the departures are those of public files of other makers (docs/results). The
oracle is a foreign master on a bus, and the library `canopen` where it reads the file too.
"""

import csv
import math
import re
import threading
from functools import partial
from pathlib import Path

import can
import canopen
import pytest
from canopen.profiles.p402 import BaseNode402
from foreign_eds import outcome, until

from servogym.drive.canopen import eds
from servogym.drive.canopen.eds import object_dictionary
from servogym.drive.canopen.sheet import number, read_sheet
from servogym.drive.drive import Drive
from servogym.drive.imports.eds import import_eds
from servogym.drive.objects.abort import Abort, SdoAbort
from servogym.drive.wire.server import Server
from servogym.envs import Machine, commission_joint, gantry, linear_axis, rotary_axis
from servogym.envs.plants.catalogue import axis_for
from servogym.training.cli import main

# index, sub-index, data type, access, PDO mapping, further lines
SMALL = """
1000 . 7 ro 0 DefaultValue=0x60192
1001 . 5 ro 0
1018 0 5 ro 0 DefaultValue=1
1018 1 7 ro 0 DefaultValue=0x1A3
1400 0 5 ro 0 DefaultValue=2
1400 1 7 rw 0 DefaultValue=$NODEID + 0x200
1400 2 5 rw 0 DefaultValue=255
1600 0 5 rw 0 DefaultValue=1
1600 1 7 rw 0 DefaultValue=0x60400010
1800 0 5 ro 0 DefaultValue=5
1800 1 7 rw 0 DefaultValue=$NodeID+0x180
1800 2 5 rw 0 DefaultValue=255
1800 5 6 rw 0 DefaultValue=0
1A00 0 5 rw 0 DefaultValue=1
1A00 1 7 rw 0 DefaultValue=0x60410010
6040 . 6 rww 1
6041 . 6 ro 1
6060 . 2 wo 1
6061 . 2 ro 1
6064 . 4 ro 1
607A . 4 rww 1
6081 . 7 rww 1
6083 . 7 rww 1
6098 . 2 rw 0 DefaultValue=35
6502 . 7 ro 0 DefaultValue=0x21
"""
INFO = "[DeviceInfo]\nVendorName=Somebody\nProductName=Small\nNrOfRXPDO=1\nNrOfTXPDO=1\n"


def sheet(rows=SMALL, *more):
    """The text of an EDS, a line an object."""
    lines, groups = [INFO], set()
    listed = []
    for row in (*rows.strip().splitlines(), *more):
        index, sub, kind, access, mapped, *rest = row.split(" ", 5)
        if index not in listed:
            listed.append(index)
        if sub != "." and index not in groups:
            groups.add(index)
            lines.append(f"[{index}]\nParameterName=Group {index}\nObjectType=0x9\n")
        name = index if sub == "." else f"{index}sub{sub}"
        lines.append(f"[{name}]\nParameterName=Object {name}\nObjectType=0x7\nDataType={kind}\n"
                     f"AccessType={access}\nPDOMapping={mapped}\n"
                     + "".join(f"{line}\n" for line in "".join(rest).split("|")))
    objects = "".join(f"{n}=0x{index}\n" for n, index in enumerate(listed, 1))
    lists = f"[MandatoryObjects]\nSupportedObjects={len(listed)}\n{objects}"
    return lists + "\n".join(lines)


@pytest.fixture
def made(tmp_path):
    """Import a text; -> what became of it."""

    def make(text, name="drive.eds", encoding="ascii"):
        file = tmp_path / name
        file.write_bytes(text.encode(encoding) if isinstance(text, str) else text)
        return import_eds(file, tmp_path / f"model_{len([*tmp_path.iterdir()])}")

    return make


def said(made, where):
    """The repair of an object."""
    (repair,) = [r for r in made.repairs if r.where.startswith(where)]
    return repair


# object, what the file says, what the drive then reads, and the repair
DEFAULTS = [
    ("60C0 . 3 rw 0 DefaultValue=65535", (0x60C0, 0), None, "65535"),
    ("2001 . 3 rw 0 DefaultValue=65535", (0x2001, 0), -1, "65535"),
    ("6076 . 7 rw 0 DefaultValue=0", (0x6076, 0), 1270, "default 0"),
    ("6075 . 7 rw 0 DefaultValue=0|LowLimit=0|HighLimit=100000", (0x6075, 0), 2600, "default 0"),
    ("60C4 2 7 rw 0 DefaultValue=0", (0x60C4, 2), 64, "default 0"),
    ("607F . 7 rw 0 DefaultValue=50000|LowLimit=0|HighLimit=25000", (0x607F, 0), 50000, "limits"),
    ("6066 . 6 rw 0 DefaultValue=10|LowLimit=0|HighLimit=0", (0x6066, 0), 10, "limits 0..0"),
    ("2002 . 5 rw 0 DefaultValue=300", (0x2002, 0), 255, "300"),
    ("2003 . 7 rw 0 DefaultValue=-1", (0x2003, 0), 0xFFFFFFFF, "-1"),
    ("2004 . 7 rw 0 DefaultValue=abc", (0x2004, 0), 0, "'abc'"),
    ("2005 . 7 rw 0 DefaultValue=5|LowLimit=9|HighLimit=3", (0x2005, 0), 5, "limits 9..3"),
    ("608F 1 7 rw 0 DefaultValue=1", (0x608F, 1), 1048576, "default 1"),
    ("6091 1 7 rw 0 DefaultValue=0", (0x6091, 1), 1, "default 0"),
]


@pytest.mark.parametrize(("row", "address", "value", "says"), DEFAULTS, ids=lambda x: str(x)[:12])
def test_a_default_outside_its_range_or_type_is_repaired_and_told(made, row, address, value, says):
    model = made(sheet(SMALL, row))
    where = f"{address[0]:04X}h:{address[1]:02X}h"
    repairs = [r for r in model.repairs if r.where == where]
    assert any(says in r.says for r in repairs), model.repairs
    assert all(r.line > 0 for r in repairs)
    page = (model.folder / "README.md").read_text(encoding="utf-8")
    assert where in page.partition("## Repairs")[2].partition("## Unknown")[0]
    drive = Drive(model.folder)
    read = drive.read(*address)
    assert read == value or value is None
    row = drive.model.objects[address]
    assert row.minimum <= read <= row.maximum


def test_a_factor_of_a_type_without_limits_is_repaired(made):
    """A feed constant in REAL64 beside a gear that makes no exact fraction."""
    rows = "6091 1 7 rw 0 DefaultValue=4294967295", "6092 1 17 rw 0 DefaultValue=0"
    repairs = made(sheet(SMALL, *rows)).repairs
    assert any(r.where == "6092h:01h" and "no exact fraction" in r.why for r in repairs)


@pytest.mark.parametrize(
    ("text", "value"),
    [("0x10", 16), ("10", 10), ("010", 10), ("08", 8), ("0X1f", 31), ("1Fh", 31), (" 7 ", 7),
     ("-5", -5), ("0x-5", None), ("0xFFFFFFFF", 0xFFFFFFFF), ("5.0", 5), ("5.5", None), ("", None),
     ("$NODEID+0x200", (0x200, True)), ("0x200 + $NODEID", (0x200, True)), ("$NodeID", (0, True)),
     ("$NODEID + 0x40000180", (0x40000180, True)), ("0x200+$NODEID+1", None)],
)
def test_numbers_as_files_write_them(text, value):
    if value is None:
        with pytest.raises(ValueError, match="is not a number"):
            number(text)
    else:
        assert number(text) == (value if isinstance(value, tuple) else (value, False))


def test_identifiers_follow_the_node_id_however_it_is_written(made):
    folder = made(sheet()).folder
    drive = Drive(folder, node_id=9)
    assert (drive.read(0x1400, 1), drive.read(0x1800, 1)) == (0x209, 0x189)


def test_more_own_objects_than_the_record_has_place_for(made):
    """1,024 bytes are in the record, where PDOs reach; all others work by SDO alike."""
    rows = [f"{0x2000 + n:04X} . 7 rw 1 DefaultValue={n}" for n in range(2000)]
    model = made(sheet(SMALL, *rows))
    assert "can be mapped" in said(model, "PDOs").says
    drive = Drive(model.folder)
    for n in (0, 100, 511, 512, 1999):
        assert drive.read(0x2000 + n, 0) == n
        drive.write(0x2000 + n, 0, n + 7)
        assert drive.read(0x2000 + n, 0) == n + 7
    state = drive.snapshot()
    drive.write(0x2000 + 1999, 0, 1)
    drive.restore(state)
    assert drive.read(0x2000 + 1999, 0) == 2006
    drive.reset()
    assert drive.read(0x2000 + 1999, 0) == 1999
    assert drive.model.objects[0x2000 + 1999, 0].pdo == ""
    assert "rx" in drive.model.objects[0x2000, 0].pdo


def test_a_pdo_without_its_mapping_can_be_mapped(made):
    rows = ("1401 0 5 ro 0 DefaultValue=2", "1401 1 7 rw 0 DefaultValue=$NODEID+0x300",
            "1401 2 5 rw 0 DefaultValue=255")
    model = made(sheet(SMALL, *rows))
    assert "1601h" in {repair.where for repair in model.repairs}
    described = eds.object_dictionary(model.folder, 5)
    assert [described[0x1601][n].default for n in range(9)] == [0] * 9
    drive = Drive(model.folder)
    drive.write(0x1401, 1, 0x80000305)
    drive.write(0x1601, 1, 0x607A0020)
    drive.write(0x1601, 0, 1)
    drive.write(0x1401, 1, 0x305)
    assert int(drive.rpdos[1].width) == 4


@pytest.mark.parametrize(
    ("value", "index", "taken"),
    [(0, 0, (1, -3)), (1, 0, (1, -3)), (2, -3, (2, -3)), (0, -3, (1, -3))],
)
def test_a_period_that_no_master_keeps_was_not_set(made, value, index, taken):
    rows = (f"60C2 1 5 rw 0 DefaultValue={value}", f"60C2 2 2 rw 0 DefaultValue={index}")
    drive = Drive(made(sheet(SMALL, *rows)).folder)
    assert (drive.read(0x60C2, 1), drive.read(0x60C2, 2)) == taken


@pytest.mark.parametrize("kind", ["7", "8"])
def test_a_period_of_another_type_is_no_period(made, kind):
    """-3 of an UNSIGNED32 are no seconds, and a REAL32 is no power of ten."""
    index = f"60C2 2 {kind} rw 0 DefaultValue=-3"
    model = made(sheet(SMALL, "60C2 1 5 rw 0 DefaultValue=8", index))
    assert any(r.where == "60C2h:02h" for r in model.repairs)
    assert Drive(model.folder).read(0x60C2, 1) == 8


def test_ten_thousand_objects(made):
    rows = [f"{0x2000 + n // 200:04X} {n % 200 + 1:x} 6 rw 0" for n in range(10_000)]
    assert made(sheet(SMALL, *rows)).objects > 10_000


def test_a_mapped_object_keeps_its_mapping_where_place_is_short(made):
    rows = [f"{0x2000 + n:04X} . 7 rw 1" for n in range(600)]
    text = sheet(SMALL, *rows).replace("DefaultValue=0x60400010", "DefaultValue=0x22570020")
    drive = Drive(made(text).folder)
    assert int(drive.rpdos[0].valid)
    assert drive.rpdo_size == 4


TYPES = {
    "INTEGER24": ("0x10", b"\xfe\xff\xff", 3), "UNSIGNED40": ("0x18", b"\1\2\3\4\5", 5),
    "REAL64": ("0x11", b"\0\0\0\0\0\0\xf0\x3f", 8), "TIME_OF_DAY": ("0x0C", b"\1\2\3\4\5\6", 6),
    "TIME_DIFFERENCE": ("0x0D", b"\1\2\3\4\5\6", 6), "OCTET_STRING": ("0x0A", b"\0\xff\1", 0),
    "UNICODE_STRING": ("0x0B", "Ω".encode("utf-16-le"), 0), "DOMAIN": ("0x0F", bytes(300), 0),
    "VISIBLE_STRING": ("9", b"a longer text than four bytes", 0),
}


@pytest.mark.parametrize("name", TYPES)
def test_every_type_of_cia_301_is_kept_as_it_is_written(made, name):
    code, data, length = TYPES[name]
    model = made(sheet(SMALL, f"2001 . {code} rw 0", f"2002 . {code} ro 0"))
    assert model.left_out == ()
    objects = Drive(model.folder).objects
    assert objects.write(0x2001, 0, data) is Abort.NONE
    assert objects.read(0x2001, 0) == (data, Abort.NONE)
    assert objects.write(0x2002, 0, data) is Abort.READ_ONLY
    if length:
        assert len(objects.read(0x2002, 0)[0]) == length
        assert objects.write(0x2001, 0, data + b"\0") is Abort.LENGTH_TOO_HIGH
        assert objects.write(0x2001, 0, data[1:]) is Abort.LENGTH_TOO_LOW


def test_texts_are_in_a_snapshot_and_gone_after_power_on(made):
    drive = Drive(made(sheet(SMALL, "2001 . 9 rw 0 DefaultValue=factory")).folder)
    drive.objects.write(0x2001, 0, b"mine")
    state = drive.snapshot()
    drive.reset()
    assert drive.read(0x2001) == "factory"
    drive.restore(state)
    assert drive.read(0x2001) == "mine"


STRUCTURE = [
    ("a listed object without a section", lambda t: t.replace("=0x6064", "=0x6064\n99=0x6077"),
     "6077h", "listed"),
    ("a section that is not listed", lambda t: t.replace("=0x6064\n", "=0x6061\n"), "6064h",
     "not listed"),
    ("no header of a record", lambda t: re.sub(r"\[1400\]\n.*\n.*\n", "", t), "1400h",
     "no section"),
    ("no number of entries", lambda t: re.sub(r"\[1018sub0\]\n(?:(?!\[).*\n)*", "", t), "1018h:00h",
     "missing"),
    ("a bracket that does not close", lambda t: t.replace("[6064]", "[6064"), "[6064]", "[6064"),
    ("a section that comes twice", lambda t: t + "\n[6064]\nDefaultValue=0\n", "[6064]",
     "a second time"),
    ("a line that is nothing", lambda t: t.replace("[6064]", "what is this\n[6064]"), "file",
     "what is this"),
    ("no type of access", lambda t: t.replace("AccessType=rw\n", "AccessType=xyz\n", 1), "1400h",
     "access 'xyz'"),
    ("a data type there is not", lambda t: t + "\n[2001]\nParameterName=x\nDataType=0x99\n"
     "AccessType=ro\n", "2001h:00h", "data type 99h"),
    ("a variable with sub-indices", lambda t: t.replace("Group 1018\nObjectType=0x9",
                                                        "Group 1018\nObjectType=0x7"),
     "1018h", "a variable"),
    ("a mapping of what there is not", lambda t: t.replace("0x60410010", "0x60770010"), "1A00h:01h",
     "60770010"),
    ("a mapping with another length", lambda t: t.replace("0x60410010", "0x60410020"), "1A00h:01h",
     "32 bits"),
    ("a mapping of what says it is none", lambda t: re.sub(
        r"(Object 6041\n(?:.*\n){3})PDOMapping=1", r"\1PDOMapping=0", t), "1A00h:01h",
     "not mappable"),
]


@pytest.mark.parametrize(
    ("spoil", "where", "says"),
    [case[1:] for case in STRUCTURE],
    ids=[case[0] for case in STRUCTURE],
)
def test_a_structure_other_readers_forgive_is_repaired_and_told(made, spoil, where, says):
    text = spoil(sheet())
    assert text != sheet()
    model = made(text)
    assert any(r.where.startswith(where) and says in r.says for r in model.repairs), model.repairs
    assert Drive(model.folder).read(0x6041) >= 0


def test_lists_may_be_missing_altogether(made):
    text = re.sub(r"\[MandatoryObjects\]\n(?:(?!\[).*\n)*", "", sheet())
    assert made(text).repairs == ()


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "cp1252", "utf-16"])
@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_any_editor_may_have_saved_it(made, encoding, end):
    text = sheet().replace("ProductName=Small", "ProductName=Größe µ").replace("\n", end)
    model = made(text, encoding=encoding)
    assert Drive(model.folder).model.title == "Größe µ"
    assert bool(model.repairs) == (encoding in ("cp1252", "utf-16"))


def test_compact_storage(made):
    """CompactSubObj with names and values beside it, as CiA 306 has it; canopen is the oracle."""
    text = sheet() + (
        "\n[2001]\nParameterName=Table\nObjectType=0x8\nDataType=0x0006\nAccessType=rw\n"
        "DefaultValue=7\nPDOMapping=0\nCompactSubObj=4\n"
        "[2001Name]\nNrOfEntries=1\n2=Second\n[2001Value]\nNrOfEntries=2\n1=11\n3=0x21\n"
        "[1016]\nParameterName=Consumers\nObjectType=0x8\nDataType=0x7\nAccessType=rw\n"
        "CompactSubObj=127\n"
    )
    drive = Drive(made(text).folder)
    assert [drive.read(0x2001, n) for n in range(5)] == [4, 11, 7, 33, 7]
    assert drive.read(0x1016, 0) == 127
    names = [row.name for row in drive.model.objects.values() if row.index == 0x2001]
    assert "table_second" in names


def test_a_dcf_gives_the_drive_its_values(made):
    text = sheet(SMALL, "2001 . 6 rw 0 DefaultValue=5|ParameterValue=9") + (
        "\n[DeviceComissioning]\nNodeID=6\nBaudrate=500\n"
    )
    text = text.replace("DefaultValue=$NODEID + 0x200", "DefaultValue=0x206|").replace("|", "")
    model = made(text.replace("5ParameterValue", "5\nParameterValue"), "drive.dcf")
    assert model.node_id == 6
    drive = Drive(model.folder, node_id=8)
    assert drive.read(0x2001) == 9
    assert drive.read(0x1400, 1) == 0x208  # it follows the node-id
    assert "--node-id 6" in (model.folder / "README.md").read_text(encoding="utf-8")


def test_homing_methods_in_a_list_of_unsigned_numbers(made):
    """60E3h is of INTEGER8 in the profile, some drives have UNSIGNED8: -1 reads as FFh."""
    rows = ["60E3 0 5 ro 0 DefaultValue=2", "60E3 1 5 ro 0", "60E3 2 5 ro 0"]
    drive = Drive(made(sheet(SMALL, *rows)).folder)
    shown = {drive.read(0x60E3, n) for n in range(1, drive.read(0x60E3, 0) + 1)}
    assert shown == {method & 0xFF for method in drive.model.homing_methods}


def test_modes_that_6502h_does_not_say_follow_from_the_objects(made):
    """It is often without a default; the profile's, all modes, is not the drive's."""
    text = sheet(SMALL, "60E3 0 5 ro 0 DefaultValue=2", "60E3 1 2 ro 0", "60E3 2 2 ro 0",
                 "60FF . 4 rww 1").replace("DefaultValue=0x21\n", "")
    model = made(text)
    drive = Drive(model.folder)
    assert [mode.name for mode in drive.model.modes] == [
        "PROFILE_POSITION", "PROFILE_VELOCITY", "HOMING"]
    assert drive.read(0x6502) == 0x25
    page = (model.folder / "README.md").read_text(encoding="utf-8")
    assert "6502h has no default" in page
    assert "60E3h names none" in page


def test_a_drive_without_6060h_has_the_mode_of_its_set_point(made):
    rows = re.sub(r"606[01] .*\n", "", SMALL).replace("1600 0 5 rw 0 DefaultValue=1",
                                                      "1600 0 5 rw 0 DefaultValue=2")
    model = made(sheet(rows, "1600 2 7 rw 0 DefaultValue=0x607A0020"))
    assert said(model, "6060h").taken == "8"
    drive = Drive(model.folder)
    drive.cycle(0.0)
    assert drive.axis.od.modes_of_operation == drive.axis.od.modes_of_operation_display == 8
    with pytest.raises(SdoAbort):
        drive.read(0x6060)


def test_a_variable_of_the_profile_with_sub_indices_is_another_object(made):
    """Drives of two axes have left and right there; the count is no position."""
    rows = ["6064 0 5 ro 0 DefaultValue=2", "6064 1 4 ro 1", "6064 2 4 ro 1"]
    model = made(sheet(SMALL.replace("6064 . 4 ro 1\n", ""), *rows))
    assert "variable" in said(model, "6064h:00h").why
    drive = Drive(model.folder)
    drive.axis.od.position_actual_value = 77
    assert [drive.read(0x6064, n) for n in range(3)] == [2, 0, 0]
    for index in ("6040", "6041"):
        text = sheet(SMALL.replace(f"{index} . 6", f"{index} 1 6"))
        with pytest.raises(ValueError, match=f"{index}h is missing"):
            made(text)


def test_a_manufacturers_object_is_not_taken_for_one_of_ours(made):
    """2010h:01 is a gain of `generic` and something else in every other drive."""
    model = made(sheet(SMALL, "2010 0 5 const 0 DefaultValue=1", "2010 1 6 rw 0 DefaultValue=3"))
    assert Drive(model.folder).model.objects[0x2010, 1].note.startswith("unknown")


def test_what_canopen_reads_we_read_alike(tmp_path, made):
    rows = [f"{0x2000 + n:04X} . {n + 2} rw 0 DefaultValue={n}" for n in range(5)]
    text = sheet(SMALL, *rows)
    model = made(text)
    theirs = canopen.import_od(str(tmp_path / "drive.eds"))
    drive = Drive(model.folder)
    for n in range(5):
        assert drive.read(0x2000 + n) == theirs[0x2000 + n].default == n


def test_strict_lists_each_departure_with_its_line(tmp_path, capsys):
    file, folder = tmp_path / "drive.eds", tmp_path / "mine"
    file.write_text(sheet(SMALL, "6076 . 7 rw 0 DefaultValue=0", "2002 . 5 rw 0 DefaultValue=300"))
    assert main(["drives", "--from-eds", str(file), "-o", str(folder), "--strict"]) == 2
    told = capsys.readouterr().err
    assert re.search(r"line \d+, 6076h:00h: default 0; used: 1270", told)
    assert re.search(r"line \d+, 2002h:00h: default value 300; used: 255", told)
    assert "2 departures from CiA 306" in told
    assert not folder.exists()
    file.write_text(sheet())
    assert main(["drives", "--from-eds", str(file), "-o", str(folder), "--strict"]) == 0
    assert "0 repairs" in capsys.readouterr().out


def test_a_value_of_a_megabyte_is_cut_and_told(made):
    model = made(sheet(SMALL, f"2001 . 9 ro 0 DefaultValue={'x' * 1_000_000}"))
    assert "1000000 characters" in said(model, "[2001]").says
    assert len(Drive(model.folder).read(0x2001)) == 4096


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (b"hello world\n" * 10, "line 1: no section of an object"),
        (b"", "line 1: no section of an object"),
        (b"[1000]\n\0\0", "line 2: it is binary"),
        (b"\x7fELF\2\1\1\0", "line 1: it is binary"),
        (sheet().replace("[6040]", "[604]").encode(), r"line \d+: 6040h is listed"),
    ],
)
def test_what_is_no_eds_is_refused_with_file_and_line(tmp_path, data, reason):
    file = tmp_path / "bad.eds"
    file.write_bytes(data)
    with pytest.raises(ValueError, match=f"bad.eds, {reason}") as refusal:
        import_eds(file, tmp_path / "mine")
    assert "\n" not in str(refusal.value)


def test_a_hundred_megabytes_are_not_read(tmp_path):
    file = tmp_path / "big.eds"
    with file.open("wb") as big:
        big.truncate(100 * 2**20)
    with pytest.raises(ValueError, match="an EDS has at most"):
        import_eds(file, tmp_path / "mine")


def test_half_a_file_is_refused_or_its_missing_objects_are_told(tmp_path):
    text = sheet()
    for n, at in enumerate(range(200, len(text), 150)):
        file = tmp_path / "half.eds"
        file.write_text(text[:at])
        try:
            model = import_eds(file, tmp_path / f"mine{n}")
        except ValueError as error:
            refused = str(error)
        else:
            refused, there = "", {index for index, _ in read_sheet(file).entries}
            gone = {index for index, _ in read_sheet_of(text, tmp_path).entries} - there
            assert {f"{index:04X}h" for index in gone} <= {r.where[:5] for r in model.repairs}
        assert not refused or re.search(r"half.eds, line \d+", refused)


def read_sheet_of(text, tmp_path):
    file = tmp_path / "whole.eds"
    file.write_text(text)
    return read_sheet(file)


# --------------------------------------------------------------- commissioned and moved

OWN_UNITS = {
    "increments of a coarse encoder": [
        "608F 1 7 ro 0 DefaultValue=10000", "608F 2 7 ro 0 DefaultValue=1"],
    "a feed constant that cannot be written": [
        "6092 1 7 ro 0 DefaultValue=3600", "6092 2 7 ro 0 DefaultValue=1"],
    "a gear ratio of its own": ["6091 1 7 rw 0 DefaultValue=10", "6091 2 7 rw 0 DefaultValue=1"],
    "a range of the profile velocity": [
        "607F . 7 rw 0 DefaultValue=500|LowLimit=1|HighLimit=600000"],
    "accelerations limited as the maker left them": [
        "60C5 . 7 rw 0 DefaultValue=200", "60C6 . 7 rw 0 DefaultValue=200"],
    "a read-only homing method": [],
}


@pytest.mark.parametrize("kind", OWN_UNITS)
def test_commissioning_works_in_the_drives_own_units_and_ranges(made, kind):
    text = sheet(SMALL, *OWN_UNITS[kind])
    if kind == "a read-only homing method":
        text = re.sub(r"(\[6098\]\n(?:.*\n){3})AccessType=rw", r"\1AccessType=ro", text)
    machine = linear_axis(made(text).folder)
    drive = machine.drives["x"]
    machine.step()
    unit = float(drive.axis.rad_per_position_unit) / float(machine.couplings[0].gear)
    speed = float(drive.axis.profile_speed) / float(machine.couplings[0].gear)
    assert 0.03 < speed <= 1.01, "m/s, whatever the units are"
    for word in (0x06, 0x07, 0x0F):
        drive.write("controlword", word)
        machine.step(50)
    drive.axis.homed = 1
    drive.write("modes_of_operation", 1)
    machine.step(10)
    here, begin = drive.read("position_actual_value"), float(machine.data.qpos[0])
    drive.write("target_position", here + round(0.1 / unit))
    drive.write("controlword", 0x1F)
    for _ in range(40):
        machine.step(200)
    assert float(machine.data.qpos[0]) - begin == pytest.approx(0.1, abs=abs(unit) + 2e-4)


MACHINES = {
    "rotary": (rotary_axis, "x", 0.5),
    "conveyor": (partial(rotary_axis, mechanics="conveyor"), "x", 0.1),
    "gantry": (gantry, "y", 0.1),
    "gantry with two drives in X": (partial(gantry, x_drives=2), "y", 0.1),
    "MJCF": (None, "x", 0.1),
}
SLIDE = """<mujoco><option timestep="0.00025"/><worldbody><body><joint name="x" type="slide"
axis="1 0 0" range="-0.5 0.5" limited="true"/><geom size="0.05" mass="2"/></body></worldbody>
<actuator><motor name="x" joint="x" gear="100"/></actuator></mujoco>"""


def machine_of(kind, model):
    build, name, _ = MACHINES[kind]
    if build is not None:
        return build(model)
    machine = Machine.from_mjcf(SLIDE, {name: model})
    machine.reset()
    commission_joint(machine, name)
    return machine


@pytest.mark.parametrize("machine_kind", MACHINES)
@pytest.mark.parametrize("kind", [kind for kind in OWN_UNITS if "homing" not in kind])
def test_every_machine_is_commissioned_in_the_drives_own_units(made, kind, machine_kind):
    machine = machine_of(machine_kind, made(sheet(SMALL, *OWN_UNITS[kind])).folder)
    _, name, way = MACHINES[machine_kind]
    drive = machine.drives[name]
    coupling = machine.couplings[list(machine.drives).index(name)]
    machine.step()
    unit = abs(float(drive.axis.rad_per_position_unit) / float(coupling.gear))
    speed = abs(float(drive.axis.profile_speed) / float(coupling.gear))
    for word in (0x06, 0x07, 0x0F):
        drive.write("controlword", word)
        machine.step(50)
    assert drive.read("statusword") & 0x6F == 0x27, drive.describe()
    drive.axis.homed = 1
    drive.write("modes_of_operation", 1)
    machine.step(10)
    here, begin = drive.read("position_actual_value"), float(machine.data.qpos[coupling.qpos])
    drive.write("target_position", here + round(way / unit))
    drive.write("controlword", 0x1F)
    for _ in range(100):
        machine.step(200)
        if drive.read("statusword") & 0x1400 == 0x1400:
            break
    went = float(machine.data.qpos[coupling.qpos]) - begin
    assert went == pytest.approx(way, abs=unit + 2e-3 * way), drive.describe()
    assert speed > 0.02 * way, "it does not take minutes"


FACTOR_OF_1 = ["6096 1 7 rw 0 DefaultValue=1", "6096 2 7 rw 0 DefaultValue=1"]


@pytest.mark.parametrize("rows", [[], FACTOR_OF_1], ids=["", "with 6096h = 1"])
@pytest.mark.parametrize(("unit", "per_minute"), [("0x00B44700", 1.0), ("0xFDB44700", 1e-3)])
def test_a_velocity_unit_of_revolutions_per_minute_is_that(made, unit, per_minute, rows):
    """60A9h of drives whose speeds are in 1/min; the position unit is still an increment."""
    machine = linear_axis(made(sheet(SMALL, f"60A9 . 7 rw 0 DefaultValue={unit}", *rows)).folder)
    machine.step()
    drive = machine.drives["x"]
    assert float(drive.axis.rad_s_per_velocity_unit) == pytest.approx(per_minute * 2 * math.pi / 60)
    gear = float(machine.couplings[0].gear)
    shown = drive.read("profile_velocity") * per_minute / 60 * 2 * math.pi / gear
    assert 0.03 < shown <= 1.01, "m/s"
    assert shown == pytest.approx(float(drive.axis.profile_speed) / gear, rel=0.01)


def test_a_drive_of_many_departures_is_enabled_homed_and_moved_by_a_foreign_master(tmp_path):
    rows = [row for rows in OWN_UNITS.values() for row in rows[:1]] + [
        case[0] for case in DEFAULTS[:6]
    ]
    seen, kept = set(), []
    for row in rows:
        if (address := tuple(row.split()[:2])) not in seen:
            seen.add(address)
            kept.append(row)
    file = tmp_path / "many.eds"
    file.write_text(sheet(SMALL, *kept))
    for attempt in range(4):  # in real time, and the library's homing may look too early
        folder = tmp_path / str(attempt)
        folder.mkdir()
        found = outcome(file, folder)
        if found.moved == "100 mm":
            break
    assert (found.imported, found.started, found.enabled, found.moved) == (
        "yes",
        "yes",
        "yes",
        "100 mm",
    )
    assert found.repairs > 5
    assert found.homed.startswith("method")


def test_a_dcf_with_sync_pdos_is_moved_by_what_its_rpdo_carries_as_the_page_says(tmp_path):
    """`canopen.BaseNode402`: a target written by SDO gives way to that of the periodic RPDO."""
    pdos = {
        "1400 2 5 rw 0 DefaultValue=255": "1400 2 5 rw 0 DefaultValue=1",
        "1800 2 5 rw 0 DefaultValue=255": "1800 2 5 rw 0 DefaultValue=1",
        "1600 0 5 rw 0 DefaultValue=1": "1600 0 5 rw 0 DefaultValue=2",
        "0x60400010": "0x60400010\n1600 2 7 rw 0 DefaultValue=0x607A0020",
    }
    rows = SMALL
    for old, new in pdos.items():
        assert old in rows
        rows = rows.replace(old, new)
    file = tmp_path / "sync.dcf"
    file.write_text(sheet(rows) + "\n[DeviceComissioning]\nNodeID=5\nBaudrate=500\n")
    made = import_eds(file, tmp_path / "model")
    bus = can.Bus(interface="virtual", channel="foreign-sync")
    server = Server(bus, [axis_for(str(made.folder), made.node_id)])
    thread = threading.Thread(target=server.run)
    thread.start()
    network = canopen.Network()
    network.NOTIFIER_CYCLE = 0.05
    network.connect(interface="virtual", channel="foreign-sync")
    try:
        node = BaseNode402(5, object_dictionary(made.folder, 5))
        network.add_node(node)
        node.sdo.RESPONSE_TIMEOUT = node.TIMEOUT_CHECK_TPDO = 10.0
        node.TIMEOUT_SWITCH_STATE_SINGLE = node.TIMEOUT_SWITCH_STATE_FINAL = 10.0
        node.nmt.state = "PRE-OPERATIONAL"
        node.setup_402_state_machine()
        node.nmt.state = "OPERATIONAL"
        network.sync.start(0.01)
        node.rpdo[1].start(0.01)
        node.op_mode = "PROFILED POSITION"
        node.state = "OPERATION ENABLED"
        target = node.sdo[0x6064].raw + 20_000
        node.sdo[0x607A].raw = target
        until(lambda: node.sdo[0x607A].raw == 0)
        node.rpdo_pointers[0x607A].raw = target
        until(lambda: node.sdo[0x607A].raw == target)
        node.controlword = 0x1F
        until(lambda: abs(node.sdo[0x6064].raw - target) < 20)
    finally:
        network.sync.stop()
        network.disconnect()
        server.stop()
        thread.join(10)
        bus.shutdown()


def test_the_repairs_of_a_model_are_a_table_that_lists_each(made):
    model = made(sheet(SMALL, *[case[0] for case in DEFAULTS]))
    page = (model.folder / "README.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| \d* \|.*\|$", page, re.M)
    assert len(rows) == len(model.repairs)
    with (model.folder / "objects.csv").open(encoding="utf-8") as file:
        assert sum(1 for _ in csv.reader(file)) == model.objects + 1


def test_reserved_entries_and_read_only_objects_answer_with_the_protocol(made):
    drive = Drive(made(sheet(SMALL, "1800 4 5 rw 0", "6041 . 6 rw 1")).folder)
    drive.write(0x1800, 4, 3)
    assert drive.read(0x1800, 4) == 3
    with pytest.raises(SdoAbort) as refusal:
        drive.write("statusword", 1)
    assert refusal.value.code == Abort.READ_ONLY


assert Path(__file__).with_name("foreign_eds.py").is_file()
