"""FoE: the parameter file, read and written. ETG.1000.6, 5.8."""

import json
import struct

import pytest
from wired import B, I, P, Wired

from servogym.drive.drive import Drive
from servogym.drive.ethercat.mailbox import Kind
from servogym.drive.objects import store

READ, WRITE, DATA, ACKNOWLEDGE, ERROR = 1, 2, 3, 4, 5


@pytest.fixture(params=[("generic", P), ("generic", B), ("kollmorgen_akd", P)])
def slave(request):
    model, state = request.param
    return Wired(model).to(state)


def foe(slave, opcode, number, rest=b""):
    kind, body = slave.ask(Kind.FOE, struct.pack("<BxI", opcode, number) + rest)
    assert kind == Kind.FOE
    answer, value = struct.unpack_from("<BxI", body)
    return answer, value, body[6:]


def read(slave, name=b"parameters"):
    room = slave.lengths[1] - 12
    opcode, packet, part = foe(slave, READ, 0, name)
    content = part
    while len(part) == room:
        assert opcode == DATA
        opcode, number, part = foe(slave, ACKNOWLEDGE, packet)
        assert number == packet + 1
        packet = number
        content += part
    slave.send(Kind.FOE, struct.pack("<BxI", ACKNOWLEDGE, packet))
    assert slave.fetch() is None, "the last one is not answered"
    return content


def write(slave, content, name=b"parameters"):
    room = slave.lengths[0] - 12
    assert foe(slave, WRITE, 0, name) == (ACKNOWLEDGE, 0, b"")
    for packet, at in enumerate(range(0, len(content) + 1, room), 1):
        answer = foe(slave, DATA, packet, content[at : at + room])
        if answer[0] != ACKNOWLEDGE:
            return answer
        assert answer[1] == packet
    return answer


def test_the_parameter_file_is_what_the_drive_would_store(slave):
    slave.drive.write("following_error_window", 4711)
    content = json.loads(read(slave))
    assert content["model"] == slave.drive.model.name
    assert content["values"]["6065:00"] == 4711


def test_a_file_that_is_written_is_in_force_after_the_next_power_on(slave):
    slave.drive.write("following_error_window", 4711)
    content = read(slave)
    slave.drive.write("following_error_window", 12)
    assert write(slave, content)[0] == ACKNOWLEDGE
    assert slave.drive.read("following_error_window") == 12
    slave.power_cycle()
    assert slave.slave.state == I
    assert slave.drive.read("following_error_window") == 4711


def test_a_file_as_long_as_whole_packets_ends_with_an_empty_one():
    slave = Wired("generic").to(P)
    content = read(slave)
    room = slave.lengths[0] - 12
    padded = content + b" " * (-len(content) % room)
    assert write(slave, padded)[0] == ACKNOWLEDGE


@pytest.mark.parametrize("content", [b"", b"{}", b"\xff\xfe", b'{"model": "x"}', b"[1]" * 200])
def test_a_damaged_file_is_refused_and_changes_nothing(slave, content):
    answer, code, text = write(slave, content)
    assert (answer, code) == (ERROR, 0x8004)
    assert text
    assert slave.drive.parameters.stored() == {}


UNFIT = [
    {"6065:00": -1},
    {"6065:00": 1.5},
    {"6065:00": float("nan")},
    {"6065:00": 1 << 40},
    {"605A:00": 99},
    {"foo:01": 1},
    {"6065": 1},
    {"reaction:x": 1},
    {"6091:01": 2**32 - 1, "6091:02": 3, "608F:01": 2**32 - 1, "608F:02": 7},  # do not go together
]


@pytest.mark.parametrize("values", UNFIT, ids=str)
def test_a_file_with_values_that_no_object_takes_is_refused_and_changes_nothing(values):
    slave = Wired("generic").to(P)
    before = slave.drive.snapshot()
    answer, code, text = write(slave, store.encode("generic", values).encode())
    assert (answer, code) == (ERROR, 0x8004)
    assert text
    assert slave.drive.snapshot() == before
    slave.power_cycle()
    assert slave.drive.read("following_error_window") == Drive("generic").read(
        "following_error_window"
    )


def test_a_file_of_another_model_is_refused():
    content = read(Wired("kollmorgen_akd").to(P))
    answer, _, text = write(Wired("generic").to(P), content)
    assert answer == ERROR
    assert b"kollmorgen_akd" in text


def test_an_unknown_file_is_not_found(slave):
    answer, code, text = foe(slave, READ, 0, b"firmware.bin")
    assert (answer, code) == (ERROR, 0x8001)
    assert b"parameters" in text


def test_packets_out_of_order_end_the_transfer(slave):
    foe(slave, WRITE, 0, b"parameters")
    assert foe(slave, DATA, 2, b"x")[:2] == (ERROR, 0x8005)
    assert foe(slave, DATA, 1, b"x")[:2] == (ERROR, 0x8004), "there is no transfer any more"
    foe(slave, READ, 0, b"parameters")
    assert foe(slave, ACKNOWLEDGE, 7)[:2] == (ERROR, 0x8005)
    assert foe(slave, ACKNOWLEDGE, 1)[:2] == (ERROR, 0x8004)
    assert foe(slave, 9, 0)[:2] == (ERROR, 0x8004)
