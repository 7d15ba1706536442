"""What a slave controller shows of itself: as a real AKD's does, and as the data sheet has it."""

import struct

import pytest
from bare_segment import Bare, addressed, bare, fprd, fpwr
from wired import O, P, S, Wired

from servogym.drive.ethercat.mailbox import Kind
from servogym.drive.ethercat.segment import Segment
from servogym.drive.model.model import load, model_names

MS = 1_000_000
CLOCK_32 = {0x0008: b"\x84\x01"}


@pytest.mark.parametrize(
    ("address", "value"), [(0x0000, 0x0204), (0x0140, 0x0C08), (0x0008, 0x0184), (0x0502, 0x0020)]
)
def test_a_real_akd_has_these_registers(address, value):
    assert Wired("kollmorgen_akd").register(address) == value


def test_a_real_akd_takes_an_ip_address():
    akd = Wired("kollmorgen_akd").to(P)
    request = struct.pack("<HHI", 2, 0, 0x3F) + bytes(24)
    assert akd.ask(Kind.EOE, request) == (Kind.EOE, bytes.fromhex("03000000"))


def test_an_emulated_eeprom_is_read_four_bytes_at_a_time():
    akd = Wired("kollmorgen_akd")
    akd.write(0x0508, bytes(8))
    akd.write(0x0502, struct.pack("<HI", 0x0100, 8))
    assert akd.register(0x0502) == 0x0020
    assert akd.read(0x0508, 8).data == struct.pack("<II", 0x6A, 0)


# --------------------------------------------- sync managers and FMMUs (ESC data sheet, section II)


@pytest.mark.parametrize("model", ["generic", "kollmorgen_akd", "festo_cmmp_as"])
def test_the_buffer_bits_of_a_sync_manager_are_those_of_three_buffers_alone(model):
    slave = Wired(model).to(P)
    assert [slave.register(0x0805 + 8 * n, 1) for n in (0, 1)] == [0x00, 0x00]
    slave.send(Kind.COE, struct.pack("<HBHBI", 0x2000, 0x40, 0x1018, 1, 0))
    assert slave.register(0x080D, 1) & 0x30 == 0
    if slave.drive.rpdo_size:
        slave.configure()
        assert slave.register(0x0815, 1) == 0x30, "no buffer has been written"
        slave.to(S, O).outputs(bytes(slave.drive.rpdo_size))
        assert slave.register(0x0815, 1) == 0x01


def test_a_sync_manager_that_is_switched_off_shows_no_buffer_and_no_event():
    segment = addressed(bare())
    row = struct.pack("<HHBBB", 0x1000, 16, 0x26, 0, 1)
    fpwr(segment, 0, 0x0800, row)
    fpwr(segment, 0, 0x1000, bytes(16))
    assert fprd(segment, 0, 0x0805, 1).data == b"\x09"
    fpwr(segment, 0, 0x0806, b"\0")
    assert fprd(segment, 0, 0x0805, 1).data == b"\x00"


@pytest.mark.parametrize(
    ("model", "fmmus", "managers"), [("kollmorgen_akd", 4, 9), ("generic", 8, 8)]
)
def test_a_slave_has_the_fmmus_and_sync_managers_it_says(model, fmmus, managers):
    slave = Wired(model)
    assert (slave.register(0x0004, 1), slave.register(0x0005, 1)) == (fmmus, managers)
    for n in range(8):
        assert slave.read(0x0600 + 16 * n, 16).wkc == (n < fmmus)
        assert slave.write(0x0600 + 16 * n, [1]) == (n < fmmus)
    for n in range(12):
        assert slave.read(0x0800 + 8 * n, 8).wkc == (n < managers)
        assert slave.write(0x0800 + 8 * n, [0]) == (n < managers)


def test_sync_manager_8_of_the_akd_is_a_buffer_as_any_other():
    slave = Wired("kollmorgen_akd")
    row = struct.pack("<HHBBB", 0x2000, 8, 0x26, 0, 1)
    assert slave.write(0x0840, row) == 1
    assert slave.read(0x0840, 7).data == row
    assert slave.write(0x2000, b"12345678") == 1
    assert slave.write(0x2000, b"12345678") == 0, "it is full"
    assert slave.register(0x0845, 1) == 0x09
    assert slave.register(0x0220, 4) >> 8 & 0x1FF == 0x100


@pytest.mark.parametrize("model", ["generic", "kollmorgen_akd"])
def test_the_master_cannot_raise_an_event_of_the_chip(model):
    """0220h is read only (ETG.1000.4); the AKD's manual calls it R/W, its README says so."""
    slave = Wired(model)
    before = slave.register(0x0220, 4)
    assert slave.write(0x0220, b"\xff\xff") == 0
    assert slave.register(0x0220, 4) == before


# ------------------------------------------------------------------------- DL status, clock


def test_0110h_does_not_claim_that_a_watchdog_has_expired_which_nobody_triggers():
    """Bit 1: 0 expired, 1 reloaded (ESC data sheet, 0110h)."""
    for model in ("generic", "kollmorgen_akd"):
        assert Wired(model).register(0x0110) & 2


def test_a_clock_of_32_bits_shows_and_takes_its_lower_half():
    segment = addressed(Segment([Bare(esc=CLOCK_32), Bare()]))
    now = 5_000_000_123
    for slave, bits in ((0, 32), (1, 64)):
        own = int(segment.escs["clock_local"][slave]) + now + 600 * (slave + 1)
        shown = int.from_bytes(fprd(segment, slave, 0x0910, 8, now).data, "little")
        assert shown == own % (1 << bits)
    fpwr(segment, 0, 0x0900, bytes(4), now)
    assert fprd(segment, 0, 0x091C, 4).data == bytes(4)


@pytest.mark.parametrize("ahead", [0, MS, 20 * MS])
def test_sync0_of_a_clock_of_32_bits_begins_at_the_lower_half_of_its_start_time(ahead):
    segment = addressed(Segment([Bare(esc=CLOCK_32)]))
    now = (7 << 32) - 10 * MS  # the lower half runs over in a moment
    start = now + 600 + ahead
    fpwr(segment, 0, 0x09A0, MS.to_bytes(4, "little"), now)
    fpwr(segment, 0, 0x0990, (start & 0xFFFFFFFF).to_bytes(8, "little"), now)
    fpwr(segment, 0, 0x0981, b"\3", now)
    following = int.from_bytes(fprd(segment, 0, 0x0990, 8, now).data, "little")
    assert following == (start if ahead else start + MS) & 0xFFFFFFFF
    segment.poll(now + 40 * MS)
    shown = int.from_bytes(fprd(segment, 0, 0x0990, 8, now + 40 * MS).data, "little")
    assert 0 < (shown - now - 40 * MS - 600) % (1 << 32) <= MS


# --------------------------------------------------------------------------- other buses


@pytest.mark.parametrize("name", [name for name in model_names()])
def test_a_model_has_no_fault_of_a_bus_that_it_is_not_for(name):
    """Festo's lists are those of the M3, which has slots for all of them (B.3)."""
    model = load(name)
    if "ethercat" in model.buses:
        return
    own = [f"{fault.name} {fault.meaning}" for fault in model.faults]
    others = ("EtherCAT", "EtherNet/IP", "PROFIBUS", "PROFINET", "DeviceNet")
    assert [fault for fault in own if any(bus in fault for bus in others)] == []
