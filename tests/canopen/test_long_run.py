"""Eight nodes in lock-step for a long time: nothing grows, and nobody falls out.

``SERVOGYM_SIMULATED_SECONDS=3600`` runs the whole hour.
"""

import os
import struct
from pathlib import Path

import numpy as np
import pytest

from servogym.drive.canopen.frame import Frame
from servogym.drive.canopen.lockstep import LockStep
from servogym.drive.canopen.node import NmtCommand
from servogym.drive.kernel.words import TO_ENABLED, Mode, State
from servogym.training.bench.can import STATES, axis_in_csp

NODES, PERIOD = 8, 1000  # µs
STATM = Path("/proc/self/statm")


def memory():
    """Resident (KiB)."""
    return int(STATM.read_text().split()[1]) * os.sysconf("SC_PAGESIZE") // 1024


def run(seconds, tell):
    """Eight axes in csp; -> resident memory at 10, 50 and 100 % of the time (KiB)."""
    step = LockStep([axis_in_csp(n) for n in range(1, NODES + 1)], PERIOD)
    master = step.bus.join()
    master.send(Frame(0x000, bytes([NmtCommand.START, 0])), 0)
    cycles, found = round(seconds * 1e6 / PERIOD), {}
    for number in range(cycles + 1):
        word = TO_ENABLED[STATES[min(number // 10, len(STATES) - 1)]]
        target = round(20_000 * np.sin(number * 2e-3))
        command = struct.pack("<Hbi", word, Mode.CYCLIC_SYNC_POSITION, target)
        for n in range(1, NODES + 1):
            master.send(Frame(0x200 + n, command), step.time)
            master.send(Frame(0x300 + n, bytes(6)), step.time)
        step.sync()
        frames = master.receive(step.time)
        if number > 100:
            assert len(frames) == 2 * NODES + 1, number  # and the SYNC
        if number * 10 % cycles < 10:
            share = number * 100 // cycles
            found[share] = memory()
            tell(f"{number * PERIOD * 1e-6:.0f} s simulated, {share} %: {found[share]} KiB")
    assert all(node.drive.state == State.OPERATION_ENABLED for node in step.nodes)
    return [found[share] for share in (10, 50, 100)]


@pytest.mark.skipif(not STATM.exists(), reason="needs /proc")
def test_eight_nodes_run_a_second(tell):
    run(1, tell)


@pytest.mark.slow
@pytest.mark.skipif(not STATM.exists(), reason="needs /proc")
def test_eight_nodes_in_lock_step_keep_the_memory(tell):
    begin, middle, end = run(float(os.environ.get("SERVOGYM_SIMULATED_SECONDS", "240")), tell)
    assert max(middle, end) - begin <= 1024, (begin, middle, end)
