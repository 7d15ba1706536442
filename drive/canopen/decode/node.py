"""Explains the frames of one node of a CANopen log, given its earlier frames (CiA 301, 402)."""

import json
import struct
from collections.abc import Callable, Iterable
from functools import partial
from typing import NamedTuple

from ...kernel.process_data import DUMMY_BITS, INVALID
from ...kernel.words import Mode, decode_controlword, decode_statusword
from ...model.model import DriveModel, Object
from ...model.pdo import mapping_entry
from ...objects.hooks.standard import LOAD, SAVE
from ..eds import rows
from ..frame import Base, Frame
from ..node import NmtState
from ..time_stamp import TimeOfDay
from .sdo import Channel

CONTROLWORD, STATUSWORD, MODE, MODE_DISPLAY, ERROR_CODE = 0x6040, 0x6041, 0x6060, 0x6061, 0x603F
HEXADECIMAL = (CONTROLWORD, STATUSWORD, ERROR_CODE)  # and 32-bit objects below 2000h
# statusword bits that are set in every state of a drive on a powered bus
EVERYWHERE = ("voltage_enabled", "remote")
# CiA 301, emergency error code classes; the most specific one applies
EMCY_CLASS = {
    0x0000: "no error", 0x1000: "generic error", 0x2000: "current", 0x3000: "voltage",
    0x4000: "temperature", 0x5000: "device hardware", 0x6000: "device software",
    0x7000: "additional modules", 0x8000: "monitoring", 0x8100: "communication",
    0x8200: "protocol error", 0x9000: "external error", 0xF000: "additional functions",
    0xFF00: "device specific",
}


class ModelInfo:
    """The parts of a drive model that a decoder uses."""

    def __init__(self, model: DriveModel):
        self.rows = {(row.index, row.subindex): row for row in rows(model)}
        communication = (*range(0x1400, 0x1600), *range(0x1800, 0x1A00))
        self.pdos = [index for index, subindex in self.rows
                     if subindex == 1 and index in communication]
        self.causes = {f.code: f.cause.name.lower() for f in reversed(model.faults)}
        self.modes = model.own_modes


class Service(NamedTuple):
    """A service of a node on an identifier; the services with the lowest rank are shown."""

    explain: Callable[[Frame], str | None]
    rank: int = 0


