"""Addresses that a master writes stay within the memory of a slave controller.

Compiled code does not check its indices, so the frames pass a slave controller that is interpreted.
"""

import os
import random
import subprocess
import sys
from pathlib import Path

from bare_segment import addressed, bare, log, one

from servogym.drive.ethercat.frame import Command as C

AREAS = (  # first register, bytes: EEPROM, FMMUs, sync managers, distributed clocks, all but ports
    (0x0500, 16), (0x0600, 32), (0x0800, 32), (0x0900, 0xC0), (0x0110, 0x0EF0),
)
ENDS = (0, 1, 0x7F, 0xFFF, 0x1000, 0x2FFF, 0x3000, 0x7FFF, 0xFFFF)


def play(seed, rounds):
    """Frames that configure a slave at random, and that then go through its configuration."""
    generator = random.Random(seed)

    def word():
        return generator.choice((*ENDS, generator.randrange(1 << 16))).to_bytes(2, "little")

    segment = addressed(bare(2))
    for now in range(rounds):
        physical, kind = word(), generator.choice((b"\1", b"\2", b"\3"))
        bits = bytes(generator.randrange(8) for _ in range(2))
        fmmu = b"\0\0\1\0" + word() + bits + physical + bits[:1] + kind + b"\1"
        one(segment, C.BWR, 0, 0x0600, fmmu, now)
        manager = word() + word() + bytes([generator.randrange(256), 0, 1, 0])
        one(segment, C.BWR, 0, 0x0800 + 8 * generator.randrange(4), manager, now)
        begin, size = generator.choice(AREAS)
        data = generator.randbytes(generator.randrange(1, 17))
        one(segment, C.BWR, 0, begin + generator.randrange(size), data, now)
        for command in (C.LRD, C.LWR, C.LRW):
            log(segment, command, 0x10000, generator.randbytes(generator.randrange(1, 40)), now)
        for command in (C.BRD, C.BWR, C.BRW):
            address = generator.choice((*ENDS, generator.randrange(0x0110, 1 << 16)))
            one(segment, command, 0, address, generator.randbytes(4), now)
        segment.poll(now)


def test_no_register_leads_out_of_the_memory():
    here = Path(__file__).parent
    paths = [str(here), str(here.parent), *filter(None, [os.environ.get("PYTHONPATH")])]
    environment = os.environ | {
        "NUMBA_DISABLE_JIT": "1", "PYTHONPATH": os.pathsep.join(paths),
    }
    done = subprocess.run(
        [sys.executable, "-c", "from test_fmmu_bounds import play; play(1, 100)"],
        env=environment, capture_output=True, text=True, check=False,
    )
    assert done.returncode == 0, done.stderr[-2000:]
