"""CoE through the slave controller: SDO, complete access, emergencies. ETG.1000.6, 5.6."""

import dataclasses
import random
import shutil
import struct

import pytest
from wired import B, I, O, P, S, Wired

from servogym.drive.ethercat.mailbox import Kind
from servogym.drive.model.model import load
from servogym.drive.objects.mapping import described


@pytest.fixture
def slave():
    return Wired("generic").to(P)


@pytest.fixture
def akd():
    return Wired("kollmorgen_akd").to(P)


# request: CoE header, command, index, sub-index, data -> answer; ETG.1000.6, tables 29-40
DIALOGUES = [
    # expedited upload of 4, 2 and 1 bytes: 43h, 4Bh, 4Fh
    ("0020 40 1810 02 00000000", "0030 43 1810 02 02040000"),
    ("0020 40 4160 00 00000000", "0030 4b 4160 00 50020000"),
    ("0020 40 1810 00 00000000", "0030 4f 1810 00 04000000"),
    # expedited download: 2Fh, 2Bh, 23h -> 60h
    ("0020 2f 6060 00 08000000", "0030 60 6060 00 00000000"),
    ("0020 2b 6560 00 00000000", "0020 80 6560 00 13000706"),  # 2 bytes into UNSIGNED32
    ("0020 23 6560 00 e8030000", "0030 60 6560 00 00000000"),
    ("0020 22 6560 00 e8030000", "0030 60 6560 00 00000000"),  # without a size: that of the object
    # normal download of 4 bytes
    ("0020 21 6560 00 04000000 e8030000", "0030 60 6560 00 00000000"),
    # aborts are SDO requests with 80h
    ("0020 2b 4160 00 00000000", "0020 80 4160 00 02000106"),  # read only
    ("0020 40 ff5f 00 00000000", "0020 80 ff5f 00 00000206"),  # no such object
    ("0020 40 1810 05 00000000", "0020 80 1810 05 11000906"),  # no such sub-index
    ("0020 2f 6060 00 63000000", "0020 80 6060 00 30000906"),  # no such mode
    ("0020 2f 6060 00 63000000", "0020 80 6060 00 30000906"),
    ("0020 23 6060 00 01000000", "0020 80 6060 00 12000706"),  # too long
    ("0020 e0 6060 00 00000000", "0020 80 6060 00 01000405"),  # unknown command
    ("0020 60 0000 00 00000000", "0020 80 0000 00 01000405"),  # a segment of nothing
    ("0020 00 0000 00 00000000", "0020 80 0000 00 01000405"),
]


@pytest.mark.parametrize(("request_", "answer"), DIALOGUES)
def test_a_sdo_request_has_the_bytes_of_the_standard(slave, request_, answer):
    got = slave.ask(Kind.COE, bytes.fromhex(request_))
    assert got == (Kind.COE, bytes.fromhex(answer))


def test_23_a_name_is_read_in_a_normal_transfer(akd):
    assert akd.upload(0x1008) == b"AKD-P00606-NBCC-E000"
    reply, data = akd.sdo(0x40, 0x1008)
    assert (reply, data[:4]) == (0x41, struct.pack("<I", 20)), "the complete size, and the text"


@pytest.fixture(scope="module")
def long_model(tmp_path_factory):
    """A generic drive whose name has 2,000 characters."""
    folder = tmp_path_factory.mktemp("models") / "long_name"
    shutil.copytree(load("generic").folder, folder)
    path = folder / "objects.csv"
    text = path.read_text(encoding="utf-8")
    path.write_text(text.replace("servogym generic CiA 402 drive", NAME), encoding="utf-8")
    return folder


NAME = "".join(chr(ord("a") + n % 26) for n in range(2000))


@pytest.mark.parametrize("size", [34, 35, 64, 256])
def test_23_an_object_of_2_kb_comes_in_segments_that_fill_the_mailbox(long_model, size):
    slave = Wired(long_model, mailbox=(size, size)).to(P)
    assert slave.upload(0x1008) == NAME.encode()


