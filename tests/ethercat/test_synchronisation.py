"""What a slave counts and shows of its synchronisation: 0930h-0935h, 1C32h:0B-0D."""

import pytest
from test_segment_master import AKD, Clocked, slaves
from wired import O, P, S, Wired

from servogym.drive.ethercat.frame import Command, Datagram
from servogym.drive.ethercat.master import EtherCatMaster
from servogym.drive.ethercat.segment import Segment

MS, US = 1_000_000, 1000


def deviation(start, difference):
    """Of clock periods, from 0930h and 0932h (ESC data sheet, section II, 0932h)."""
    return 5 * difference / ((start + difference + 2) * (start - difference + 2))


class Pulled:
    """A clock that is off, steered by FRMW each ms."""

    def __init__(self, ppb, depth=None):
        self.master = EtherCatMaster(Clocked(Segment(slaves(AKD, AKD), clocks=[0, ppb])))
        self.master.scan()
        self.master.synchronise()
        self.slave = self.master.slaves[1]
        if depth is not None:
            self.slave.write(0x0935, bytes([depth]))

    def after(self, frames):
        for _ in range(frames):
            self.master.wire.now += MS
            self.master.send(Datagram(Command.FRMW, 0x1001, 0x0910, bytes(8)))
        return self

    @property
    def shown(self):
        value = int.from_bytes(self.slave.read(0x0932, 2), "little", signed=True)
        return deviation(self.slave.number(0x0930, 2), value)


@pytest.mark.parametrize("ppb", [50_000, -50_000, 3_000])
def test_36_0932h_shows_the_deviation_of_the_clocks(ppb):
    shown = Pulled(ppb, depth=0).after(3000).shown
    step = 0.3e-6  # of 0932h, with 1000h in 0930h
    assert shown == pytest.approx(-ppb * 1e-9, abs=step, rel=0.03)


def test_36_the_filter_0935h_smooths_the_deviation_shown():
    quick, slow = (abs(Pulled(50_000, depth).after(1500).shown) for depth in (2, 12))
    assert quick == pytest.approx(50e-6, rel=0.05)
    assert 0 < slow < 0.6 * quick


@pytest.mark.parametrize(
    ("register", "value"), [(0x0930, b"\0\x10"), (0x0934, b"\4"), (0x0935, b"\x0c")]
)
def test_36_0930h_and_both_filter_depths_reset_what_is_shown(register, value):
    pulled = Pulled(50_000, depth=2).after(300)
    assert pulled.slave.number(0x092C, 4)
    assert pulled.slave.number(0x0932, 2)
    pulled.slave.write(register, value)
    assert pulled.slave.number(0x092C, 4) == 0
    assert pulled.slave.number(0x0932, 2) == 0


# ------------------------------------------------------------- 1C32h (ETG.1020)


def send(slave, now, image):
    slave.now = now
    assert slave.outputs(image) == 1


def counters(slave):
    return [int.from_bytes(slave.upload(0x1C32, n), "little") for n in (0x0B, 0x0C, 0x0D)]


def test_26_outputs_that_come_within_the_shortest_cycle_are_counted_in_1c32h_0c():
    slave = Wired("generic").to(P, S, O)  # shortest cycle 500 µs
    image, now = bytes(slave.drive.rpdo_size), 10 * MS
    for pause, exceeded in ((MS, 0), (500 * US, 0), (499 * US, 1), (100 * US, 2), (MS, 2)):
        now += pause
        send(slave, now, image)
        assert counters(slave) == [0, exceeded, 0]
    slave.request(S)
    send(slave, now + 100 * US, image)
    assert counters(slave) == [0, 2, 0], "in OPERATIONAL only"


def test_26_outputs_too_short_before_sync0_are_counted_in_1c32h_0d_and_wait_for_the_next_edge():
    slave = Wired("generic").to(P)  # calculation and copy time 10 µs
    slave.write(0x09A0, MS.to_bytes(4, "little"))
    slave.write(0x0981, [3])
    slave.to(S, O)
    edge = slave.segment.next_time
    for n, (before, missed, short, taken) in enumerate(
        [(500 * US, 0, 0, True), (11 * US, 0, 0, True), (9 * US, 0, 1, False)]
    ):
        image = bytes([6 + n]) + bytes(slave.drive.rpdo_size - 1)
        now = edge + n * MS
        send(slave, now - before, image)
        slave.now = now
        slave.segment.poll(now)
        assert (slave.drive.read("controlword") == 6 + n) == taken
        assert counters(slave) == [missed, 0, short]
    slave.segment.poll(edge + 3 * MS)
    assert slave.drive.read("controlword") == 8
    assert counters(slave) == [0, 0, 1]
    slave.segment.poll(edge + 4 * MS)
    assert counters(slave) == [1, 0, 1]
    assert slave.upload(0x1C32, 0x20) == b"\1", "the last edge had no new outputs"
