"""Text logs of a CAN bus in the variants found in practice, normalised for python-can's readers.

Output of `candump` is copied from terminals and forums; CANoe and PCAN-View write several versions
of their formats. Each class passes its reader lines that are unambiguous.
"""

import contextlib
import gzip
import math
import re
import zlib
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

LONGEST = 1 << 16  # characters of a line; the readers would hold any at once, unpacked ones too
APART = 1e-3  # s between frames of a text without times (inferred: an order is all it tells)
LOOK_AHEAD = 1000  # lines in which times that go back show that they are differences
# a line that candump prints: (time), channel, TX or RX and flags (-x), identifier, length, the
# rest; of the older canutils: <identifier> [length] bytes
_PRINTED = re.compile(
    r"[\s>|]*(?:\((?P<time>[^)]*)\)\s+)?"
    r"(?:(?P<channel>[A-Za-z][\w.-]*)\s+(?:[TR]X\s+[B-]\s+[E-]\s+)?|<0x)"
    r"(?P<id>[0-9A-Fa-f]{8}|[0-9A-Fa-f]{3})>?\s+[\[{](?P<length>\d{1,2})[\]}](?P<rest>.*)"
)
_LOGGED = re.compile(r"(?P<head>\s*\S+\s+\S+\s+)(?P<id>[0-9A-Fa-f]{8})(?P<rest>#.*)")
_ERROR, _BUS_ERROR = 1 << 29, 0x80  # of an identifier (linux/can/error.h)
# what stands around it in a terminal: prompts, jobs, comments, "...", Ctrl-C, words about an error
_AROUND = re.compile(
    r"\s*(?:[$#>]|\.{2,}|…|\^C|```|\S+@\S+|\[\d+\][+-]?\s|interface = |(?:sudo )?candump\b)|\t"
)
_COLOUR = re.compile(r"\x1b\[[\d;]*m")
_EVENT = re.compile(r"(?P<time>\s*\d+\.\d+)(?P<rest>\s.*)", re.DOTALL)  # of an .asc
_BASE = re.compile(r"\s*base\s+(?P<base>hex|dec)(?:\s+timestamps\s+(?P<times>\w+))?", re.IGNORECASE)
_REQUEST = re.compile(r"\s*\d+\.\d+\s+\d+\s+\w+\s+TxRq\b")  # a frame that is still to be sent
_VERSION = re.compile(r"\s*;\$FILEVERSION\s*=\s*(?P<version>[\d.]+)")
_VERSIONS = ("1.0", "1.1", "1.3", "2.0", "2.1")  # of .trc that python-can reads


class Damaged(ValueError):
    """A line cannot be read; the message is meant for the user."""


class Lines:
    """The lines of a text log, counted and limited to the length of the longest frame.

    Bytes that are not UTF-8 occur in paths, dates and comments, and are kept.

    Args:
        log: the file; UTF-16 with a byte-order mark, as written by PowerShell, is recognised.
        packed: whether the file is compressed by gzip.
    """

    def __init__(self, log: Path, packed: bool):
        opened: Any = gzip.open if packed else open
        encoding = "utf-8-sig"
        with contextlib.suppress(OSError, EOFError, zlib.error), opened(log, "rb") as begin:
            encoding = "utf-16" if begin.read(2) in (b"\xff\xfe", b"\xfe\xff") else encoding
        self._file = opened(log, "rt", encoding=encoding, errors="surrogateescape")
        self.number, self.text = 0, ""
        self.open_end = False

    def __iter__(self) -> "Lines":
        return self

    def __next__(self) -> str:
        line = self._file.readline(LONGEST + 1)
        if not line:
            raise StopIteration
        self.number, self.text = self.number + 1, line
        if len(line) > LONGEST:
            raise Damaged(f"it has more than {LONGEST} characters")
        if "\0" in line:
            raise Damaged("it is not a text")
        self.open_end = not line.endswith("\n")
        return line

    def close(self) -> None:
        """Close the file."""
        self._file.close()


