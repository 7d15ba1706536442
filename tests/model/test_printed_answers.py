"""Dialogues and codes as the manuals print them, replayed on the bus."""

import re
import struct

import pytest

from servogym.drive.canopen.decode import Decoder
from servogym.drive.canopen.frame import Frame, parse
from servogym.drive.canopen.node import Node
from servogym.drive.canopen.port import NodePort
from servogym.drive.canopen.remote import CanOpenPort
from servogym.drive.drive import Drive
from servogym.envs.plants.catalogue import axis_for


def download(model, index, subindex, data):
    """-> abort code, 0 without one."""
    node = Node(Drive(model, node_id=1))
    node.poll(0)
    command = 0x23 | 4 - len(data) << 2
    request = struct.pack("<BHB", command, index, subindex) + data.ljust(4, b"\0")
    node.receive(Frame(0x601, request), 0)
    (frame,) = node.poll(0)
    return struct.unpack_from("<I", frame.data, 4)[0] if frame.data[0] == 0x80 else 0


@pytest.mark.parametrize(
    ("index", "subindex", "data", "code"),
    [
        (0x2FFF, 0, b"\0\0", 0x0602_0000),  # the parameter does not exist
        (0x2174, 10, b"\0\0", 0x0609_0011),  # the data set does not exist
        (0x20F9, 0, b"\1\0", 0x0601_0000),  # not writable
    ],
)
def test_bonfiglioli_8_7_codes(index, subindex, data, code):
    assert download("bonfiglioli_act", index, subindex, data) == code


def test_bonfiglioli_8_7_too_large_and_too_small_have_one_code():
    drive = Drive("bonfiglioli_act")
    refused = 0
    for (index, subindex), slot in drive.objects.slots.items():
        row = slot.row
        if not (0x2001 <= index <= 0x2FFF and row.access == "rw" and row.format in ("H", "h")):
            continue
        for value in (int(row.minimum) - 1, int(row.maximum) + 1):
            try:
                data = struct.pack("<" + row.format, value)
            except struct.error:
                continue  # beyond the type
            refused += 1
            assert download("bonfiglioli_act", index, subindex, data) == 0x0609_0030, row
        if refused > 40:
            return
    assert refused


@pytest.mark.parametrize("model", ["festo_cmms", "festo_cmmd"])
@pytest.mark.parametrize(
    ("index", "data", "code"),
    [
        (0x6041, b"\0\0", 0x0601_0000),  # kind of access not supported
        (0x7FFF, b"\0\0", 0x0602_0000),  # no such object
        (0x6040, b"\0\0\0\0", 0x0607_0010),  # length of the service parameter
        (0x6040, b"\0", 0x0607_0010),
    ],
)
def test_cmms_3_2_2_codes(model, index, data, code):
    assert download(model, index, 0, data) == code


