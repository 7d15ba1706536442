"""The slave controller alone: commands, working counters, addresses, locks, FMMUs, EEPROM."""

import random

import pytest
from bare_segment import (
    Bare,
    addressed,
    bare,
    bare_sii,
    fmmu,
    fprd,
    fpwr,
    log,
    one,
    send,
    sync_manager,
)

from servogym.drive.ethercat.frame import Command as C
from servogym.drive.ethercat.frame import Datagram, logical, pack, text, unpack
from servogym.drive.ethercat.segment import Segment

USER = 0x0F80  # user RAM: a register both sides read and write
BUFFERED_OUT, BUFFERED_IN, MAILBOX_OUT, MAILBOX_IN = 0x24, 0x20, 0x26, 0x22


@pytest.fixture
def one_slave():
    return addressed(bare(1))


@pytest.fixture
def two_slaves():
    return addressed(bare(2))


# command -> working counter: addressed, not addressed, two slaves addressed (ETG.1000.4, 5.4)
COUNTERS = {
    C.NOP: (0, 0, 0),
    C.APRD: (1, 0, 1), C.APWR: (1, 0, 1), C.APRW: (3, 0, 3),
    C.FPRD: (1, 0, 2), C.FPWR: (1, 0, 2), C.FPRW: (3, 0, 6),
    C.BRD: (1, 1, 2), C.BWR: (1, 1, 2), C.BRW: (3, 3, 6),
    C.LRD: (1, 0, 2), C.LWR: (1, 0, 2), C.LRW: (3, 0, 6),
    C.ARMW: (1, 1, 2), C.FRMW: (1, 1, 2),
}


def _address(command, hit):
    if command in (C.LRD, C.LWR, C.LRW):
        return (0, 0x0001) if hit else (0, 0x0002)
    if command in (C.FPRD, C.FPWR, C.FPRW, C.FRMW):
        return (0x1001 if hit else 0x2001, USER)
    return (0 if hit else 5, USER)


@pytest.mark.parametrize("command", C)
@pytest.mark.parametrize("case", ["addressed", "not addressed", "two slaves"])
def test_02_working_counter_of_every_command(command, case):
    segment = addressed(bare(2 if case == "two slaves" else 1))
    for i in range(len(segment)):
        fmmu(segment, i, 0, 0x10000, 4, USER, 3)
        fpwr(segment, i, USER, bytes([0x11 << i] * 4))
    if case == "two slaves":  # both have one station address
        fpwr(segment, 1, 0x0010, (0x1001).to_bytes(2, "little"))
    adp, ado = _address(command, case != "not addressed")
    reply = one(segment, command, adp, ado, b"\x80\0\0\1")
    expected = COUNTERS[command][("addressed", "not addressed", "two slaves").index(case)]
    assert reply.wkc == expected
    held = [segment.escs["memory"][i, USER : USER + 4].tobytes() for i in range(len(segment))]
    reads = command in (C.APRD, C.APRW, C.FPRD, C.FPRW, C.LRD, C.LRW)
    if case == "addressed":
        if reads or command in (C.ARMW, C.FRMW):
            assert reply.data == b"\x11" * 4
        if command in (C.BRD, C.BRW):
            assert reply.data == b"\x91\x11\x11\x11"  # ORed to what was sent
        if command in (C.APWR, C.FPWR, C.BWR, C.LWR, C.APRW, C.FPRW, C.BRW, C.LRW):
            assert held == [b"\x80\0\0\1"]
        else:
            assert held == [b"\x11" * 4]
    if case == "not addressed" and command in (C.ARMW, C.FRMW):
        assert held == [b"\x80\0\0\1"]
    if case == "two slaves":
        if command in (C.FPRD, C.LRD):
            assert reply.data == b"\x22" * 4  # the last one has the say
        if command == C.BRD:
            assert reply.data == b"\xb3\x33\x33\x33"
        if command == C.ARMW:  # the first one reads, the second one writes what was read
            assert held == [b"\x11" * 4, b"\x11" * 4]
        if command == C.LRW:  # a slave that reads and writes one place swaps
            assert held == [b"\x80\0\0\1", b"\x11" * 4]
            assert reply.data == b"\x22" * 4


@pytest.mark.parametrize("command", [C.APRD, C.APWR, C.APRW, C.BRD, C.BWR, C.BRW, C.ARMW])
def test_03_position_and_broadcast_come_back_increased_by_the_slaves(command):
    assert one(bare(5), command, 0xFFFE, USER, b"\0\0").adp == 3