def test_23_a_toggle_error_ends_the_transfer(long_model):
    slave = Wired(long_model, mailbox=(64, 64)).to(P)
    slave.sdo(0x40, 0x1008)
    assert slave.segment_request(0x60)[0] & 0xF0 == 0x00
    _, answer = slave.ask(Kind.COE, bytes.fromhex("0020 60 0000 00 00000000"))
    assert answer == bytes.fromhex("0020 80 0810 00 00000305")
    _kind, answer = slave.ask(Kind.COE, bytes.fromhex("0020 70 0000 00 00000000"))
    assert answer[2] == 0x80, "there is no transfer any more"


def test_an_abort_of_the_master_ends_the_transfer_without_an_answer(long_model):
    slave = Wired(long_model, mailbox=(64, 64)).to(P)
    slave.sdo(0x40, 0x1008)
    assert slave.send(Kind.COE, bytes.fromhex("0020 80 0810 00 00000008")) == 1
    assert slave.fetch() is None
    assert slave.ask(Kind.COE, bytes.fromhex("0020 60 0000 00 00000000"))[1][2] == 0x80


def test_24_a_segmented_download_arrives_whole():
    slave = Wired("generic", mailbox=(34, 34)).to(P)
    entries = struct.pack("<BxII", 2, 0x60400010, 0x607A0020)
    whole = entries + bytes(4 * 14)
    assert slave.write8(0x1C12, 0, 0) == 0
    assert slave.download(0x1600, 0, whole[:10], complete=True) == 0
    assert slave.upload(0x1600, complete=True)[:10] == entries
    assert slave.download(0x1600, 0, entries + bytes(32), complete=True) == 0


@pytest.mark.parametrize(("size", "code"), [(0, 0x06070013), (3, 0x06070013), (5, 0x06070012)])
def test_24_a_download_of_a_wrong_size_says_so(slave, size, code):
    before = slave.upload(0x6065)
    assert slave.download(0x6065, 0, bytes(size), normal=True) == code
    assert slave.upload(0x6065) == before


def test_a_segmented_download_of_another_size_than_announced_is_refused():
    slave = Wired("generic", mailbox=(34, 34)).to(P)
    head = struct.pack("<I", 40) + bytes(18)
    assert slave.sdo(0x21, 0x6065, 0, head)[0] == 0x60
    reply, rest = slave.segment_request(0x01, bytes(7))
    assert (reply, rest[3:]) == (0x80, struct.pack("<I", 0x06070013))
    slave.sdo(0x21, 0x6065, 0, head)
    reply, rest = slave.segment_request(0x00, bytes(25))
    assert (reply, rest[3:7]) == (0x80, struct.pack("<I", 0x06070012))


def test_24_a_download_too_long_for_any_object_is_refused_at_once(slave):
    assert slave.sdo(0x21, 0x6065, 0, struct.pack("<I", 1 << 20))[0] == 0x80
    assert slave.sdo(0x21, 0x6041, 0, struct.pack("<I", 300))[0] == 0x80, "read only"


# ------------------------------------------------------------------ complete access


def test_25_complete_access_reads_sub_index_0_in_16_bits(slave):
    assert slave.upload(0x1018, complete=True) == struct.pack("<BxIIII", 4, 0, 0x402, 0x10000, 1)
    assert slave.upload(0x1018, 1, complete=True) == struct.pack("<IIII", 0, 0x402, 0x10000, 1)
    assert slave.upload(0x1C12, complete=True) == struct.pack("<BxH", 1, 0x1600)


def test_25_complete_access_writes_an_assignment_as_a_whole(slave):
    assert slave.download(0x1C12, 0, struct.pack("<BxHH", 2, 0x1600, 0x1601), complete=True) == 0
    assert slave.upload(0x1C12, complete=True) == struct.pack("<BxHH", 2, 0x1600, 0x1601)
    assert slave.drive.rpdo_size == 14


@pytest.mark.parametrize(
    ("data", "code"),
    [
        (struct.pack("<BxH", 1, 0x1699), 0x06090030),  # no such PDO
        (struct.pack("<BxHH", 2, 0x1601, 0x1600), 0x06040043),  # not in their order
        (struct.pack("<BxH", 2, 0x1600), 0x06070013),  # one is missing
        (struct.pack("<BxHB", 1, 0x1600, 0), 0x06070013),  # half of one
        (struct.pack("<Bx6H", 4, *[0x1600] * 6), 0x06070012),
    ],
)
def test_a_refused_complete_access_leaves_all_as_it_was(slave, data, code):
    before = slave.upload(0x1C12, complete=True)
    assert slave.download(0x1C12, 0, data, complete=True) == code
    assert slave.upload(0x1C12, complete=True) == before
    assert slave.drive.rpdo_size == 7