# model, section, dialogue: requests (>) and what is answered (<), as the manuals print them
DIALOGUES = [
    # Metronix 5.2.1, Festo CMMP-AS 3.2.1, CMMS 3.2.1: command specifiers and examples
    *(
        (model, "SDO access, reading and writing", dialogue)
        for model in ("metronix_ars2000", "festo_cmmp_as", "festo_cmmp_as_m0",
                      "festo_cmms", "festo_cmmd")
        for dialogue in (
            "> 601#4061600000000000 < 581#4F61600003000000",  # 8 bits; 6061h is 3
            "> 601#4041600000000000 < 581#4B416000",  # 16 bits
            "> 601#4093600100000000 < 581#4393600101000000",  # 32 bits
            "> 601#2F011402EF000000 < 581#6001140200000000",
            "> 601#2B406000E8030000 < 581#6040600000000000 > 601#4040600000000000"
            " < 581#4B406000E8030000",
            "> 601#237A600039300000 < 581#607A600000000000",
        )
    ),
    ("festo_cmms", "3.2.1", "> 601#2393600178563412 < 581#6093600100000000"
     " > 601#4093600100000000 < 581#4393600178563412"),
    ("festo_cmmp_as", "3.2.1 against 5.3: at most 2^24", "> 601#2393600178563412"
     " < 581#8093600147000406"),
    # the error answer 80h, low byte first
    ("festo_cmmp_as", "3.2.2", "> 601#2341600000000000 < 581#8041600002000106"),
    ("metronix_ars2000", "5.2.2", "> 601#2341600000000000 < 581#8041600002000106"),
    ("festo_cmms", "3.2.2", "> 601#2B41600000000000 < 581#8041600000000106"),
    ("festo_cmms", "3.2.2", "> 601#40FF7F0000000000 < 581#80FF7F0000000206"),
    ("festo_cmms", "3.2.2", "> 601#2340600000000000 < 581#8040600010000706"),
    # parameter sets: signatures, what they read
    ("metronix_ars2000", "6.1.2.1", "> 601#231110016C6F6164 < 581#6011100100000000"
     " > 601#4011100100000000 < 581#4311100101000000"),
    ("metronix_ars2000", "6.1.2.1, wrong signature", "> 601#2311100100000000"
     " < 581#8011100120000008"),
    ("metronix_ars2000", "6.1.2.2", "> 601#2310100173617665 < 581#6010100100000000"),
    ("festo_cmmp_as", "5.1", "> 601#231110016C6F6164 < 581#6011100100000000"),
    ("festo_cmmp_as", "5.1, wrong signature", "> 601#2311100100000000 < 581#8011100120000008"),
    # mapping: number 0, entries, number; the mask of the example leaves the 16 bits of 60FDh
    *(
        (model, "PDO, mapping in order", "> 601#2F001A0000000000 < 581#60001A0000000000"
         " > 601#23001A0110004160 < 581#60001A0100000000"
         " > 601#23001A0208006160 < 581#60001A0200000000"
         " > 601#23001A032000FD60 < 581#60001A0300000000"
         " > 601#2F001A0003000000 < 581#60001A0000000000"
         " > 601#2314200100000000 < 581#6014200100000000"
         " > 601#2314200200FFFF00 < 581#6014200200000000"
         " > 601#2300180181010040 < 581#6000180100000000")
        for model in ("metronix_ars2000", "festo_cmmp_as", "festo_cmms")
    ),
    ("metronix_ars2000", "5.3.1: no read-only object in an RPDO", "> 601#2F00160000000000"
     " < 581#6000160000000000 > 601#2300160110004160 < 581#8000160141000406"),
    # NMT, heartbeat, guarding
    *(
        (model, "NMT, boot-up, heartbeat and guarding", "> 701#R < 701#7F > 701#R < 701#FF"
         " > 000#0101 > 701#R < 701#05 > 000#0201 > 701#R < 701#84 > 000#8201 < 701#00"
         " > 701#R < 701#7F")
        for model in ("metronix_ars2000", "festo_cmmp_as")
    ),
    # Bonfiglioli 8.7: frames and examples; data sets are sub-indices
    ("bonfiglioli_act", "8.7 write 372, data set 2", "> 601#22742102DC050000"
     " < 581#6074210200000000"),
    ("bonfiglioli_act", "8.7 read 372, data set 2", "> 601#4074210200000000"
     "< 581#4274210278050000"),
    ("bonfiglioli_act", "8.7 the example's request 42h", "> 601#4274210200000000"
     " < 581#4274210278050000"),
    ("bonfiglioli_act", "8.7 write 407 = -15", "> 601#22972100F1FF0000 < 581#6097210000000000"
     " > 601#4097210000000000 < 581#42972100F1FF0000"),
    ("bonfiglioli_act", "8.7 write 407 = -5", "> 601#22972100FBFF0000 < 581#6097210000000000"),
    ("bonfiglioli_act", "8.7 write 480 = -15.00 Hz, long", "> 601#22E0210124FAFFFF"
     " < 581#60E0210100000000 > 601#40E0210100000000 < 581#42E0210124FAFFFF"),
    ("bonfiglioli_act", "8.7 no such parameter", "> 601#40FF2F0000000000 < 581#80FF2F0000000206"),
    ("bonfiglioli_act", "8.7 no such data set", "> 601#4074210A00000000 < 581#8074210A11000906"),
    ("bonfiglioli_act", "8.7 a string", "> 601#400C200000000000 < 581#800C200047000406"),
    ("bonfiglioli_act", "8.7 data sets differ", "> 601#22742101DC050000 < 581#6074210100000000"
     " > 601#4074210000000000 < 581#8074210047000406"),
    ("bonfiglioli_act", "8.7 too large", "> 601#2281210009000000 < 581#8081210030000906"),
    ("bonfiglioli_act", "8.7 too small", "> 601#2281210000000000 < 581#8081210030000906"),
    ("bonfiglioli_act", "8.7 not writable", "> 601#22F9200001000000 < 581#80F9200000000106"),
    # 8.6: number + 1000 * data set, here 370 + 3 * 1000 = 3370; ENQ 5, ACK 6, SEL 2, NAK 15
    ("bonfiglioli_act", "8.6.1, 8.6.4 read 370, data set 3", "> 601#2100200106000000"
     " < 581#6000200100000000 > 601#032A0D0500000000 < 581#2000000000000000"
     " > 601#4000200100000000 < 581#4100200106000000 > 601#6000000000000000"
     " < 581#032A0D0600900100"),
    ("bonfiglioli_act", "8.6.1 write 370, data set 3", "> 601#2100200106000000"
     " < 581#6000200100000000 > 601#032A0D0200F40100 < 581#2000000000000000"
     " > 601#4000200100000000 < 581#4100200106000000 > 601#6000000000000000"
     " < 581#032A0D0600F40100"),
    ("bonfiglioli_act", "8.6.2 an unknown parameter is error 11 in a NAK", "> 601#2100200106000000"
     " < 581#6000200100000000 > 601#03E7030500000000 < 581#2000000000000000"
     " > 601#4000200100000000 < 581#4100200106000000 > 601#6000000000000000"
     " < 581#03E7030F000B0000"),
    ("bonfiglioli_act", "8.6.2 neither ENQ nor SEL is error 0", "> 601#2100200106000000"
     " < 581#6000200100000000 > 601#032A0D0700000000 < 581#2000000000000000"
     " > 601#4000200100000000 < 581#4100200106000000 > 601#6000000000000000"
     " < 581#032A0D0F00000000"),
    ("bonfiglioli_act", "2 boot-up is a heartbeat with 0", "> 000#8201 < 701#00"),
    ("bonfiglioli_act", "6 writing 387 resets, and the address is adopted",
     "> 601#2283210005000000 < 581#6083210000000000 < 705#00 > 605#4083210000000000"
     " < 585#4283210005000000"),
    ("bonfiglioli_act", "6 address 0 switches the interface off", "> 601#2283210000000000"
     " < 581#6083210000000000 > 601#4083210000000000"),
]


