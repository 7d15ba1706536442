"""What a drive says of itself when it is asked: objects, ranges, answers to what it must refuse.

One observation is a dictionary of plain values with a hash over it; two of them are compared line
by line. A model is observed as a node or a slave in this process is, by the same questions, so that
a real drive and its model differ in nothing but what they are. `canopen.observe` and
`ethercat.observe` are the ways to a drive, and ask what only their bus has.

The power stage stays off: the controlwords sent are Shutdown, Disable voltage and Fault reset.
Nothing is written to a drive that is enabled or moves, nor while another one on its bus is. What is
written (parameters of the profile that act on nothing at rest) is read before and put back.
"""

import hashlib
import json
import struct
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from typing import Any, NamedTuple, Protocol

from .kernel.words import MODE_ABBREVIATION, State, state_of
from .model.made import ModelFolder
from .model.model import DriveModel, load
from .model.rows import FORMATS, REAL, SIZES, Object
from .objects.abort import TEXT, Abort, SdoAbort

FORMAT, VERSION = "servogym observation", 1
SCANNED = (range(0x1000, 0x2000), range(0x2000, 0x6000), range(0x6000, 0x6800))
LIVE_STATES = (State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE, State.FAULT_REACTION_ACTIVE)
SETTLED = 0.05  # s, until what was written shows
MOVED = 64  # position units in `SETTLED`: more than the noise of an encoder at rest
# parameters that act on nothing while the power stage is off, and can be put back as they were
OPTIONS = (0x6007, 0x605A, 0x605B, 0x605C, 0x605D, 0x605E, 0x6086, 0x6098, 0x60F2)
PARAMETERS = (*OPTIONS, 0x6065, 0x6066, 0x6067, 0x6068, 0x606D, 0x606E, 0x606F, 0x6070, 0x607C,
              0x607D, 0x607F, 0x6081, 0x6082, 0x6083, 0x6084, 0x6085, 0x6087, 0x6099, 0x609A,
              0x60C5, 0x60C6, 0x60E0, 0x60E1)
STATUSWORD, HOMING_METHOD, HOMING_METHODS = 0x6041, 0x6098, 0x60E3
# numbers of data types in CiA 301
TYPES = {0x01: "BOOLEAN", 0x02: "INTEGER8", 0x03: "INTEGER16", 0x04: "INTEGER32",
         0x05: "UNSIGNED8", 0x06: "UNSIGNED16", 0x07: "UNSIGNED32", 0x08: "REAL32",
         0x09: "VISIBLE_STRING", 0x15: "INTEGER64", 0x1B: "UNSIGNED64"}
INTEGERS = tuple(name for name, code in FORMATS.items() if code and code not in REAL)
TRIED = range(-20, 41)  # values of option codes, modes and homing methods
MODES = range(-10, 16)
# objects that are asked for a wrong sub-index and sent a wrong length
ASKED = ((0x1000, 0), (0x1001, 0), (0x1018, 1), (0x1018, 2), (0x6041, 0), (0x6060, 0), (0x6061, 0),
         (0x6064, 0), (0x606C, 0), (0x607A, 0), (0x6081, 0), (0x6083, 0), (0x60FF, 0),
         (0x6502, 0))
CONTROLWORDS = ((0x00,), (0x06,), (0x06, 0x00), (0x80,), (0x06, 0x80), (0x06, 0x06), (0x00, 0x06))


class Difference(NamedTuple):
    """A line in which two observations differ."""

    where: str  # object or dialogue
    what: str
    drive: str
    model: str

    def __str__(self) -> str:
        return f"{self.where}: {self.what}: drive {self.drive}, model {self.model}"