class Printed(Lines):
    """Output of candump (also with -t a, A, d, z, -x, -a, -c, -e, -8), and its logs (-l).

    Prompts of a terminal and comments are skipped. Times of `-t A` are read as UTC; frames without
    times are spaced by `APART`.
    """

    def __init__(self, log: Path, packed: bool):
        self._frames = 0
        self._elapsed = 0.0
        self._differences = _are_differences(Lines(log, packed))
        super().__init__(log, packed)

    def __next__(self) -> str:
        while True:
            line = _COLOUR.sub("", super().__next__())
            printed = _PRINTED.fullmatch(line.rstrip("\r\n"))
            if printed:
                return self._as_logged(printed)
            if not _AROUND.match(line):
                return _LOGGED.sub(lambda found: found["head"] + _id(found["id"]) + found["rest"],
                                   line)

    def _as_logged(self, printed: re.Match[str]) -> str:
        length, rest = int(printed["length"]), printed["rest"].strip()
        data = "".join(rest.split()[:length])
        if rest.startswith("remote request"):
            data = f"R{length}"
        elif len(data) != 2 * length or not re.fullmatch(r"[0-9A-Fa-f]*", data):
            raise Damaged(f"{length} bytes are announced, {rest[:40]!r} follows")
        elif len(printed["length"]) == 2:  # a length of two digits is that of CAN FD
            data = f"#0{data}"
        self._frames += 1
        seconds = self._frames * APART if printed["time"] is None else _seconds(printed["time"])
        if self._differences:
            self._elapsed = seconds = self._elapsed + seconds
        return f"({seconds:.6f}) {printed['channel'] or 'can'} {_id(printed['id'])}#{data}\n"


def _id(text: str) -> str:
    """An identifier; python-can takes an error frame for one only if its class is a bus error."""
    error = len(text) == 8 and int(text, 16) & _ERROR
    return f"{int(text, 16) | _BUS_ERROR:08X}" if error else text


def _seconds(text: str) -> float:
    """A time as candump prints it, with a date too."""
    if "-" in text:
        return datetime.fromisoformat(text.strip()).replace(tzinfo=UTC).timestamp()
    return float(text)


def _are_differences(lines: Lines) -> bool:
    """Whether the times are those from frame to frame (-t d): then they go back."""
    before = -math.inf
    try:
        for line, _ in zip(lines, range(LOOK_AHEAD), strict=False):
            printed = _PRINTED.match(_COLOUR.sub("", line))
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


class Vector(Lines):
    """An .asc of CANoe or CANalyzer.

    python-can ends the header at the first unexpected line, which it drops, and reads times
    relative to the previous event as times since the start.
    """

    def __init__(self, log: Path, packed: bool):
        super().__init__(log, packed)
        self._elapsed = 0.0
        self._relative = False
        self._begin: Iterator[str] | None = None

    def __next__(self) -> str:
        if self._begin is None:
            self._begin = iter(self._header())
        line = next(self._begin, None)
        if line is not None:
            return line
        line = super().__next__()
        while _REQUEST.match(line):
            self._timed(line)
            line = super().__next__()
        return self._timed(line)

    def _header(self) -> list[str]:
        """Lines in its place, and the first event."""
        base = "hex"
        for line in iter(super().__next__, None):
            found = _BASE.match(line)
            if found:
                base = found["base"]
                self._relative = (found["times"] or "").lower() == "relative"
            elif _EVENT.match(line):
                return [f"base {base} timestamps absolute\n", "internal events logged\n",
                        self._timed(line)]
        return []

    def _timed(self, line: str) -> str:
        event = _EVENT.match(line) if self._relative else None
        if event is None:
            return line
        self._elapsed += float(event["time"])
        return f"{self._elapsed:.6f}{event['rest']}"


class Trace(Lines):
    """A .trc of PCAN-View; python-can reads a version it does not know as the first one."""

    def __next__(self) -> str:
        line = super().__next__()
        found = _VERSION.match(line)
        if found and found["version"] not in _VERSIONS:
            raise Damaged(
                f"version {found['version']} of this format is not read, save it as one of "
                + ", ".join(_VERSIONS)
            )
        return line


TEXTS: dict[str, type[Lines]] = {
    ".log": Printed, ".txt": Printed, ".asc": Vector, ".trc": Trace, ".csv": Lines,
}
