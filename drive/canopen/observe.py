"""What a drive says of itself when it is asked: objects, ranges, answers to what it must refuse.

One observation is a dictionary of plain values with a hash over it; two of them are compared line
by line. A model is observed as a node in this process is, by the same questions, so that a real
drive and its model differ in nothing but what they are.

The power stage stays off: the controlwords sent are Shutdown, Disable voltage and Fault reset.
Nothing is written to a drive that is enabled or moves, nor while another one on its bus is. What is
written (parameters of the profile that act on nothing at rest) is read before and put back.
"""

import hashlib
import json
import struct
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

from ..drive import Drive
from ..kernel.words import State, state_of
from ..machine import Standing
from ..master.errors import Timeout
from ..model.made import Made
from ..model.model import DriveModel, load
from ..model.rows import Object
from ..objects.abort import TEXT, Abort, SdoAbort
from .frame import Base, Frame
from .node import Node
from .port import FramePort, NodePort
from .sdo_client import SdoClient

FORMAT, VERSION = "servogym observation", 1
SCANNED = (range(0x1000, 0x2000), range(0x2000, 0x6000), range(0x6000, 0x6800))
LIVE_STATES = (State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE, State.FAULT_REACTION_ACTIVE)
SETTLED = 0.05  # s, until what was written shows
LISTENED = 0.3  # s, for other nodes
MOVED = 64  # position units in `SETTLED`: more than the noise of an encoder at rest
# parameters that act on nothing while the power stage is off, and can be put back as they were
OPTIONS = (0x6007, 0x605A, 0x605B, 0x605C, 0x605D, 0x605E, 0x6086, 0x6098, 0x60F2)
PARAMETERS = (*OPTIONS, 0x6065, 0x6066, 0x6067, 0x6068, 0x606D, 0x606E, 0x606F, 0x6070, 0x607C,
              0x607D, 0x607F, 0x6081, 0x6082, 0x6083, 0x6084, 0x6085, 0x6087, 0x6099, 0x609A,
              0x60C5, 0x60C6, 0x60E0, 0x60E1)  # fmt: skip
TRIED = range(-20, 41)  # values of option codes, modes and homing methods
MODES = range(-10, 16)
# objects that are asked for a wrong sub-index and sent a wrong length
ASKED = ((0x1000, 0), (0x1001, 0), (0x1018, 1), (0x1018, 2), (0x6041, 0), (0x6060, 0), (0x6061, 0),
         (0x6064, 0), (0x606C, 0), (0x607A, 0), (0x6081, 0), (0x6083, 0), (0x60FF, 0),
         (0x6502, 0))  # fmt: skip
PROTOCOL = {  # requests without an object, as CiA 301 answers or refuses them
    "unknown command specifier": ("E041600000000000",),
    "segment of no upload": ("6000000000000000",),
    "segment of no download": ("0000000000000000",),
    "end of no block download": ("C100000000000000",),
    "start of no block upload": ("A300000000000000",),
    "block upload of 0 segments": ("A041600000000000",),
    "block upload of 128 segments": ("A041600080000000",),
    "block download of a read-only object": ("C241600002000000",),
    "an object that there is not": ("40FF5F0000000000",),
    "segmented upload, toggle wrong": ("4008100000000000", "7000000000000000"),
    "segmented download refused at the start": ("2141600002000000",),
}
CONTROLWORDS = ((0x00,), (0x06,), (0x06, 0x00), (0x80,), (0x06, 0x80), (0x06, 0x06), (0x00, 0x06))


class Difference(NamedTuple):
    """A line in which two observations differ."""

    where: str  # object or dialogue
    what: str
    drive: str
    model: str

    def __str__(self) -> str:
        return f"{self.where}: {self.what}: drive {self.drive}, model {self.model}"


@dataclass
class _Cycling(Standing):
    """A drive that stands still, and whose cycles pass."""

    def step(self, cycles: int = 1) -> None:
        """Let so many position cycles pass."""
        for drive in self.drives.values():
            for _ in range(cycles):
                drive.cycle(0.0)
        self.time += cycles * self.cycle_time


