"""What a drive took it gives back: after 1010h and power-on, and after a reset that keeps it all.

Any order of writes that the drive accepts is a state it can be in; keeping it must not ask again
what was asked when it was written. The oracle is the drive itself, read before and after.
"""

import random
import warnings

import pytest

from servogym.drive.drive import Drive
from servogym.drive.model.model import load, model_names
from servogym.drive.objects import reactions

SAVE = 0x65766173
NOT_KEPT = (  # what the act of a reset is about, or follows from others
    "act_node_id", "data_set", "single_set", "act_connection", "act_slope_up", "act_slope_down",
    "act_amount", "act_poles",
)


def number(row, chance):
    """A value the row may take, mostly near its ends, where factors make the most trouble."""
    if row.allowed is not None:
        return chance.choice(sorted(row.allowed))
    if row.possible:
        return chance.choice(row.possible)
    low, high = int(row.minimum), int(row.maximum)
    return min(max(chance.choice([low, high, 1, 2, 7, -3, chance.randint(low, high)]), low), high)


def shown(drive):
    """What a master reads of all that can be stored, and how each fault acts."""
    values = {
        key: drive.objects.read(*key)
        for key, slot in drive.objects.slots.items()
        if slot.row.storable and slot.row.hook not in NOT_KEPT
    }
    acts = {f.name: reactions.reaction_to(drive, f) for f in drive.model.faults if f.name}
    return values, acts, drive.axis.od.fault_reaction.tolist()


def check(model, seed, writes=150):
    chance = random.Random(seed)
    drive = Drive(model)
    rows = [slot.row for slot in drive.objects.slots.values()]
    rows = [row for row in rows if row.format and row.format != "f" and row.access in ("rw", "wo")]
    rows = [row for row in rows if row.index not in (0x1010, 0x1011, 0x6040)]
    makers = [row for row in rows if "factor" in row.hook or "factor" in row.name]
    if seed % 2:
        rows = [row for row in rows if row not in makers]
    special = [row for row in rows if row.hook or row in makers]
    for _ in range(writes):
        row = chance.choice(special if chance.random() < 0.5 else rows)
        if row.hook not in NOT_KEPT:
            data = row.pack(number(row, chance))
            drive.objects.write(row.index, row.subindex, data)
    if chance.random() < 0.5:
        drive.cycle(0.0)
    before = shown(drive)
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # that a parameter file is ignored is a warning
        drive.reset(keep_parameters=True)
        assert shown(drive) == before
        drive.write(0x1010, 1, SAVE)
        drive.reset()
    assert shown(drive) == before


STORING = [name for name in model_names() if (0x1010, 1) in load(name).objects]


@pytest.mark.parametrize("model", STORING)
def test_what_a_drive_took_it_gives_back(model):
    for seed in range(8):
        check(model, seed)


@pytest.mark.slow
@pytest.mark.parametrize("model", STORING)
def test_what_a_drive_took_it_gives_back_long(model):
    for seed in range(8, 250):
        check(model, seed)
