"""Logs and captures from strangers: what they claim is not what memory is held for."""

import gzip
import struct
import tracemalloc

import pytest

from servogym.drive.wire import log, pcapng

FRAME = "(1.000000) can0 181#3702\n"


def consumed(read):
    """Peak of memory (bytes) and the refusal of a reader."""
    tracemalloc.start()
    try:
        with pytest.raises(ValueError, match=r"more than|at most") as refusal:
            list(read)
        return tracemalloc.get_traced_memory()[1], str(refusal.value)
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("suffix", [*log.TEXT_LOGS, *(f"{s}.gz" for s in log.TEXT_LOGS)])
def test_a_line_without_end_is_refused_and_not_held(tmp_path, suffix):
    file = tmp_path / f"bus{suffix}"
    with gzip.open(file, "wb") if suffix.endswith(".gz") else file.open("wb") as target:
        target.write(b"\n")
        for _ in range(64):
            target.write(b"0" * 2**20)
    peak, says = consumed(log.messages(file))
    assert f"{file}, line 2: " in says
    assert f"more than {log.LONGEST} characters" in says
    assert peak < 4 * 2**20


def test_a_packed_log_that_is_cut_off_still_gives_what_is_whole(tmp_path):
    file = tmp_path / "bus.log.gz"
    whole = gzip.compress((FRAME * 2000).encode())
    file.write_bytes(whole[:-12])
    read = log.messages(file)
    assert next(read).arbitration_id == 0x181
    with pytest.raises(ValueError, match="cut off"):
        list(read)


SECTION = struct.pack("<IIIHHqI", pcapng.SECTION, 28, pcapng.MAGIC, 1, 0, -1, 28)
CLASSIC = b"\xd4\xc3\xb2\xa1" + struct.pack("<HHiIII", 2, 4, 0, 0, 65535, 1)


@pytest.mark.parametrize(
    ("head", "claim"),
    [
        (SECTION, struct.pack("<II", pcapng.PACKET, 0xFFFFFFF0)),
        (SECTION, struct.pack("<II", 0x0BAD, pcapng.LONGEST + 12)),
        (CLASSIC, struct.pack("<IIII", 0, 0, 0xFFFFFFF0, 0xFFFFFFF0)),
    ],
)
def test_a_capture_that_claims_more_than_it_may_is_refused_and_not_held(tmp_path, head, claim):
    file = tmp_path / "line.pcapng"
    with file.open("wb") as target:
        target.write(head + claim)
        target.truncate(2**33)
    peak, says = consumed(pcapng.read(file))
    assert f"at most {pcapng.LONGEST} at once" in says
    assert peak < 2**20
