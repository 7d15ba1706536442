"""Random and mutated frames against every CANopen model: no exception, no power not asked for."""

import random

import pytest
import test_conformance
import test_conformance_services as services

from servogym.drive.canopen.frame import Frame, parse
from servogym.drive.canopen.node import Node
from servogym.drive.drive import Drive
from servogym.drive.model.model import load, model_names

MODELS = [name for name in model_names() if "can" in load(name).buses]
KNOWN = [
    parse(line.split()[1])
    for text in (test_conformance.CASES | services.CASES | services.UNCONFIGURED).values()
    for line in text.splitlines()
    if line.strip().startswith(">") and "#" in line
]


def fuzz(model, seed, frames):
    """Send `frames`; a quarter of them are followed by a control cycle."""
    chance = random.Random(seed)
    drive = Drive(model, node_id=1)
    node, time = Node(drive), 0
    for n in range(frames):
        frame = chance.choice(KNOWN)
        dice = chance.random()
        if dice < 0.6 and frame.data:
            data = bytearray(frame.data)
            for _ in range(chance.randint(1, 3)):
                data[chance.randrange(len(data))] = chance.randrange(256)
            frame = frame._replace(data=bytes(data[: chance.choice((8, 8, 8, 7, 2, 0))]))
        elif dice < 0.7:
            data = chance.randbytes(chance.randint(0, 8))
            frame = Frame(chance.randrange(0x800), data, chance.random() < 0.2, dice < 0.62)
        time += chance.randrange(2000)
        node.receive(frame, time)
        if n % 4 == 0:
            torque = drive.cycle(0.0)
            assert torque == 0.0 or drive.energised
        answers = node.poll(time)
        assert len(answers) < 600
        assert all(len(answer.data) <= 8 for answer in answers)


@pytest.mark.parametrize("model", MODELS)
def test_frames_do_no_harm(model):
    fuzz(model, 1, 100_000 // len(MODELS))


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2, 14))
@pytest.mark.parametrize("model", MODELS)
def test_ten_million_frames_do_no_harm(model, seed):
    for part in range(12):
        fuzz(model, 1000 * seed + part, 10_000_000 // len(MODELS) // 12 // 12 + 1)
