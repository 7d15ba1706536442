"""Links, bit times and arbitration; oracles counted by hand or known from the literature."""

import can
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from servogym.drive.canopen.bit_time import crc15, length, priority, stuff_bits, stuffed
from servogym.drive.canopen.faulty import Faults, Faulty
from servogym.drive.canopen.frame import Frame, parse
from servogym.drive.canopen.link import QUEUE, Loopback
from servogym.drive.wire.bus import CanLink, Traced

FRAMES = st.one_of(
    st.builds(Frame, st.integers(0, 0x7FF), st.binary(max_size=8), st.booleans()),
    st.builds(
        Frame, st.integers(0, 0x1FFF_FFFF), st.binary(max_size=8), st.booleans(), st.just(True)
    ),
)


# ---------------------------------------------------------------- bit times


def test_crc_has_the_check_value_of_crc_15_can():
    assert crc15("".join(f"{byte:08b}" for byte in b"123456789")) == 0x059E


def test_a_frame_of_zeros_has_a_stuff_bit_after_each_five():
    # 19 zeros up to the DLC and a CRC of 15 zeros: 34 bits, 6 stuff bits, 10 + 3 that are fixed
    assert stuffed(Frame(0)) == "0" * 34
    assert length(Frame(0)) == 34 + 6 + 10 + 3


@pytest.mark.parametrize(("bits", "added"), [
    ("00000", 1), ("0000", 0), ("0000011110", 2), ("000001111", 2), ("00000111", 1),
    ("1111100000", 2), ("01" * 20, 0), ("0" * 10, 2),
])
def test_a_stuff_bit_begins_the_next_run(bits, added):
    assert stuff_bits(bits) == added


@pytest.mark.parametrize("n", range(9))
def test_base_frames_have_47_and_8_bits_a_byte_before_stuffing(n):
    frame = Frame(0x555, b"\x55" * n)
    assert length(frame) - stuff_bits(stuffed(frame)) == 47 + 8 * n


def test_an_extended_frame_has_20_bits_more():
    assert len(stuffed(Frame(0x555, extended=True))) == len(stuffed(Frame(0x555))) + 20


def test_a_remote_frame_carries_no_data_bits():
    assert len(stuffed(Frame(0x701, b"\0", remote=True))) == len(stuffed(Frame(0x701)))


@given(FRAMES)
def test_stuffing_adds_no_more_than_the_formula_and_leaves_no_run_of_six(frame):
    bits = stuffed(frame)
    assert stuff_bits(bits) <= (len(bits) - 1) // 4
    assert crc15(bits) == 0  # the receiver's check
    sent = ""
    for bit in bits:
        sent += bit
        if len(sent) >= 5 and len(set(sent[-5:])) == 1:
            sent += "1" if bit == "0" else "0"
    assert len(sent) == len(bits) + stuff_bits(bits)
    assert "000000" not in sent
    assert "111111" not in sent


def test_worst_case_of_stuffing_is_reached_by_a_pattern():
    bits = "00000" + "11110000" * 12 + "111"
    assert stuff_bits(bits[:98]) == (98 - 1) // 4  # 34 + 8 · 8 bits


def test_arbitration_prefers_low_identifiers_then_data_then_base_frames():
    order = [
        Frame(0x100), Frame(0x101), Frame(0x101, remote=True), Frame(0x101 << 18, extended=True),
        Frame(0x101 << 18, remote=True, extended=True), Frame(0x101 << 18 | 1, extended=True),
        Frame(0x102),
    ]
    assert sorted(reversed(order), key=priority) == order


# ---------------------------------------------------------------- loop-back


def texts(frames):
    return [str(frame) for frame in frames]


def test_members_hear_all_others_but_not_themselves():
    bus = Loopback()
    a, b, c = bus.join(), bus.join(), bus.join()
    a.send(parse("181#01"), 5)
    assert texts(b.receive(5)) == texts(c.receive(5)) == ["181#01"]
    assert a.receive(5) == []


def test_lowest_identifier_first_but_each_member_in_its_own_order():
    bus = Loopback()
    master, x, y, listener = (bus.join() for _ in range(4))
    for frame in ("201#", "080#"):
        master.send(parse(frame), 0)
    x.send(parse("182#"), 0)
    for frame in ("701#", "081#"):
        y.send(parse(frame), 0)
    assert texts(listener.receive(0)) == ["182#", "201#", "080#", "701#", "081#"]


def test_frames_take_their_bit_times_one_after_the_other():
    bus = Loopback(500_000)
    a, b, listener = bus.join(), bus.join(), bus.join()
    first, second = Frame(0x181, bytes(8)), Frame(0x182, b"\x55" * 8)
    b.send(second, 0)
    a.send(first, 0)
    end = 2 * length(first)
    assert bus.due() == end
    assert listener.receive(end - 1) == []
    assert listener.receive(end) == [first]
    assert bus.due() == end + 2 * length(second)
    assert listener.receive(end + 2 * length(second)) == [second]
    assert bus.due() is None