@pytest.mark.parametrize(
    ("index", "subindex", "code"),
    [(0x6065, 0, 0x06010000), (0x1018, 2, 0x06010000), (0x5FFF, 0, 0x06020000)],
)
def test_complete_access_is_for_objects_with_entries(slave, index, subindex, code):
    assert slave.upload(index, subindex, complete=True) == code


def test_complete_access_passes_over_what_is_read_only(slave):
    before = slave.upload(0x60C1, complete=True)
    assert slave.download(0x60C1, 0, before, complete=True) == 0
    assert slave.download(0x1018, 0, bytes(18), complete=True) == 0x06010002


@pytest.mark.parametrize("model", ["kollmorgen_akd", "festo_cmmp_as"])
def test_25_complete_access_is_refused_where_the_model_has_none(model):
    slave = Wired(model).to(P)
    for index in (0x1C12, 0x1018):
        assert slave.upload(index, complete=True) == 0x06010000
        assert slave.download(index, 0, bytes(4), complete=True) == 0x06010000


# --------------------------------------------------------------- objects of EtherCAT


@pytest.mark.parametrize("model", ["generic", "kollmorgen_akd"])
def test_26_1c00h_tells_what_the_sync_managers_are_for(model):
    slave = Wired(model).to(P)
    assert [slave.upload(0x1C00, n) for n in range(5)] == [b"\4", b"\1", b"\2", b"\3", b"\4"]


def test_1c00h_of_the_cmmp_as_is_as_printed():
    slave = Wired("festo_cmmp_as").to(P)
    assert [slave.upload(0x1C00, n) for n in range(5)] == [b"\4", b"\2", b"\2", b"\3", b"\4"]


@pytest.mark.parametrize(("model", "minimum"), [("generic", 500_000), ("kollmorgen_akd", 250_000)])
@pytest.mark.parametrize("index", [0x1C32, 0x1C33])
def test_26_1c32h_and_1c33h_show_the_synchronisation(model, minimum, index):
    slave = Wired(model).to(P)

    def value(subindex):
        return int.from_bytes(slave.upload(index, subindex), "little")

    assert (value(0), value(4), value(5)) == (0x20, 0x0007, minimum)
    slave.write8(0x60C2, 1, 2)
    slave.to(S)
    assert (value(1), value(2)) == (1, 2_000_000), "with sync manager 2, in the period 60C2h"
    assert [value(n) for n in (0x0B, 0x0C, 0x0D, 0x20)] == [0, 0, 0, 0]
    slave.request(P)
    slave.write(0x09A0, struct.pack("<I", 1_000_000))
    slave.write(0x0981, [3])
    slave.to(S)
    assert (value(1), value(2), value(0x0A)) == (2, 1_000_000, 1_000_000), "with SYNC0"


def test_26_10f1h_is_there_where_the_model_has_it(slave, akd):
    assert slave.upload(0x10F1, 2) == struct.pack("<H", 7)
    assert slave.write16(0x10F1, 2, 3) == 0
    assert akd.upload(0x10F1, 2) == 0x06020000


def test_pdos_change_in_pre_operational_only(slave):
    slave.to(S)
    assert slave.write8(0x1C12, 0, 0) == 0x08000022
    slave.to(O)
    assert slave.write8(0x1C13, 0, 0) == 0x08000022
    slave.request(P)
    assert slave.write8(0x1C12, 0, 0) == 0


@pytest.mark.parametrize(
    "index", [0x1005, 0x1014, 0x1017, 0x1400, 0x1800, 0x1200], ids="{:04X}h".format
)
@pytest.mark.parametrize("model", ["generic", "festo_cmmp_as"])
def test_objects_of_can_are_not_on_ethercat(model, index):
    assert Wired(model).to(P).upload(index) == 0x06020000


