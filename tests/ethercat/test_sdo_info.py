"""SDO information: ETG.1000.6, 5.6.3; tables 43-49."""

import struct

import pytest
from canopen.objectdictionary import datatypes
from wired import P, Wired

from servogym.drive.ethercat import esi
from servogym.drive.ethercat.esi_reader import read_esi
from servogym.drive.ethercat.mailbox import Kind
from servogym.drive.model.rows import DATA_TYPES, FORMATS, OBJECT_COLUMNS
from servogym.drive.objects.mapping import described


@pytest.fixture(scope="module")
def slave():
    return Wired("generic").to(P)


def information(slave, opcode, data):
    """All fragments of an answer, put together: opcode and content."""
    assert slave.send(Kind.COE, struct.pack("<HBxH", 0x8000, opcode, 0) + data) == 1
    content, left = b"", None
    while left != 0:
        kind, body = slave.fetch()
        service, answer, fragments = struct.unpack_from("<HBxH", body)
        assert (kind, service) == (Kind.COE, 0x8000)
        assert bool(answer & 0x80) == (fragments > 0), "incomplete while fragments follow"
        assert left is None or fragments == left - 1
        left = fragments
        content += body[6:]
    assert slave.fetch() is None
    return answer & 0x7F, content


def words(content):
    return [word for (word,) in struct.iter_unpack("<H", content)]


def test_27_the_lists_name_the_objects_that_belong_to_them(slave):
    rows = described(slave.drive.model)
    wanted = {
        1: {row.index for row in rows},
        2: {row.index for row in rows if "rx" in row.pdo},
        3: {row.index for row in rows if "tx" in row.pdo},
        4: {row.index for row in rows if row.storable},
        5: {row.index for row in rows if row.storable and row.index < 0x2000},
    }
    for number, indices in wanted.items():
        opcode, content = information(slave, 1, struct.pack("<H", number))
        assert (opcode, words(content)) == (2, [number, *sorted(indices)])
    opcode, content = information(slave, 1, bytes(2))
    assert words(content) == [0, *(len(indices) for indices in wanted.values())]


def test_a_long_list_comes_in_fragments():
    slave = Wired("generic", mailbox=(64, 64)).to(P)
    _, content = information(slave, 1, struct.pack("<H", 1))
    assert words(content)[1:] == sorted({row.index for row in described(slave.drive.model)})


# object -> data type, highest sub-index, object code (7 VAR, 8 ARRAY, 9 RECORD), name
OBJECTS = {
    0x1000: (0x0007, 0, 7, "device_type"),
    0x1008: (0x0009, 0, 7, "manufacturer_device_name"),
    0x1018: (0x0023, 4, 9, "identity_object"),
    0x1600: (0x0021, 16, 9, "rpdo1"),
    0x1C00: (0x0005, 4, 8, "sync_manager_types"),
    0x1C12: (0x0006, 4, 8, "sync_manager_2_number_of_assigned_pdos"),
    0x1C32: (0x0029, 0x20, 9, "output_synchronisation"),
    0x6041: (0x0006, 0, 7, "statusword"),
}


@pytest.mark.parametrize("index", OBJECTS, ids="{:04X}h".format)
def test_an_object_tells_type_entries_code_and_name(slave, index):
    data_type, last, code, name = OBJECTS[index]
    opcode, content = information(slave, 3, struct.pack("<H", index))
    assert opcode == 4
    assert struct.unpack_from("<HHBB", content) == (index, data_type, last, code)
    assert content[6:].decode() == name


ACCESS = {"ro": 0x0007, "const": 0x0007, "rw": 0x003F, "wo": 0x0038}
MAPPABLE = {"": 0, "rx": 0x0040, "tx": 0x0080, "rxtx": 0x00C0}