class Node:
    """The state of one node as far as the log shows it."""

    def __init__(
        self, drive: ModelInfo, node_id: int, changed: Callable[["Node", Iterable[int]], None],
        heard: Callable[[int, Object, float], None],
    ):
        self._drive = drive
        self._heard = heard
        self._changed = changed  # called with the previous identifiers of this node
        self.id = node_id
        self.alive = False  # has sent something
        self.services: dict[int, list[Service]] = {}
        self._seen: dict[tuple[int, int], int] = {}
        self._stored: dict[tuple[int, int], int] = {}
        self.reset()

    def reset(self) -> None:
        """Return to the state after power-on: stored parameters, else the model's defaults."""
        self._seen = dict(self._stored)
        self._mode: int | None = None  # last value of 6060h or 6061h
        self._guarded = False
        self._channel = Channel(self)
        self._listen()

    def _value(self, index: int, subindex: int = 0, otherwise: int = 0) -> int:
        if (index, subindex) in self._seen:
            return self._seen[index, subindex]
        row = self._drive.rows.get((index, subindex))
        if row is None or not isinstance(row.default, int):
            return otherwise
        return row.default + self.id * row.per_node

    def _listen(self) -> None:
        """Register the services by identifier."""
        before = [*self.services]
        self.services = {}
        for identifier, explain in (
            (self._value(0x1005, 0, Base.SYNC), self._sync),
            (self._value(0x1012, 0, 0x100), self._time),
            (self._value(0x1014, 0, Base.EMCY + self.id), self._emcy),
            (Base.SDO_REQUEST + self.id, self._request),
            (Base.SDO_RESPONSE + self.id, self._response),
            (Base.ERROR_CONTROL + self.id, self._error_control),
        ):
            self.services.setdefault(identifier & 0x7FF, []).append(Service(explain))
        for index in self._drive.pdos:
            cob_id = self._value(index, 1)
            service = Service(partial(self._pdo, index), 2 if cob_id & INVALID else 1)
            self.services.setdefault(cob_id & 0x7FF, []).append(service)
        self._changed(self, before)

    # ---------------------------------------------------------------- objects

    def name(self, index: int, subindex: int) -> str:
        """Name and address, ``controlword (6040h:00)``."""
        row = self._drive.rows.get((index, subindex))
        return f"{row.name if row else 'unknown object'} ({index:04X}h:{subindex:02X})"

    def size(self, index: int, subindex: int) -> int:
        """Length of an object in bytes; 0 if it is unknown or variable."""
        row = self._drive.rows.get((index, subindex))
        return row.size if row else 0

    def text(self, index: int, subindex: int, data: bytes) -> str:
        """Format a value with its meaning."""
        row = self._drive.rows.get((index, subindex))
        if row is None or (row.format and len(data) != row.size):
            return f"{data.hex(' ').upper()} (bytes)" if data else "nothing"
        if not row.format:
            return json.dumps(data.decode("ascii", "replace"))
        return self._number(row, row.unpack(data))

    def learn(self, index: int, subindex: int, data: bytes) -> None:
        """Note the new value of an object."""
        row = self._drive.rows.get((index, subindex))
        if row is None or not row.format or len(data) != row.size:
            return
        self._heard(self.id, row, row.unpack(data))
        if row.real:
            return
        value = int.from_bytes(data, "little")
        if index in (MODE, MODE_DISPLAY):
            self._mode = int.from_bytes(data, "little", signed=True)
        elif index == 0x1010 and value == SAVE:
            self._stored = dict(self._seen)
        elif index == 0x1011 and value == LOAD:
            self._stored = {}
        elif index < 0x2000:
            self._seen[index, subindex] = value
            self._listen()

    def _number(self, row: Object, value: int | float) -> str:
        index = row.index
        if isinstance(value, float):
            return f"{value:g}"
        if index in HEXADECIMAL or (index < 0x2000 and row.data_type == "UNSIGNED32"):
            text = f"{value:0{2 * row.size}X}h"
        else:
            text = str(value)
        if index == CONTROLWORD:
            return " ".join([text, *decode_controlword(value, self._mode or 0, self._drive.modes)])
        if index == STATUSWORD:
            names = decode_statusword(value, self._mode or 0, self._drive.modes)
            if self._mode is None:  # the meaning of bit 10 in most modes
                names = ["target_reached" if name == "bit_10" else name for name in names]
            return " ".join([text, *(name for name in names if name not in EVERYWHERE)])
        if index in (MODE, MODE_DISPLAY) and (value in self._drive.modes or value in {*Mode}):
            own = self._drive.modes.get(value)
            return f"{text} {own.name if own else Mode(value).name}"
        if row.area in ("rpdo", "tpdo") and index & 0x200 and row.subindex and value:
            target = self._drive.rows.get(mapping_entry(value)[:2])
            return f"{text} {target.name}" if target else text
        return text

    # --------------------------------------------------------------- services

    def _sync(self, frame: Frame) -> str | None:
        if frame.remote or len(frame.data) > 1:
            return None
        return f"SYNC {frame.data[0]}" if frame.data else "SYNC"

    def _time(self, frame: Frame) -> str | None:
        time = None if frame.remote else TimeOfDay.unpack(frame.data)
        return f"TIME {time.datetime().isoformat(' ', 'milliseconds')}" if time else None

    def _emcy(self, frame: Frame) -> str | None:
        if frame.remote or len(frame.data) != 8:
            return None
        self.alive = True
        code, register = struct.unpack_from("<HB", frame.data)
        classes = (EMCY_CLASS.get(code & mask) for mask in (0xFF00, 0xF000))
        meaning = self._drive.causes.get(code) or next((c for c in classes if c), "unknown error")
        more = frame.data[3:]
        own = f" manufacturer={more.hex().upper()}" if any(more) else ""
        return f"EMCY[{self.id}] {code:04X}h {meaning} register={register:02X}h{own}"

    def _request(self, frame: Frame) -> str | None:
        if frame.remote or len(frame.data) != 8:
            return None
        return f"SDO[{self.id}] {self._channel.request(frame.data)}"

    def _response(self, frame: Frame) -> str | None:
        if frame.remote or len(frame.data) != 8:
            return None
        self.alive = True
        return f"SDO[{self.id}] {self._channel.response(frame.data)}"

    def _error_control(self, frame: Frame) -> str | None:
        if frame.remote:
            self._guarded = True
            return f"guarding[{self.id}] request"
        if len(frame.data) != 1:
            return None
        self.alive = True
        state, toggle = frame.data[0] & 0x7F, frame.data[0] >> 7
        if state not in {*NmtState}:
            return None
        if state == NmtState.INITIALISING and not toggle:
            self.reset()
            return f"boot-up[{self.id}]"
        name = NmtState(state).name.replace("_", "-")
        if self._guarded or toggle:
            self._guarded = False
            return f"guarding[{self.id}] {name} toggle={toggle}"
        return f"heartbeat[{self.id}] {name}"

    def _pdo(self, index: int, frame: Frame) -> str:
        direction = "RPDO" if index < 0x1800 else "TPDO"
        head = f"{direction}{(index & 0x1FF) + 1}[{self.id}]"
        if frame.remote:
            return f"{head} request"
        entries = [self._value(index + 0x200, n + 1) for n in range(self._value(index + 0x200))]
        image, at = int.from_bytes(frame.data, "little"), 0
        parts: list[tuple[int, int, int, int]] = []
        for entry in entries:
            index, subindex, bits = mapping_entry(entry)
            if at + bits > 8 * len(frame.data):
                parts = []  # a PDO that is too short is ignored (CiA 301)
                break
            value = image >> at & (1 << bits) - 1
            parts.append((index, subindex, bits, value))
            at += bits
        if not parts:
            reason = "too short" if entries else "nothing mapped"
            return f"{head} {frame.data.hex(' ').upper()} ({reason})".replace("  ", " ")
        for i, s, bits, value in parts:  # the mode first, because it names the bits of the words
            if i in (MODE, MODE_DISPLAY):
                self.learn(i, s, value.to_bytes(-(-bits // 8), "little"))
        texts = [self._part(*part) for part in parts]
        extra = frame.data[-(-at // 8) :]
        if extra:
            texts.append(f"and {extra.hex(' ').upper()}")
        return " ".join([head, *(text for text in texts if text)])

    def _part(self, index: int, subindex: int, bits: int, value: int) -> str:
        if index in DUMMY_BITS and subindex == 0:
            return ""
        row = self._drive.rows.get((index, subindex))
        if row is None or bits != 8 * row.size:
            return f"{index:04X}h:{subindex:02X}={value:0{-(-bits // 4)}X}h"
        data = value.to_bytes(row.size, "little")
        if row.format:
            self._heard(self.id, row, row.unpack(data))
        return f"{row.name}={self.text(index, subindex, data)}"
