"""A node driven by lists of frames: ``>`` to the node, ``<`` from it, ``+n`` n ms pass."""

import random
import struct

from servogym.drive.canopen.frame import Frame, parse
from servogym.drive.canopen.node import Node
from servogym.drive.drive import Drive


class Bus:
    """A node, the clock, and what has come out."""

    def __init__(self, node_id=1):
        self.drive = Drive(node_id=1)
        self.node = Node(self.drive, node_id)
        self.time = 0
        self.drive.cycle(0.0)
        assert self.node.poll(0) == ([] if node_id == 255 else [Frame(0x701, b"\0")])

    def run(self, script):
        waiting = []
        for line in filter(str.strip, script.splitlines()):
            direction, _, text = line.partition("#!")[0].strip().partition(" ")
            if direction.startswith("+"):
                waiting += self.wait(int(direction[1:]))
            elif direction == ">":
                assert not waiting, f"before {line}: {[*map(str, waiting)]}"
                self.node.receive(parse(text), self.time)
                self.drive.cycle(0.0)
                waiting += self.node.poll(self.time)
            else:
                assert waiting, f"nothing came for {line}"
                assert str(waiting.pop(0)) == text.strip(), line
        assert not waiting, f"not expected: {[*map(str, waiting)]}"

    def wait(self, milliseconds):
        frames = []
        for _ in range(milliseconds):
            self.time += 1000
            self.drive.cycle(0.0)
            frames += self.node.poll(self.time)
        return frames


def read(index, sub, answer):
    request = f"> 601#40{index & 0xFF:02X}{index >> 8:02X}{sub:02X}00000000\n"
    return request + f"< 581#{answer}"


def refuse(request, index, sub, code):
    return (
        f"> 601#{request}\n< 581#80{index & 0xFF:02X}{index >> 8:02X}{sub:02X}"
        + struct.pack("<I", code).hex().upper()
    )


def write(index, sub, value, size):
    """An expedited download that is accepted."""
    address = f"{index & 0xFF:02X}{index >> 8:02X}{sub:02X}"
    data = value.to_bytes(4, "little").hex().upper()
    return f"> 601#{0x23 | 4 - size << 2:02X}{address}{data}\n< 581#60{address}00000000\n"


def fuzz(cases, seed, frames, node_id=1):
    """Random and mutated frames: no exception, no endless queue, no power not asked for."""
    bus = Bus(node_id)
    random_ = random.Random(seed)
    known = [parse(line.split()[1]) for text in cases.values() for line in text.splitlines()
             if line.strip().startswith(">") and "#" in line]
    for n in range(frames):
        frame = random_.choice(known)
        if random_.random() < 0.7:
            data = bytearray(frame.data)
            for _ in range(random_.randint(1, 3)):
                if data:
                    data[random_.randrange(len(data))] = random_.randrange(256)
            frame = frame._replace(data=bytes(data[: random_.choice((8, 8, 8, 7, 2, 0))]))
        if random_.random() < 0.1:
            frame = Frame(
                random_.randrange(0x800), random_.randbytes(random_.randint(0, 8)),
                random_.random() < 0.2, random_.random() < 0.1,
            )
        bus.time += random_.randrange(2000)
        bus.node.receive(frame, bus.time)
        if n % 4 == 0:
            torque = bus.drive.cycle(0.0)
            assert torque == 0.0 or bus.drive.energised
        assert len(bus.node.poll(bus.time)) < 200


OPERATIONAL = "> 000#0101\n< 181#5002\n"