class Line(Protocol):
    """The way to one drive."""

    @property
    def about(self) -> Mapping[str, Any]:
        """The bus, and the address of the drive on it."""

    def upload(self, index: int, subindex: int = 0, /) -> bytes:
        """The bytes of an object. Raises SdoAbort, and what its bus has for silence."""

    def download(self, index: int, subindex: int, data: bytes, /) -> None:
        """Write an object; as `upload`."""

    def wait(self, time: float, /) -> object:
        """Let a time pass (s)."""

    def why_not_write(self) -> str:
        """Why nothing is written; "" if it may be."""

    def indices(self, block: range) -> Iterable[int]:
        """The objects of a range that there may be."""

    def ask(self, values: Mapping[tuple[int, int], str]) -> dict[str, list[str]]:
        """Questions that only this bus has, and their answers; `values` are those of objects."""


def danger(read: Callable[[int], bytes], wait: Callable[[float], object]) -> str:
    """Why nothing may be written while a drive is as it is, "" where it is at rest and off.

    Args:
        read: an object of the drive. Raises SdoAbort where it has none.
        wait: lets a time pass (s).
    """
    word = int.from_bytes(read(0x6041), "little")
    state = state_of(word)
    if state in LIVE_STATES:
        assert state is not None
        return f"is in {state.name}"
    first = int.from_bytes(read(0x6064), "little", signed=True)
    wait(SETTLED)
    last = int.from_bytes(read(0x6064), "little", signed=True)
    return f"moves: {first} to {last} position units" if abs(last - first) > MOVED else ""


