"""Kollmorgen AKD: AL states, mailbox, fixed and flexible PDOs, latch words, F125."""

import random
import struct

import pytest

from conftest import Shaft
from servogym.drive.drive import Drive
from servogym.drive.ethercat import FRAME, AlState, AlStatusCode, Slave
from servogym.drive.words import State

I, P, B, S, O = AlState  # noqa: E741


@pytest.fixture
def shaft():
    return Shaft("kollmorgen_akd")


@pytest.fixture
def slave(shaft):
    slave = Slave(shaft.drive)
    slave.configure()
    return slave


def to(slave, *states):
    for state in states:
        slave.configure()
        slave.al_control(state)
        assert slave.al_status == state
    return slave


def sdo(slave, command, index, subindex, data=b""):
    request = FRAME.pack(10, 0, 0, 3, 2 << 12, command, index, subindex, data.ljust(4, b"\0"))
    reply = FRAME.unpack(slave.mailbox(request))
    assert reply[:5] == (10, 0, 0, 3, 3 << 12)
    assert reply[6:8] == (index, subindex)
    return reply[5], reply[8]


def write16(slave, index, subindex, value):
    return sdo(slave, 0x2B, index, subindex, struct.pack("<H", value))


def write8(slave, index, subindex, value):
    return sdo(slave, 0x2F, index, subindex, bytes([value]))


PATH = {I: (), B: (B,), P: (P,), S: (P, S), O: (P, S, O)}
REFUSED = {(I, S), (I, O), (P, O), (O, B), (S, B), (P, B)}  # 5.3.3
ALLOWED = {(I, B), (B, I), (I, P), (P, I), (P, S), (S, P), (S, I), (S, O), (O, S), (O, P), (O, I)}


@pytest.mark.parametrize("source", AlState)
@pytest.mark.parametrize("target", [*range(16)])
def test_every_state_request(slave, source, target):
    to(slave, *PATH[source])
    slave.al_control(target)
    if target == source:
        assert slave.al_status == source
    elif (source, target) in ALLOWED:
        assert slave.al_status == target
    else:
        if (source, target) in REFUSED:
            assert slave.status_code == AlStatusCode.INVALID_STATE_CHANGE
        assert slave.al_status == source | 0x10
        slave.al_control(source)
        assert slave.al_status == source | 0x10, "not without acknowledgement"
        slave.al_control(source | 0x10)
        assert slave.al_status == source
        slave.al_control(0x0F)
        slave.al_control(source | 0x10)
        assert slave.al_status == source
        assert slave.status_code == 0


@pytest.mark.parametrize(("number", "path"), [(0, ()), (1, ()), (2, (P,)), (3, (P,))])
def test_a_wrong_sync_manager_is_code_17h(slave, number, path):
    to(slave, *path)
    start, length = slave.sync_managers[number]
    for wrong in ((start + 1, length), (start, length + 1)):
        slave.sync_managers[number] = wrong
        slave.al_control(P if number < 2 else S)
        assert slave.status_code == AlStatusCode.INVALID_SYNC_MANAGER
        slave.al_control(slave.state | 0x10)


def test_a_model_for_another_bus_is_refused():
    with pytest.raises(ValueError, match="choose a model"):
        Slave(Drive("generic"))


def test_sdo_read_write_and_abort(slave):
    assert slave.mailbox(bytes(16)) == b""
    to(slave, P)
    assert sdo(slave, 0x40, 0x1702, 1) == (0x43, bytes.fromhex("2000ff60"))
    assert sdo(slave, 0x40, 0x1702, 0) == (0x4F, b"\2\0\0\0")
    assert sdo(slave, 0x40, 0x6041, 0) == (0x4B, bytes.fromhex("50020000"))
    assert sdo(slave, 0x2F, 0x6060, 0, b"\x08") == (0x60, bytes(4))
    assert sdo(slave, 0x2F, 0x6041, 0, b"\1") == (0x80, struct.pack("<I", 0x06010002))
    assert sdo(slave, 0x40, 0x5FFF, 0) == (0x80, struct.pack("<I", 0x06020000))
    assert sdo(slave, 0x21, 0x6060, 0) == (0x80, struct.pack("<I", 0x05040001))
    assert sdo(slave, 0x40, 0x1008, 0)[0] == 0x80, "longer than a frame"


SIZES = {0x1701: 6, 0x1702: 6, 0x1720: 12, 0x1721: 8, 0x1722: 14, 0x1723: 14, 0x1724: 8}
INPUTS = {0x1B01: 6, 0x1B02: 6, 0x1B20: 32, 0x1B21: 6, 0x1B22: 32, 0x1B23: 32, 0x1B24: 6}


