"""A slave goes on from a snapshot bit by bit: AL state, transfers, telegrams that wait."""

import struct

import pytest
from wired import O, P, S, Wired

from servogym.drive.ethercat.mailbox import Kind


def frames(slave):
    """What comes back of some SDO and process data."""
    answers = []
    for index, subindex in ((0x1018, 2), (0x6041, 0), (0x5FFF, 0), (0x1C32, 1)):
        slave.send(Kind.COE, struct.pack("<HBHBI", 0x2000, 0x40, index, subindex, 0), counter=1)
        answers.append(slave.fetch())
        answers.append(slave.cycle(bytes(slave.drive.rpdo_size), 3))
    return answers


@pytest.mark.parametrize("model", ["generic", "kollmorgen_akd"])
def test_a_segment_in_operational_goes_on_from_its_snapshot(model):
    slave = Wired(model).to(P, S, O)
    slave.cycle(bytes(slave.drive.rpdo_size), 10)
    snapshot = slave.segment.snapshot()
    wanted = frames(slave)
    slave.segment.restore(snapshot)
    assert frames(slave) == wanted
    other = Wired(model)
    other.segment.restore(snapshot)
    assert other.slave.state == O
    assert frames(other) == wanted


def test_a_transfer_in_segments_goes_on_from_its_snapshot():
    slave = Wired("generic", mailbox=(34, 34)).to(P)
    request = struct.pack("<HBHBI", 0x2000, 0x40, 0x1008, 0, 0)
    slave.ask(Kind.COE, request)
    snapshot = slave.segment.snapshot()
    rest = slave.segment_request(0x60)
    slave.segment.restore(snapshot)
    assert slave.segment_request(0x60) == rest
    other = Wired("generic", mailbox=(34, 34))
    other.segment.restore(snapshot)
    assert other.segment_request(0x60) == rest


def test_an_emergency_that_waits_and_a_file_that_is_read_are_in_the_snapshot():
    slave = Wired("generic").to(P)
    slave.send(Kind.COE, struct.pack("<HBHBI", 0x2000, 0x40, 0x1018, 2, 0))
    slave.drive.inject("overvoltage")
    slave.cycle(cycles=5)
    snapshot = slave.segment.snapshot()
    wanted = [slave.fetch() for _ in range(3)]
    assert wanted[1][1][:4] == bytes.fromhex("00101032")
    other = Wired("generic")
    other.segment.restore(snapshot)
    assert [other.fetch() for _ in range(3)] == wanted
    slave = Wired("generic").to(P)
    slave.ask(Kind.FOE, struct.pack("<BxI", 1, 0) + b"parameters")
    snapshot = slave.segment.snapshot()
    acknowledge = struct.pack("<BxI", 4, 1)
    wanted = slave.ask(Kind.FOE, acknowledge)
    other = Wired("generic")
    other.segment.restore(snapshot)
    assert other.ask(Kind.FOE, acknowledge) == wanted


def test_a_damaged_snapshot_of_a_slave_is_refused():
    slave = Wired("generic").to(P)
    for damaged in (b"", b"(1, 2)", b"\xff", b"__import__('os')"):
        with pytest.raises(ValueError, match="no snapshot of a slave"):
            slave.slave.restore(damaged)
