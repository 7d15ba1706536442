"""Decodes the SDO channel of one node in a log: expedited, segmented, block (CiA 301, SDO).

Both sides are tracked, so the value of a segmented transfer is printed with its last segment.
Frames that do not fit the transfer are shown as bytes, because a log may start or end anywhere.
"""

import binascii
import struct
from collections.abc import Callable
from enum import Enum
from functools import partial
from typing import Protocol

from ...objects.abort import TEXT

_HEAD = struct.Struct("<BHB")


class Objects(Protocol):
    """The part of the object dictionary that the channel needs."""

    def name(self, index: int, subindex: int) -> str:
        """Return name and address of an object."""

    def size(self, index: int, subindex: int) -> int:
        """Return the length of an object (bytes), 0 if it is unknown or variable."""

    def text(self, index: int, subindex: int, data: bytes) -> str:
        """Format a value with its meaning."""

    def learn(self, index: int, subindex: int, data: bytes) -> None:
        """Note the new value of an object."""


class _Phase(Enum):
    """The transfer in progress, by the kind of its next part."""

    IDLE = 0
    SEGMENTS = 1
    CLIENT_BLOCK = 2  # the client sends segments without a command
    SERVER_BLOCK = 3  # the server sends them


class Channel:
    """Client and server of one SDO channel; `request` and `response` take eight bytes each."""

    def __init__(self, objects: Objects):
        self._objects = objects
        self._end()

    def _end(self) -> None:
        self._phase = _Phase.IDLE
        self._verb = ""
        self._index = self._subindex = 0
        self._data = b""
        self._announced: int | None = None
        self._block: list[bytes] = []  # segments that are not acknowledged yet
        self._block_size = 127
        self._last = 0  # number of the very last segment, once it has been received
        self._crc = False
        self._written: bytes | None = None  # waits for the server's confirmation

    def _begin(self, verb: str, data: bytes) -> None:
        self._end()
        self._verb = verb
        _, self._index, self._subindex = _HEAD.unpack_from(data)

    def request(self, data: bytes) -> str:
        """Explain eight bytes from the client."""
        if self._phase is _Phase.CLIENT_BLOCK and data[0] != 0x80:
            return self._part(data)
        service = _REQUESTS.get(data[0] >> 5)
        return service(self, data) if service else _stray(data)

    def response(self, data: bytes) -> str:
        """Explain eight bytes from the server."""
        if self._phase is _Phase.SERVER_BLOCK and data[0] != 0x80:
            return self._part(data)
        service = _RESPONSES.get(data[0] >> 5)
        return service(self, data) if service else _stray(data)

    # ------------------------------------------------------------------ words

    def _say(self, more: str = "") -> str:
        return f"{self._verb} {self._objects.name(self._index, self._subindex)}{more}"

    def _value(self, data: bytes) -> str:
        return self._say(f" = {self._objects.text(self._index, self._subindex, data)}")

    def _progress(self) -> str:
        of = "" if self._announced is None else f" of {self._announced}"
        return f"{len(self._data)}{of} bytes"

    def _announce(self, how: str) -> str:
        size = "" if self._announced is None else f", {self._announced} bytes"
        return self._say(f", {how}{size}")

    def _learn(self, data: bytes) -> None:
        self._objects.learn(self._index, self._subindex, data)

    def _confirmed(self) -> str:
        if self._written is None:
            return self._say(", go on")
        self._learn(self._written)
        text = self._say(" done")
        self._end()
        return text

    def _abort(self, data: bytes, by: str = "") -> str:
        _, index, subindex = _HEAD.unpack_from(data)
        (code,) = struct.unpack_from("<I", data, 4)
        self._end()
        meaning = TEXT.get(code, "unknown abort code")  # type: ignore[call-overload]
        return f"abort {code:08X}h {meaning}: {self._objects.name(index, subindex)}{by}"

    # --------------------------------------------------- expedited, segmented

    def _expedited(self, data: bytes) -> bytes:
        if data[0] & 1:
            return data[4 : 8 - (data[0] >> 2 & 3)]
        return data[4 : 4 + min(self._objects.size(self._index, self._subindex) or 4, 4)]

    def _initiated(self, data: bytes) -> str:
        self._phase = _Phase.SEGMENTS
        self._announced = struct.unpack_from("<I", data, 4)[0] if data[0] & 1 else None
        return self._announce("segmented")

    def _download(self, data: bytes) -> str:
        self._begin("write", data)
        if not data[0] & 2:
            return self._initiated(data)
        self._written = self._expedited(data)
        return self._value(self._written)

    def _downloaded(self, data: bytes) -> str:
        if (data[1] | data[2] << 8, data[3]) != (self._index, self._subindex):
            self._begin("write", data)  # the request is not in the log
            return self._say(" done")
        return self._confirmed()

    def _upload(self, data: bytes) -> str:
        self._begin("read", data)
        return self._say()

    def _uploaded(self, data: bytes) -> str:
        self._begin("read", data)
        if not data[0] & 2:
            return self._initiated(data)
        content = self._expedited(data)
        text = self._value(content)
        self._learn(content)
        return text

    def _segment(self, data: bytes) -> bool:
        """Process a segment; -> whether it was the last one."""
        self._data += data[1 : 8 - (data[0] >> 1 & 7)]
        return bool(data[0] & 1)

    def _runs(self, verb: str) -> bool:
        return self._phase is _Phase.SEGMENTS and self._verb == verb

    def _download_segment(self, data: bytes) -> str:
        if not self._runs("write"):
            return _stray(data)
        if not self._segment(data):
            return self._say(f", {self._progress()}")
        self._written = self._data
        return self._value(self._data)

    def _segment_downloaded(self, data: bytes) -> str:
        return self._confirmed() if self._runs("write") else _stray(data)

    def _upload_segment(self, data: bytes) -> str:
        return self._say(", go on") if self._runs("read") else _stray(data)

    def _segment_uploaded(self, data: bytes) -> str:
        if not self._runs("read"):
            return _stray(data)
        if not self._segment(data):
            return self._say(f", {self._progress()}")
        text = self._value(self._data)
        self._learn(self._data)
        self._end()
        return text

    # ------------------------------------------------------------------ block

    def _part(self, data: bytes) -> str:
        """Process a segment of a block: sequence number (bit 7: the last one) and seven bytes."""
        number = data[0] & 0x7F
        if number == len(self._block) + 1:
            self._block.append(data[1:])
            self._last = number if data[0] & 0x80 else 0
        if data[0] & 0x80 or number >= self._block_size:
            self._phase = _Phase.SEGMENTS
        return self._say(f", block part {number}{' (last)' * (data[0] >> 7)}")

    def _acknowledge(self, data: bytes, next_phase: _Phase) -> str:
        """Keep the segments that the other side has received; the others are repeated."""
        self._data += b"".join(self._block[: data[1]])
        self._block = []
        self._block_size = data[2]
        self._phase = _Phase.SEGMENTS if 0 < self._last == data[1] else next_phase
        self._last = 0
        return self._say(f", {data[1]} parts received")

    def _ended(self, data: bytes) -> str:
        """End a block transfer with the number of unused bytes and the CRC of the sender."""
        content = self._data[: len(self._data) - (data[0] >> 2 & 7)]
        (crc,) = struct.unpack_from("<H", data, 1)
        wrong = self._crc and binascii.crc_hqx(content, 0) != crc
        self._phase = _Phase.SEGMENTS
        self._written = content
        return self._value(content) + " (CRC wrong)" * wrong

    def _block_download(self, data: bytes) -> str:
        if data[0] & 1:
            return self._ended(data) if self._verb == "write" else _stray(data)
        self._begin("write", data)
        self._crc = bool(data[0] & 4)
        self._announced = struct.unpack_from("<I", data, 4)[0] if data[0] & 2 else None
        return self._announce("block")

    def _block_downloaded(self, data: bytes) -> str:
        if self._verb != "write":
            return _stray(data)
        if data[0] & 3 == 0:
            self._block_size = data[4]
            self._crc = self._crc and bool(data[0] & 4)
            self._phase = _Phase.CLIENT_BLOCK
            return self._say(f", block of up to {self._block_size} parts")
        if data[0] & 3 == 2:
            return self._acknowledge(data, _Phase.CLIENT_BLOCK)
        return self._confirmed()

    def _block_upload(self, data: bytes) -> str:
        kind = data[0] & 3
        if kind == 0:
            self._begin("read", data)
            self._crc = bool(data[0] & 4)
            self._block_size = data[4]
            return self._say(f", block of up to {self._block_size} parts")
        if self._verb != "read":
            return _stray(data)
        if kind == 1:
            return self._confirmed()
        if kind == 2:
            return self._acknowledge(data, _Phase.SERVER_BLOCK)
        self._phase = _Phase.SERVER_BLOCK
        return self._say(", start")

    def _block_uploaded(self, data: bytes) -> str:
        if data[0] & 1:
            return self._ended(data) if self._verb == "read" else _stray(data)
        size, crc = self._block_size, self._crc
        self._begin("read", data)
        self._block_size, self._crc = size, crc and bool(data[0] & 4)
        self._announced = struct.unpack_from("<I", data, 4)[0] if data[0] & 2 else None
        return self._announce("block")


def _stray(data: bytes) -> str:
    return f"{data.hex(' ').upper()} belongs to no transfer of this log"


_REQUESTS: dict[int, Callable[[Channel, bytes], str]] = {
    0: Channel._download_segment,
    1: Channel._download,
    2: Channel._upload,
    3: Channel._upload_segment,
    4: partial(Channel._abort, by=", by the client"),
    5: Channel._block_upload,
    6: Channel._block_download,
}
_RESPONSES: dict[int, Callable[[Channel, bytes], str]] = {
    0: Channel._segment_uploaded,
    1: Channel._segment_downloaded,
    2: Channel._uploaded,
    3: Channel._downloaded,
    4: Channel._abort,
    5: Channel._block_downloaded,
    6: Channel._block_uploaded,
}
