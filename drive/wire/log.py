"""Logs of a CAN bus: read and written in the formats of python-can."""

import contextlib
import gzip
import logging
import math
import re
import sqlite3
import zlib
from collections.abc import Callable, Iterator
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import can
from can.io.player import MESSAGE_READERS

from ..model.files import regular

TEXT_LOGS = (".log", ".txt", ".asc", ".trc", ".csv")  # a frame a line
OF_CANDUMP = (".log", ".txt")  # what it writes with -l, and what it prints
APART = 1e-3  # s between frames of a text without times (inferred: an order is all it tells)
LOOK_AHEAD = 1000  # lines in which times that go back show that they are differences
# a line that candump prints: (time), channel, TX or RX and flags (-x), identifier, length, the rest
_PRINTED = re.compile(
    r"\s*(?:\((?P<time>[^)]*)\)\s+)?(?P<channel>[A-Za-z][\w.-]*)\s+(?:[TR]X\s+[B-]\s+[E-]\s+)?"
    r"(?P<id>[0-9A-Fa-f]{8}|[0-9A-Fa-f]{3})\s+\[(?P<length>\d{1,2})\](?P<rest>.*)"
)
# what stands around it in a terminal: prompts, comments, "...", Ctrl-C
_AROUND = re.compile(r"\s*(?:[$#>]|\.{2,}|…|\^C|```|\S+@\S+|(?:sudo )?candump\b)")
LONGEST = 1 << 16  # characters of a line; the readers would hold any at once, unpacked ones too
LARGEST_BLOCK = 1 << 24  # bytes of a block of a .blf, unpacked, and of what has no frame in it
BLOCK_TYPE = 12  # place of an object's type in its header of 16 bytes (Vector BLF)
CONTAINER, PACKED = 10, 2  # type of an object, and its method
CONTAINER_HEADER = 16  # bytes in front of what is packed
LARGEST_VALUE = 1 << 20  # bytes of a value of a .db
HELD_WHOLE = (".mf4",)  # python-can's readers hold all of them in memory
# no generated columns, no virtual tables
_PLAIN_TABLE = re.compile(r"(?is)create\s+table\s(?!.*\b(generated|as)\b).*")


def not_classical(message: can.Message) -> str:
    """A line about a message that is not a classical frame."""
    if message.is_error_frame:
        return "error frame"
    return f"CAN FD {message.arbitration_id:03X}##{bytes(message.data).hex().upper()}"


def messages(log: Path) -> Iterator[can.Message]:
    """Read the messages of a log; an error of a reader becomes a ValueError with the line."""
    suffixes = [suffix.lower() for suffix in log.suffixes]
    packed = suffixes[-1:] == [".gz"]
    plain = suffixes[-2:-1] if packed else suffixes[-1:]
    readers = MESSAGE_READERS | {".txt": MESSAGE_READERS[".log"]}
    if not plain or plain[0] not in readers or plain[0] in HELD_WHOLE:
        known = " ".join(sorted({*readers} - {*HELD_WHOLE}))
        raise ValueError(f"{log}: unknown suffix, use one of {known}, also with .gz behind it")
    size = regular(log)  # also because the reader of .db makes a file that is not there
    lines = None
    if plain[0] in TEXT_LOGS:
        lines = (_Printed if plain[0] in OF_CANDUMP else _Lines)(log, packed)
    blocks = _Blocks(log, packed) if plain[0] == ".blf" else None
    source: Any = lines or blocks or log
    reads: Any = readers[plain[0]]
    library = logging.getLogger(reads.__module__)
    library.addFilter(_refuse)
    try:
        if plain[0] == ".db":
            if packed:
                raise ValueError("a packed .db is not read: unpack it first")
            _look_through(log)
        with reads(source) as reader:
            for message in reader:
                if blocks:
                    blocks.held = 0
                if message.arbitration_id is None:  # of a damaged .db
                    raise ValueError("a frame without an identifier")
                yield message
            if blocks and not packed and size < reader.file_size:
                raise ValueError(f"{size} bytes of {reader.file_size} are there")
            if lines and lines.open_end:  # the readers take what is left of a frame for a short one
                raise ValueError("it has no end and may be wrong")
    except gzip.BadGzipFile as error:
        raise ValueError(f"{log}: {error}") from None
    except OSError:
        raise
    except Exception as error:  # each reader has exceptions of its own, down to IndexError
        reason = " ".join(str(error).split())
        if isinstance(error, UnicodeError):
            reason = "it is not a text"
        elif lines and not _is_ours(error):  # a reader stumbles in words of its own
            reason = f"not a frame: {lines.text.strip()[:40]!r}"
        where = f"{log}, line {lines.number}" if lines else f"{log}"
        raise ValueError(
            f"{where}: damaged or cut off, no further frame can be read ({reason})"
        ) from None
    finally:
        library.removeFilter(_refuse)