def test_03_alias_answers_only_when_it_is_switched_on():
    segment = addressed(Segment([Bare(alias=0x0ABC)]))
    assert fprd(segment, 0, 0x0012, 2).data == b"\xbc\x0a"
    assert one(segment, C.FPRD, 0x0ABC, 0x0130, b"\0\0").wkc == 0
    fpwr(segment, 0, 0x0103, b"\1")
    assert one(segment, C.FPRD, 0x0ABC, 0x0130, b"\0\0").wkc == 1
    assert one(segment, C.FPRD, 0x1001, 0x0130, b"\0\0").wkc == 1


def mailboxes(segment):
    sync_manager(segment, 0, 0, 0x1000, 64, MAILBOX_OUT)
    sync_manager(segment, 0, 1, 0x1080, 64, MAILBOX_IN)
    return segment


def test_04_empty_mailbox_full_mailbox_and_wrong_direction_count_nothing(one_slave):
    segment = mailboxes(one_slave)
    assert fprd(segment, 0, 0x1080, 64).wkc == 0  # empty
    assert fprd(segment, 0, 0x1000, 64).wkc == 0  # SM0 is the master's to write
    assert fpwr(segment, 0, 0x1080, bytes(64)).wkc == 0
    assert fpwr(segment, 0, 0x1000, b"A" * 64).wkc == 1
    before = segment.snapshot()
    assert fpwr(segment, 0, 0x1000, b"B" * 64).wkc == 0  # full
    assert segment.snapshot() == before
    assert segment.pdis[0].mailbox_take() == b"A" * 64
    assert fpwr(segment, 0, 0x1000, b"B" * 64).wkc == 1
    assert segment.pdis[0].mailbox_put(b"C")
    assert not segment.pdis[0].mailbox_put(b"D")
    assert fprd(segment, 0, 0x080D, 1).data[0] & 8
    assert fprd(segment, 0, 0x1080, 64).data == b"C".ljust(64, b"\0")
    assert fprd(segment, 0, 0x1080, 64).wkc == 0


def test_05_second_al_control_before_the_drive_has_read_the_first(one_slave):
    assert fpwr(one_slave, 0, 0x0120, b"\2\0").wkc == 1
    assert fpwr(one_slave, 0, 0x0120, b"\4\0").wkc == 0
    assert one_slave.pdis[0].al_control() == 2
    assert fpwr(one_slave, 0, 0x0120, b"\4\0").wkc == 1


def test_06_mailbox_is_taken_with_the_last_byte_of_its_buffer(one_slave):
    segment = mailboxes(one_slave)
    assert fpwr(segment, 0, 0x1020, bytes(32)).wkc == 0  # it does not begin in the middle
    assert fpwr(segment, 0, 0x1000, b"A" * 10).wkc == 1
    assert segment.pdis[0].mailbox_take() == b""
    assert fpwr(segment, 0, 0x103F, b"Z").wkc == 1
    assert segment.pdis[0].mailbox_take() == b"A" * 10 + bytes(53) + b"Z"


def test_07_two_slaves_map_their_mailbox_bit_side_by_side_into_one_byte(two_slaves):
    segment = two_slaves
    for i in range(2):
        fpwr(segment, i, 0x0800 + 8, b"\x80\x10\x40\0\x22\0\1\0")
        fmmu(segment, i, 2, 0x20000, 1, 0x080D, 1, bits=(3 + i, 3 + i), bit=3)
    assert log(segment, C.LRD, 0x20000, b"\xff").data == b"\xe7"
    segment.pdis[1].mailbox_put(b"x")
    reply = log(segment, C.LRD, 0x20000, b"\0")
    assert (reply.data, reply.wkc) == (b"\x10", 2)
    segment.pdis[0].mailbox_put(b"x")
    assert log(segment, C.LRD, 0x20000, b"\0").data == b"\x18"


def test_08_outputs_that_hit_half_of_the_buffer_do_not_arrive(one_slave):
    segment = one_slave
    sync_manager(segment, 0, 2, 0x1100, 8, BUFFERED_OUT)
    fmmu(segment, 0, 0, 0x10000, 8, 0x1100, 2)
    assert log(segment, C.LWR, 0x10000, b"12345678").wkc == 1
    assert segment.escs["local"][0, 0x1100:0x1108].tobytes() == b"12345678"
    assert log(segment, C.LWR, 0x10000, b"abcd").wkc == 1
    assert segment.escs["local"][0, 0x1100:0x1108].tobytes() == b"12345678"
    assert log(segment, C.LWR, 0x10004, b"efgh").wkc == 1  # the second half ends it
    assert segment.escs["local"][0, 0x1100:0x1108].tobytes() == b"abcdefgh"


