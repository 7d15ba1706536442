"""CoE: SDO, SDO information and emergencies in the mailbox (ETG.1000.6, 5.6; tables 27-50).

A body begins with two bytes: number (bits 0-8) and service (bits 12-15). An SDO telegram continues
as on CAN with command, index and sub-index, but normal and segmented transfers fill the mailbox. An
abort by either side is a telegram of the service SDO request with the command 80h.
"""

import struct
from collections.abc import Callable
from typing import ClassVar

from ..drive import Drive
from ..objects.abort import Abort
from ..objects.dictionary import ObjectDictionary
from . import complete_access
from .coe_header import Service, header
from .mailbox import Answer, MailboxError
from .sdo_info import SdoInfo

_SDO = struct.Struct("<HBHB")  # CoE header, command, index, sub-index
_SIZED = struct.Struct("<HBHBI")  # with the complete size, or four bytes of data
SHORTEST = 10  # bytes of the body of an SDO telegram
SEGMENT_HEAD = 3  # bytes before the data of a segment
SEGMENT = 7  # bytes of data in the shortest segment
LIMIT = 0x10000  # bytes a master may send for one object

# commands, bits 7-5: specifier of the request, and of the answer
DOWNLOAD_SEGMENT, DOWNLOAD, UPLOAD, UPLOAD_SEGMENT, ABORT = 0, 1, 2, 3, 4
DOWNLOADED_SEGMENT, DOWNLOADED, UPLOADED, UPLOADED_SEGMENT = 1, 3, 2, 0
COMPLETE = 0x10  # complete access
EXPEDITED, SIZE = 0x02, 0x01
TOGGLE, LAST = 0x10, 0x01  # of segments


class Sdo:
    """The SDO server: one transfer at a time.

    Args:
        objects: the dictionary.
        complete_access: whether whole objects may be read and written at once.
    """

    # in a snapshot
    KEPT: ClassVar = ("_running", "_address", "_data", "_at", "_toggle", "_announced")

    def __init__(self, objects: ObjectDictionary, complete_access: bool):
        self._objects = objects
        self._complete_access = complete_access
        self._size = 0
        self.reset()

    def reset(self) -> None:
        """Forget a transfer in progress."""
        self._running: int | None = None  # specifier of its next request
        self._address = (0, 0, False)  # index, sub-index, complete access
        self._data = b""
        self._at = 0
        self._toggle = 0
        self._announced = 0

    def request(self, body: bytes, size: int) -> Answer:
        """Answer the body of an SDO request; `size` is the longest body of an answer (bytes)."""
        if len(body) < SHORTEST:
            return MailboxError.SIZE_TOO_SHORT
        self._size = size
        _, command, index, subindex = _SDO.unpack_from(body)
        specifier = command >> 5
        if specifier == ABORT:
            self.reset()
            return ()
        if specifier in (DOWNLOAD, UPLOAD):
            self.reset()
            self._address = index, subindex, bool(command & COMPLETE)
        handler = _HANDLERS.get(specifier)
        segment = specifier in (DOWNLOAD_SEGMENT, UPLOAD_SEGMENT)
        if handler is None or (segment and self._running != specifier):
            if not segment:
                self._address = index, subindex, False
            return self._abort(Abort.COMMAND_SPECIFIER)
        return handler(self, command, body)

    def _abort(self, code: int) -> Answer:
        index, subindex, _ = self._address
        self.reset()
        head = Service.SDO_REQUEST << 12
        code = self._objects.drive.model.abort_codes.get(code, code)
        return (_SIZED.pack(head, 0x80, index, subindex, code),)

    def _answer(self, command: int, data: bytes) -> Answer:
        """An answer that names the object; `data` has four bytes or more."""
        index, subindex, _ = self._address
        return (_SDO.pack(Service.SDO_RESPONSE << 12, command, index, subindex) + data,)

    def _refused(self) -> Abort:
        """Whether the addressed object may be accessed in this way at all."""
        _, subindex, complete = self._address
        if not complete:
            return Abort.NONE
        if not self._complete_access or subindex > 1:
            return Abort.UNSUPPORTED_ACCESS
        return Abort.NONE

    # --------------------------------------------------------------- upload

    def _upload(self, command: int, body: bytes) -> Answer:
        index, subindex, complete = self._address
        abort = self._refused()
        if not abort and complete:
            data, abort = complete_access.read(self._objects, index, subindex)
        elif not abort:
            data, abort = self._objects.read(index, subindex)
        if abort:
            return self._abort(abort)
        flags = command & COMPLETE
        if 1 <= len(data) <= 4:
            code = UPLOADED << 5 | flags | (4 - len(data)) << 2 | EXPEDITED | SIZE
            return self._answer(code, data.ljust(4, b"\0"))
        room = self._size - SHORTEST
        first = data[:room]
        if len(data) > room:
            self._running, self._data, self._at = UPLOAD_SEGMENT, data, room
        total = struct.pack("<I", len(data))
        return self._answer(UPLOADED << 5 | flags | SIZE, total + first)

    def _upload_segment(self, command: int, body: bytes) -> Answer:
        if command & TOGGLE != self._toggle:
            return self._abort(Abort.TOGGLE_BIT)
        part = self._data[self._at : self._at + self._size - SEGMENT_HEAD]
        self._at += len(part)
        code = UPLOADED_SEGMENT << 5 | self._toggle
        if self._at >= len(self._data):
            code |= LAST
            self._running = None
        if len(part) < SEGMENT:
            code |= (SEGMENT - len(part)) << 1
        self._toggle ^= TOGGLE
        return (header(Service.SDO_RESPONSE) + bytes([code]) + part.ljust(SEGMENT, b"\0"),)

    # ------------------------------------------------------------- download

    def _download(self, command: int, body: bytes) -> Answer:
        abort = self._refused()
        if abort:
            return self._abort(abort)
        if command & EXPEDITED:
            length = 4 - (command >> 2 & 3) if command & SIZE else self._own_length()
            return self._store(body[6 : 6 + length])
        (total,) = struct.unpack_from("<I", body, 6)
        data = body[SHORTEST:]
        if len(data) >= total:
            return self._store(data[:total])
        abort = self._writable(total)
        if abort:
            return self._abort(abort)
        self._running, self._data, self._announced = DOWNLOAD_SEGMENT, data, total
        return self._answer(DOWNLOADED << 5, bytes(4))

    def _own_length(self) -> int:
        """Length of an expedited download that does not state it."""
        slot, _ = self._objects.find(*self._address[:2])
        return min(slot.row.size, 4) if slot else 4

    def _writable(self, total: int) -> Abort:
        """Check a segmented download before its data arrive."""
        if total > LIMIT:
            return Abort.LENGTH_TOO_HIGH
        index, subindex, complete = self._address
        if complete:
            return Abort.NONE
        slot, abort = self._objects.find(index, subindex)
        if slot is not None and not slot.writable:
            return Abort.READ_ONLY
        return abort

    def _download_segment(self, command: int, body: bytes) -> Answer:
        if command & TOGGLE != self._toggle:
            return self._abort(Abort.TOGGLE_BIT)
        part = body[SEGMENT_HEAD:]
        if len(part) == SEGMENT:
            part = part[: SEGMENT - (command >> 1 & 7)]
        self._data += part
        code = DOWNLOADED_SEGMENT << 5 | self._toggle
        self._toggle ^= TOGGLE
        if len(self._data) > self._announced:
            return self._abort(Abort.LENGTH_TOO_HIGH)
        if command & LAST:
            if len(self._data) < self._announced:
                return self._abort(Abort.LENGTH_TOO_LOW)
            abort = self._write(self._data)
            if abort:
                return self._abort(abort)
            self._running = None
        return (header(Service.SDO_RESPONSE) + bytes([code]) + bytes(SEGMENT),)

    def _store(self, data: bytes) -> Answer:
        abort = self._write(data)
        if abort:
            return self._abort(abort)
        return self._answer(DOWNLOADED << 5, bytes(4))

    def _write(self, data: bytes) -> Abort:
        index, subindex, complete = self._address
        if complete:
            return complete_access.write(self._objects, index, subindex, data)
        return self._objects.write(index, subindex, data)


