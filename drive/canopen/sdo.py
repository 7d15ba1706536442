"""SDO server: expedited, segmented and block transfer (CiA 301, SDO protocol).

There is one transfer at a time. Each request is answered or aborted; an abort by the client ends
the transfer, and the server aborts if the client is silent for the time-out. In a block download
any frame may be a segment. Only the expected segment restarts the time-out, so requests of other
clients do not keep the transfer of a dead client alive.
"""

import binascii
import struct
from collections.abc import Callable

from ..objects.abort import Abort
from ..objects.dictionary import ObjectDictionary

TIME_OUT = 1_000_000  # µs between two frames of a transfer
BLOCK_SIZE = 127  # segments in a block
LIMIT = 4096  # longest download to an object of variable length (bytes)
SIZELESS = range(0x2001, 0x3000)  # objects with the quirk `upload_without_size`
_HEAD = struct.Struct("<BHB")
_ANSWER = struct.Struct("<BHB4s")


class SdoServer:
    """One SDO server of a node; `send` takes the eight bytes of each response."""

    send: Callable[[bytes], None]

    def __init__(self, objects: ObjectDictionary):
        self._objects = objects
        self._sizeless = objects.drive.model.quirk("upload_without_size")
        self.reset()

    def reset(self) -> None:
        """Forget a transfer in progress."""
        self._handler: Callable[[bytes], None] | None = None  # of the running transfer
        self._index = self._subindex = 0
        self._data = b""
        self._at = 0
        self._toggle = 0
        self._size: int | None = None
        self._limit = LIMIT
        self._sequence = 0
        self._block = 0
        self._crc = False
        self._last = 0

    def request(self, data: bytes, time: int) -> None:
        """Process the eight bytes of a request at `time` (µs); other lengths are ignored."""
        if len(data) != 8:
            return
        if self._handler and self._handler == self._download_block and data[0] != 0x80:
            self._download_block(data, time)
            return
        self._last = time
        _SERVICES[data[0] >> 5](self, data)

    def poll(self, time: int) -> None:
        """Abort a transfer whose client has exceeded the time-out."""
        if self._handler is not None and time - self._last > TIME_OUT:
            self._abort(Abort.TIME_OUT)

    def _abort(self, code: Abort, request: bytes = b"") -> None:
        if request and self._handler is None:
            _, self._index, self._subindex = _HEAD.unpack_from(request)
        code = self._objects.drive.model.abort_codes.get(code, code)  # type: ignore[assignment]
        self._answer(0x80, self._index, self._subindex, struct.pack("<I", code))
        self._handler = None

    def _answer(self, command: int, index: int, subindex: int, data: bytes = b"") -> None:
        self.send(_ANSWER.pack(command, index, subindex, data))

    def _unknown(self, data: bytes) -> None:
        self._abort(Abort.COMMAND_SPECIFIER, data)

    def _end(self, data: bytes) -> None:
        """End a transfer without an answer."""
        self._handler = None

    # ------------------------------------------------------------- download

    def _initiate_download(self, data: bytes) -> None:
        command, self._index, self._subindex = _HEAD.unpack_from(data)
        self._handler = None
        if command & 0x02:  # expedited
            length = 4 - (command >> 2 & 3) if command & 0x01 else self._own_length()
            self._store(data[4 : 4 + length], 0x60)
            return
        if abort := self._announced(data, command & 0x01):
            self._abort(abort)
            return
        self._begin(self._download_segment)
        self._answer(0x60, self._index, self._subindex)

    def _begin(self, handler: Callable[[bytes], None]) -> None:
        self._handler = handler
        self._data, self._at, self._toggle = b"", 0, 0

    def _announced(self, data: bytes, sized: int) -> Abort:
        """Check the size announced by a download; -> the abort code if it is refused."""
        self._size = struct.unpack_from("<I", data, 4)[0] if sized else None
        slot, abort = self._objects.find(self._index, self._subindex)
        if slot is None:
            return abort
        if slot.row.access in ("ro", "const"):
            return Abort.READ_ONLY
        own = 0 if slot.raw else slot.row.size  # 0: variable length
        self._limit = own or LIMIT
        if self._size is not None and self._size > self._limit:
            return Abort.LENGTH_TOO_HIGH
        return Abort.LENGTH_TOO_LOW if self._size is not None and self._size < own else Abort.NONE

    def _own_length(self) -> int:
        slot, _ = self._objects.find(self._index, self._subindex)
        return min(slot.row.size, 4) if slot else 4

    def _store(self, data: bytes, command: int, index: int | None = None) -> None:
        abort = self._objects.write(self._index, self._subindex, data)
        self._handler = None
        if abort:
            self._abort(abort)
        elif index is None:
            self._answer(command, self._index, self._subindex)
        else:
            self._answer(command, 0, 0)

    def _download_segment(self, data: bytes) -> None:
        if self._handler != self._download_segment:
            self._abort(Abort.COMMAND_SPECIFIER, data)
        elif data[0] >> 4 & 1 != self._toggle:
            self._abort(Abort.TOGGLE_BIT)
        else:
            self._data += data[1 : 8 - (data[0] >> 1 & 7)]
            answer = 0x20 | self._toggle << 4
            self._toggle ^= 1
            if len(self._data) > self._limit:
                self._abort(Abort.LENGTH_TOO_HIGH if self._size is None else Abort.LENGTH)
            elif not data[0] & 1:
                self.send(bytes([answer]) + bytes(7))
            elif self._size not in (None, len(self._data)):
                self._abort(Abort.LENGTH)
            else:
                self._store(self._data, answer, index=0)

    # --------------------------------------------------------------- upload

    def _initiate_upload(self, data: bytes) -> None:
        _, index, subindex = _HEAD.unpack_from(data)
        self._index, self._subindex, self._handler = index, subindex, None
        value, abort = self._objects.read(index, subindex)
        length = len(value)
        if abort:
            self._abort(abort)
        elif 1 <= length <= 4:
            command = 0x42 if self._sizeless and index in SIZELESS else 0x53 - 4 * length
            self.send(_ANSWER.pack(command, index, subindex, value))
        else:
            self._begin(self._upload_segment)
            self._data = value
            self._answer(0x41, self._index, self._subindex, struct.pack("<I", len(value)))

    def _upload_segment(self, data: bytes) -> None:
        if self._handler != self._upload_segment:
            self._abort(Abort.COMMAND_SPECIFIER, data)
        elif data[0] >> 4 & 1 != self._toggle:
            self._abort(Abort.TOGGLE_BIT)
        else:
            part = self._data[self._at : self._at + 7]
            self._at += 7
            last = self._at >= len(self._data)
            command = self._toggle << 4 | (7 - len(part)) << 1 | last
            self._toggle ^= 1
            self.send(bytes([command]) + part.ljust(7, b"\0"))
            if last:
                self._handler = None

    # ---------------------------------------------------------------- block

    def _block_download(self, data: bytes) -> None:
        command = data[0]
        if command & 1:  # end of the transfer
            self._end_block_download(data)
            return
        _, self._index, self._subindex = _HEAD.unpack_from(data)
        if abort := self._announced(data, command & 2):
            self._handler = None
            self._abort(abort)
            return
        self._begin(self._download_block)
        self._crc = bool(command & 4)
        self._sequence = 0
        self._answer(0xA4, self._index, self._subindex, bytes([BLOCK_SIZE]))

    def _download_block(self, data: bytes, time: int = 0) -> None:
        number, last = data[0] & 0x7F, data[0] & 0x80
        if number == self._sequence + 1:
            self._last = time
            self._sequence = number
            self._data += data[1:]
        if len(self._data) >= self._limit + 7:  # the last segment may be padded
            self._abort(Abort.LENGTH_TOO_HIGH)
        elif last or number >= BLOCK_SIZE:
            if last and number == self._sequence:
                self._handler = self._end_block_download
            self.send(bytes([0xA2, self._sequence, BLOCK_SIZE]) + bytes(5))
            self._sequence = 0

    def _end_block_download(self, data: bytes) -> None:
        if self._handler != self._end_block_download:
            self._abort(Abort.COMMAND_SPECIFIER, data)
            return
        content = self._data[: len(self._data) - (data[0] >> 2 & 7)]
        if self._crc and binascii.crc_hqx(content, 0) != struct.unpack_from("<H", data, 1)[0]:
            self._abort(Abort.CRC)
        elif self._size not in (None, len(content)):
            self._abort(Abort.LENGTH)
        else:
            self._store(content, 0xA1, index=0)

    def _block_upload(self, data: bytes) -> None:
        """Process a block upload; its parts have to come in their order."""
        parts = (  # by client subcommand
            self._initiate_block_upload, self._end, self._segments_received, self._send_block
        )
        part = parts[data[0] & 3]
        if data[0] & 3 and self._handler != part:
            self._abort(Abort.COMMAND_SPECIFIER, data)
        else:
            part(data)

    def _segments_received(self, data: bytes) -> None:
        if data[1] > self._sequence:  # more than were sent
            self._abort(Abort.SEQUENCE_NUMBER)
            return
        self._at += data[1] * 7
        self._block = data[2]
        if not 1 <= self._block <= 127:
            self._abort(Abort.BLOCK_SIZE)
        elif self._at < len(self._data):
            self._send_block(data)
        else:
            unused = -len(self._data) % 7 if self._data else 7
            crc = binascii.crc_hqx(self._data, 0)
            self.send(struct.pack("<BH5x", 0xC1 | unused << 2, crc))
            self._handler = self._end

    def _initiate_block_upload(self, data: bytes) -> None:
        _, self._index, self._subindex = _HEAD.unpack_from(data)
        self._handler = None
        value, abort = self._objects.read(self._index, self._subindex)
        if not abort and not 1 <= data[4] <= 127:
            abort = Abort.BLOCK_SIZE
        if abort:
            self._abort(abort)
            return
        self._begin(self._send_block)
        self._data, self._block = value, data[4]
        self._answer(0xC6, self._index, self._subindex, struct.pack("<I", len(value)))

    def _send_block(self, data: bytes) -> None:
        self._handler = self._segments_received
        parts = [self._data[at : at + 7] for at in range(self._at, len(self._data), 7)] or [b""]
        self._sequence = min(len(parts), self._block)
        for number, part in enumerate(parts[: self._block], 1):
            last = 0x80 if number == len(parts) else 0
            self.send(bytes([last | number]) + part.ljust(7, b"\0"))


_SERVICES: tuple[Callable[[SdoServer, bytes], None], ...] = (  # by client command specifier
    SdoServer._download_segment,
    SdoServer._initiate_download,
    SdoServer._initiate_upload,
    SdoServer._upload_segment,
    SdoServer._end,
    SdoServer._block_upload,
    SdoServer._block_download,
    SdoServer._unknown,
)
