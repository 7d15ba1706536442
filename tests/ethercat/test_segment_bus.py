"""Segments with machines behind them: clocks, process images, watchdogs, faults; in memory."""

import random
import resource
import shutil
import struct
import subprocess
import sys

import numpy as np
import pytest
from bare_segment import bare, send
from test_controller import broken_frames

from servogym.drive.drive import Drive
from servogym.drive.ethercat.al import AlState
from servogym.drive.ethercat.bus import Bus
from servogym.drive.ethercat.faulty import Fault, FaultyBus
from servogym.drive.ethercat.frame import Command, Datagram, pack
from servogym.drive.ethercat.master import EtherCatMaster
from servogym.drive.ethercat.port import EtherCatPort
from servogym.drive.ethercat.segment import Segment
from servogym.drive.ethercat.slave import Slave
from servogym.drive.kernel.words import State
from servogym.drive.master import Master
from servogym.drive.model.model import load
from servogym.drive.objects.abort import SdoAbort
from servogym.envs.engine import loop
from servogym.envs.plants.catalogue import ethercat_line
from servogym.envs.plants.linear_axis import linear_axis

AKD = "kollmorgen_akd"


def line(*models, clock="frame", faults=(), **arguments):
    machines = [linear_axis(load(model, "ethercat")) for model in models]
    drives = [drive for machine in machines for drive in machine.drives.values()]
    segment = Segment([Slave(drive) for drive in drives], **arguments)
    kind = FaultyBus if faults else Bus
    return kind(segment, machines, clock, **({"faults": faults} if faults else {}))


def operational(bus, rpdos=(0x1724,), tpdos=(0x1B24,)):
    master = EtherCatMaster(bus)
    master.scan()
    master.to_preop()
    for slave in master.slaves:
        slave.assign(rpdos, tpdos)
    master.map()
    master.to_op()
    return master


def outputs(target=0, control=0, torque=0):
    return struct.pack("<iHh", target, control, torque)


@pytest.mark.parametrize("model", [AKD, "generic", "festo_cmmp_as"])
def test_a_drive_without_an_axis_runs_its_state_machine(model):
    """`--axis none`: no motion, but states, ramps and faults as with a motor that is held."""
    segment, machines = ethercat_line([model], "none")
    master = EtherCatMaster(Bus(segment, machines))
    axis = Master(EtherCatPort(master, {"x": model}))
    axis.enable()
    assert machines[0].drives["x"].state is State.OPERATION_ENABLED
    axis.disable()
    assert machines[0].drives["x"].state is State.SWITCH_ON_DISABLED
    assert machines[0].time > 0.0


