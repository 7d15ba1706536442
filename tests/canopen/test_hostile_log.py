"""Logs and captures from strangers: what they claim is not what memory is held for."""

import gzip
import sqlite3
import struct
import tracemalloc
import zlib

import can
import pytest

from servogym.drive.wire import log, pcapng, text_log

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


@pytest.mark.parametrize("suffix", [*text_log.TEXTS, *(f"{s}.gz" for s in text_log.TEXTS)])
def test_a_line_without_end_is_refused_and_not_held(tmp_path, suffix):
    file = tmp_path / f"bus{suffix}"
    with gzip.open(file, "wb") if suffix.endswith(".gz") else file.open("wb") as target:
        target.write(b"\n")
        for _ in range(64):
            target.write(b"0" * 2**20)
    peak, says = consumed(log.messages(file))
    assert f"{file}, line 2: " in says
    assert f"more than {text_log.LONGEST} characters" in says
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


def blf(tmp_path, *objects):
    """A .blf of python-can with one frame, its objects then replaced."""
    file = tmp_path / "bus.blf"
    with can.BLFWriter(file) as writer:
        writer(can.Message(arbitration_id=0x181, data=[1, 2], is_extended_id=False, timestamp=1.0))
    data = file.read_bytes()
    file.write_bytes(data[: data.index(b"LOBJ")] + b"".join(objects) if objects else data)
    return file


def container(payload, size=None, method=2):
    """A LOG_CONTAINER (type 10) with what it claims to be its size."""
    body = struct.pack("<H6xL4x", method, 0) + payload
    claimed = 16 + len(body) if size is None else size
    padding = bytes(claimed % 4)  # as python-can reads it
    return struct.pack("<4sHHLL", b"LOBJ", 16, 1, claimed, 10) + body + padding


def packed(megabytes):
    """Zeros, a thousandth of their size."""
    squeeze = zlib.compressobj(9)
    zeros = bytes(2**20)
    return b"".join(squeeze.compress(zeros) for _ in range(megabytes)) + squeeze.flush()


ENDLESS = struct.pack("<4sHHLL", b"LOBJ", 32, 1, 0xFFFFFFF0, 1)  # an object longer than any
HOSTILE = {
    "a container that unpacks to four times a block": lambda: [container(packed(64))],
    "one that claims 4 GiB": lambda: [container(b"", size=0xFFFFFFF0)],
    "one shorter than its head": lambda: [container(bytes(100), size=3)],
    "an object without end over many containers": lambda: [
        container(zlib.compress(ENDLESS)),
        *[container(packed(8)) for _ in range(4)],
    ],
}


@pytest.mark.parametrize("suffix", ["", ".gz"])
@pytest.mark.parametrize("kind", HOSTILE)
def test_a_blf_is_refused_and_not_held(tmp_path, kind, suffix):
    file = blf(tmp_path, *HOSTILE[kind]())
    if suffix:
        data, file = file.read_bytes(), file.with_suffix(".blf.gz")
        file.write_bytes(gzip.compress(data))
    peak, says = consumed(log.messages(file))
    assert says.startswith(f"{file}: damaged or cut off")
    assert "\n" not in says
    assert peak < 8 * log.LARGEST_BLOCK


@pytest.mark.parametrize("suffix", ["", ".gz"])
def test_a_whole_blf_is_read(tmp_path, suffix):
    file = blf(tmp_path)
    if suffix:
        data, file = file.read_bytes(), file.with_suffix(".blf.gz")
        file.write_bytes(gzip.compress(data))
    assert [message.arbitration_id for message in log.messages(file)] == [0x181]


COLUMNS = "ts REAL, arbitration_id INTEGER, extended INTEGER, remote INTEGER, error INTEGER, " \
    "dlc INTEGER, data BLOB"
TABLES = {
    "a view without end": [
        "CREATE VIEW messages AS WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n) "
        "SELECT i AS ts, 1, 0, 0, 0, 8, zeroblob(1000000000) FROM n"
    ],
    "a column that is made": [
        "CREATE TABLE messages (ts REAL, a INTEGER, b INTEGER, c INTEGER, d INTEGER, e INTEGER, "
        "data BLOB GENERATED ALWAYS AS (zeroblob(900000000)))",
        "INSERT INTO messages VALUES (1, 1, 0, 0, 0, 8)",
    ],
    "a value that is long": [
        f"CREATE TABLE messages ({COLUMNS})",
        "INSERT INTO messages VALUES (1, 1, 0, 0, 0, 8, zeroblob(50000000))",
    ],
    "no table": ["CREATE TABLE other (a)"],
}


@pytest.mark.parametrize("kind", TABLES)
def test_a_db_is_refused_and_not_held(tmp_path, kind):
    file = tmp_path / "bus.db"
    with sqlite3.connect(file) as db:
        for statement in TABLES[kind]:
            db.execute(statement)
    db.close()
    tracemalloc.start()
    try:
        with pytest.raises(ValueError, match="damaged or cut off") as refusal:
            list(log.messages(file))
        assert tracemalloc.get_traced_memory()[1] < 8 * 2**20
    finally:
        tracemalloc.stop()
    assert "\n" not in str(refusal.value)


def test_a_whole_db_is_read(tmp_path):
    file = tmp_path / "bus.db"
    with can.SqliteWriter(file) as writer:
        writer(can.Message(arbitration_id=0x181, data=[1, 2], is_extended_id=False, timestamp=1.0))
    assert [message.arbitration_id for message in log.messages(file)] == [0x181]


def test_a_log_that_its_reader_holds_whole_is_not_read(tmp_path):
    (tmp_path / "bus.mf4").write_bytes(b"MDF     4.10")
    with pytest.raises(ValueError, match=r"unknown suffix, use one of \.asc"):
        list(log.messages(tmp_path / "bus.mf4"))
