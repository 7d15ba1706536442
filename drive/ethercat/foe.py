"""FoE: reads and writes a file of the drive in packets (ETG.1000.6, 5.8; tables 62-69).

A body consists of opcode, a reserved byte, four bytes (password, packet number or error code), and
file name or data. A packet shorter than the mailbox is the last one.
"""

import struct
from collections.abc import Callable, Mapping
from enum import IntEnum
from typing import ClassVar, NamedTuple

from .mailbox import Answer, MailboxError

HEAD = struct.Struct("<BxI")
LIMIT = 1 << 20  # longest file that a master may write (bytes)


class Opcode(IntEnum):
    """Opcode of a FoE telegram: table 62."""

    READ = 1
    WRITE = 2
    DATA = 3
    ACKNOWLEDGE = 4
    ERROR = 5
    BUSY = 6


class FoeError(IntEnum):
    """Error codes: table 69."""

    NOT_DEFINED = 0x8000
    NOT_FOUND = 0x8001
    ACCESS_DENIED = 0x8002
    DISK_FULL = 0x8003
    ILLEGAL = 0x8004
    PACKET_NUMBER = 0x8005
    ALREADY_EXISTS = 0x8006
    NO_USER = 0x8007
    BOOTSTRAP_ONLY = 0x8008
    NOT_BOOTSTRAP = 0x8009
    NO_RIGHTS = 0x800A
    PROGRAM_ERROR = 0x800B


class File(NamedTuple):
    """A file: `read` returns the content; `write` stores it and returns the reason of a refusal."""

    read: Callable[[], bytes]
    write: Callable[[bytes], str]


class Foe:
    """The FoE server: one transfer at a time."""

    KEPT: ClassVar = ("_name", "_writing", "_data", "_packet")  # in a snapshot

    def __init__(self, files: Mapping[str, File]):
        self._files = files
        self._size = 0
        self.reset()

    def reset(self) -> None:
        """Forget a transfer in progress."""
        self._name = ""
        self._writing = False
        self._data = b""
        self._packet = 0  # number of the last data packet

    def request(self, body: bytes, size: int) -> Answer:
        """Answer the body of a telegram; `size` is the longest body of an answer (bytes)."""
        if len(body) < HEAD.size:
            return MailboxError.SIZE_TOO_SHORT
        self._size = size
        opcode, number = HEAD.unpack_from(body)
        rest = body[HEAD.size :]
        if opcode in (Opcode.READ, Opcode.WRITE):
            return self._open(opcode == Opcode.WRITE, rest)
        if opcode == Opcode.DATA:
            return self._take(number, rest)
        if opcode == Opcode.ACKNOWLEDGE:
            return self._go_on(number)
        if opcode == Opcode.ERROR:
            self.reset()
            return ()
        return self._error(FoeError.ILLEGAL, "unknown opcode")

    def _error(self, code: FoeError, text: str) -> Answer:
        self.reset()
        return ((HEAD.pack(Opcode.ERROR, code) + text.encode())[: self._size],)

    def _open(self, writing: bool, name: bytes) -> Answer:
        self.reset()
        text = name.split(b"\0")[0].decode(errors="replace")
        if text not in self._files:
            known = ", ".join(self._files)
            return self._error(FoeError.NOT_FOUND, f"no file {text!r}, there is {known}")
        self._name, self._writing = text, writing
        if writing:
            return (HEAD.pack(Opcode.ACKNOWLEDGE, 0),)
        self._data = self._files[text].read()
        return self._send()

    # ------------------------------------------------------------------ read

    def _send(self) -> Answer:
        self._packet += 1
        room = self._size - HEAD.size
        at = (self._packet - 1) * room
        return (HEAD.pack(Opcode.DATA, self._packet) + self._data[at : at + room],)

    def _go_on(self, number: int) -> Answer:
        if not self._name or self._writing:
            return self._error(FoeError.ILLEGAL, "no file is being read")
        if number != self._packet:
            return self._error(FoeError.PACKET_NUMBER, f"{self._packet} was sent")
        if self._packet * (self._size - HEAD.size) > len(self._data):
            self.reset()  # the last one was short
            return ()
        return self._send()

    # ----------------------------------------------------------------- write

    def _take(self, number: int, data: bytes) -> Answer:
        if not self._name or not self._writing:
            return self._error(FoeError.ILLEGAL, "no file is being written")
        if number != self._packet + 1:
            return self._error(FoeError.PACKET_NUMBER, f"{self._packet + 1} is expected")
        self._packet = number
        self._data += data
        if len(self._data) > LIMIT:
            return self._error(FoeError.DISK_FULL, f"longer than {LIMIT} bytes")
        if len(data) < self._size - HEAD.size:  # the last one
            refused = self._files[self._name].write(self._data)
            if refused:
                return self._error(FoeError.ILLEGAL, refused)
            self.reset()
        return (HEAD.pack(Opcode.ACKNOWLEDGE, number),)