def of_model(model: "str | DriveModel | Any", node_id: int = 1) -> dict[str, Any]:
    """The observation of a model: of its node, in this process. Raises ValueError as `load`."""
    drive = Drive(load(model, "can"), node_id=node_id)
    period = float(drive.model.cycle_time["position"])
    port = NodePort(_Cycling({"x": drive}, period), Node(drive))
    return Observer(port, node_id, drive.model).observe()


class Observer:
    """Asks one node.

    Args:
        bus: the way to it.
        node_id: 1..127.
        model: whose data types the objects have, where their lengths agree.
        read_only: write nothing.
        timeout: for an answer (s).
        tell: takes a line of progress.
    """

    def __init__(
        self,
        bus: FramePort,
        node_id: int,
        model: "str | DriveModel" = "generic",
        *,
        read_only: bool = False,
        timeout: float = 0.5,
        tell: Callable[[str], None] = lambda text: None,
    ):
        self._bus = bus
        self._node_id = node_id
        self._model = load(model)
        self._sdo = SdoClient(bus, node_id, timeout)
        self._timeout = timeout
        self._read_only = read_only
        self._tell = tell
        self._values: dict[tuple[int, int], str] = {}

    def observe(self) -> dict[str, Any]:
        """All there is to be seen.

        Raises:
            Timeout: the node does not answer.
        """
        self._sdo.upload(0x1000)
        reason = "as asked" if self._read_only else self._why_not_write()
        found: dict[str, Any] = {
            "format": FORMAT, "version": VERSION, "bus": "can", "node_id": self._node_id,
            "read_only": reason,
        }  # fmt: skip
        self._scan()
        live = self._live()
        objects: dict[str, dict[str, Any]] = {}
        for address, text in sorted(self._values.items()):
            objects[_shown(address)] = {"value": "live" if address in live else text}
        if not reason:
            for address in sorted(self._values):
                if address[0] in PARAMETERS:
                    self._probe(address, objects[_shown(address)])
        found["objects"] = objects
        found["dialogues"] = self._dialogues(bool(reason))
        return sealed(found)

    # ------------------------------------------------------------ permission

    def _why_not_write(self) -> str:
        """Why nothing is written; "" if it may be."""
        heard = self._wait(LISTENED)
        others = {frame.id & 0x7F for frame in heard if frame.id >= 0x180} - {0, self._node_id}
        for node_id in (self._node_id, *sorted(others)):
            try:
                sdo = SdoClient(self._bus, node_id, self._timeout, attempts=1)
                word = int.from_bytes(sdo.upload(0x6041), "little")
                first = int.from_bytes(sdo.upload(0x6064), "little", signed=True)
                self._wait(SETTLED)
                last = int.from_bytes(sdo.upload(0x6064), "little", signed=True)
            except (SdoAbort, Timeout):
                continue  # no drive, or one without a position
            if state_of(word) in LIVE_STATES:
                return f"node {node_id} is in {state_of(word).name}"  # type: ignore[union-attr]
            if abs(last - first) > MOVED:
                return f"node {node_id} moves: {first} to {last} position units"
        return ""

    def _wait(self, time: float) -> list[Frame]:
        end = self._bus.now() + time
        heard: list[Frame] = []
        while self._bus.now() < end:
            heard += self._bus.exchange([])
        return heard

    # --------------------------------------------------------------- objects

    def _read(self, index: int, subindex: int) -> str:
        """The bytes of an object in hexadecimal, or the abort code."""
        try:
            return self._sdo.upload(index, subindex).hex()
        except SdoAbort as abort:
            return _aborted(abort.code)

    def _scan(self) -> None:
        """All objects there are, with their sub-indices."""
        for block in SCANNED:
            self._tell(f"{block[0]:04X}h to {block[-1]:04X}h")
            for index in block:
                first = self._read(index, 0)
                if first == _aborted(Abort.NO_OBJECT):
                    continue
                if first != _aborted(Abort.NO_SUBINDEX):
                    self._values[index, 0] = first
                count = int(first, 16) if len(first) == 2 else 0
                for subindex in range(1, 0xFF):
                    text = self._read(index, subindex)
                    if text in (_aborted(Abort.NO_SUBINDEX), _aborted(Abort.NO_OBJECT)):
                        if subindex >= count:
                            break
                        continue
                    self._values[index, subindex] = text

    def _live(self) -> set[tuple[int, int]]:
        """Objects whose value changes by itself."""
        self._wait(SETTLED)
        return {address for address, text in self._values.items() if self._read(*address) != text}

    def _row(self, address: tuple[int, int], size: int) -> Object | None:
        """A row with the data type of an object, where its length is that of the drive."""
        for model in (self._model, load("generic")):
            row = model.objects.get(address)
            if row is not None and row.format not in ("", "f") and row.size == size:
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
                self._sdo.download(*address, row.code.pack(value))
            except SdoAbort as abort:
                return _aborted(abort.code)
            return ""

        value = int(row.code.unpack(data)[0])
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
            self._tell(f"{_shown(address)} could not be put back to {text}")

    # ------------------------------------------------------------- dialogues

    def _ask(self, request: bytes) -> str:
        """The answer to a raw request, "" where none comes."""
        end = self._bus.now() + SETTLED
        frames = [Frame(Base.SDO_REQUEST + self._node_id, request)]
        while True:
            for frame in self._bus.exchange(frames):
                if frame.id == Base.SDO_RESPONSE + self._node_id:
                    return frame.data.hex()
            frames = []
            if self._bus.now() >= end:
                return ""

    def _dialogues(self, read_only: bool) -> dict[str, list[str]]:
        """Scripted questions and their answers."""
        found: dict[str, list[str]] = {}
        for name, requests in PROTOCOL.items():
            found[name] = [self._ask(bytes.fromhex(request)) for request in requests][-1:]
            self._abort()
        for address in ASKED:
            if address not in self._values:
                continue
            shown, head = _shown(address), struct.pack("<H", address[0])
            found[f"{shown} sub-index FEh"] = [self._ask(b"\x40" + head + b"\xfe" + bytes(4))]
            size = len(self._values[address]) // 2
            if self._values[address].startswith("abort") or not 1 <= size <= 4:
                continue
            target = head + bytes([address[1]])
            # a length that the object does not have is refused before anything is stored
            too_long = b"\x21" + target + struct.pack("<I", size + 4)
            found[f"{shown} {size + 4} bytes"] = [self._ask(too_long)]
            self._abort()
            if size > 1:
                short = bytes([0x23 | (4 - size + 1) << 2]) + target + bytes(4)
                found[f"{shown} {size - 1} bytes"] = [self._ask(short)]
        rtr = Frame(Base.ERROR_CONTROL + self._node_id, remote=True)
        guarded = self._bus.exchange([rtr])
        found["node guarding"] = [
            frame.data.hex() for frame in [*guarded, *self._wait(SETTLED)]
            if frame.id == rtr.id and not frame.remote
        ][:1]  # fmt: skip
        if not read_only:
            self._words(found)
            self._modes(found)
        return found

    def _abort(self) -> None:
        """End a transfer that may be open."""
        data = b"\x80" + bytes(3) + struct.pack("<I", Abort.GENERAL)
        self._bus.exchange([Frame(Base.SDO_REQUEST + self._node_id, data)])

    def _download(self, index: int, data: bytes) -> str:
        try:
            self._sdo.download(index, 0, data)
        except SdoAbort as abort:
            return _aborted(abort.code)
        return "ok"

    def _words(self, found: dict[str, list[str]]) -> None:
        """Controlwords that leave the power stage off, and the statusword after each."""
        for words in CONTROLWORDS:
            answers = []
            for word in words:
                self._download(0x6040, struct.pack("<H", word))
                self._wait(SETTLED)
                answers.append(self._read(0x6041, 0))
            found["controlword " + " ".join(f"{word:04X}h" for word in words)] = answers
            self._download(0x6040, bytes(2))
            self._wait(SETTLED)

    def _modes(self, found: dict[str, list[str]]) -> None:
        """Which modes 6060h takes, and what 6061h then shows."""
        before = self._values.get((0x6060, 0), "")
        for mode in MODES:
            answer = self._download(0x6060, struct.pack("<b", mode))
            self._wait(SETTLED)
            shows = self._read(0x6061, 0) == struct.pack("<b", mode).hex()
            found[f"mode {mode}"] = [answer, "shown" if shows else "not shown"]
        if len(before) == 2:
            self._download(0x6060, bytes.fromhex(before))
            self._wait(SETTLED)


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


