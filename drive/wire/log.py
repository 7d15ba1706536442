"""Logs of a CAN bus: read and written in the formats of python-can."""

import contextlib
import gzip
import logging
import re
import sqlite3
import zlib
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import can
from can.io.player import MESSAGE_READERS

from ..model.files import regular
from .text_log import LONGEST, TEXTS, Damaged

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
    lines = TEXTS[plain[0]](log, packed) if plain[0] in TEXTS else None
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
                raise Damaged("it has no end and may be wrong")
    except gzip.BadGzipFile as error:
        raise ValueError(f"{log}: {error}") from None
    except OSError:
        raise
    except Exception as error:  # each reader has exceptions of its own, down to IndexError
        reason = " ".join(str(error).split())
        if isinstance(error, UnicodeError):
            reason = "it is not a text"
        elif lines and not isinstance(error, Damaged):  # a reader stumbles in words of its own
            reason = f"not a frame: {lines.text.strip()[:40]!r}"
        where = f"{log}, line {lines.number}" if lines else f"{log}"
        raise ValueError(
            f"{where}: damaged or cut off, no further frame can be read ({reason})"
        ) from None
    finally:
        library.removeFilter(_refuse)


class _Blocks:
    """A .blf file that limits block sizes; python-can's reader would allocate any size claimed."""

    def __init__(self, log: Path, packed: bool):
        self._file: Any = gzip.open(log) if packed else log.open("rb")  # noqa: SIM115
        self._container = False
        self.held = 0  # bytes since the last frame

    def read(self, size: int) -> bytes:
        """Read like a file, at most one block at a time."""
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
        """Close the file."""
        self._file.close()


def _unpacked(data: bytes) -> int:
    """Number of bytes after decompression, counted up to one byte beyond the limit of a block."""
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
        raise Damaged(record.getMessage())
    return False


class LogFile:
    """A log that python-can's tools read; each `flush` leaves complete lines behind.

    A file that can no longer be written ends the log, not the drive.

    Args:
        file: its name; the suffix is the format: .log (candump), .asc, .blf, .csv, ...
        tell: called with a line if the log has to end early.

    Raises:
        ValueError: unknown suffix. OSError: the file cannot be created.
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
