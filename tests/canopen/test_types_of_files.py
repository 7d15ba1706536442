"""Data sheets whose objects have other types than CiA 402's: the same numbers in other lengths.

Trinamic has 6071h as INTEGER32, others 6040h as UNSIGNED32 or 6065h as UNSIGNED16. The oracle is
the number itself, packed by `struct` in the type of the file, and an unmodified foreign master.
"""

import re
import struct

import pytest
from foreign_eds import outcome
from test_foreign_eds import SMALL, sheet

from servogym.drive.drive import Drive
from servogym.drive.imports.eds import import_eds
from servogym.drive.objects.abort import Abort

# data type of CiA 301 -> name, format
TYPES = {2: ("INTEGER8", "b"), 3: ("INTEGER16", "h"), 4: ("INTEGER32", "i"),
         5: ("UNSIGNED8", "B"), 6: ("UNSIGNED16", "H"), 7: ("UNSIGNED32", "I")}
# object, its field of the record, and the format that it has there
WRITTEN = {
    0x6040: ("controlword", "H"), 0x6060: ("modes_of_operation", "b"),
    0x6071: ("target_torque", "h"), 0x6072: ("max_torque", "H"),
    0x6081: ("profile_velocity", "I"), 0x607A: ("target_position", "i"),
    0x6065: ("following_error_window", "I"),
}
READ = {0x6041: ("statusword", "H"), 0x6077: ("torque_actual_value", "h"),
        0x6064: ("position_actual_value", "i"), 0x606C: ("velocity_actual_value", "i")}
BASE = "\n".join(row for row in SMALL.strip().splitlines() if not row.startswith("60"))
OTHERS = {0x6061: 2, 0x6098: 2}


def limits(code):
    bits = 8 * struct.calcsize(code)
    return (-1 << bits - 1, (1 << bits - 1) - 1) if code.islower() else (0, (1 << bits) - 1)


@pytest.fixture(params=TYPES, ids=lambda code: TYPES[code][0])
def typed(request, tmp_path):
    """A drive whose objects all have one type, and the format of it."""
    kinds = OTHERS | dict.fromkeys((*WRITTEN, *READ), request.param)
    rows = [f"{index:04X} . {kind} {'ro' if index in READ else 'rww'} 1"
            for index, kind in kinds.items()]
    text = sheet(BASE, *rows)
    for entry in ("60400010", "60410010"):
        text = text.replace(entry, f"{entry[:6]}{8 * struct.calcsize(TYPES[request.param][1]):02X}")
    (tmp_path / "drive.eds").write_text(text)
    made = import_eds(tmp_path / "drive.eds", tmp_path / "model")
    assert not [repair for repair in made.repairs if "keeps what is written" in repair.taken]
    return Drive(made.folder), TYPES[request.param][1]


def test_what_a_master_writes_is_the_number_in_the_drive(typed):
    drive, code = typed
    for index, (field, own) in WRITTEN.items():
        row = drive.model.objects[index, 0]
        drive.map_pdos(rpdos=[[row.name]])
        least, most = max(limits(own)[0], limits(code)[0]), min(limits(own)[1], limits(code)[1])
        same_bytes = struct.calcsize(own) == struct.calcsize(code)
        for value in (0, 1, 7, -5, 100, 127, -128, 200, 30000, 70000, least, most):
            if not limits(code)[0] <= value <= limits(code)[1]:
                continue
            data = struct.pack(f"<{code}", value)
            before = int(getattr(drive.axis.od, field))
            drive.latch(data)
            if same_bytes:
                (expected,) = struct.unpack(f"<{own}", data)
            else:
                expected = value if least <= value <= most else before
            assert int(getattr(drive.axis.od, field)) == expected, row.name
            if row.hook:  # what it does is tested elsewhere
                continue
            abort = drive.objects.write(index, 0, data)
            if row.minimum <= value <= row.maximum:
                assert abort is Abort.NONE
                assert drive.objects.read(index, 0) == (data, abort)
            else:
                assert abort in (Abort.VALUE_TOO_HIGH, Abort.VALUE_TOO_LOW)


