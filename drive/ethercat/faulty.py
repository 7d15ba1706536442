"""Fault injection on a segment: random with a seed, or scripted by milestones.

>>> bus = FaultyBus(segment, machines, faults=["drop at=cycle:100 count=3",
...                                            "retreat at=op:50 slave=1 code=0x1B"])

A fault is a line: its kind, then ``key=value`` pairs. ``at=MILESTONE:N`` starts it at the N-th
frame (``frame``), frame of process data (``cycle``) or mailbox request (``mailbox``), or N frames
after all slaves were first in OPERATIONAL (``op``). ``count`` is the number of occurrences (1; 0
means unlimited), ``rate`` the probability at each opportunity.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields
from typing import Any, ClassVar

import numpy as np

from ..machine import Machine
from ..model.given import whole
from ..objects.abort import Abort
from .al import AlState, AlStatusCode
from .bus import Bus, Clock
from .coe_header import Service
from .controller.record import PORTS, Event
from .controller.registers import FULL, R
from .frame import HEADER, LOGICAL, TAIL, Command, body_of, unpack
from .mailbox import HEADER as MAILBOX_HEADER
from .segment import Segment

LIMITS = {  # range of each number of a fault
    "count": (0, 1 << 31), "slave": (-1, 0xFFFF), "port": (0, PORTS - 1), "frames": (0, 1 << 31),
    "offset": (-0xFFFF, 0xFFFF),
}
MILESTONES = ("frame", "cycle", "mailbox", "op")
KINDS = {
    "drop": "the frame is lost on its way out",
    "lose": "the frame is lost on its way back",
    "delay": "the frame returns `frames` frames later",
    "duplicate": "the frame returns twice",
    "stale": "the previous frame returns instead",
    "truncate": "the last `frames` bytes of the frame are missing",
    "wrong_index": "the first datagram of the frame has another index",
    "wkc": "`offset` is added to the working counters of `command` (all) at `slave` (all: -1)",
    "disconnect": "the cable before `slave` is unplugged for `frames` frames (0: for ever)",
    "break_link": "the cable at `port` of `slave` breaks",
    "heal_link": "the cable at `port` of `slave` is repaired",
    "power_cycle": "`slave` is without power for `frames` frames",
    "al_error": "`slave` shows `code` and stays in its state",
    "retreat": "`slave` retreats to SAFE_OPERATIONAL with `code`",
    "mailbox_abort": "`slave` answers an SDO with an abort of `code`",
    "mailbox_toggle": "the answer of `slave` has a wrong toggle bit",
    "mailbox_silence": "`slave` does not answer",
    "mailbox_stale": "`slave` repeats its previous answer",
}


@dataclass(frozen=True)
class Fault:
    """One fault of a script.

    Raises ValueError naming the invalid part.
    """

    kind: str
    at: str = "frame:0"
    count: int = 1
    rate: float = 1.0
    slave: int = 0
    port: int = 1
    code: int = 0
    frames: int = 1
    offset: int = -1
    command: str = ""

    def __post_init__(self) -> None:
        name, _, number = self.at.partition(":")
        if self.kind not in KINDS:
            raise ValueError(f"fault {self.kind!r}: choose one of {', '.join(KINDS)}")
        if name not in MILESTONES or not number.isdecimal():
            raise ValueError(
                f"fault {self.kind}: at={self.at}: give one of {', '.join(MILESTONES)} and a "
                "number, such as cycle:100"
            )
        if self.command and self.command not in Command.__members__:
            raise ValueError(
                f"fault {self.kind}: command={self.command} is unknown: choose one of "
                f"{', '.join(Command.__members__)}"
            )
        try:
            for field_, (low, high) in LIMITS.items():
                whole(field_, getattr(self, field_), low, high)
            # an SDO abort code has 32 bits, an AL status code 16
            whole("code", self.code, 0, 0xFFFFFFFF if self.kind == "mailbox_abort" else 0xFFFF)
        except ValueError as error:
            raise ValueError(f"fault {self.kind}: {error}") from None
        if not 0.0 <= self.rate <= 1.0:
            raise ValueError(f"fault {self.kind}: rate={self.rate} is out of range 0..1")

    @property
    def milestone(self) -> tuple[str, int]:
        """Name and number of `at`."""
        name, _, number = self.at.partition(":")
        return name, int(number)

    @classmethod
    def parse(cls, line: str) -> "Fault":
        """Parse a fault from its line. Raises ValueError."""
        if not isinstance(line, str):
            raise ValueError(f"fault {line!r}: give a line such as 'drop at=frame:5 count=3'")
        kind, *pairs = line.split() or [""]
        types: dict[str, Any] = {field.name: field.type for field in fields(cls)[1:]}
        values: dict[str, Any] = {}
        for pair in pairs:
            key, _, text = pair.partition("=")
            if key not in types:
                raise ValueError(f"fault {line!r}: {key!r} is unknown: use {', '.join(types)}")
            if key in values:
                raise ValueError(f"fault {line!r}: {key!r} is given twice")
            try:
                values[key] = int(text, 0) if types[key] is int else types[key](text)
            except ValueError:
                raise ValueError(f"fault {line!r}: {key}={text!r} is not a number") from None
        return cls(kind, **values)


class FaultyBus(Bus):
    """A `Bus` with injected faults.

    Args:
        segment: the slaves.
        machines: the machines with their drives.
        clock: source of time.
        faults: lines, or `Fault` objects.
        seed: seed of the rates, or a generator.

    Raises:
        ValueError: an invalid fault, or one at a slave or port that does not exist.
    """

    KEPT: ClassVar[tuple[str, ...]] = (
        *Bus.KEPT, "happened", "_random", "_later", "_last", "_mailbox", "_seen",
    )

    def __init__(
        self, segment: Segment, machines: Sequence[Machine] = (), clock: Clock | str = Clock.FRAME,
        *, faults: Sequence[str | Fault] = (), seed: int | np.random.Generator = 0,
    ):
        super().__init__(segment, machines, clock)
        self._random = np.random.default_rng(seed)
        self._later: list[tuple[int, Fault, bytes]] = []  # frame at which a fault ends, its reply
        self._last = b""
        self._mailbox: dict[int, bytes] = {}
        self.order(faults)

    def order(self, faults: Sequence[str | Fault]) -> None:
        """Replace the script of faults; milestones count from now on. Raises ValueError."""
        self.faults = [f if isinstance(f, Fault) else Fault.parse(f) for f in faults]
        for fault in self.faults:
            if not -1 <= fault.slave < len(self.segment):
                raise ValueError(
                    f"fault {fault.kind}: slave={fault.slave}: there are {len(self.segment)} "
                    "slaves, counted from 0"
                )
            if fault.kind in ("break_link", "heal_link"):
                try:
                    self.segment.cable(max(fault.slave, 0), fault.port)
                except ValueError as error:
                    raise ValueError(f"fault {fault.kind}: {error}") from None
        self.happened = [0] * len(self.faults)
        self._seen = dict.fromkeys(MILESTONES, 0)

    # ----------------------------------------------------------------- frames

    def receive(self, length: int, now: int, port: int = 0) -> bool:
        """Let the frame in ``segment.frame[:length]`` pass with the faults that are due."""
        frame = self.segment.frame
        self._seen["frame"] += 1
        self._seen["cycle"] += bool(length > 16 and frame[16] in LOGICAL)
        self._seen["op"] += bool(self._seen["op"] or self._all_in_op())
        self._catch_up()
        due = [*self._due(now)]
        kinds = {fault.kind for fault in due}
        for fault in due:
            self._act(fault)
        if "drop" in kinds:
            return False
        answered = super().receive(length, now, port)
        for slave in self.segment.requested:
            self._seen["mailbox"] += 1
            self._spoil_mailbox(slave, now)
        if not answered:
            return False
        reply = frame[:length].tobytes()
        answered = self._spoil(due, kinds, length, reply)
        self._last = reply
        return answered

    def _spoil(self, due: list[Fault], kinds: set[str], length: int, reply: bytes) -> bool:
        """Apply faults to a returning frame; -> whether it arrives now."""
        for fault in due:
            if fault.kind == "wkc":
                self._add(fault, length)
            if fault.kind == "wrong_index":
                self.segment.frame[17] ^= 0x55
            if fault.kind == "delay":
                self._end_later(fault, reply)
            if fault.kind == "truncate":
                self.extra.append(reply[: max(len(reply) - fault.frames, 14)])
        if "duplicate" in kinds:
            self.extra.append(reply)
        if "stale" in kinds and self._last:
            self.extra.append(self._last)
        return not kinds & {"lose", "delay", "truncate", "stale"}

    def exchange(self, frame: bytes, now: int = 0, port: int = 0) -> bytes | None:
        """Exchange a frame as `Bus` does; a delayed answer may replace a missing one."""
        reply = super().exchange(frame, now, port)
        if reply is None and self.extra:
            return self.extra.popleft()
        return reply

    def _add(self, fault: Fault, length: int) -> None:
        """Add an offset to working counters."""
        frame = self.segment.frame[:length]
        station = self.segment.pdis[fault.slave].get(R.STATION_ADDRESS, 2)
        at = body_of(frame.tobytes()) + 2
        for row in unpack(frame.tobytes()):
            end = at + HEADER + len(row.data)
            by_station = row.command in (Command.FPRD, Command.FPWR, Command.FPRW)
            right = not fault.command or row.command == Command[fault.command]
            if right and not (fault.slave >= 0 and by_station and row.adp != station):
                counter = max(row.wkc + fault.offset, 0) & 0xFFFF
                frame[end : end + TAIL] = list(counter.to_bytes(TAIL, "little"))
            at = end + TAIL

    # ------------------------------------------------------------------ script

    def _due(self, now: int, mailbox: bool = False) -> Iterator[Fault]:
        for n, fault in enumerate(self.faults):
            if fault.kind.startswith("mailbox_") != mailbox:
                continue
            name, number = fault.milestone
            if self._seen[name] < max(number, 1) or 0 < fault.count <= self.happened[n]:
                continue
            if fault.kind == "wkc" and name == "cycle" and self.segment.frame[16] not in LOGICAL:
                continue
            if fault.rate < 1.0 and self._random.random() >= fault.rate:
                continue
            self.happened[n] += 1
            yield fault

    def _end_later(self, fault: Fault, reply: bytes = b"") -> None:
        self._later.append((self._seen["frame"] + fault.frames, fault, reply))

    def _catch_up(self) -> None:
        """End faults that have lasted their number of frames."""
        due = [row for row in self._later if row[0] <= self._seen["frame"]]
        for row in due:
            self._later.remove(row)
            _, fault, reply = row
            slave = max(fault.slave, 0)
            if fault.kind == "delay":
                self.extra.append(reply)
            elif fault.kind == "disconnect":
                self.segment.heal_link(slave, 0)
            else:
                self.segment.power(slave, True, self.time)

    def _all_in_op(self) -> bool:
        status = self.segment.escs["memory"][:, R.AL_STATUS]
        return bool((status == AlState.OPERATIONAL).all())

    # ------------------------------------------------------------------ slaves

    def _act(self, fault: Fault) -> None:
        """Apply a fault to a slave or a cable."""
        segment, slave = self.segment, max(fault.slave, 0)
        if fault.kind in ("disconnect", "break_link"):
            port = 0 if fault.kind == "disconnect" else fault.port
            segment.break_link(slave, port)
            if fault.kind == "disconnect" and fault.frames:
                self._end_later(fault)
        elif fault.kind == "heal_link":
            segment.heal_link(slave, fault.port)
        elif fault.kind == "power_cycle":
            segment.power(slave, False)
            self._end_later(fault)
        elif fault.kind == "al_error":
            station = segment.stations[slave]
            station.fail(fault.code or AlStatusCode.UNSPECIFIED, station.state)
        elif fault.kind == "retreat":
            segment.stations[slave].fail(fault.code or AlStatusCode.WATCHDOG)

    def _spoil_mailbox(self, slave: int, now: int) -> None:
        """Apply faults to an answer in sync manager 1."""
        memory = self.segment.escs["memory"][slave]
        status = R.SYNC_MANAGER + 8 + 5
        if not memory[status] & FULL:
            return
        record = self.segment.escs[slave]
        start, length = int(record["sm_start"][1]), int(record["sm_length"][1])
        here = slice(start, start + length)
        answer = memory[here].tobytes()
        for fault in self._due(now, mailbox=True):
            if fault.slave not in (-1, slave):
                continue
            if fault.kind == "mailbox_abort":
                memory[here] = np.frombuffer(_abort(answer, fault.code), np.uint8)
            elif fault.kind == "mailbox_toggle":
                if memory[start + MAILBOX_HEADER.size + 2] >> 5 < 2:  # an answer to a segment
                    memory[start + MAILBOX_HEADER.size + 2] ^= 0x10
            elif fault.kind == "mailbox_stale" and slave in self._mailbox:
                memory[here] = np.frombuffer(self._mailbox[slave], np.uint8)
            elif fault.kind == "mailbox_silence":
                memory[status] &= 0xFF ^ FULL
                record["events"] = int(record["events"]) | Event.MAILBOX_READ
                self.segment.serve(now)
        self._mailbox[slave] = answer


def _abort(answer: bytes, code: int) -> bytes:
    """Replace an answer by an SDO abort with the same counter and address."""
    _length, address, channel, kind = MAILBOX_HEADER.unpack_from(answer)
    at = MAILBOX_HEADER.size
    place = answer[at + 3 : at + 6]
    body = (Service.SDO_REQUEST << 12).to_bytes(2, "little") + b"\x80" + place
    body += (code or Abort.GENERAL).to_bytes(4, "little")
    return (MAILBOX_HEADER.pack(len(body), address, channel, kind) + body).ljust(len(answer), b"\0")