def test_08_working_counter_of_lrw_is_three_for_each_slave():
    segment = addressed(bare(4))
    for i in range(4):
        sync_manager(segment, i, 2, 0x1100, 4, BUFFERED_OUT)
        sync_manager(segment, i, 3, 0x1140, 4, BUFFERED_IN)
        fmmu(segment, i, 0, 0x10000 + 8 * i, 4, 0x1100, 2)
        fmmu(segment, i, 1, 0x10004 + 8 * i, 4, 0x1140, 1)
    assert log(segment, C.LRW, 0x10000, bytes(32)).wkc == 8  # no inputs have been written yet
    for i in range(4):
        segment.escs["memory"][i, 0x081D] &= 0xCF
    assert log(segment, C.LRW, 0x10000, bytes(32)).wkc == 12


def broken_frames(seed, count):
    """Frames that are noise, cut, too long, of another type, or altered in some bytes."""
    chance = random.Random(seed)
    for _ in range(count):
        rows = [
            Datagram(chance.choice([*C, 15, 99, 255]), chance.choice([0, 0x1001, 0xFFFF, 7]),
                     chance.choice([0, 0x10, 0x120, 0x300, 0x502, 0x600, 0x800, 0x900, 0x910, 0x981,
                                    0x1000, 0x1080, 0x2FFE, 0xFFFF]),
                     chance.randbytes(chance.choice([0, 1, 2, 8, 16, 64])))
            for _ in range(chance.randint(1, 4))
        ]
        frame = bytearray(pack(rows))
        kind = chance.randrange(6)
        if kind == 0:
            del frame[chance.randrange(len(frame)) :]
        elif kind == 1:
            frame[14:16] = chance.randbytes(2)
        elif kind == 2:
            frame[12:14] = chance.choice([b"\x81\0", b"\x08\0", b"\x88\xcc"])
        elif kind == 3:
            frame = bytearray(chance.randbytes(1500))
            if chance.random() < 0.9:
                frame[12:14] = b"\x88\xa4"
                frame[15] = 0x10 | frame[15] & 7
        elif kind == 4:
            for _ in range(4):
                frame[chance.randrange(len(frame))] = chance.randrange(256)
        yield bytes(frame)


def feed(segment, frames):
    lost = 0
    for now, frame in enumerate(frames):
        reply = segment.exchange(frame, now * 1000)
        lost += reply is None
        assert reply is None or len(reply) == len(frame)
    return lost


def test_09_no_frame_does_harm():
    segment = mailboxes(addressed(bare(3)))
    assert feed(segment, broken_frames(1, 4000)) > 500
    assert one(segment, C.BRD, 0, 0, b"\0").wkc == 3  # and they are all there


@pytest.mark.slow
def test_09_no_frame_does_harm_in_a_million():
    segment = mailboxes(addressed(bare(3)))
    feed(segment, broken_frames(2, 1_000_000))
    for _ in range(3):  # some frames have closed ports; the way to the next slave opens first
        send(segment, Datagram(C.BWR, 0, 0x0100, b"\1\0\0\0"))
    assert one(segment, C.BRD, 0, 0, b"\0").wkc == 3


@pytest.mark.parametrize("change", [
    lambda f: f[:29],
    lambda f: f[:14] + b"\x0e\x40" + f[16:], lambda f: f[:14] + b"\x0e\x50" + f[16:],
    lambda f: f[:14] + b"\xff\x17" + f[16:], lambda f: f[:22] + b"\xff\x07" + f[24:],
])
def test_09_bad_frames_are_counted_and_not_answered(one_slave, change):
    assert one_slave.exchange(change(pack([Datagram(C.FPRD, 0x1001, 0, bytes(2))])), 0) is None
    assert fprd(one_slave, 0, 0x030C, 1).data == b"\1"


def test_09_a_vlan_tag_is_passed_over(one_slave):
    frame = pack([Datagram(C.FPRD, 0x1001, 0, bytes(2))])
    tagged = frame[:12] + b"\x81\0\0\1" + frame[12:]
    assert unpack(one_slave.exchange(tagged, 0))[0].wkc == 1


