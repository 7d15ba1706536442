"""SDO answers as the manuals print them: codes and frames, replayed on the bus."""

import struct

import pytest

from servogym.drive.canopen.frame import Frame, parse
from servogym.drive.canopen.node import Node
from servogym.drive.drive import Drive


def answer(model, request):
    node = Node(Drive(model, node_id=1))
    node.poll(0)
    node.receive(parse(request), 0)
    (frame,) = node.poll(0)
    return str(frame)


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


def test_cmmp_3_2_2_example_of_a_write_to_the_statusword():
    assert answer("festo_cmmp_as", "601#2341600000000000") == "581#8041600002000106"


@pytest.mark.parametrize("model", ["festo_cmmp_as", "festo_cmms", "metronix_ars2000"])
@pytest.mark.parametrize(
    ("request_", "begins"),
    [
        ("601#4061600000000000", "581#4F616000"),  # 8 bits
        ("601#4041600000000000", "581#4B416000"),  # 16 bits
        ("601#4093600100000000", "581#43936001"),  # 32 bits
        ("601#2F60600001000000", "581#60606000"),
        ("601#2B40600006000000", "581#60406000"),
        ("601#237A600039300000", "581#607A6000"),
    ],
)
def test_the_command_specifiers_of_3_2_1_and_5_2_1(model, request_, begins):
    assert answer(model, request_).startswith(begins)