def ids(value):
    return value.replace(" ", "_") if isinstance(value, str) and value[0] != ">" else ""


@pytest.mark.parametrize(("model", "section", "dialogue"), DIALOGUES, ids=ids)
def test_a_printed_dialogue_is_answered_as_printed(model, section, dialogue):
    node = Node(Drive(model, node_id=1))
    node.poll(0)
    expected = []
    for part in re.findall(r"([<>]) ([^<>]*)", dialogue + " "):
        direction, frame = part[0], part[1].replace(" ", "")
        if direction == "<":
            expected.append(frame)
            continue
        check(node, expected)
        node.receive(parse(frame), 0)
    check(node, expected)


def check(node, expected):
    """What is answered begins with what is printed; the value of the statusword is not."""
    answers = [str(frame) for frame in node.poll(0)]
    assert [a[: len(e)] for a, e in zip(answers, expected, strict=False)] == expected
    assert len(answers) == len(expected), answers
    expected.clear()


def test_bonfiglioli_6_the_address_lasts_over_a_power_off(tmp_path):
    file = tmp_path / "act.json"
    node = Node(Drive("bonfiglioli_act", node_id=1, parameter_file=file))
    node.poll(0)
    node.receive(parse("601#2283210005000000"), 0)
    node.poll(0)
    assert Node(Drive("bonfiglioli_act", node_id=1, parameter_file=file)).node_id == 5


def test_bonfiglioli_8_7_a_read_answer_without_size_is_understood():
    machine = axis_for("bonfiglioli_act", 1)
    port = CanOpenPort(NodePort(machine), 1, "bonfiglioli_act")
    assert port.upload("node", "rated_speed_data_set_2") == 1400
    told = Decoder("bonfiglioli_act").decode(parse("581#4274210278050000"))
    assert "rated_speed_data_set_2" in told
    assert "1400" in told