def _shown(address: tuple[int, int]) -> str:
    return f"{address[0]:04X}h:{address[1]:02X}h"


def _aborted(code: int) -> str:
    return f"abort {int(code):08X}h"


# ------------------------------------------------------------------- files


def sealed(found: Mapping[str, Any]) -> dict[str, Any]:
    """An observation with its hash."""
    plain = {key: value for key, value in found.items() if key != "sha256"}
    return plain | {"sha256": hashlib.sha256(_canonical(plain)).hexdigest()}


def _canonical(found: Mapping[str, Any]) -> bytes:
    return json.dumps(found, sort_keys=True, separators=(",", ":")).encode()


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
                     "beyond_high"):  # fmt: skip
            a, b = one.get(what), other.get(what)
            if a is None or b is None or a == b or "live" in (a, b):
                continue
            lengths = what == "value" and len(str(a)) != len(str(b))
            found.append(Difference(where, "length" if lengths else what, _said(a), _said(b)))
    asked, told = drive["dialogues"], model["dialogues"]
    for where in asked:
        if where in told and asked[where] != told[where]:
            found.append(Difference(where, "answer", _answers(asked[where]), _answers(told[where])))
    return found


def _said(value: Any) -> str:
    text = str(value)
    code = text.removeprefix("abort ").removesuffix("h")
    if text.startswith("abort ") and int(code, 16) in TEXT:
        return f"{text} ({TEXT[Abort(int(code, 16))]})"
    return text