def test_09_an_unknown_command_passes_untouched(one_slave):
    row = Datagram(0x37, 0x1001, 0, b"\5\6")
    assert send(one_slave, row) == [row]


def test_10_writing_an_error_counter_clears_them():
    segment = addressed(bare(3))
    for first, last in ((0x0300, 0x030E), (0x0310, 0x0314)):
        segment.escs["memory"][:, first:last] = 7
    assert one(segment, C.BWR, 0, 0x0300, b"\0").wkc == 3
    assert not segment.escs["memory"][:, 0x0300:0x030C].any()
    assert segment.escs["memory"][:, 0x030C:0x030E].all()
    for address in (0x030C, 0x030D, 0x0310):
        one(segment, C.BWR, 0, address, b"\0")
    assert not segment.escs["memory"][:, 0x0300:0x0314].any()


def test_10_a_broken_link_shows_and_takes_the_slaves_behind_it_away():
    segment = addressed(bare(4))
    assert fprd(segment, 1, 0x0110, 2).data == b"\x33\x5a"
    segment.break_link(1)
    assert one(segment, C.BRD, 0, 0, b"\0").wkc == 2
    assert fprd(segment, 1, 0x0110, 2).data == b"\x13\x56"  # port 1: no link, loop closed
    assert fprd(segment, 1, 0x0310, 4).data == b"\0\1\0\0"
    segment.heal_link(1)
    assert one(segment, C.BRD, 0, 0, b"\0").wkc == 4
    assert fprd(segment, 2, 0x0310, 4).data == b"\1\0\0\0"


# ------------------------------------------------------------------- EEPROM


def command(segment, word, address=0, data=b"\0\0", now=0):
    fpwr(segment, 0, 0x0504, address.to_bytes(4, "little"), now)
    fpwr(segment, 0, 0x0508, data, now)
    fpwr(segment, 0, 0x0502, word.to_bytes(2, "little"), now)
    return int.from_bytes(fprd(segment, 0, 0x0502, 2, now).data, "little")


def test_13_eeprom_reads_four_or_eight_bytes():
    sii = bare_sii(alias=0x1234)
    for control, size in ((b"\xc0", 8), (b"\x80", 4)):
        segment = addressed(Segment([Bare(alias=0x1234, esc={0x0502: control})]))
        assert not command(segment, 0x0100, 4) & 0xE800
        assert fprd(segment, 0, 0x0508, 8).data[:size] == sii[8 : 8 + size]
        assert (fprd(segment, 0, 0x0508, 8).data == sii[8:16]) == (size == 8)


def test_13_eeprom_write_needs_its_enable_bit(one_slave):
    assert command(one_slave, 0x0200, 40, b"\x55\xaa") & 0x4000
    assert one_slave.pdis[0].sii[80:82] == b"\xff\xff"
    assert not command(one_slave, 0x0201, 40, b"\x55\xaa") & 0x6000
    assert one_slave.pdis[0].sii[80:82] == b"\x55\xaa"
    assert command(one_slave, 0x0200, 40, b"\0\0") & 0x4000  # it held for one frame


def test_13_eeprom_address_behind_the_end_is_an_error(one_slave):
    assert command(one_slave, 0x0100, 128) & 0x2000
    assert not command(one_slave, 0x0100, 127) & 0x2000  # and the next command takes it back


def test_13_alias_written_is_there_after_the_reload(one_slave):
    from servogym.drive.ethercat.controller.eeprom import checksum

    wanted = bytearray(bare_sii(alias=0x0777))
    command(one_slave, 0x0201, 4, b"\x77\x07")
    assert command(one_slave, 0x0400) & 0x0800  # the check sum does not fit any more
    assert fprd(one_slave, 0, 0x0012, 2).data == b"\0\0"
    command(one_slave, 0x0201, 7, bytes([checksum(wanted), 0]))
    assert not command(one_slave, 0x0400) & 0x0800
    assert fprd(one_slave, 0, 0x0012, 2).data == b"\x77\x07"


def test_13_eeprom_refuses_while_it_is_busy_or_the_drive_has_it(one_slave):
    one_slave.escs["eeprom_until"] = 500
    assert fprd(one_slave, 0, 0x0502, 2, now=400).data[1] & 0x80
    assert fpwr(one_slave, 0, 0x0502, b"\0\1", now=400).wkc == 0
    assert fpwr(one_slave, 0, 0x0502, b"\0\1", now=600).wkc == 1
    fpwr(one_slave, 0, 0x0500, b"\1", now=600)
    assert fprd(one_slave, 0, 0x0501, 1, now=600).data == b"\1"
    assert fpwr(one_slave, 0, 0x0502, b"\0\1", now=600).wkc == 0


