"""Drives in simulated time, on a loop-back and on python-can's virtual bus."""

import random
import struct

import can
import numpy as np
import pytest

from servogym.drive.canopen.bit_time import length
from servogym.drive.canopen.faulty import Faults, Faulty
from servogym.drive.canopen.frame import Frame, parse
from servogym.drive.canopen.link import Loopback
from servogym.drive.canopen.lockstep import LockStep
from servogym.drive.kernel.words import Mode, State
from servogym.drive.wire.bus import CanLink, Traced, to_message
from servogym.training.bench.can import axis_in_csp

PERIOD = 1000  # µs
FAULT_AT, GONE_AT, RESET_AT, CYCLES = 400, 440, 450, 600


def axis(node_id=1):
    machine = axis_in_csp(node_id, PERIOD)
    (drive,) = machine.drives.values()
    drive.write("following_error_window", 0xFFFF_FFFF)  # off: after the fault the axis catches up
    return machine


def commands(seed):
    """Two RPDOs a cycle: enable, csp along a random walk, a fault, reset, enable, csp again."""
    random_ = random.Random(seed)
    target, speed = 0, 0
    for cycle in range(CYCLES):
        since = cycle if cycle < RESET_AT else cycle - RESET_AT - 20
        word = 0x80 if RESET_AT <= cycle < RESET_AT + 20 else 0x06
        word = word if since < 10 else 0x07 if since < 20 else 0x0F
        if since > 40 and cycle != FAULT_AT:
            speed = max(-300, min(300, speed + random_.randint(-10, 10)))
            target += speed
        yield (
            struct.pack("<Hbi", word, Mode.CYCLIC_SYNC_POSITION, target),
            struct.pack("<ih", random_.randint(-1000, 1000), random_.randint(-20, 20)),
        )


def through_the_process_image(seed):
    """As the environments do: latch, run the cycles, collect; -> image at and after each SYNC."""
    machine = axis()
    (drive,) = machine.drives.values()
    states = set()
    at, after = [], []
    for cycle, rpdos in enumerate(commands(seed)):
        if cycle == FAULT_AT:
            drive.inject("overvoltage")
        if cycle == GONE_AT:
            drive.clear_injected()
        at.append(drive.exchange(b"".join(rpdos)))
        machine.step(2)
        after.append(drive.collect())
        states.add(drive.state)
    return at, after, states


def over_python_can(seed, channel):
    """The same as frames on a virtual bus -> TPDO bytes of each cycle."""
    machine = axis()
    (drive,) = machine.drives.values()
    lock_step = LockStep([machine], PERIOD)
    with (
        can.Bus(interface="virtual", channel=channel) as here,
        can.Bus(interface="virtual", channel=channel) as there,
    ):
        master, link = CanLink(here), CanLink(there)
        here.send(to_message(Frame(0x000, b"\x01\x01")))
        lock_step.serve(link)
        assert [str(frame) for frame in master.receive(0)] == ["701#00"]
        images = []
        for cycle, rpdos in enumerate(commands(seed)):
            if cycle == FAULT_AT:
                drive.inject("overvoltage")
            if cycle == GONE_AT:
                drive.clear_injected()
            for identifier, data in zip((0x201, 0x301), rpdos, strict=True):
                here.send(to_message(Frame(identifier, data)))
            here.send(can.Message(arbitration_id=0x080, is_extended_id=False))
            lock_step.serve(link)
            frames = [f for f in master.receive(0) if f.id in (0x181, 0x281)]
            assert [f.id for f in frames] == [0x181, 0x281], f"cycle {cycle}"
            images.append(b"".join(f.data for f in frames))
    return images


def test_the_process_image_and_the_bus_carry_the_same_bytes_in_every_cycle(request):
    at, after, states = through_the_process_image(7)
    assert over_python_can(7, f"lockstep-{id(request)}") == at
    assert after[:-1] == at[1:]
    assert {State.OPERATION_ENABLED, State.FAULT} <= states
    positions = [struct.unpack_from("<i", image, 2)[0] for image in at]
    assert max(positions) - min(positions) > 1000  # µm; it has moved
    assert struct.unpack_from("<H", at[-1])[0] & 0x6F == 0x27  # and has been enabled again