_HANDLERS: dict[int, Callable[[Sdo, int, bytes], Answer]] = {
    DOWNLOAD_SEGMENT: Sdo._download_segment,
    DOWNLOAD: Sdo._download,
    UPLOAD: Sdo._upload,
    UPLOAD_SEGMENT: Sdo._upload_segment,
}


class Coe:
    """The services of CoE that a model has; others are refused with a mailbox error."""

    def __init__(self, sdo: Sdo, info: SdoInfo | None):
        self._services = {Service.SDO_REQUEST: sdo.request}
        if info:
            self._services[Service.SDO_INFORMATION] = info.request

    def request(self, body: bytes, size: int) -> Answer:
        """Answer the body of a telegram; `size` is the longest body of an answer (bytes)."""
        if len(body) < 2:
            return MailboxError.SIZE_TOO_SHORT
        service = self._services.get(struct.unpack_from("<H", body)[0] >> 12)
        return service(body, size) if service else MailboxError.SERVICE_NOT_SUPPORTED


class Emergencies:
    """Emergencies to be sent: one CoE emergency body for each entry of the drive's error history.

    A body has code, error register and five manufacturer-specific bytes (ETG.1000.6, table 50). A
    body with the code 0 follows when a bit of the error register has been cleared.
    """

    KEPT: ClassVar = ("_events_sent", "_register_sent")  # in a snapshot
    _BODY = struct.Struct("<HHB5x")

    def __init__(self, drive: Drive):
        own = slice(drive.index, drive.index + 1)
        self._drive = drive
        self._events = drive.axes["error_events"][own]
        self._register = drive.axes["od"]["error_register"][own]
        self.reset()

    def reset(self) -> None:
        """Regard all earlier errors as sent."""
        self._events_sent = self._events.item(0)
        self._register_sent = self._register.item(0)

    def bodies(self) -> list[bytes]:
        """Return the new emergency bodies, oldest first."""
        events, register = self._events.item(0), self._register.item(0)
        if (events, register) == (self._events_sent, self._register_sent):
            return []
        codes = [code for code, _ in self._drive.errors_since(self._events_sent)]
        if not codes and self._register_sent & ~register:
            codes = [0]
        self._events_sent, self._register_sent = events, register
        return [self._BODY.pack(Service.EMERGENCY << 12, code, register) for code in codes]