# --------------------------------------------------------- sync managers, IRQ


def test_a_sync_manager_is_locked_while_it_is_on(one_slave):
    sync_manager(one_slave, 0, 2, 0x1100, 8, BUFFERED_OUT)
    fpwr(one_slave, 0, 0x0810, b"\0\x12")
    assert fprd(one_slave, 0, 0x0810, 2).data == b"\0\x11"
    fpwr(one_slave, 0, 0x0816, b"\0")
    fpwr(one_slave, 0, 0x0810, b"\0\x12")
    assert fprd(one_slave, 0, 0x0810, 2).data == b"\0\x12"


def test_inputs_of_one_cycle_stay_together_while_they_are_read(one_slave):
    sync_manager(one_slave, 0, 3, 0x1140, 4, BUFFERED_IN)
    assert fprd(one_slave, 0, 0x1140, 4).wkc == 0  # none was written
    record = one_slave.escs[0]

    def publish(data):
        record["local"][0x1140:0x1144] = list(data)
        record["sm_fresh"][3] = 1
        record["memory"][0x081D] &= 0xCF

    publish(b"aaaa")
    assert fprd(one_slave, 0, 0x1140, 2).data == b"aa"
    publish(b"bbbb")
    assert fprd(one_slave, 0, 0x1142, 2).data == b"aa"
    assert fprd(one_slave, 0, 0x1142, 2).wkc == 0  # closed: it begins at the start again
    assert fprd(one_slave, 0, 0x1140, 4).data == b"bbbb"


def test_events_come_in_the_irq_field_as_they_are_masked(one_slave):
    one_slave.pdis[0].al_status(2)
    assert fprd(one_slave, 0, 0x0000, 1).irq == 0
    fpwr(one_slave, 0, 0x0200, b"\x08\0")
    assert fprd(one_slave, 0, 0x0000, 1).irq == 0x0008
    assert fprd(one_slave, 0, 0x0130, 2).data == b"\2\0"
    assert fprd(one_slave, 0, 0x0000, 1).irq == 0


def test_registers_that_are_none_count_nothing(one_slave):
    assert fprd(one_slave, 0, 0x0040 + 1, 1).wkc == 0
    assert fpwr(one_slave, 0, 0x0000, b"\x55").wkc == 0  # and a type cannot be written
    assert fprd(one_slave, 0, 0x0000, 1).data == b"\x11"
    assert fprd(one_slave, 0, 0x2FFF, 2).wkc == 0  # half outside the memory


def test_process_data_watchdog_bites_once(one_slave):
    segment = one_slave
    fpwr(segment, 0, 0x0420, (100).to_bytes(2, "little"))  # x 100 µs
    sync_manager(segment, 0, 2, 0x1100, 1, BUFFERED_OUT | 0x40)
    fpwr(segment, 0, 0x1100, b"x", now=1_000_000)
    assert segment.next_time == 11_000_000
    segment.poll(10_999_999)
    assert fprd(segment, 0, 0x0440, 4).data == b"\1\0\0\0"
    segment.poll(11_000_000)
    segment.poll(99_000_000)
    assert fprd(segment, 0, 0x0440, 4).data == b"\0\0\1\0"
    fpwr(segment, 0, 0x1100, b"x", now=100_000_000)
    assert fprd(segment, 0, 0x0440, 1).data == b"\1"


# ------------------------------------------------------------------- frames


def test_frames_as_text():
    frame = pack(
        [
            Datagram(C.FPRD, 0x1001, 0x0130, b"\2\0", 1),
            logical(C.LRW, 0x10000, b"\xaa")._replace(index=7),
        ]
    )
    assert text(frame) == "FPRD 1001:0130 [2] 0200 wkc 1 | LRW  00010000 [1] aa wkc 0"
    # destination, source, type 88A4h, 1 << 12 | 27 bytes; FPRD, index, 1001h, 0130h, more | 2, irq
    assert frame.hex().startswith("ffffffffffff01010101010188a41b1004000110300102800000020001000c")