def test_27_every_entry_tells_the_type_bits_access_and_name_of_its_row(slave):
    for row in described(slave.drive.model):
        opcode, content = information(slave, 5, struct.pack("<HBB", row.index, row.subindex, 0))
        assert opcode == 6
        index, subindex, given, data_type, bits, access = struct.unpack_from("<HBBHHH", content)
        assert (index, subindex, given) == (row.index, row.subindex, 0)
        assert data_type == DATA_TYPES[row.data_type]
        size = 1 if row.data_type == "BOOLEAN" else 8 * (row.size or len(str(row.default)))
        assert bits == size
        stored = 0x0100 if row.storable else 0
        assert access == ACCESS[row.access] | MAPPABLE[row.pdo] | stored, row.name
        assert content[10:].decode() == row.name


def test_an_entry_tells_default_and_limits_where_they_are_asked_for(slave):
    ask = struct.pack("<HBB", 0x605A, 0, 0x78)  # unit, default, minimum, maximum
    _, content = information(slave, 5, ask)
    row = next(row for row in described(slave.drive.model) if row.index == 0x605A)
    assert content[3] == 0x70, "a unit has no number here"
    values = struct.pack("<hhh", int(row.default), int(row.minimum), int(row.maximum))
    assert content[10:] == values + b"quick_stop_option_code"


@pytest.mark.parametrize(
    ("opcode", "data", "code"),
    [
        (1, struct.pack("<H", 6), 0x06090030),
        (3, struct.pack("<H", 0x5FFF), 0x06020000),
        (5, struct.pack("<HBB", 0x5FFF, 0, 0), 0x06020000),
        (5, struct.pack("<HBB", 0x1018, 9, 0), 0x06090011),
        (9, bytes(4), 0x05040001),
    ],
)
def test_what_is_not_there_is_an_information_error(slave, opcode, data, code):
    assert information(slave, opcode, data) == (7, struct.pack("<I", code))


@pytest.mark.parametrize("model", ["kollmorgen_akd", "festo_cmmp_as"])
def test_27_models_whose_coe_details_do_not_offer_it_refuse_it(model):
    slave = Wired(model).to(P)
    assert not slave.data.coe_details & 0x02
    request = struct.pack("<HBxHH", 0x8000, 1, 0, 1)
    assert slave.ask(Kind.COE, request) == (Kind.ERROR, struct.pack("<HH", 1, 4))


NUMBERS = {"BOOLEAN": "1", "REAL32": "1.5", "REAL64": "2.5e-300"}


def test_objects_of_every_type_describe_themselves_and_are_read_back_from_an_esi(tmp_path):
    folder = tmp_path / "typed"
    folder.mkdir()
    (folder / "drive.toml").write_text('based_on = "generic"\ntitle = "Typed"\n')
    rows = [
        f"0x{0x2F00 + n:04X},0x00,own_{n},VAR,{name},rw,,,,,"
        f"{'text' if name.endswith('STRING') or name == 'DOMAIN' else NUMBERS.get(name, '7')},,own,"
        ",,,\n" for n, name in enumerate(FORMATS)
    ]
    (folder / "objects.csv").write_text(",".join(OBJECT_COLUMNS) + "\n" + "".join(rows))
    slave = Wired(str(folder)).to(P)
    model = slave.drive.model
    (tmp_path / "typed.xml").write_text(esi.write(esi.of_model(model)), encoding="utf-8")
    read = {row.index: row for row in read_esi(tmp_path / "typed.xml").objects}
    for n, name in enumerate(FORMATS):
        row = model.objects[0x2F00 + n, 0]
        ask = struct.pack("<HBB", row.index, 0, 0x10)  # its default
        opcode, content = information(slave, 5, ask)
        assert opcode == 6, name
        _, _, given, number, bits, _ = struct.unpack_from("<HBBHHH", content)
        default = row.initial if not row.format else row.code.pack(row.default)
        assert number == getattr(datatypes, name, number), "as the library canopen numbers it"
        assert (given, bits) == (0x10, 1 if name == "BOOLEAN" else 8 * len(default)), name
        assert content[10:] == default + row.name.encode()
        if not name.endswith("STRING"):  # which the reader keeps as text or bytes
            assert read[row.index].data_type == number, name