def _is_ours(error: Exception) -> bool:
    """Whether it was raised in this file."""
    last = error.__traceback__
    while last is not None and last.tb_next is not None:
        last = last.tb_next
    return last is not None and last.tb_frame.f_globals is globals()


class _Lines:
    """The lines of a text log for a reader of python-can: counted, none longer than any frame."""

    def __init__(self, log: Path, packed: bool):
        self._file = gzip.open(log, "rt") if packed else log.open()  # noqa: SIM115
        self.number, self.text = 0, ""
        self.open_end = False

    def __iter__(self) -> "_Lines":
        return self

    def __next__(self) -> str:
        line = self._file.readline(LONGEST + 1)
        if not line:
            raise StopIteration
        self.number, self.text = self.number + 1, line
        if len(line) > LONGEST:
            raise ValueError(f"it has more than {LONGEST} characters")
        self.open_end = not line.endswith("\n")
        return line

    def close(self) -> None:
        """As a file."""
        self._file.close()


class _Printed(_Lines):
    """Text that candump prints (also -t a, A, d, z, -x, -a, -e), as it writes logs (-l).

    Terminals' prompts and comments around it are left out. Times of `-t A` are taken as UTC;
    frames without times are `APART`.
    """

    def __init__(self, log: Path, packed: bool):
        self._frames = 0
        self._elapsed = 0.0
        self._differences = _are_differences(_Lines(log, packed))
        super().__init__(log, packed)

    def __next__(self) -> str:
        line = super().__next__()
        while _AROUND.match(line):
            line = super().__next__()
        printed = _PRINTED.fullmatch(line.rstrip("\r\n"))
        return self._as_logged(printed) if printed else line

    def _as_logged(self, printed: re.Match[str]) -> str:
        length, rest = int(printed["length"]), printed["rest"].strip()
        data = "".join(rest.split()[:length])
        if rest.startswith("remote request"):
            data = f"R{length}"
        elif len(data) != 2 * length or not re.fullmatch(r"[0-9A-Fa-f]*", data):
            raise ValueError(f"{length} bytes are announced, {rest[:40]!r} follows")
        elif len(printed["length"]) == 2:  # a length of two digits is that of CAN FD
            data = f"#0{data}"
        self._frames += 1
        seconds = self._frames * APART if printed["time"] is None else _seconds(printed["time"])
        if self._differences:
            self._elapsed = seconds = self._elapsed + seconds
        return f"({seconds:.6f}) {printed['channel']} {printed['id']}#{data}\n"


def _seconds(text: str) -> float:
    """A time as candump prints it, with a date too."""
    if "-" in text:
        return datetime.fromisoformat(text.strip()).replace(tzinfo=UTC).timestamp()
    return float(text)


def _are_differences(lines: _Lines) -> bool:
    """Whether the times are those from frame to frame (-t d): then they go back."""
    before = -math.inf
    try:
        for line, _ in zip(lines, range(LOOK_AHEAD), strict=False):
            printed = _PRINTED.match(line)
            if printed and printed["time"] is not None:
                seconds = _seconds(printed["time"])
                if seconds < before:
                    return seconds < 1e6  # a clock that was set back shows other numbers
                before = seconds
    except (ValueError, OSError, EOFError):
        pass  # it is told where the frame is read
    finally:
        lines.close()
    return False