class Observer:
    """Asks one drive.

    Args:
        line: the way to it.
        model: whose data types the objects have, where their lengths agree.
        read_only: write nothing.
        tell: takes a line of progress.
        like: an observation to compare with, whose data types come first: a range is found by
            values of a type, so both drives must be asked in the same one.
    """

    def __init__(
        self, line: Line, model: "str | DriveModel" = "generic", *, read_only: bool = False,
        tell: Callable[[str], None] = lambda text: None, like: Mapping[str, Any] | None = None,
    ):
        self._line = line
        self._models = (load(model), load("generic"))
        self._read_only = read_only
        self._tell = tell
        self._values: dict[tuple[int, int], str] = {}
        objects = like["objects"] if like else {}
        self._types = {where: one["type"] for where, one in objects.items()
                       if one.get("type") in INTEGERS}

    def observe(self) -> dict[str, Any]:
        """All there is to be seen. Raises what the line raises where the drive does not answer."""
        self._line.upload(0x1000)
        reason = "as asked" if self._read_only else self._line.why_not_write()
        found: dict[str, Any] = {
            "format": FORMAT, "version": VERSION, "read_only": reason, **self._line.about
        }
        self._scan()
        live = self._live()
        objects: dict[str, dict[str, Any]] = {}
        for address, text in sorted(self._values.items()):
            objects[shown(address)] = {"value": "live" if address in live else text}
        if not reason:
            for address in sorted(self._values):
                if address[0] in PARAMETERS:
                    self._probe(address, objects[shown(address)])
        found["objects"] = objects
        found["dialogues"] = self._line.ask(self._values)
        if not reason:
            self._words(found["dialogues"])
            self._modes(found["dialogues"])
        return sealed(found)

    # --------------------------------------------------------------- objects

    def _read(self, index: int, subindex: int) -> str:
        """The bytes of an object in hexadecimal, or the abort code."""
        try:
            return self._line.upload(index, subindex).hex()
        except SdoAbort as abort:
            return aborted(abort.code)

    def _scan(self) -> None:
        """All objects there are, with their sub-indices."""
        for block in SCANNED:
            self._tell(f"{block[0]:04X}h to {block[-1]:04X}h")
            for index in self._line.indices(block):
                first = self._read(index, 0)
                if first == aborted(Abort.NO_OBJECT):
                    continue
                if first != aborted(Abort.NO_SUBINDEX):
                    self._values[index, 0] = first
                count = int(first, 16) if len(first) == 2 else 0
                for subindex in range(1, 0xFF):
                    text = self._read(index, subindex)
                    if subindex > count and text.startswith("abort"):
                        break  # whatever the reason: nothing is behind the number of entries
                    if text not in (aborted(Abort.NO_SUBINDEX), aborted(Abort.NO_OBJECT)):
                        self._values[index, subindex] = text

    def _live(self) -> set[tuple[int, int]]:
        """Objects whose value changes by itself."""
        self._line.wait(SETTLED)
        return {address for address, text in self._values.items() if self._read(*address) != text}

    def _row(self, address: tuple[int, int], size: int) -> Object | None:
        """A row with the data type of an object, where its length is that of the drive."""
        for model in self._models:
            row = model.objects.get(address)
            if row is None:
                continue
            row = replace(row, data_type=self._types.get(shown(address), row.data_type))
            if row.data_type in INTEGERS and row.size == size:
                return row
        return None

    def _probe(self, address: tuple[int, int], found: dict[str, Any]) -> None:
        """Whether an object can be written, and its range; its value is put back."""
        text = self._values[address]
        if text.startswith("abort"):
            return
        data = bytes.fromhex(text)
        row = self._row(address, len(data))
        if row is None:
            return

        def write(value: int) -> str:
            try:
                self._line.download(*address, row.code.pack(value))
            except SdoAbort as abort:
                return aborted(abort.code)
            return ""

        value = int(row.code.unpack(data)[0])
        found["type"] = row.data_type
        found["write"] = write(value) or "yes"
        if found["write"] != "yes":
            return
        bits = 8 * row.size
        low, high = (0, (1 << bits) - 1)
        if row.format.islower():
            low, high = -(1 << bits - 1), (1 << bits - 1) - 1
        if address[0] in OPTIONS:
            tried = [n for n in TRIED if low <= n <= high]
            answers = {n: write(n) for n in tried}
            found["values"] = [n for n, refused in answers.items() if not refused]
            found["refused"] = sorted({refused for refused in answers.values() if refused})
        else:
            for name, end in (("low", low), ("high", high)):
                found[name], found[f"beyond_{name}"] = _bound(write, value, end)
        write(value)
        if self._read(*address) != text:
            found["not_restored"] = self._read(*address)
            self._tell(f"{shown(address)} could not be put back to {text}")

    # ------------------------------------------------------------- dialogues

    def _download(self, index: int, data: bytes) -> str:
        try:
            self._line.download(index, 0, data)
        except SdoAbort as abort:
            return aborted(abort.code)
        return "ok"

    def _words(self, found: dict[str, list[str]]) -> None:
        """Controlwords that leave the power stage off, and the statusword after each."""
        for words in CONTROLWORDS:
            answers = []
            for word in words:
                self._download(0x6040, struct.pack("<H", word))
                self._line.wait(SETTLED)
                answers.append(self._read(0x6041, 0))
            found["controlword " + " ".join(f"{word:04X}h" for word in words)] = answers
            self._download(0x6040, bytes(2))
            self._line.wait(SETTLED)

    def _modes(self, found: dict[str, list[str]]) -> None:
        """Which modes 6060h takes, and what 6061h then shows."""
        before = self._values.get((0x6060, 0), "")
        for mode in MODES:
            answer = self._download(0x6060, struct.pack("<b", mode))
            self._line.wait(SETTLED)
            shows = self._read(0x6061, 0) == struct.pack("<b", mode).hex()
            found[f"mode {mode}"] = [answer, "shown" if shows else "not shown"]
        if len(before) == 2:
            self._download(0x6060, bytes.fromhex(before))
            self._line.wait(SETTLED)