@pytest.mark.parametrize("model", ["generic", "festo_cmmp_as", "kollmorgen_akd"])
def test_every_object_is_read_in_the_mailbox_with_its_size(model):
    slave = Wired(model).to(P)
    for row in described(slave.drive.model):
        value = slave.upload(row.index, row.subindex)
        if row.access == "wo":
            assert value == 0x06010001
        elif row.index == 0x1003 and row.subindex and value == 0x08000024:
            assert not slave.drive.model.quirk("empty_history_reads_0")
        else:
            assert len(value) == (row.size or len(str(row.default))), row.name


# -------------------------------------------------------------------- emergencies


@pytest.mark.parametrize("model", ["generic", "kollmorgen_akd"])
def test_28_a_fault_sends_one_emergency_and_a_pending_sdo_its_answer_in_order(model):
    slave = Wired(model).to(P)
    assert slave.send(Kind.COE, bytes.fromhex("0020 40 1810 02 00000000")) == 1
    slave.drive.inject("overvoltage")
    slave.cycle(cycles=5)
    assert slave.fetch() == (
        Kind.COE,
        bytes.fromhex("0030 43 1810 02") + slave.drive.read(0x1018, 2).to_bytes(4, "little"),
    )
    # CoE header with service 1 | error code | error register | five bytes of the manufacturer
    assert slave.fetch() == (Kind.COE, bytes.fromhex("0010 1032 05 0000000000"))
    assert slave.fetch() is None
    slave.drive.clear_injected()
    slave.cycle(cycles=2)
    slave.drive.write("controlword", 0x80)
    slave.cycle(cycles=5)
    assert slave.fetch() == (Kind.COE, bytes.fromhex("0010 0000 00 0000000000"))
    assert slave.fetch() is None


@pytest.mark.parametrize("model", ["generic", "kollmorgen_akd", "festo_cmmp_as"])
def test_a_history_that_is_cleared_before_the_mailbox_is_read_changes_no_emergency(model):
    slave = Wired(model).to(P)
    slave.drive.inject("overvoltage")
    for _ in range(5):
        slave.drive.cycle(0.0)
    code = slave.drive.read("error_code") & 0xFFFF
    slave.drive.write(0x1003, 0, 0)
    slave.cycle(cycles=2)
    kind, body = slave.fetch()
    assert (kind, body[:4]) == (Kind.COE, bytes.fromhex("0010") + code.to_bytes(2, "little"))
    assert code


def test_what_happened_before_pre_operational_is_not_told():
    slave = Wired("generic")
    slave.drive.inject("overvoltage")
    slave.cycle(cycles=5)
    slave.to(P)
    assert slave.fetch() is None


def test_a_master_that_reads_no_mailbox_does_not_fill_the_memory(slave):
    for _ in range(60):
        slave.drive.inject("overvoltage")
        slave.cycle(cycles=4)
        slave.drive.clear_injected()
        slave.cycle(cycles=2)
        for word in (0x80, 0x00):
            slave.drive.write("controlword", word)
            slave.cycle(cycles=2)
    told = 0
    while slave.fetch() is not None:
        told += 1
    assert 1 <= told < 40
    assert slave.upload(0x1018, 2) == struct.pack("<I", 0x402)


# ------------------------------------------------------------- never silence


def test_29_repeat_request_gives_the_same_mailbox_again(slave):
    assert slave.send(Kind.COE, bytes.fromhex("0020 40 1810 02 00000000")) == 1
    first = slave.read(slave.in_, slave.lengths[1])
    assert first.wkc == 1
    assert slave.read(slave.in_, slave.lengths[1]).wkc == 0
    for toggle in (0x02, 0x00):
        slave.write(0x080E, [0x01 | toggle])
        assert slave.register(0x080F, 1) & 0x02 == toggle, "acknowledged"
        again = slave.read(slave.in_, slave.lengths[1])
        assert (again.wkc, again.data) == (1, first.data)


@pytest.mark.parametrize(
    ("body", "detail"),
    [
        ("00", 6),  # too short for a CoE header
        ("0020 40 1810 02 000000", 6),  # too short for an SDO
        ("0000" + "00" * 8, 4),  # service 0
        ("0030" + "00" * 8, 4),  # a SDO response
        ("0010" + "00" * 8, 4),  # an emergency
        ("0040" + "00" * 8, 4),  # a TPDO
        ("00f0" + "00" * 8, 4),
    ],
)
def test_30_an_unknown_service_gets_a_mailbox_error(slave, body, detail):
    answer = slave.ask(Kind.COE, bytes.fromhex(body))
    assert answer == (Kind.ERROR, struct.pack("<HH", 1, detail))


