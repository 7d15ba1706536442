"""Random masters, inputs and faults against every drive model: it never breaks and never cheats."""

import math
import random

import pytest

from servogym.drive.drive import Drive
from servogym.drive.kernel.words import State, state_of
from servogym.drive.model.model import model_names

FED = (State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE, State.FAULT_REACTION_ACTIVE)
WORDS = (0, 2, 6, 7, 0x0F, 0x1F, 0x3F, 0x80, 0x10F)
INPUTS = (
    "negative_limit_switch", "positive_limit_switch", "home_switch", "enable_input", "sto_input",
    "connection_lost", "sync_pulse",
)


def random_access(drive, slot, chance):
    """Write anything to an object and read it; on the bus both are answered, never raise."""
    row = slot.row
    data = chance.randbytes(chance.randrange(40))
    if row.format and row.format != "f":
        low, high = int(row.minimum), int(row.maximum)
        value = chance.choice([low, high, low - 1, high + 1, 0, 1, chance.randint(low, high)])
        signed = row.format.islower()
        if -(1 << 8 * row.size - 1) * signed <= value < 1 << 8 * row.size - signed:
            data = value.to_bytes(row.size, "little", signed=signed)
    drive.objects.write(row.index, row.subindex, data)
    drive.objects.read(row.index, row.subindex)


def disturb(drive, chance):
    """Inputs, faults, power cycles."""
    dice = chance.random()
    if dice < 0.3:
        drive.inject(chance.choice(drive.injectable))
    elif dice < 0.55:
        drive.clear_injected()
    elif dice < 0.7:
        for name in INPUTS:
            setattr(drive.axis, name, chance.getrandbits(1))
        drive.axis.terminals = chance.getrandbits(8)
    elif dice < 0.98:
        drive.axis.enable_input = drive.axis.sto_input = 1
        drive.axis.terminals = 3
    elif dice < 0.99:
        drive.reset(keep_parameters=chance.random() < 0.5)
    else:
        drive.restore(drive.snapshot())


def fuzz(model, seed, cycles):
    chance = random.Random(seed)
    drive = Drive(model)
    slots = [*drive.objects.slots.values()]
    angle = speed = 0.0
    for _ in range(cycles):
        dice = chance.random()
        if dice < 0.4:
            random_access(drive, chance.choice(slots), chance)
        elif dice < 0.75:
            drive.axis.od.controlword = chance.choice([*WORDS, chance.getrandbits(16)])
        elif dice < 0.85:
            disturb(drive, chance)
        torque = drive.cycle(angle, speed)
        assert math.isfinite(torque)
        assert torque == 0.0 or drive.state in FED, drive.describe()
        assert state_of(int(drive.axis.od.statusword)) is not None, drive.describe()
        speed = min(max(speed + torque, -500.0), 500.0)
        angle += speed * drive.model.cycle_time["position"]


@pytest.mark.parametrize("model", model_names())
def test_nothing_breaks_a_drive(model):
    fuzz(model, seed=1, cycles=4000)


@pytest.mark.slow
@pytest.mark.parametrize("model", model_names())
def test_nothing_breaks_a_drive_long(model):
    for seed in range(2, 12):
        fuzz(model, seed, cycles=20_000)
