"""Kollmorgen AKD: fixed and flexible PDOs, modes, latch words, F125, cycle time."""

import struct

import pytest
from wired import O, P, S, Wired

from conftest import Shaft
from servogym.drive.canopen.node import Node
from servogym.drive.drive import Drive
from servogym.drive.ethercat.slave import Slave
from servogym.drive.kernel.words import State


@pytest.fixture
def slave():
    return Wired("kollmorgen_akd").to(P)


# 5.5; digital outputs with 32 bits, 1725h, 1B25h and 1B26h observed
SIZES = {0x1701: 6, 0x1702: 6, 0x1720: 14, 0x1721: 8, 0x1722: 16, 0x1723: 16, 0x1724: 8, 0x1725: 16}
INPUTS = {
    0x1B01: 6, 0x1B02: 6, 0x1B20: 32, 0x1B21: 6, 0x1B22: 32, 0x1B23: 32, 0x1B24: 6, 0x1B25: 32,
    0x1B26: 18,
}


@pytest.mark.parametrize(("pdo", "size"), [*SIZES.items(), *INPUTS.items()])
def test_fixed_pdos_are_chosen_and_have_their_size(slave, pdo, size):
    index = 0x1C12 if pdo < 0x1A00 else 0x1C13
    assert slave.write16(index, 1, pdo) == 0x08000022, "only with a number of 0"
    assert slave.write8(index, 0, 0) == 0
    assert slave.write16(index, 1, pdo) == 0
    assert slave.write8(index, 0, 1) == 0
    assert (slave.drive.rpdo_size if index == 0x1C12 else slave.drive.tpdo_size) == size
    slave.to(S, O)
    assert slave.outputs(bytes(slave.drive.rpdo_size)) == 1
    assert slave.inputs().wkc == 1


def test_a_pdo_that_no_list_has_is_refused(slave):
    assert slave.write8(0x1C12, 0, 0) == 0
    assert slave.write16(0x1C12, 1, 0x1704) == 0x06090030


def test_flexible_mapping_as_in_the_manual(slave):
    for index in (0x1C12, 0x1C13):
        assert slave.write8(index, 0, 0) == 0
    for n in range(4):
        assert slave.write8(0x1A00 + n, 0, 0) == 0
    for n, word in ((1, 0x60410010), (2, 0x60630020)):
        assert slave.write32(0x1A00, n, word) == 0
    assert slave.write8(0x1A00, 0, 2) == 0
    assert slave.write32(0x1A01, 1, 0x606C0020) == 0
    assert slave.write8(0x1A01, 0, 1) == 0
    assert slave.write16(0x1C13, 1, 0x1A00) == 0
    assert slave.write16(0x1C13, 2, 0x1A01) == 0
    assert slave.write8(0x1C13, 0, 2) == 0
    assert slave.drive.tpdo_size == 10
    assert slave.write8(0x1A00, 0, 0) == 0x08000022, "assigned PDOs keep their mapping"
    slave.write8(0x1C13, 0, 0)
    slave.write16(0x1C13, 2, 0x1B01)
    assert slave.write8(0x1C13, 0, 2) == 0x06040043, "a fixed PDO stands alone"


def test_flexible_pdos_are_as_delivered(slave):
    assert [slave.upload(0x1600, n) for n in (0, 1)] == [b"\1", struct.pack("<I", 0x60400010)]
    assert [slave.upload(0x1A00, n) for n in (0, 1)] == [b"\1", struct.pack("<I", 0x60410010)]
    for n in (1, 2, 3):
        assert slave.upload(0x1600 + n) == slave.upload(0x1A00 + n) == b"\0"


# mode -> receive PDO, image of set-point and controlword, bits that start the motion
STREAMS = {
    7: (0x1701, "<iH", 0x1F),
    8: (0x1724, "<iH2x", 0x0F),
    9: (0x1702, "<iH", 0x0F),
}


def stream(slave, mode, word, cycles=300):
    """Enable, then a set-point every millisecond: -> revolutions of the shaft."""
    pdo, image, _ = STREAMS[mode]
    slave.assign([pdo], [0x1B24])
    assert slave.write8(0x6060, 0, mode) == 0
    slave.to(S, O)
    for enabling in (6, 7, 15, 15, 15):
        slave.cycle(struct.pack(image, 0, enabling), 4)
    begin, position = slave.shaft.angle, 0
    for _ in range(cycles):
        position += 500
        value = 500_000 if mode == 9 else position
        _, status = struct.unpack("<iH", slave.cycle(struct.pack(image, value, word), 4))
    assert status & 0x6F == 0x27
    return abs(slave.shaft.angle - begin)


@pytest.mark.parametrize("mode", STREAMS)
def test_csp_csv_and_ip_follow_the_process_data(slave, mode):
    assert stream(slave, mode, STREAMS[mode][2]) > 0.05


def test_ip_needs_controlword_bit_4(slave):
    assert stream(slave, 7, 0x0F) < 1e-3


def test_more_than_seven_missing_frames_are_f125(slave):
    stream(slave, 8, 0x0F)
    slave.shaft.step(4 * 7)
    assert slave.drive.state == State.OPERATION_ENABLED
    slave.shaft.step(4 * 3)
    assert slave.drive.state in (State.FAULT_REACTION_ACTIVE, State.FAULT)
    assert slave.drive.read("error_code") == 0x8700