def test_33_an_episode_of_the_environment_replayed_in_frames_is_the_same_episode():
    model = load(AKD, "ethercat")
    names = [["target_position", "controlword", "modes_of_operation"]]
    shown = [["position_actual_value", "statusword"]]
    direct, wired = linear_axis(model), linear_axis(model)
    machines = (direct, wired)
    for machine in machines:
        machine.reset(positions={"x": 0.2})
    (drive,) = wired.drives.values()
    bus = Bus(Segment([Slave(drive)]), [wired])
    for machine in machines:
        next(iter(machine.drives.values())).map_pdos(names, shown)
    master = EtherCatMaster(bus)
    master.scan()
    master.to_preop()
    master.map()
    master.to(AlState.SAFE_OPERATIONAL)
    master.to(AlState.OPERATIONAL)
    for machine in machines:  # both begin here
        machine.reset(positions={"x": 0.2})
    bus.segment.images[0].prepare()
    (own,) = direct.drives.values()
    random = np.random.default_rng(3)
    places = []
    start = int(own.read("position_actual_value"))
    period = 4 * direct.physics_steps  # 60C2h: 1 ms, position cycles of 250 µs
    trail: list[tuple[bytes, bytes]] = []
    target = start
    for n in range(400):
        command = (6, 7, 15)[min(n // 5, 2)]
        target += int(random.integers(-150, 150))
        image = struct.pack("<iHb", target, command, 8)
        # directly, as the environments do
        tpdo = np.zeros((1, own.tpdo_size), np.uint8)
        loop.run(direct.addresses, period, np.frombuffer(image, np.uint8)[None], tpdo)
        # through a frame; its inputs are seen by the next one
        master.slaves[0].outputs[:] = image
        assert master.cycle()
        master.slaves[0].outputs[:] = image
        trail.append((tpdo.tobytes(), drive.collect()))
        places.append(direct.data.qpos.copy())
        assert np.array_equal(direct.data.qpos, wired.data.qpos), n
        assert np.array_equal(direct.data.qvel, wired.data.qvel), n
    assert all(a == b for a, b in trail)
    assert own.state == drive.state == State.OPERATION_ENABLED
    assert np.ptp(places) > 1e-4


# ---------------------------------------------------------- SYNC0, watchdog, faults

MS = 1_000_000


class Timed:
    """A bus whose frames come when the test says."""

    def __init__(self, bus):
        self.bus, self.now = bus, 0
        self.segment = bus.segment

    def exchange(self, frame, now=0):
        return self.bus.exchange(frame, self.now)


def synchronised(shift=250_000):
    """An AKD in OP with SYNC0 of 1 ms; -> bus, master, and the time of the next edge."""
    bus = line(AKD, clock="dc")
    wire = Timed(bus)
    master = EtherCatMaster(wire)
    master.scan()
    master.to_preop()
    master.slaves[0].assign([0x1724], [0x1B24])
    master.map()
    master.synchronise()
    master.sync0(MS, shift)
    master.to(AlState.SAFE_OPERATIONAL)
    master.slaves[0].outputs[:] = outputs()
    master.cycle()
    master.to(AlState.OPERATIONAL)
    edge = bus.segment.next_time
    return bus, wire, master, edge


def test_37_drive_cycles_begin_at_the_edge_of_sync0():
    bus, wire, master, edge = synchronised()
    drive = bus.segment.stations[0].drive
    machine = bus._plants[0].machine
    own = int(bus.segment.escs["sync0_at"][0])
    assert own % MS == 250_000  # system time of an edge: the shift
    before = machine.time
    wire.now = edge - 100
    master.slaves[0].outputs[:] = outputs(1234, 6)
    master.cycle()
    assert drive.read("controlword") == 0  # nothing before the edge
    assert machine.time == before
    wire.now = edge + 100
    master.cycle()
    assert drive.read("controlword") == 6
    assert machine.time - before == pytest.approx(1e-3)
    assert bus.segment.next_time == edge + MS


def test_37_a_late_frame_leaves_the_old_set_point_and_is_counted():
    bus, wire, master, edge = synchronised()
    drive, image = bus.segment.stations[0].drive, bus.segment.images[0]
    slave = master.slaves[0]
    for k in range(3):  # in time
        wire.now = edge + k * MS - 500_000
        slave.outputs[:] = outputs(100 + k, 0)
        master.cycle()
    bus.advance(edge + 2 * MS + 1)
    missed = int(image.esc.sync_errors)
    wire.now = edge + 3 * MS + 100_000  # 100 µs late
    slave.outputs[:] = outputs(999, 0)
    master.cycle()
    assert drive.read("target_position") == 102
    assert image.esc.sync_errors == missed + 1
    assert slave.upload(0x1C32, 0x0B) == missed + 1
    bus.advance(edge + 4 * MS)
    assert drive.read("target_position") == 999


def test_37_eight_late_frames_raise_f125():
    bus, wire, master, edge = synchronised()
    drive, slave = bus.segment.stations[0].drive, master.slaves[0]
    now = edge
    for command in (6, 7, 15, 15):
        for _ in range(3):
            wire.now = now - 500_000
            slave.outputs[:] = outputs(drive.read("position_actual_value"), command)
            master.cycle()
            now += MS
    bus.advance(now - MS + 1)
    assert drive.state == State.OPERATION_ENABLED
    bus.advance(now - MS + 7 * MS)
    assert drive.state == State.OPERATION_ENABLED  # seven are borne
    bus.advance(now + 9 * MS)
    assert drive.state in (State.FAULT, State.FAULT_REACTION_ACTIVE)
    assert "F125" in drive.fault or "125" in drive.fault or "sync" in drive.fault.lower()


def test_18_op_without_outputs_falls_to_safe_op_and_comes_back():
    bus = line("generic", clock="real")
    wire = Timed(bus)
    master = EtherCatMaster(wire)
    master.to_op()
    slave = master.slaves[0]
    slave.write(0x0420, (200).to_bytes(2, "little"))  # 20 ms
    wire.now += MS
    master.cycle()
    wire.now += 19 * MS
    assert slave.number(0x0130, 2) == AlState.OPERATIONAL
    wire.now += 2 * MS
    assert slave.number(0x0130, 2) == AlState.SAFE_OPERATIONAL | 0x10
    assert slave.number(0x0134, 2) == 0x1B
    assert slave.number(0x0440, 2) & 1 == 0
    assert slave.number(0x0442, 1) == 1
    slave.recover()
    assert slave.state == AlState.SAFE_OPERATIONAL
    master.cycle()
    slave.request(AlState.OPERATIONAL)
    assert master.cycle()
    assert slave.number(0x0440, 2) & 1 == 1


def test_19_leaving_op_while_enabled_stops_the_axis_within_eight_periods():
    bus = line(AKD)
    master = operational(bus)
    drive, slave = bus.segment.stations[0].drive, master.slaves[0]
    drive.write("modes_of_operation", 8)
    target = 0
    for n in range(120):
        target += 20 * (n > 40)
        slave.outputs[:] = outputs(target, (6, 7, 15)[min(n // 10, 2)])
        assert master.cycle()
    assert drive.state == State.OPERATION_ENABLED
    assert abs(drive.read("velocity_actual_value")) > 5000
    slave.request(AlState.SAFE_OPERATIONAL)
    states = []
    for _ in range(8):
        master.cycle()
        states.append(drive.state)
    assert states[-1] != State.OPERATION_ENABLED
    for _ in range(1000):
        master.cycle()
    assert abs(drive.read("velocity_actual_value")) < 100
    assert not drive.energised


@pytest.mark.parametrize("line_of_fault", [
    "drop", "drop at=frames:3", "drop at=cycle:x", "drop count=many", "nonsense", "drop wkc=3",
    "wkc command=LXW", "drop rate=2", "",
])
def test_a_fault_that_is_none_is_refused_with_the_choices(line_of_fault):
    if line_of_fault == "drop":
        assert Fault.parse("drop") == Fault("drop")
        return
    with pytest.raises(ValueError, match="fault"):
        Fault.parse(line_of_fault)


def test_39_a_wrong_toggle_bit_ends_the_transfer_of_a_name_and_the_next_is_whole(tmp_path):
    folder = tmp_path / "short_mailboxes"
    shutil.copytree(load("generic").folder, folder)
    path = folder / "ethercat.toml"
    text = path.read_text(encoding="utf-8")
    path.write_text(text.replace("0x1000, 256, 0x1400, 256", "0x1000, 34, 0x1400, 34"), "utf-8")
    bus = FaultyBus(Segment([Slave(Drive(folder, bus="ethercat"))]))
    master = EtherCatMaster(bus)
    master.scan()
    master.to_preop()
    bus.order(["mailbox_toggle at=mailbox:2"])  # the first answer is not a segment
    mailbox = master.slaves[0].mailbox
    with pytest.raises(SdoAbort) as refused:
        mailbox.upload(0x1008)
    assert refused.value.code == 0x05030000
    assert mailbox.upload(0x1008) == b"servogym generic CiA 402 drive"
    assert bus.happened == [1]


def test_faults_with_a_rate_are_the_same_for_one_seed():
    frame = pack([Datagram(Command.BRD, 0, 0, b"\0")])

    def lost(seed):
        bus = FaultyBus(bare(1), faults=["drop rate=0.3 count=0"], seed=seed)
        return [bus.exchange(frame) is None for _ in range(200)]

    assert lost(1) == lost(1) != lost(2)
    assert 30 < sum(lost(1)) < 90


def test_nothing_of_ethercat_is_loaded_by_those_who_do_not_use_it():
    program = (
        "import sys, servogym.envs, servogym.drive.drive, servogym.envs.plants.linear_axis;"
        "print([m for m in sys.modules if m.startswith('servogym.drive.ethercat')])"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.stdout.strip() == "[]", done.stdout + done.stderr


def test_09_a_thousand_random_frames_never_move_a_drive_without_a_legal_path():
    for model in (AKD, "festo_cmmp_as", "generic"):
        bus = line(model)
        drive = bus.segment.stations[0].drive
        for frame in broken_frames(7, 1000):
            bus.exchange(frame)
            assert not drive.energised  # no frame of these is a master that enables it
        assert send(bus.segment, Datagram(Command.BRD, 0, 0, b"\0"))[0].wkc == 1


@pytest.mark.slow
@pytest.mark.parametrize("model", [AKD, "festo_cmmp_as", "generic"])
def test_09_random_frames_on_a_drive_in_op_never_raise_and_never_lose_it(model):
    """A third of a million each: mutated frames of a master that drives the axis."""
    bus = line(model)
    master = EtherCatMaster(bus)
    master.to_op()
    chance = random.Random(11)
    sent = []
    inner = bus.exchange
    bus.exchange = lambda frame, now=0: sent.append(frame) or inner(frame, now)
    for _ in range(100):
        master.cycle()
    for _ in range(333_334):
        frame = bytearray(chance.choice(sent))
        for _ in range(chance.randrange(4)):
            frame[chance.randrange(len(frame))] = chance.randrange(256)
        inner(bytes(frame))
    assert send(bus.segment, Datagram(Command.BRD, 0, 0, b"\0"))[0].wkc == 1


@pytest.mark.slow
def test_41_ten_minutes_at_a_kilohertz_on_the_clock_dc_keep_the_memory():
    """Time is told, not waited for: 600,000 cycles of two slaves with SYNC0."""
    bus = line(AKD, AKD, clock="dc")
    wire = Timed(bus)
    master = EtherCatMaster(wire)
    master.scan()
    master.to_preop()
    for slave in master.slaves:
        slave.assign([0x1724], [0x1B24])
    master.map()
    master.synchronise()
    master.sync0(MS, 250_000)
    master.to(AlState.SAFE_OPERATIONAL)
    master.cycle()
    master.to(AlState.OPERATIONAL)
    for n in range(600_000):
        wire.now += MS
        master.cycle()
        if n == 20_000:
            begin = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    assert master.wrong == 0
    assert bus.statistics.missed == 0
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - begin <= 1024  # KiB


def test_the_clock_real_follows_and_counts_what_it_misses():
    bus = line(AKD, clock="real")
    wire = Timed(bus)
    master = EtherCatMaster(wire)
    master.to_op()
    machine = bus._plants[0].machine
    bus.advance(wire.now)
    begin, missed = machine.time, bus.statistics.missed
    for _ in range(100):  # a master at 1 kHz: the machine keeps up
        wire.now += MS
        master.cycle()
    assert machine.time - begin == pytest.approx(0.1, abs=2e-3)
    assert bus.statistics.missed == missed
    wire.now += 50 * MS  # the master was away: one bus cycle of physics, not fifty
    begin = machine.time
    master.cycle()
    assert machine.time - begin <= 2.1e-3
    assert bus.statistics.missed == missed + 1


def test_sync1_follows_sync0_and_both_show_in_the_event_register():
    bus, wire, master, _ = synchronised()
    slave = master.slaves[0]
    slave.write(0x0981, b"\0")
    slave.write(0x09A4, (300_000).to_bytes(4, "little"))
    now = slave.number(0x0910, 8)
    slave.write(0x0990, (now + MS).to_bytes(8, "little"))
    slave.write(0x0981, b"\7")
    assert slave.number(0x0984, 1) == 3
    wire.now += MS + 1000
    bus.advance(wire.now)
    assert slave.number(0x0220, 4) & 0x0C == 0x0C
    assert slave.number(0x0990, 8) == now + 2 * MS  # the next edge
    assert slave.number(0x0998, 8) == now + 2 * MS + 300_000
    slave.write(0x0981, b"\0")
    assert bus.segment.next_time > wire.now + 100 * MS
