"""The master in memory on whole slaves: scan, map, OP, process data, clocks."""

import struct

import pytest

from servogym.drive.drive import Drive
from servogym.drive.ethercat.al import AlState
from servogym.drive.ethercat.bus import Bus
from servogym.drive.ethercat.frame import Command, Datagram
from servogym.drive.ethercat.master import EtherCatMaster
from servogym.drive.ethercat.segment import Segment
from servogym.drive.ethercat.slave import Slave

AKD = "kollmorgen_akd"
MODELS = (AKD, "festo_cmmp_as", "generic")


def slaves(*models):
    return [Slave(Drive(model, bus="ethercat")) for model in models]


def bus(*models, clock="frame", **arguments):
    return Bus(Segment(slaves(*models), **arguments), clock=clock)


@pytest.mark.parametrize("model", MODELS)
def test_scan_map_and_op_of_every_model(model):
    master = EtherCatMaster(bus(model, model))
    assert [s.description.name for s in master.scan()] == [
        Drive(model, bus="ethercat").model.ethercat.name
    ] * 2
    master.to_op()
    assert all(master.cycle() for _ in range(100))
    assert master.wrong == 0
    assert {slave.state for slave in master.slaves} == {AlState.OPERATIONAL}


def test_43_thirty_two_slaves_in_one_frame_of_1486_bytes():
    master = EtherCatMaster(bus(*[AKD] * 32))
    master.scan()
    master.to_preop()
    for slave in master.slaves:
        slave.assign([0x1720], [0x1B20])  # 14 and 32 bytes
    master.map()
    ((begin, size, members),) = master._groups
    assert len(members) == 32
    assert size == 32 * 46
    master._groups = [(begin, 1486, members)]  # all a frame can have
    master.to_op()
    assert all(master.cycle() for _ in range(100))
    # outputs of the last slave arrive, and its inputs come from it
    master.slaves[31].outputs[:] = struct.pack("<HiHhI", 6, 0, 0, 0, 0)
    master.cycle()
    drive = master.wire.segment.stations[31].drive
    assert drive.read("controlword") == 6
    assert master.wire.segment.stations[30].drive.read("controlword") == 0


def test_43_a_map_split_over_three_frames():
    wire = bus(*[AKD] * 9)
    master = EtherCatMaster(wire, most=3 * 12)
    master.to_op()
    assert master.frames == 3
    assert all(master.cycle() for _ in range(50))
    for i, slave in enumerate(master.slaves):
        slave.outputs[:] = struct.pack("<iH", 1000 * i, 6)
    master.cycle()
    words = [s.drive.read("controlword") for s in wire.segment.stations]
    assert words == [6] * 9


def test_a_frame_that_is_cut_between_two_slaves_still_gives_whole_images():
    wire = bus(AKD, AKD)
    master = EtherCatMaster(wire)
    master.to_op()
    ((begin, _size, members),) = master._groups
    for slave in master.slaves:
        slave.outputs[:] = b"abcd\6\0"
    image = b"".join(bytes(s.outputs) for s in members) + bytes(12)
    from servogym.drive.ethercat.frame import logical

    first = master.send(logical(Command.LRW, begin, image[:10]))[0]
    assert first.wkc == 4  # outputs of both were touched
    assert wire.segment.stations[1].drive.read("controlword") == 0
    master.send(logical(Command.LRW, begin + 10, image[10:]))
    assert wire.segment.stations[1].drive.read("controlword") == 6


def places(segment):
    """How far each slave is from the first one (hops): the oracle of the delays."""
    times = segment._walks[0][1]
    order = segment._walks[0][0]
    return {int(i): int(t - times[0]) for i, t in zip(order, times, strict=True)}


def test_35_delays_of_a_line_of_eight_are_multiples_of_the_hop():
    wire = bus(*[AKD] * 8, hop=640)
    master = EtherCatMaster(wire)
    master.scan()
    assert master.synchronise() == {k: 640 * k for k in range(8)}
    assert [s.number(0x0928, 4) for s in master.slaves] == [640 * k for k in range(8)]


def test_35_delays_of_a_branch():
    #   0 -1- 1 -1- 2      port 3 of slave 1 has slaves 3 and 4: it is passed first
    links = [((-1, 0), (0, 0)), ((0, 1), (1, 0)), ((1, 3), (2, 0)), ((2, 1), (3, 0)),
             ((1, 1), (4, 0)), ((1, 2), (5, 0))]
    wire = bus(*[AKD] * 6, hop=700, links=links)
    master = EtherCatMaster(wire)
    master.scan()
    delays = master.synchronise()
    assert delays == places(wire.segment)
    assert delays == {0: 0, 1: 700, 2: 1400, 3: 2100, 4: 700 * 6, 5: 700 * 8}