def test_set_points_count_in_operational_only(slave):
    slave.to(S)
    slave.outputs(struct.pack("<iH", 0, 6))
    slave.cycle(cycles=4)
    assert slave.drive.state == State.SWITCH_ON_DISABLED
    slave.to(O)
    slave.cycle(struct.pack("<iH", 0, 6), 4)
    assert slave.drive.state == State.READY_TO_SWITCH_ON


@pytest.mark.parametrize(
    ("units", "index", "code"),
    [(1, -3, 0), (250, -6, 0), (3, -4, 0), (2, -4, 0x06090032), (249, -6, 0x06090032)],
)
def test_60c2h_below_250_us_is_refused(slave, units, index, code):
    """5.10."""
    assert slave.write8(0x60C2, 1, 250) == 0
    first = slave.write8(0x60C2, 2, index & 0xFF)
    assert (first or slave.write8(0x60C2, 1, units)) == code
    if not code:
        assert slave.upload(0x60C2, 1) == bytes([units])


def test_latch_words():
    shaft = Shaft("kollmorgen_akd")
    shaft.write(latch_controlword=0x0003)
    for level in (1, 0):
        shaft.angle += 0.5
        shaft.axis.touch_probe[0] = level
        shaft.step(3)
    status = shaft.read("latch_status")
    assert status & 0xF == 3
    shaft.write(latch_controlword=0x0203)
    shaft.step(2)
    assert shaft.read("latch_status") & 0xF0F == 0x203
    rising = shaft.read("latch_position_positive_edge")
    assert 0 < rising < shaft.read("latch_position_negative_edge")
    shaft.axis.touch_probe[0] = 1
    shaft.step()
    assert shaft.read("latch_status") & 0xF000 == 0x8000
    shaft.write(latch_controlword=0)
    shaft.step(2)
    assert shaft.read("latch_status") & 0xFFF == 0


def test_20a6h_and_20a7h_have_the_edge_that_came_last():
    shaft = Shaft("kollmorgen_akd")
    shaft.write(latch_controlword=0x000F)
    shown = []
    for level in (1, 0):
        shaft.angle += 0.5
        shaft.axis.touch_probe[:] = level
        shaft.step(3)
        shown.append((shaft.read("latch_1_position"), shaft.read("latch_2_position")))
    positive = shaft.read("latch_position_positive_edge")
    negative = shaft.read("latch_position_negative_edge")
    assert shown == [(positive, positive), (negative, negative)]
    assert positive < negative


# ------------------------------------------------------------------ on which bus


def test_a_drive_on_another_bus_is_refused_with_the_way_out():
    with pytest.raises(ValueError, match="use `servogym node`"):
        Slave(Drive("metronix_ars2000"))
    with pytest.raises(ValueError, match=r'Drive\(.generic., bus="ethercat"\)'):
        Slave(Drive("generic"))
    with pytest.raises(ValueError, match="use `servogym ethercat`"):
        Node(Drive("kollmorgen_akd"))
    with pytest.raises(ValueError, match='bus="can"'):
        Node(Drive("generic", bus="ethercat"))
    with pytest.raises(ValueError, match="use `servogym ethercat`"):
        Drive("kollmorgen_akd", bus="can")


@pytest.mark.parametrize("model", ["generic", "festo_cmmp_as"])
def test_a_model_with_two_faces_is_the_same_drive_on_both(model):
    can, ethercat = Drive(model), Drive(model, bus="ethercat")
    assert (can.model.bus, ethercat.model.bus) == ("can", "ethercat")
    shared = set(can.objects.slots) & set(ethercat.objects.slots)
    assert {index for index, _ in shared} >= {0x6040, 0x6041, 0x607A, 0x6060}
    for address in shared:
        if address[0] >= 0x2000:
            here, there = can.objects.slots[address], ethercat.objects.slots[address]
            assert (here.row.name, here.row.offset) == (there.row.name, there.row.offset)
            assert here.row.default == there.row.default
    assert Node(can).drive is can
    assert Slave(ethercat).drive is ethercat
    with pytest.raises(ValueError, match="take a new one"):
        ethercat.restore(can.snapshot())


def test_the_cmmp_as_is_enabled_and_moves_in_ip():
    slave = Wired("festo_cmmp_as").to(P)
    for n, word in enumerate((0x60400010, 0x60C10120), 1):
        slave.write8(0x1600, 0, 0)
        assert slave.write32(0x1600, n, word) == 0
    assert slave.write8(0x1600, 0, 2) == 0
    slave.assign([0x1600], [0x1A00])
    assert slave.write16(0x6510, 0x10, 2) == 0, "enabling by the bus (5.4)"
    assert slave.write8(0x6060, 0, 7) == 0
    assert slave.write8(0x60C4, 6, 1) == 0, "the buffer is open (7.4.2)"
    slave.to(S, O)
    position, begin = 0, slave.shaft.angle
    for word in (0, 6, 7, *[15] * 20, *[31] * 300):
        position += 200 if slave.drive.read("modes_of_operation_display") == 7 else 0
        status = slave.cycle(struct.pack("<Hi", word, position), 2)
    assert struct.unpack("<H", status)[0] & 0x6F == 0x27
    assert abs(slave.shaft.angle - begin) > 0.05
    slave.request(S)
    slave.shaft.step(9 * 2)
    assert slave.drive.state != State.OPERATION_ENABLED, "it has lost its master"