def _bound(write: Callable[[int], str], good: int, end: int) -> tuple[int, str]:
    """The last value on the way to `end` that is taken, and what refuses the next one."""
    refused = write(end)
    if not refused:
        return end, ""
    step = 1 if end > good else -1
    while abs(end - good) > 1:
        middle = good + step * (abs(end - good) // 2)
        answer = write(middle)
        if answer:
            end, refused = middle, answer
        else:
            good = middle
    return good, refused


def shown(address: tuple[int, int]) -> str:
    """An object as it is written: ``6041h:00h``."""
    return f"{address[0]:04X}h:{address[1]:02X}h"


def aborted(code: int) -> str:
    """An abort as it stands in an observation."""
    return f"abort {int(code):08X}h"


# ------------------------------------------------------------------- files


def sealed(found: Mapping[str, Any]) -> dict[str, Any]:
    """An observation with its hash."""
    plain = {key: value for key, value in found.items() if key != "sha256"}
    canonical = json.dumps(plain, sort_keys=True, separators=(",", ":")).encode()
    return plain | {"sha256": hashlib.sha256(canonical).hexdigest()}


def opened(text: str, where: str) -> dict[str, Any]:
    """An observation of a file.

    Raises:
        ValueError: it is none, of another version, or altered.
    """
    try:
        found = json.loads(text)
        objects, dialogues, stated = found["objects"], found["dialogues"], found["sha256"]
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise ValueError(f"{where} is not an observation of a drive ({error!r:.80})") from None
    if (found.get("format"), found.get("version")) != (FORMAT, VERSION):
        raise ValueError(f"{where} is not a {FORMAT} of version {VERSION}: observe the drive again")
    plain = all(isinstance(one, dict) for one in (objects, dialogues, *objects.values()))
    if not plain or sealed(found)["sha256"] != stated:
        raise ValueError(f"{where} was altered, its hash does not match: observe the drive again")
    return found


# -------------------------------------------------------------- comparison


def compare(drive: Mapping[str, Any], model: Mapping[str, Any]) -> list[Difference]:
    """Where two observations differ, an object or a dialogue a line."""
    found: list[Difference] = []
    ours, theirs = drive["objects"], model["objects"]
    for where in sorted({*ours, *theirs}):
        one, other = ours.get(where), theirs.get(where)
        if one is None or other is None:
            there = ("missing", "there") if one is None else ("there", "missing")
            found.append(Difference(where, "object", *there))
            continue
        for what in ("value", "write", "low", "high", "values", "refused", "beyond_low",
                     "beyond_high"):
            a, b = one.get(what), other.get(what)
            if a is None or b is None or a == b or "live" in (a, b):
                continue
            lengths = what == "value" and len(str(a)) != len(str(b))
            found.append(Difference(where, "length" if lengths else what, _said(a), _said(b)))
    other = model["dialogues"]
    for where, answers in drive["dialogues"].items():
        if where in other and answers != other[where]:
            found.append(Difference(where, "answer", _answers(answers), _answers(other[where])))
    return found


def _said(value: Any) -> str:
    text = str(value)
    code = text.removeprefix("abort ").removesuffix("h")
    if text.startswith("abort ") and int(code, 16) in TEXT:
        return f"{text} ({TEXT[Abort(int(code, 16))]})"
    return text


def _answers(answers: Iterable[str]) -> str:
    return ", ".join(_said(answer) or "none" for answer in answers) or "none"


def proposed(
    differences: Iterable[Difference], model: DriveModel, source: str, drive: Mapping[str, Any]
) -> ModelFolder:
    """A model on top of `model` whose rows say what was observed, each marked so.

    Args:
        differences: of the observation and the model.
        model: what it stands on.
        source: name of the observation.
        drive: the observation.
    """
    made = ModelFolder(f"{model.title}, as observed", source, "servogym observe --compare")
    made.base = str(model.folder) if model.folder.name != model.name else model.name
    made.pdos = None
    rows: dict[str, dict[str, Any]] = {}
    gone: set[str] = set()
    modes, methods = {int(mode) for mode in model.modes}, set(model.homing_methods)
    for difference in differences:
        where, what, ours, _ = difference
        made.notes.append(f"`observed` {difference}")
        if where.startswith("mode "):
            number = int(where.removeprefix("mode "))
            (modes.add if ours.startswith("ok") else modes.discard)(number)
        if len(where) != 9 or where[4] != "h":
            continue  # a dialogue: no row says that
        index, subindex = int(where[:4], 16), int(where[6:8], 16)
        if 0x1400 <= index < 0x1C20 or index in (STATUSWORD, HOMING_METHODS):
            continue  # PDOs are set by the master; a drive makes the other two
        row = model.objects.get((index, subindex))
        if what == "object" and ours == "missing":
            if subindex == 0:
                gone.add(f"{index:04X}h")
            continue
        own = rows.setdefault(where, {
            "index": f"0x{index:04X}", "subindex": f"0x{subindex:02X}", "section": "observed",
        })
        if row is not None and row.data_type == "VISIBLE_STRING" and what in ("value", "length"):
            own["default"] = _text(ours)
        elif row is None or what == "length":
            own |= _unknown(where, drive)
        elif what == "value" and row.format and not ours.startswith("abort"):
            own["default"] = str(row.code.unpack(bytes.fromhex(ours))[0])
        elif what in ("low", "high"):
            own["min" if what == "low" else "max"] = ours
        elif what == "values":
            taken = [int(value) for value in ours.strip("[]").split(", ") if value]
            if not taken:
                continue
            if index == HOMING_METHOD:
                methods = {method for method in taken if method}
            elif taken == [*range(taken[0], taken[-1] + 1)]:
                own |= {"min": str(taken[0]), "max": str(taken[-1])}
            else:
                own["min"] = "{" + ";".join(map(str, taken)) + "}"
        elif what == "write":
            own["access"] = "rw" if ours == "yes" else "ro"
    made.objects = [row for row in rows.values() if len(row) > 3]
    made.toml = {"without": sorted(gone)} if gone else {}
    capabilities: dict[str, Any] = {}
    if modes != {int(mode) for mode in model.modes}:
        capabilities["modes"] = [
            abbreviation
            for mode, abbreviation in sorted(MODE_ABBREVIATION.items())
            if mode in modes
        ]
    if methods != {*model.homing_methods}:
        known = dict.fromkeys((*model.homing_methods, *load("generic").homing_methods))
        capabilities["homing_methods"] = [method for method in known if method in methods]
    if capabilities:
        made.toml["capabilities"] = capabilities
    return made


def _text(data: str) -> str:
    """A string as `objects.csv` has it, of bytes in hexadecimal."""
    if data.startswith("abort"):
        return ""
    text = bytes.fromhex(data).rstrip(b"\0").decode("ascii", "replace")
    return "".join(c for c in text if c.isprintable() and c.isascii())


def _unknown(where: str, drive: Mapping[str, Any]) -> dict[str, Any]:
    """Cells of an object that the model does not have, or has in another length."""
    found = drive["objects"].get(where, {})
    data, writable = str(found.get("value", "")), found.get("write") == "yes"
    described = "".join(drive["dialogues"].get(f"{where}, entry", ()))
    cells = {"name": f"observed_{where[:4].lower()}_{where[6:8].lower()}", "object_type": "VAR",
             "access": "rw" if writable else "ro", "default": "0"}
    size = 0 if data.startswith(("abort", "live")) else len(data) // 2
    if described:  # SDO information: type, bits, access, name
        code, bits, access = struct.unpack_from("<HHH", bytes.fromhex(described))
        kind = TYPES.get(code)
        cells["access"] = "rw" if access & 0x38 and access & 0x07 else cells["access"]
        size = size or bits // 8
        if kind is not None and (not FORMATS[kind] or SIZES[FORMATS[kind]] == size):
            cells["data_type"] = kind
    if "data_type" not in cells:
        usual = {1: "UNSIGNED8", 2: "UNSIGNED16", 4: "UNSIGNED32", 8: "UNSIGNED64"}
        cells["data_type"] = usual.get(size, "VISIBLE_STRING")
    letter = FORMATS[cells["data_type"]]
    if not letter:
        cells["default"] = _text(data) if cells["data_type"] == "VISIBLE_STRING" else ""
        cells["access"] = "ro"
    elif size == SIZES[letter] and not data.startswith("live"):
        cells["default"] = str(struct.unpack("<" + letter, bytes.fromhex(data))[0])
    return cells