class _Blocks:
    """A .blf file for python-can's reader, which would allocate whatever size a block claims."""

    def __init__(self, log: Path, packed: bool):
        self._file: Any = gzip.open(log) if packed else log.open("rb")  # noqa: SIM115
        self._container = False
        self.held = 0  # bytes since the last frame

    def read(self, size: int) -> bytes:
        """Read as a file does, at most one block at a time."""
        if not 0 <= size <= LARGEST_BLOCK:
            raise ValueError(f"a block of {size} bytes, it has 0 to at most {LARGEST_BLOCK}")
        data = self._file.read(size)
        if self._container:
            packed = int.from_bytes(data[:2], "little") == PACKED
            self.held += _unpacked(data[CONTAINER_HEADER:]) if packed else len(data)
            if self.held > LARGEST_BLOCK:
                raise ValueError(f"more than {LARGEST_BLOCK} bytes without a frame")
        head = size == CONTAINER_HEADER and data[:4] == b"LOBJ"
        self._container = head and int.from_bytes(data[BLOCK_TYPE:], "little") == CONTAINER
        return data

    def close(self) -> None:
        """As a file."""
        self._file.close()


def _unpacked(data: bytes) -> int:
    """How many bytes something packed becomes, counted up to a block and one more."""
    return len(zlib.decompressobj().decompress(data, LARGEST_BLOCK + 1))


def _look_through(log: Path) -> None:
    """Refuse a .db whose table of frames is made while it is read, or has values without end."""
    with contextlib.closing(sqlite3.connect(f"{log.absolute().as_uri()}?mode=ro", uri=True)) as db:
        db.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, LARGEST_VALUE)
        made = db.execute("SELECT type, sql FROM sqlite_master WHERE name = 'messages'").fetchall()
        if [kind for kind, _ in made] != ["table"] or not _PLAIN_TABLE.fullmatch(made[0][1]):
            raise ValueError("it has no plain table 'messages'")
        columns = [row[1] for row in db.execute("PRAGMA table_xinfo(messages)")]
        for column in columns:
            longest = f'SELECT max(length("{column}")) FROM messages'
            if (db.execute(longest).fetchone()[0] or 0) > LONGEST:
                raise ValueError(f"a value of {column} has more than {LONGEST} bytes")


def _refuse(record: logging.LogRecord) -> bool:
    """Readers only warn of a line they do not understand; an empty one may stay."""
    if record.args != ("",):
        raise ValueError(record.getMessage())
    return False


class LogFile:
    """A log that python-can's tools read; each `flush` leaves complete lines behind.

    A file that can no longer be written ends the log, not the drive.

    Args:
        file: its name; the suffix is the format: .log (candump), .asc, .blf, .csv, ...
        tell: takes the line about a log that has ended early.

    Raises:
        ValueError: unknown suffix. OSError: the file cannot be made.
    """

    def __init__(self, file: str | Path, tell: Callable[[str], None] = lambda text: None):
        self._name = file
        self._tell = tell
        self._written = False
        try:
            self._writer: Any = can.Logger(file)
        except ValueError as error:
            raise ValueError(f"log = {str(file)!r}: {error}; use .log, .asc or .blf") from None

    def __call__(self, message: can.Message) -> None:
        """Write a message to the log."""
        self._try(lambda: self._writer(message))
        self._written = True

    def flush(self) -> None:
        """Hand written data to the operating system, so that it survives a kill of the process."""
        if self._written:
            self._written = False
            self._try(lambda: getattr(self._writer, "file", None) and self._writer.file.flush())

    def stop(self) -> None:
        """Finish the file."""
        self._try(lambda: self._writer.stop())
        self._writer = None

    def _try(self, write: Callable[[], object]) -> None:
        if self._writer is None:
            return
        try:
            write()
        except OSError as error:
            broken, self._writer = self._writer, None
            with suppress(OSError, ValueError):
                broken.stop()  # what is buffered cannot be written either
            self._tell(f"{self._name}: {error}; the log ends here, the drive goes on")