def _answers(answers: Iterable[str]) -> str:
    return ", ".join(_said(answer) or "none" for answer in answers) or "none"


def proposed(differences: Iterable[Difference], model: DriveModel, source: str) -> Made:
    """A model on top of `model` whose rows say what was observed, each marked so."""
    made = Made(f"{model.title}, as observed", source, "servogym observe --compare")
    made.base = str(model.folder) if model.folder.name != model.name else model.name
    made.pdos = None
    rows: dict[str, dict[str, Any]] = {}
    gone: set[str] = set()
    for difference in differences:
        where, what, ours, _ = difference
        made.notes.append(f"`observed` {difference}")
        if len(where) != 9 or where[4] != "h":
            continue  # a dialogue: no row says that
        index, subindex = int(where[:4], 16), int(where[6:8], 16)
        if 0x1400 <= index < 0x1C00:
            continue  # PDOs are set by the master
        row = model.objects.get((index, subindex))
        if what == "object" and ours == "missing":
            if subindex == 0:
                gone.add(f"{index:04X}h")
            continue
        own = rows.setdefault(where, {
            "index": f"0x{index:04X}", "subindex": f"0x{subindex:02X}", "section": "observed",
        })  # fmt: skip
        if row is None or what == "length":
            own |= {"name": f"observed_{index:04x}_{subindex:02x}", "object_type": "VAR",
                    "data_type": "UNSIGNED32", "access": "ro", "default": "0"}  # fmt: skip
        elif what == "value" and row.format and not ours.startswith("abort"):
            own["default"] = str(row.code.unpack(bytes.fromhex(ours))[0])
        elif what in ("low", "high"):
            own["min" if what == "low" else "max"] = ours
        elif what == "values":
            own["min"] = "{" + ";".join(ours.strip("[]").split(", ")) + "}"
        elif what == "write":
            own["access"] = "rw" if ours == "yes" else "ro"
    made.objects = [row for row in rows.values() if len(row) > 3]
    made.toml = {"without": sorted(gone)} if gone else {}
    return made
