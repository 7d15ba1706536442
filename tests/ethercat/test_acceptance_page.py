"""docs/results/ethercat.md: the 43 checks of the slaves, each with the tests named after it.

``SERVOGYM_WRITE=1 pytest tests/ethercat/test_acceptance_page.py`` writes it anew.
"""

import os
import re
from collections import defaultdict
from pathlib import Path

TESTS = Path(__file__).parents[1]
PAGE = TESTS.parent / "docs" / "results" / "ethercat.md"
HEAD = """# Acceptance tests of the EtherCAT slaves

A test named `test_NN_…` proves the check with that number, either in memory with frames or on a
wire (a veth pair in a network namespace of its own) with an unmodified master. Without user
namespaces, wire tests are skipped with the reason. Tests in italics belong to `make slow`: they
take minutes or build a master from source. `tests/ethercat/test_acceptance_page.py` writes this
page and fails if a check has no test or the page is out of date.

| | check | tests |
|---|---|---|
"""
CHECKS = """
frames that SOEM, ethercrab and KickCAT sent to this emulated drive are answered byte for byte
working counter and data of each of the 14 commands
addresses: position and broadcast addresses count on, the station alias answers if enabled
locks of the mailbox sync managers
a second AL Control before the first has been read
a mailbox in two datagrams
FMMUs with bits
LRW counts 3 for each slave; half a buffer of outputs is not delivered
noise, truncated, altered frames: no exception, nothing lost, no motor energised without legal path
error counters; a broken link disconnects the slaves behind it
SII and ESI are parsed back row by row; checksum, size, end
the scan of a master shows the model's identity and sizes
EEPROM: reads of 4 and 8 bytes, write enable, end, busy, a persistent alias
ESI, SII and dictionary agree
5 x 16 state requests
error bit and acknowledge
wrong sync managers: status codes 0016h, 0017h, 001Dh, 001Eh
process-data watchdog, and the return to OP
leaving OP while enabled: the axis stops
explicit device identification
bootstrap supports only FoE
abort codes reach the master
normal and segmented uploads, toggle bit
downloads of more than 4 bytes, wrong sizes
complete access
1C00h, 1C32h, 1C33h with their counters, 10F1h
SDO information
an emergency and a pending SDO
repeat request, lost replies
never silence
masters reach OP, every working counter is right
homing by method 1 and 0.1 m in csp, bit-identical in five runs
environment and wire exchange the same bytes
fixed and flexible PDOs have their sizes and move the drive
delays of a line, a branch and slaves with swapped ports; also measured by SOEM and ethercrab
drift: 50 ppm, the registers 092Ch, 0930h, 0932h, 0934h, 0935h
SYNC0: cycles begin at the edge, late frames, F125
a SYNC0 cycle that the model does not support
each injected fault, the master's reaction and the return to OP
redundancy: break and heal
ten minutes at 1 kHz on the clock dc
cycles a second, time of a frame: `servogym bench --ethercat`
32 slaves in one frame, a map split over three frames
""".strip().splitlines()

# a test and its decorators, which may have several lines
TEST = r"((?:^@.*\n(?:^[ )\]].*\n)*)*)^def test_(\d\d)_(\w+)"


def named():
    """Number of a check -> its tests: file and name, those of `make slow` in italics."""
    found = defaultdict(list)
    folders = ("ethercat", "interop", "tasks", "cli")
    for path in sorted(path for folder in folders for path in (TESTS / folder).glob("test_*.py")):
        text = path.read_text(encoding="utf-8")
        for match in re.finditer(TEST, text, re.M):
            slow = re.search(r"^@pytest\.mark\.slow", match[1], re.M)
            name = f"{path.parent.name}/{path.stem.removeprefix('test_')}: {match[3]}"
            found[int(match[2])].append(f"*{name}*" if slow else name)
    return found


def page():
    found = named()
    rows = [
        f"| {n} | {check} | {'; '.join(name.replace('_', ' ') for name in found[n])} |"
        for n, check in enumerate(CHECKS, 1)
    ]
    return HEAD + "\n".join(rows) + "\n"


def test_each_of_the_43_checks_has_a_test_and_the_page_names_it():
    assert sorted(named()) == list(range(1, len(CHECKS) + 1)) == list(range(1, 44))
    if os.environ.get("SERVOGYM_WRITE"):
        PAGE.write_text(page(), encoding="utf-8")
    assert PAGE.read_text(encoding="utf-8") == page(), "SERVOGYM_WRITE=1 writes it anew"