def test_sdo_is_answered_while_time_stands_still_between_syncs(request, tmp_path):
    channel, log = f"lockstep-{id(request)}", tmp_path / "run.log"
    lock_step = LockStep([axis(1), axis(2)], PERIOD)
    with (
        can.Bus(interface="virtual", channel=channel) as here,
        can.Bus(interface="virtual", channel=channel) as there,
    ):
        link = Traced(CanLink(there), str(log))
        for line in ("601#4000100000000000", "602#4000100000000000", "080#", "701#R"):
            here.send(to_message(parse(line)))
        lock_step.serve(link)
        link.close()
        answers = [str(frame) for frame in CanLink(here).receive(0)]
    assert answers == [
        "701#00", "702#00", "581#4300100092010200", "582#4300100092010200", "701#7F",
    ]
    assert lock_step.time == PERIOD
    times = [line.split()[0] for line in log.read_text().splitlines()]
    assert times == ["(0.000000)"] * 8 + ["(0.001000)"]  # the guarding answer follows the SYNC


def test_a_node_with_pdos_is_stepped_twice_a_millisecond_and_hears_its_neighbours():
    lock_step = LockStep([axis(1), axis(2)], PERIOD)
    master = lock_step.bus.join()
    lock_step.nodes[1].drive.write("consumer_heartbeat_time_1", 1 << 16 | 20)
    lock_step.nodes[0].drive.write("producer_heartbeat_time", 10)
    master.send(Frame(0x000, b"\x01\x00"), 0)
    lock_step.sync(50)
    assert lock_step.time == 50_000
    assert [int(node.drive.axis.cycle_count) for node in lock_step.nodes] == [100, 100]
    assert not any(node.drive.axis.connection_lost for node in lock_step.nodes)
    lock_step.nodes[0].drive.write("producer_heartbeat_time", 0)
    lock_step.sync(50)
    assert [int(node.drive.axis.connection_lost) for node in lock_step.nodes] == [0, 1]


def faulty_run(seed):
    """Two axes in csp behind a bad link -> all frames heard and the state of the drives."""
    machines = [axis(1), axis(2)]
    lock_step = LockStep(machines, PERIOD)
    faults = Faults(drop=0.05, corrupt=0.05, delay=0.05, reorder=0.05, duplicate=0.05)
    master = Faulty(lock_step.bus.join(), faults, np.random.default_rng(seed))
    heard = []
    for rpdos in commands(seed):
        master.send(Frame(0x000, b"\x01\x00"), lock_step.time)
        for base, data in zip((0x200, 0x300), rpdos, strict=True):
            for node_id in (1, 2):
                master.send(Frame(base + node_id, data), lock_step.time)
        lock_step.sync()
        heard += master.receive(lock_step.time)
    return heard, [machine.snapshot() for machine in machines]


def test_two_runs_are_the_same_bit_by_bit_also_behind_a_bad_link():
    first, second = faulty_run(5), faulty_run(5)
    assert first == second
    assert len(first[0]) > 1000
    assert faulty_run(6)[1] != first[1]


def test_on_a_bus_with_a_bit_rate_the_answers_come_when_it_has_carried_them():
    lock_step = LockStep([axis(1)], PERIOD, Loopback(1_000_000))
    master = lock_step.bus.join()
    master.send(Frame(0x000, b"\x01\x00"), 0)
    lock_step.sync(3)
    master.receive(lock_step.time)
    begin = lock_step.time
    lock_step.sync()
    sync, *tpdos = master.receive(lock_step.time)
    assert [frame.id for frame in (sync, *tpdos)] == [0x080, 0x181, 0x281]
    bits = sum(map(length, (sync, *tpdos)))
    assert bits < PERIOD
    before = lock_step.bus.load(begin) * begin
    assert lock_step.bus.load(lock_step.time) * lock_step.time - before == pytest.approx(bits)


def test_eight_drives_with_four_pdos_each_millisecond_are_too_much_for_1_mbit():
    lock_step = LockStep([axis(n) for n in range(1, 9)], PERIOD, Loopback(1_000_000))
    master = lock_step.bus.join()
    master.send(Frame(0x000, b"\x01\x00"), 0)
    lock_step.sync(10)
    late = 0
    for _ in range(50):
        for node_id in range(1, 9):
            master.send(Frame(0x200 + node_id, bytes(7)), lock_step.time)
            master.send(Frame(0x300 + node_id, bytes(6)), lock_step.time)
        lock_step.sync()
        late += len({f.id for f in master.receive(lock_step.time) if f.id > 0x180}) < 16
    assert lock_step.bus.load(lock_step.time) > 0.9
    assert late > 40


@pytest.mark.parametrize("period", [0, 250, 1250])
def test_a_period_that_is_no_multiple_of_the_cycle_is_refused(period):
    with pytest.raises(ValueError, match=f"period = {period} µs is not a whole multiple .* 500 µs"):
        LockStep([axis()], period)


def test_two_drives_with_one_node_id_are_refused():
    with pytest.raises(ValueError, match="each node needs a node-id of its own"):
        LockStep([axis(1), axis(1)])