def test_35_delay_of_a_slave_with_its_cable_at_the_other_port():
    links = [((-1, 0), (0, 0)), ((0, 1), (1, 0)), ((1, 1), (2, 1))]
    wire = bus(*[AKD] * 3, hop=500, links=links)
    master = EtherCatMaster(wire)
    master.scan()
    assert master.synchronise() == {0: 0, 1: 500, 2: 1000}
    assert master.slaves[2].number(0x0110, 2) >> 8 & 3 == 1  # its port 0 is a loop


def test_35_delays_where_a_slave_in_the_middle_is_the_wrong_way_round():
    """Its cables are swapped: it processes a frame on the way back (data sheet, section I)."""
    links = [((-1, 0), (0, 0)), ((0, 1), (1, 1)), ((1, 0), (2, 0)), ((2, 1), (3, 0))]
    wire = bus(*[AKD] * 4, hop=500, links=links)
    master = EtherCatMaster(wire)
    master.scan()  # in the order of processing: 0, 2, 3, 1
    assert places(wire.segment) == {0: 0, 2: 1000, 3: 1500, 1: 2500}
    assert master.synchronise() == {0: 0, 1: 1000, 2: 1500, 3: 2500}
    turned = master.slaves[3]
    entrance, out = turned.number(0x0904, 4), turned.number(0x0900, 4)
    assert out - entrance == 2000  # two slaves and back
    assert turned.number(0x0918, 4) == out
    assert master.slaves[3].read(0x0110, 2) == wire.segment.escs["memory"][1, 0x110:0x112].tobytes()


def test_35_delays_of_a_branch_behind_a_slave_the_wrong_way_round():
    links = [((-1, 0), (0, 0)), ((0, 1), (1, 1)), ((1, 2), (2, 0)), ((1, 0), (3, 0)),
             ((1, 3), (4, 2)), ((0, 3), (5, 0))]
    wire = bus(*[AKD] * 6, hop=700, links=links)
    master = EtherCatMaster(wire)
    master.scan()
    order, _ = wire.segment._walks[0]
    delays = master.synchronise()
    assert {int(order[i]): delay for i, delay in delays.items()} == places(wire.segment)
    assert len(set(delays.values())) == 6


def test_36_a_clock_of_50_ppm_is_pulled_to_the_reference():
    segment = Segment(slaves(AKD, AKD, AKD), clocks=[0, 50_000, -50_000])
    master = EtherCatMaster(Clocked(segment))
    master.scan()
    master.synchronise()
    frmw = Datagram(Command.FRMW, 0x1001, 0x0910, bytes(8))
    for _ in range(2000):
        master.wire.now += 1_000_000
        master.send(frmw)

    def difference(slave):
        value = slave.number(0x092C, 4)
        return -(value & 0x7FFFFFFF) if value >> 31 else value

    for i in (1, 2):
        own = own_time(segment, i, master.wire.now)
        assert abs(own - own_time(segment, 0, master.wire.now)) < 1000
        assert abs(difference(master.slaves[i])) < 1000
    # without FRMW they drift apart by 50 µs a second
    free = segment.escs["drift_ppb"][1]
    assert free == pytest.approx(-50_000, abs=2000)
    master.slaves[1].write(0x0930, b"\0\x10")
    assert segment.escs["drift_ppb"][1] == 0
    assert difference(master.slaves[1]) == 0
    before = own_time(segment, 1, master.wire.now) - own_time(segment, 0, master.wire.now)
    master.wire.now += 1_000_000_000
    after = own_time(segment, 1, master.wire.now) - own_time(segment, 0, master.wire.now)
    assert after - before == pytest.approx(50_000, abs=10)
    master.send(frmw)
    assert difference(master.slaves[1]) == pytest.approx(after, abs=100)


class Clocked:
    """A segment whose frames are sent when the test says."""

    def __init__(self, segment):
        self.segment = segment
        self.now = 0

    def exchange(self, frame, now=0):
        return self.segment.exchange(frame, self.now)


def own_time(segment, slave, now):
    from servogym.drive.ethercat.controller import dc

    return int(dc.system_time(segment.escs[slave], now))
