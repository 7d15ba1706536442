"""Three clocks, SYNC0 off, before and behind SAFE_OP: how much time one frame lets pass."""

import time

import pytest

from servogym.drive.ethercat.al import AlState
from servogym.drive.ethercat.bus import Bus, Clock
from servogym.drive.ethercat.controller.record import SyncMode
from servogym.drive.ethercat.frame import Command, Datagram, pack
from servogym.drive.ethercat.master import EtherCatMaster
from servogym.drive.ethercat.slave import interpolation_ns
from servogym.envs.plants.catalogue import ethercat_line

MS = 1_000_000
MODELS = ("generic", "kollmorgen_akd", "festo_cmmp_as")
WHEN = ("off", "before", "behind")
COMMANDS = {0x40: 6, 0x21: 7, 0x23: 15, 0x27: 15}


class Paced:
    """A wire whose frames are sent when the test says."""

    def __init__(self, bus):
        self.bus, self.now = bus, 0

    def exchange(self, frame, now=0):
        return self.bus.exchange(frame, self.now)


def brought_up(model, clock, when, axis="linear", slaves=1, period=2 * MS):
    """A master in OP; SYNC0 of `period` is set before SAFE_OP, behind it or not at all."""
    segment, machines = ethercat_line([model] * slaves, axis)
    master = EtherCatMaster(Paced(Bus(segment, machines, clock)))
    master.scan()
    master.to_preop()
    for slave in master.slaves:
        slave.mailbox.download(0x60C2, 1, bytes([period // MS]))
        if not slave.upload(0x1C12):
            slave.assign([0x1600], [0x1A00])
    master.synchronise()
    if when == "before":
        master.sync0(period)
    master.map()
    master.to(AlState.SAFE_OPERATIONAL)
    for _ in range(15):  # as a master does until its SYNC0 begins
        master.wire.now += period
        master.cycle()
    if when == "behind":
        master.sync0(period)
    master.to(AlState.OPERATIONAL)
    return master, machines


def dc_time(master):
    return master.slaves[0].number(0x0910, 8)


def ran(master, machines, cycles, period=2 * MS):
    """DC time and physics of each cycle (ns)."""
    rows = []
    for _ in range(cycles):
        before = dc_time(master), machines[0].time
        master.wire.now += period
        assert master.cycle()
        rows.append(
            (dc_time(master) - before[0], round((machines[0].time - before[1]) * 1e9)),
        )
    return rows


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("when", WHEN)
@pytest.mark.parametrize("clock", Clock)
def test_a_frame_lets_one_period_pass_whatever_the_clock_and_sync0(model, clock, when):
    master, machines = brought_up(model, clock, when)
    mode = master.wire.bus.segment.escs["sync_mode"][0]
    assert (mode == SyncMode.SYNC0) == (when == "before")
    rows = ran(master, machines, 300)
    assert {dc for dc, _ in rows} == {2 * MS}
    assert {physics for _, physics in rows} == {2 * MS}
    assert master.slaves[0].state == AlState.OPERATIONAL


@pytest.mark.parametrize("clock", Clock)
@pytest.mark.parametrize("when", WHEN)
def test_a_drive_is_enabled_whatever_the_clock_and_sync0(clock, when):
    master, machines = brought_up("generic", clock, when)
    drive = machines[0].drives["x"]
    place = drive.read("position_actual_value")
    for _ in range(1000):
        word = COMMANDS.get(drive.read("statusword") & 0x6F, 6)
        image = word.to_bytes(2, "little") + place.to_bytes(4, "little", signed=True) + b"\x08"
        master.slaves[0].outputs[:] = image[: len(master.slaves[0].outputs)]
        master.wire.now += 2 * MS
        assert master.cycle()
    assert drive.read("statusword") & 0x6F == 0x27
    assert master.slaves[0].state == AlState.OPERATIONAL


@pytest.mark.parametrize("axis", ["linear", "none"])
def test_a_slave_that_joins_late_lets_time_pass_at_once(axis):
    """With the clock frame, when the slaves that were there before have left."""
    master, _machines = brought_up("generic", "frame", "off", axis, slaves=2)
    first, second = master.slaves
    second.request(AlState.PRE_OPERATIONAL)
    for _ in range(100):
        master.cycle()
    first.request(AlState.PRE_OPERATIONAL)
    second.request(AlState.SAFE_OPERATIONAL)
    second.request(AlState.OPERATIONAL)
    master.cycle()
    before = dc_time(master)
    for _ in range(100):
        master.cycle()
    assert dc_time(master) - before == 200 * MS


def test_sync0_period_that_is_not_60c2h_passes_with_each_frame():
    master, machines = brought_up("generic", "frame", "before", period=4 * MS)
    master.slaves[0].mailbox.download(0x60C2, 1, b"\1")
    assert interpolation_ns(machines[0].drives["x"]) == MS
    assert set(ran(master, machines, 100)) == {(4 * MS, 4 * MS)}


# ------------------------------------------------------- short periods, jumps of the time


def spent(work):
    begin = time.process_time()
    work()
    return time.process_time() - begin


@pytest.mark.parametrize("state", [AlState.INIT, AlState.PRE_OPERATIONAL, AlState.OPERATIONAL])
@pytest.mark.parametrize("cycle", [1, 20, 100, 999])
def test_a_sync0_period_of_nanoseconds_costs_nothing_where_no_drive_runs_with_it(state, cycle):
    master, _ = brought_up("generic", "dc", "off", "none")
    slave = master.slaves[0]
    if state != AlState.OPERATIONAL:
        slave.request(state)
    bus = master.wire.bus
    slave.write(0x09A0, cycle.to_bytes(4, "little"))
    slave.write(0x0981, b"\3")

    def work():
        for _ in range(100):
            master.wire.now += 10 * MS
            bus.advance(master.wire.now)

    assert spent(work) < 0.5, "100 calls; edge by edge it was 600 ms of each ms"
    before = dc_time(master)
    following = slave.number(0x0990, 8)
    assert 0 < following - before <= cycle
    assert slave.number(0x0990, 8) == following
    assert bus.segment.escs["sync0_count"][0] >= 1_000 * MS // cycle


@pytest.mark.parametrize("clock", Clock)
@pytest.mark.parametrize("data", [(0x09A0, 20), (0x09A0, 0), (0x09A0, 333_333)])
def test_a_drive_that_runs_with_sync0_goes_to_pre_op_where_its_period_becomes_impossible(
    clock, data
):
    master, _ = brought_up("generic", clock, "before")
    slave, (register, value) = master.slaves[0], data
    slave.write(register, value.to_bytes(4, "little"))
    assert slave.number(0x0130, 2) == AlState.PRE_OPERATIONAL | 0x10
    assert slave.number(0x0134, 2) == 0x0035

    def work():
        for _ in range(100):
            master.wire.now += 10 * MS
            master.cycle()

    assert spent(work) < 0.5


@pytest.mark.parametrize("clock", Clock)
def test_a_drive_whose_sync0_is_switched_off_goes_to_safe_op_and_comes_back_with_it(clock):
    master, machines = brought_up("generic", clock, "before")
    slave = master.slaves[0]
    slave.write(0x0981, b"\0")
    assert (slave.number(0x0130, 2), slave.number(0x0134, 2)) == (0x14, 0x002D)
    slave.recover()
    with pytest.raises(RuntimeError, match="002Dh"):
        slave.request(AlState.OPERATIONAL)
    slave.recover()
    master.sync0(2 * MS)
    for _ in range(15):
        master.wire.now += 2 * MS
        master.cycle()
    slave.request(AlState.OPERATIONAL)
    assert set(ran(master, machines, 50)) == {(2 * MS, 2 * MS)}


@pytest.mark.parametrize("jump", [1 << 62, -(1 << 62), 10**18, -(10**18), 10**12, 1])
def test_a_system_time_that_jumps_stops_nothing(jump):
    master, _ = brought_up("generic", "dc", "before", "none")
    slave = master.slaves[0]
    offset = slave.number(0x0920, 8) + jump & (1 << 64) - 1

    def work():
        slave.write(0x0920, offset.to_bytes(8, "little"))
        for _ in range(100):
            master.wire.now += 2 * MS
            master.cycle()

    assert spent(work) < 1.0


@pytest.mark.parametrize("start", [0, 1, 1 << 62, (1 << 63) - 1, 1 << 63, (1 << 64) - 1])
@pytest.mark.parametrize("ppb", [0, 300_000, -300_000])
def test_any_start_time_is_borne(start, ppb):
    master, _ = brought_up("generic", "dc", "off", "none")
    segment = master.wire.bus.segment
    segment.escs["clock_ppb"][0] = ppb
    slave = master.slaves[0]
    slave.request(AlState.PRE_OPERATIONAL)

    def work():
        slave.write(0x09A0, MS.to_bytes(4, "little"))
        slave.write(0x0990, start.to_bytes(8, "little"))
        slave.write(0x0981, b"\3")
        slave.request(AlState.SAFE_OPERATIONAL)
        for _ in range(100):
            master.wire.now += MS
            master.cycle()

    assert spent(work) < 1.0


# ------------------------------------------------------------------ what a master should know


@pytest.mark.parametrize(
    ("clock", "when", "says"),
    [
        ("frame", "before", "a master that aligns its cycle with the DC time needs --clock dc"),
        ("frame", "behind", "set it in PRE_OP, then request SAFE_OP"),
        ("dc", "behind", "set it in PRE_OP, then request SAFE_OP"),
        ("real", "behind", "set it in PRE_OP, then request SAFE_OP"),
        ("dc", "before", ""),
        ("real", "before", ""),
        ("frame", "off", ""),
    ],
)
def test_what_sync0_means_here_is_said_once(clock, when, says):
    master, _ = brought_up("generic", clock, when, "none")
    lines = [*dict.fromkeys(master.wire.bus.notes())]
    assert len(lines) == bool(says)
    assert all(line.startswith("slave 0: SYNC0 of 2 ms") and says in line for line in lines)
    assert master.wire.bus.notes() == []


def test_a_frame_that_is_no_process_data_lets_no_time_pass():
    segment, machines = ethercat_line(["generic"], "none")
    bus = Bus(segment, machines)
    for _ in range(100):
        bus.exchange(pack([Datagram(Command.BRD, 0, 0x0130, bytes(2))]))
    assert bus.time == 0
