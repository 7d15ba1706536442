"""Drives in simulated time, on a loop-back and on python-can's virtual bus."""

import random
import struct

import can

from servogym.drive.canopen.frame import Frame
from servogym.drive.words import Mode, State
from servogym.envs.linear_axis import linear_axis
from servogym.training.can_link import CanLink
from servogym.training.lockstep import LockStep
from servogym.training.node import to_message

RPDOS = [["controlword", "modes_of_operation", "target_position"], ["velocity_offset"]]
TPDOS = [
    ["statusword", "position_actual_value", "torque_actual_value"],
    ["velocity_actual_value", "following_error_actual_value"],
]
PERIOD = 1000  # µs
FAULT_AT, GONE_AT, RESET_AT, CYCLES = 400, 440, 450, 600


def axis(node_id=1):
    machine = linear_axis("generic")
    (drive,) = machine.drives.values()
    drive.node_id = node_id
    drive.reset_communication()
    drive.map_pdos(RPDOS, TPDOS)
    for n in range(2):
        drive.write(0x1400 + n, 2, 1)
        drive.write(0x1800 + n, 2, 1)
    drive.write("interpolation_time_period_value", 1)
    drive.write("interpolation_time_index", -3)
    drive.write(
        "following_error_window", 0xFFFF_FFFF
    )  # off: after the fault the axis has to catch up
    machine.reset(positions={"x": 0.1})
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
            struct.pack("<i", random_.randint(-1000, 1000)),
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
