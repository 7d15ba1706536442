"""What foreign masters sent, recorded on the wire with our AKD, replayed in memory.

It was not recorded with a real drive, whose recordings are kept apart: it proves that what three
unmodified masters sent is answered today as it was when they reached OP, byte by byte.
"""

import pytest
from golden import recordings

from servogym.drive.ethercat.frame import Command, unpack

ETHERNET = bytes(12)


@pytest.mark.parametrize("master", recordings.MASTERS)
def test_01_what_a_master_sent_is_answered_byte_for_byte(master):
    pairs = recordings.read(master)
    found = list(recordings.replayed(request for request, _ in pairs))
    for n, ((request, reply), again) in enumerate(zip(pairs, found, strict=True)):
        assert again == reply.rstrip(b"\0"), f"frame {n}: {request.hex()}"


@pytest.mark.parametrize("master", recordings.MASTERS)
def test_01_a_recording_goes_from_the_scan_to_process_data_with_the_right_working_counter(master):
    rows = [
        row
        for request, reply in recordings.read(master)
        for row in unpack(ETHERNET + reply.ljust(2048, b"\0"))
    ]
    states = [row.data[0] for row in rows if row.ado == 0x0130 and row.wkc == 1]
    assert {1, 2, 4, 8} <= set(states)
    logical = [row.wkc for row in rows if row.command in (Command.LRW, Command.LRD, Command.LWR)]
    assert logical[-1] == max(logical)
    assert len(rows) > 80