def test_frames_round_trip_and_refuse_what_is_cut():
    rows = [Datagram(c, 1, 2, bytes(range(c)), 3, 4, 5, True) for c in C]
    assert unpack(pack(rows)) == rows
    with pytest.raises(ValueError, match=r"longer than its frame|cut off"):
        unpack(pack(rows)[:100])
    with pytest.raises(ValueError, match="several frames"):
        pack([Datagram(C.BRD, 0, 0, bytes(1486)), Datagram(C.BRD, 0, 0, b"")])


def test_snapshot_of_a_segment_goes_on_bit_by_bit():
    segment, other = (mailboxes(addressed(bare(3, clocks=[0, 40_000]))) for _ in range(2))
    feed(segment, broken_frames(5, 300))
    segment.break_link(1)
    kept = segment.snapshot()
    other.restore(kept)
    assert other.snapshot() == kept
    feed(segment, broken_frames(6, 300))
    feed(other, broken_frames(6, 300))
    assert other.snapshot() == segment.snapshot()
    with pytest.raises(ValueError, match="take a new one"):
        bare(2).restore(kept)


def test_a_latch_input_keeps_the_system_time_until_it_is_read(one_slave):
    fpwr(one_slave, 0, 0x09A8, b"\1")  # single event at rising edges
    one_slave.latch(0, 0, True, 1000)
    one_slave.latch(0, 0, True, 2000)  # the first one is kept
    one_slave.latch(0, 0, False, 3000)
    assert fprd(one_slave, 0, 0x09AE, 1).data == b"\3"
    assert fprd(one_slave, 0, 0x09B0, 8).data == (1000).to_bytes(8, "little")
    assert fprd(one_slave, 0, 0x09B8, 8).data == (3000).to_bytes(8, "little")
    assert fprd(one_slave, 0, 0x09AE, 1).data == b"\0"  # both have been read
    one_slave.latch(0, 0, True, 4000)
    assert fprd(one_slave, 0, 0x09B0, 8).data == (4000).to_bytes(8, "little")


def test_a_port_is_closed_and_opened_by_its_loop_control():
    segment = addressed(bare(3))
    fpwr(segment, 0, 0x0101, b"\x0c")  # port 1 closed
    assert one(segment, C.BRD, 0, 0, b"\0").wkc == 1
    assert fprd(segment, 0, 0x0110, 2).data[1] & 0x0C == 0x04
    fpwr(segment, 0, 0x0101, b"\0")
    assert one(segment, C.BRD, 0, 0, b"\0").wkc == 3


def test_09_with_all_ports_closed_port_0_is_the_recovery_port():
    segment = addressed(bare(2))
    fpwr(segment, 0, 0x0100, b"\1\xff\0\0")  # all four closed
    assert one(segment, C.BRD, 0, 0, b"\0").wkc == 1  # it is there, and who is behind it is not
    assert fprd(segment, 0, 0x0101, 1).data == b"\xff"
    fpwr(segment, 0, 0x0100, b"\1\0\0\0")
    assert one(segment, C.BRD, 0, 0, b"\0").wkc == 2


def test_auto_close_waits_for_the_master_after_a_broken_link():
    segment = addressed(bare(2))
    fpwr(segment, 0, 0x0101, b"\x04")
    segment.break_link(0)
    segment.heal_link(0)
    assert one(segment, C.BRD, 0, 0, b"\0").wkc == 1
    fpwr(segment, 0, 0x0101, b"\x04")
    assert one(segment, C.BRD, 0, 0, b"\0").wkc == 2


def test_a_frame_that_goes_round_is_marked_and_destroyed_at_the_second_time():
    ring = addressed(bare(3, ring=True))
    ring.break_link(0)
    frame = pack([Datagram(C.BRD, 0, 0, b"\0")])
    (row,) = unpack(ring.exchange(frame, 0, 1))  # from the second port: port 0 of slave 1 is a loop
    assert (row.wkc, row.circulating) == (2, True)
    (row,) = unpack(ring.exchange(frame, 0, 0))
    assert (row.wkc, row.circulating) == (1, False)
    loose = pack([Datagram(C.BRD, 0, 0, b"\0", circulating=True)])
    assert ring.exchange(loose, 0, 1) is None


def test_power_off_takes_a_slave_and_those_behind_it_away():
    segment = addressed(bare(3))
    segment.power(1, False)
    assert one(segment, C.BRD, 0, 0, b"\0").wkc == 1
    segment.power(1, True)
    assert one(segment, C.BRD, 0, 0, b"\0").wkc == 3
    assert fprd(segment, 1, 0, 1).wkc == 0  # its station address is gone
