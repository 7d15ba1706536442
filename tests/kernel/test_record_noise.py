"""Whatever bytes a program writes into a record, the cycle ends as a cycle.

A trap in compiled code takes the process with it, so the models run in another one, which says
which it has come to and, at its end, that it is whole.
"""

import subprocess
import sys

import pytest

from servogym.drive.model.model import model_names

NOISE = """
import sys
import numpy as np
from servogym.drive.drive import Drive
from servogym.drive.kernel.faults import Cause

def spoil(random, kind):
    if kind == 4:
        record[:] = random.integers(0, 256, len(record))
    elif kind == 5:
        name = names[random.integers(len(names))]
        field = drive.axes[name][drive.index : drive.index + 1].view(np.uint8)
        field[...] = random.integers(0, 256, field.shape)
    elif kind == 6:
        some = random.integers(0, len(record), 40)
        record[some] = random.integers(0, 256, 40)
    else:
        edges = np.array([0, -1, 1, -(2**63), 2**63 - 1, 2**31, 17, 65], "<i8")
        numbers = [n for n in names if drive.axes.dtype[n].base == "<i8"]
        for name in random.choice(numbers, 6):
            drive.axes[name][drive.index] = random.choice(edges)

begin, end, *models = sys.argv[1:]
for model in models:
    print(model, flush=True)
    drive = Drive(model)
    objects = drive.axes["od"].view(np.uint8).reshape(len(drive.axes), -1)[drive.index]
    factory = objects.copy()
    factors = np.concatenate([  # of the record: numbers that meet at the edges of 64 bits
        np.arange(*(drive.axes.dtype["od"].fields[name][1] + end for end in (0, 8)))
        for name in ("position_encoder_resolution", "gear_ratio", "feed_constant",
                     "position_factor", "velocity_factor", "position_range_limit",
                     "software_position_limit")])
    record = drive.axes.view(np.uint8).reshape(len(drive.axes), -1)[drive.index]
    names = [name for name in drive.axes.dtype.names if name != "od"]
    for seed in range(int(begin), int(end)):
        random = np.random.default_rng(seed)
        drive.reset()
        kind = seed % 8
        for _ in range(8):
            if kind > 3:  # the whole record: all of it, a field, a few bytes, numbers at the edges
                spoil(random, kind)
            elif kind == 0:
                objects[:] = random.integers(0, 256, len(objects))
            elif kind == 1:  # a few fields, the rest as it was made
                objects[:] = factory
                some = random.integers(0, len(objects), 12)
                objects[some] = random.integers(0, 256, 12)
            else:
                objects[:] = factory if kind == 2 else random.integers(0, 256, len(objects))
                edges = np.array([0, 1, 2, 2**31 - 1, 2**31, 2**32 - 1, 2**16], "<u4")
                objects[factors] = random.choice(edges, len(factors) // 4).view(np.uint8)
            drive.axis.parameters_changed = 1
            drive.axis.fault_raised = random.choice(list(Cause))
            for _ in range(4):
                drive.cycle(float(random.choice([0.0, 1e3, -1e9])), float(random.normal()) * 100)
print("whole")
"""


def run(begin, end, *models):
    command = [sys.executable, "-W", "ignore", "-c", NOISE, str(begin), str(end), *models]
    ran = subprocess.run(command, capture_output=True, text=True, timeout=500)
    assert (ran.returncode, ran.stdout.split()) == (0, [*models, "whole"]), ran.stderr[-2000:]


def test_noise_in_a_record_ends_no_process():
    run(0, 40, *model_names())  # of each kind of noise five


@pytest.mark.slow
@pytest.mark.parametrize("part", range(4))
@pytest.mark.parametrize("model", model_names())
def test_noise_in_a_record_ends_no_process_long(model, part):
    """20,000 seeds a model; a part takes 40 s of a core."""
    run(5_000 * part, 5_000 * (part + 1), model)