@pytest.mark.parametrize("name", ["AoE", "EoE", "CoE", "FoE", "SoE", "VoE"])
def test_30_every_protocol_that_a_device_announces_is_answered(name):
    model = load("generic", "ethercat")
    ethercat = dataclasses.replace(model.ethercat, protocols=("CoE", "FoE", name))
    slave = Wired(dataclasses.replace(model, ethercat=ethercat)).to(P)
    kind, _ = slave.ask(Kind[name.upper()], bytes(10))
    assert kind in (Kind[name.upper()], Kind.ERROR)


def test_ethernet_is_refused_by_a_drive_that_names_it(akd):
    assert akd.ask(Kind.EOE, bytes(32)) == (Kind.ERROR, struct.pack("<HH", 1, 4))


def test_an_address_for_ethernet_is_taken_and_announced(akd):
    """A real AKD answers Set IP with 03 00 00 00, and then sends ARP; as SOEM packs the request."""
    mac, address = bytes.fromhex("020000000001"), bytes([192, 168, 9, 5])
    request = struct.pack("<HH", 0x0102, 0) + b"\x03\0\0\0" + mac + address[::-1]
    assert akd.send(Kind.EOE, request) == 1
    assert akd.fetch() == (Kind.EOE, b"\3\0\0\0")
    kind, body = akd.fetch()
    assert (kind, body[:4]) == (Kind.EOE, struct.pack("<HH", 0x0100, 2 << 6))
    frame = body[4:]
    assert (len(frame), frame[:14]) == (60, b"\xff" * 6 + mac + b"\x08\x06")
    assert frame[14:22] == bytes.fromhex("0001080006040001")
    assert (frame[22:28], frame[28:32], frame[38:42]) == (mac, address, address)
    assert akd.fetch() is None
    for cut in range(4, len(request)):  # without an address there is nothing to announce
        assert akd.ask(Kind.EOE, request[:cut]) == (Kind.EOE, b"\3\0\0\0")


def test_there_is_no_mailbox_in_init():
    slave = Wired("generic").to(P)
    slave.request(I)
    slave.send(Kind.COE, bytes.fromhex("0020 40 1810 02 00000000"))
    assert slave.fetch() is None


@pytest.mark.parametrize("model", ["generic", "festo_cmmp_as", "kollmorgen_akd"])
def test_30_random_telegrams_are_answered_and_never_raise(model):
    slave = Wired(model).to(P)
    generator = random.Random(model)
    indices = [row.index for row in described(slave.drive.model)]
    for n in range(4000):
        choice = generator.random()
        if choice < 0.05:
            slave.configure()
            slave.request(generator.choice((P, S, O, B, I, generator.randrange(16))), 0x10)
            slave.configure()
            slave.request(P, 0x10)
        body = generator.randbytes(generator.randrange(1, 60))
        kind = generator.randrange(16)
        if choice < 0.9:
            kind = Kind.COE
            command = generator.choice((0x40, 0x50, 0x21, 0x2F, 0x2B, 0x23, 0x31, 0x60, 0x70, 0, 1))
            index = generator.choice(indices)
            head = struct.pack("<HBHB", 0x2000, command, index, generator.randrange(4))
            body = head + generator.randbytes(generator.randrange(4, 40))
        if slave.slave.state not in (P, S, O) or slave.send(kind, body, counter=n % 7 + 1) != 1:
            slave.request(I, 0x10)
            slave.request(I)
            slave.to(P)
            continue
        aborted = kind == Kind.COE and len(body) >= 10 and body[1] >> 4 == 2 and body[2] >> 5 == 4
        over = kind == Kind.FOE and len(body) >= 6 and body[0] in (4, 5)
        answers = 0
        while slave.fetch() is not None:
            answers += 1
        assert answers or aborted or over, (kind, body.hex())
        slave.drive.cycle(0.0)
        assert slave.drive.axis.torque == 0.0