@pytest.mark.parametrize(("pdo", "size"), [*SIZES.items(), *INPUTS.items()])
def test_fixed_pdos_are_chosen_and_have_the_size_of_the_manual(slave, pdo, size):
    to(slave, P)
    index = 0x1C12 if pdo < 0x1A00 else 0x1C13
    assert write16(slave, index, 1, pdo)[0] == 0x80, "only with a number of 0"
    assert write8(slave, index, 0, 0)[0] == 0x60
    assert write16(slave, index, 1, pdo)[0] == 0x60
    assert write8(slave, index, 0, 1)[0] == 0x60
    assert (slave.drive.rpdo_size if index == 0x1C12 else slave.drive.tpdo_size) == size
    assert write16(slave, index, 1, 0x1704)[0] == 0x80


def test_flexible_mapping_as_in_the_manual(slave):
    to(slave, P)
    for index in (0x1C12, 0x1C13):
        write8(slave, index, 0, 0)
    for n in range(4):
        write8(slave, 0x1A00 + n, 0, 0)
    for n, word in ((1, 0x60410010), (2, 0x60630020)):
        assert sdo(slave, 0x23, 0x1A00, n, struct.pack("<I", word))[0] == 0x60
    assert write8(slave, 0x1A00, 0, 2)[0] == 0x60
    assert sdo(slave, 0x23, 0x1A01, 1, struct.pack("<I", 0x606C0020))[0] == 0x60
    assert write8(slave, 0x1A01, 0, 1)[0] == 0x60
    write16(slave, 0x1C13, 1, 0x1A00)
    write16(slave, 0x1C13, 2, 0x1A01)
    assert write8(slave, 0x1C13, 0, 2)[0] == 0x60
    assert slave.drive.tpdo_size == 10
    assert write8(slave, 0x1A00, 0, 0)[0] == 0x80, "assigned PDOs keep their mapping"
    write8(slave, 0x1C13, 0, 0)
    write16(slave, 0x1C13, 2, 0x1B01)
    assert write8(slave, 0x1C13, 0, 2)[0] == 0x80, "a fixed PDO stands alone"


def test_csp_over_the_process_data(shaft, slave):
    to(slave, P)
    for index, pdo in ((0x1C12, 0x1724), (0x1C13, 0x1B01)):
        write8(slave, index, 0, 0)
        write16(slave, index, 1, pdo)
        write8(slave, index, 0, 1)
    write8(slave, 0x6060, 0, 8)
    slave.configure()
    slave.al_control(S)
    position = 0
    assert not slave.outputs(struct.pack("<iHh", 0, 6, 0)), "set-points only in OPERATIONAL"
    assert len(slave.inputs()) == 6
    slave.al_control(O)
    for word in (6, 7, *[15] * 500):
        if word == 15 and shaft.drive.state == State.OPERATION_ENABLED:
            position += 500
        assert slave.outputs(struct.pack("<iHh", position, word, 0))
        shaft.step(4)
    actual, status = struct.unpack("<iH", slave.inputs())
    assert status & 0x6F == 0x27
    assert abs(actual - position) < 10_000
    shaft.step(4 * 7)
    assert shaft.drive.state == State.OPERATION_ENABLED
    shaft.step(4 * 3)
    assert shaft.drive.state in (State.FAULT_REACTION_ACTIVE, State.FAULT)
    assert shaft.read("error_code") == 0x8700, "F125: more than seven frames are missing"


def test_latch_words(shaft):
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


def test_random_telegrams_never_raise(slave):
    generator = random.Random(7)
    for _ in range(20_000):
        choice = generator.random()
        if choice < 0.1:
            slave.al_control(
                generator.choice([1, 2, 4, 8, 0x11, 0x12, 0x14, generator.randrange(256)])
            )
        elif choice < 0.2:
            slave.configure()
            slave.outputs(generator.randbytes(generator.randrange(40)))
        elif choice < 0.3:
            slave.inputs()
        else:
            request = bytearray(generator.randbytes(16))
            request[5], request[7] = 3, 2 << 4
            if choice < 0.8:
                index = generator.choice([0x1C12, 0x1C13, 0x1600, 0x1A00, 0x6060, 0x607D])
                request[9:11] = index.to_bytes(2, "little")
                request[8] = generator.choice([0x40, 0x23, 0x2B, 0x2F])
                request[11] &= 3
            assert len(slave.mailbox(bytes(request))) in (0, 16)
        slave.drive.cycle(0.0)