def test_what_a_master_reads_is_the_number_of_the_drive(typed):
    drive, code = typed
    size = struct.calcsize(code)
    for index, (field, own) in READ.items():
        drive.map_pdos(tpdos=[[drive.model.objects[index, 0].name]])
        for value in (0, 5, -5, 127, -129, 30000, -30000, 70000, *limits(own)):
            if not limits(own)[0] <= value <= limits(own)[1]:
                continue
            setattr(drive.axis.od, field, value)
            expected = (value % (1 << 8 * size)).to_bytes(size, "little")  # its lower bytes
            assert drive.objects.read(index, 0) == (expected, Abort.NONE)
            assert drive.collect() == expected


WIDE = {0x6040: 7, 0x6041: 7, 0x6060: 4, 0x6061: 4, 0x6071: 4, 0x6072: 7, 0x6077: 4, 0x6098: 4}
NARROW = {0x6041: 6, 0x6065: 6, 0x6081: 6, 0x6083: 6, 0x6071: 2}
OTHER_SIGN = {0x6040: 3, 0x6041: 3, 0x6060: 5, 0x6061: 5, 0x6081: 4}


@pytest.mark.parametrize("types", [WIDE, NARROW, OTHER_SIGN], ids=["wide", "narrow", "sign"])
def test_a_foreign_master_enables_homes_and_moves_it(tmp_path, types):
    text = SMALL
    for index, code in types.items():
        text, count = re.subn(rf"(?m)^{index:04X} \. \d", f"{index:04X} . {code}", text)
        if not count:
            access = "ro" if index == 0x6077 else "rww"
            text += f"{index:04X} . {code} {access} 1\n"
        bits = 8 * struct.calcsize(TYPES[code][1])
        text = re.sub(rf"0x{index:04X}00\d\d", f"0x{index:04X}00{bits:02X}", text)
    (tmp_path / "drive.eds").write_text(sheet(text))
    found = outcome(tmp_path / "drive.eds", tmp_path)
    assert (found.imported, found.started, found.enabled) == ("yes", "yes", "yes")
    assert found.homed.startswith("method")
    assert found.moved == "100 mm"


FLOATS_AND_LONG = {"REAL32": (0x08, "f", -1.5), "REAL64": (0x11, "d", 2.5e-300),
                   "INTEGER64": (0x15, "q", -(1 << 40)), "UNSIGNED64": (0x1B, "Q", 1 << 63)}


@pytest.mark.parametrize("name", FLOATS_AND_LONG)
def test_a_mapped_object_carries_its_bytes_both_ways(tmp_path, name):
    """Reals and 64 bits: PDO in is SDO out, and the other way round."""
    code, form, value = FLOATS_AND_LONG[name]
    data = struct.pack(f"<{form}", value)
    rows = [f"2001 . {code:#x} rww 1", f"2002 . {code:#x} rwr 1"]
    text = sheet(SMALL, *rows).replace("60400010", f"200100{8 * len(data):02X}")
    (tmp_path / "drive.eds").write_text(text.replace("60410010", f"200200{8 * len(data):02X}"))
    made = import_eds(tmp_path / "drive.eds", tmp_path / "model")
    assert made.repairs == ()
    drive = Drive(made.folder)
    assert (drive.rpdo_size, drive.tpdo_size) == (len(data), len(data))
    drive.latch(data)
    assert drive.objects.read(0x2001, 0) == (data, Abort.NONE)
    assert drive.objects.write(0x2002, 0, data) is Abort.NONE
    assert drive.collect() == data


@pytest.mark.parametrize("default", ["-3", "200", "-2147483648", "0xFFFFFFFF"])
@pytest.mark.parametrize("kind", TYPES)
def test_any_default_in_any_type_becomes_a_value_of_the_drive(tmp_path, kind, default):
    kinds = OTHERS | dict.fromkeys((*WRITTEN, *READ), kind)
    rows = [f"{index:04X} . {number} {'ro' if index in READ else 'rww'} 1 DefaultValue={default}"
            for index, number in kinds.items()]
    (tmp_path / "drive.eds").write_text(sheet(BASE, *rows))
    drive = Drive(import_eds(tmp_path / "drive.eds", tmp_path / "model").folder)
    for index, (_, own) in (WRITTEN | READ).items():
        least, most = limits(own)
        assert least <= drive.model.objects[index, 0].default <= most or (
            struct.calcsize(own) == struct.calcsize(TYPES[kind][1]))