def test_a_running_frame_is_not_interrupted_by_a_higher_priority():
    bus = Loopback(1_000_000)
    a, b, listener = bus.join(), bus.join(), bus.join()
    slow, urgent = Frame(0x701, b"\x05"), Frame(0x080)
    a.send(slow, 0)
    bus.advance(10)
    b.send(urgent, 10)
    assert listener.receive(length(slow)) == [slow]
    assert listener.receive(length(slow) + length(urgent)) == [urgent]


@pytest.mark.parametrize("bit_rate", [10_000, 83_333, 125_000, 800_000, 1_000_000])
def test_a_thousand_frames_last_exactly_their_bits(bit_rate):
    bus = Loopback(bit_rate)
    a, listener = bus.join(), bus.join()
    for _ in range(1000):
        a.send(Frame(0), 0)
    bits = 1000 * length(Frame(0))
    end = -(-bits * 1_000_000 // bit_rate)
    assert len(listener.receive(end - 1)) == 999
    assert len(listener.receive(end)) == 1


def test_a_full_bus_delays_low_priorities_and_not_high_ones():
    bus = Loopback(125_000)
    flood, low, high, listener = (bus.join() for _ in range(4))
    heavy, heartbeat, sync = Frame(0x181, b"\x55" * 8), Frame(0x701, b"\x05"), Frame(0x080)
    for _ in range(20):
        flood.send(heavy, 0)
    bus.advance(0)
    low.send(heartbeat, 1)
    high.send(sync, 1)
    after_one = 8 * (length(heavy) + length(sync))
    assert listener.receive(after_one) == [heavy, sync]
    before_last = 8 * (20 * length(heavy) + length(sync))
    assert listener.receive(before_last) == [heavy] * 19
    assert listener.receive(before_last + 8 * length(heartbeat)) == [heartbeat]
    assert bus.load(before_last) == 1.0


def test_load_is_the_share_of_bit_times():
    bus = Loopback(1_000_000)
    a = bus.join()
    a.send(Frame(0), 0)
    assert bus.load(53) == 1.0
    assert bus.load(530) == pytest.approx(0.1)
    a.send(Frame(0), 1000)
    assert bus.load(1020) == pytest.approx(73 / 1020)  # also of a frame that is still running


def test_a_member_that_does_not_listen_loses_the_oldest_frames():
    bus = Loopback()
    a, listener = bus.join(), bus.join()
    for n in range(QUEUE + 3):
        a.send(Frame(0x181, n.to_bytes(2, "little")), n)
        bus.advance(n)
    frames = listener.receive(QUEUE + 3)
    assert len(frames) == QUEUE
    assert frames[0].data == b"\x03\x00"
    assert bus.lost == 3


@pytest.mark.parametrize("bit_rate", [0, -1, 1_000_001])
def test_a_bit_rate_out_of_range_is_refused(bit_rate):
    with pytest.raises(ValueError, match=f"bit_rate = {bit_rate} bit/s is out of range 1..1000000"):
        Loopback(bit_rate)


# ------------------------------------------------------------------- faults


def through(faults, frames, seed=1, gap=100):
    """What of `frames`, sent every `gap` µs over a faulty link, arrives when."""
    bus = Loopback()
    faulty, listener = Faulty(bus.join(), faults, np.random.default_rng(seed)), bus.join()
    heard = []
    for n, frame in enumerate(frames):
        faulty.send(frame, n * gap)
        heard += [(n * gap, f) for f in listener.receive(n * gap)]
    for time in range(len(frames) * gap, len(frames) * gap + 30_000, gap):
        faulty.receive(time)
        heard += [(time, f) for f in listener.receive(time)]
    return heard, faulty


NUMBERED = [Frame(0x181, n.to_bytes(4, "little")) for n in range(500)]


def test_without_faults_nothing_changes():
    heard, faulty = through(Faults(), NUMBERED)
    assert heard == [(n * 100, frame) for n, frame in enumerate(NUMBERED)]
    assert not any(faulty.counts.values())


def test_one_seed_gives_the_same_faults_and_another_one_others():
    faults = Faults(drop=0.1, corrupt=0.1, delay=0.1, reorder=0.1, duplicate=0.1, bus_off=0.01)
    assert through(faults, NUMBERED, 3)[0] == through(faults, NUMBERED, 3)[0]
    assert through(faults, NUMBERED, 3)[0] != through(faults, NUMBERED, 4)[0]


def test_dropped_frames_are_missing():
    heard, faulty = through(Faults(drop=0.25), NUMBERED)
    assert len(heard) == 500 - faulty.counts["drop"]
    assert 80 < faulty.counts["drop"] < 170


def test_corrupted_frames_differ_in_one_bit():
    heard, faulty = through(Faults(corrupt=1.0), NUMBERED)
    for (_, frame), sent in zip(heard, NUMBERED, strict=True):
        difference = int.from_bytes(frame.data, "little") ^ int.from_bytes(sent.data, "little")
        assert difference.bit_count() == 1
    assert faulty.counts["corrupt"] == 500


def test_delayed_frames_come_in_time():
    heard, _ = through(Faults(delay=1.0, longest_delay=2_000), NUMBERED)
    assert sorted(f for _, f in heard) == sorted(NUMBERED)
    delays = [time - 100 * int.from_bytes(f.data, "little") for time, f in heard]
    assert all(0 < delay <= 2_100 for delay in delays)
    assert len(set(delays)) > 10


def test_reordered_frames_change_places_with_the_next():
    heard, _ = through(Faults(reorder=1.0), NUMBERED[:4])
    assert [f.data[0] for _, f in heard] == [1, 0, 3, 2]


def test_a_reordered_frame_without_a_next_one_comes_after_the_longest_delay():
    heard, _ = through(Faults(reorder=1.0, longest_delay=5_000), NUMBERED[:1])
    assert heard == [(5_000, NUMBERED[0])]


def test_doubled_frames_come_twice():
    heard, _ = through(Faults(duplicate=1.0), NUMBERED[:2])
    assert [f.data[0] for _, f in heard] == [0, 0, 1, 1]


def test_bus_off_takes_the_member_off_the_bus_for_its_time():
    bus = Loopback()
    faults = Faults(bus_off=1.0, bus_off_time=1_000)
    faulty, other = Faulty(bus.join(), faults, np.random.default_rng(1)), bus.join()
    faulty.send(NUMBERED[0], 0)
    assert faulty.bus_off(999)
    other.send(NUMBERED[1], 500)
    assert faulty.receive(500) == []
    assert other.receive(500) == []
    other.send(NUMBERED[2], 1_000)
    assert faulty.receive(1_000) == [NUMBERED[2]]
    assert not faulty.bus_off(1_000)
    assert faulty.counts["bus_off"] == 1


def test_faults_meet_received_frames_as_well():
    bus = Loopback()
    faulty, other = Faulty(bus.join(), Faults(drop=1.0), np.random.default_rng(1)), bus.join()
    other.send(NUMBERED[0], 0)
    assert faulty.receive(0) == []
    assert faulty.counts["drop"] == 1


@pytest.mark.parametrize(
    ("name", "value"), [("drop", 1.5), ("bus_off", -0.1), ("longest_delay", 0), ("delay", "often")]
)
def test_faults_out_of_range_are_refused(name, value):
    with pytest.raises(ValueError, match=f"{name} = {value!r}"):
        Faults(**{name: value})


# ---------------------------------------------------------------- python-can


@pytest.mark.parametrize("suffix", [".log", ".asc", ".blf"])
def test_a_trace_holds_both_directions_with_their_times(tmp_path, suffix):
    file = tmp_path / f"run{suffix}"
    bus = Loopback()
    traced, other = Traced(bus.join(), str(file)), bus.join()
    traced.send(parse("601#4041600000000000"), 1_000)
    other.send(parse("581#4B41600050020000"), 1_500)
    assert texts(traced.receive(1_500)) == ["581#4B41600050020000"]
    traced.close()
    with can.LogReader(file) as reader:
        messages = list(reader)
    assert [m.arbitration_id for m in messages] == [0x601, 0x581]
    assert [m.is_rx for m in messages] == [False, True]
    assert messages[1].timestamp - messages[0].timestamp == pytest.approx(0.0005, abs=1e-6)


def test_a_trace_with_an_unknown_suffix_is_refused(tmp_path):
    with pytest.raises(ValueError, match=r"use \.log, \.asc or \.blf"):
        Traced(Loopback().join(), str(tmp_path / "run.txtt"))


def test_a_link_to_python_can_carries_classical_frames_only(request):
    channel = f"link-{id(request)}"
    with (
        can.Bus(interface="virtual", channel=channel) as here,
        can.Bus(interface="virtual", channel=channel) as there,
    ):
        link = CanLink(here)
        there.send(can.Message(arbitration_id=0x181, data=b"\x01", is_extended_id=False))
        there.send(can.Message(is_error_frame=True))
        there.send(can.Message(arbitration_id=0x181, is_fd=True, is_extended_id=False))
        there.send(can.Message(arbitration_id=0x701, is_extended_id=False, is_remote_frame=True))
        assert texts(link.receive(0)) == ["181#01", "701#R"]
        link.send(Frame(0x12345, b"\x02", extended=True), 0)
        message = there.recv(1)
        assert (message.arbitration_id, message.is_extended_id) == (0x12345, True)
