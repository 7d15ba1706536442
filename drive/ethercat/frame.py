"""EtherCAT frames and datagrams as values: pack, unpack, and a line of text for each.

Source: ETG.1000.4, clause 5 (frame structure, datagram), and its annex for UDP port 88A4h.
The text, such as ``FPRD 1001:0130 [2] 0800 wkc 1``, serves golden tests and logs.
"""

import struct
from collections.abc import Iterable, Iterator
from enum import IntEnum
from typing import NamedTuple

ETHERTYPE = 0x88A4
VLAN, IP = 0x8100, 0x0800
UDP_PORT = 0x88A4
BROADCAST = b"\xff" * 6
MASTER = b"\x01\x01\x01\x01\x01\x01"  # source address, the same as SOEM's
SHORTEST, LONGEST = 60, 1514  # bytes of an Ethernet frame without its check sequence
MORE = 0x8000  # bit of the length: another datagram follows
ROUND = 0x4000  # bit of the length: the datagram has circulated before
LENGTH = 0x07FF
DATAGRAMS = 1  # type in the header; 4 are network variables, 5 a mailbox over IP
HEADER, TAIL = 10, 2  # bytes of a datagram before and after its data
MOST = LONGEST - 14 - 2 - HEADER - TAIL  # bytes of data in one datagram


class Command(IntEnum):
    """The commands of a datagram (ETG.1000.4 table 14 and following)."""

    NOP = 0
    APRD = 1
    APWR = 2
    APRW = 3
    FPRD = 4
    FPWR = 5
    FPRW = 6
    BRD = 7
    BWR = 8
    BRW = 9
    LRD = 10
    LWR = 11
    LRW = 12
    ARMW = 13
    FRMW = 14


NAMES = {int(command): command.name for command in Command}
LOGICAL = (Command.LRD, Command.LWR, Command.LRW)


class Datagram(NamedTuple):
    """A datagram; `command` is a plain int if `Command` does not contain it."""

    command: int
    adp: int  # position, station address, or low word of the logical address
    ado: int  # register, or high word of the logical address
    data: bytes
    wkc: int = 0
    index: int = 0  # type: ignore[assignment]
    irq: int = 0
    circulating: bool = False

    @property
    def logical(self) -> int:
        """The 32-bit address of LRD, LWR and LRW."""
        return self.ado << 16 | self.adp

    def __str__(self) -> str:
        name = NAMES.get(self.command, f"{self.command:02X}h?")
        place = (
            f"{self.logical:08X}" if self.command in LOGICAL else f"{self.adp:04X}:{self.ado:04X}"
        )
        return f"{name:4} {place} [{len(self.data)}] {self.data.hex()} wkc {self.wkc}"


_HEADER = struct.Struct("<BBHHHH")


def logical(command: Command, address: int, data: bytes) -> Datagram:
    """A datagram with a logical address."""
    return Datagram(command, address & 0xFFFF, address >> 16, data)


def pack(datagrams: Iterable[Datagram], source: bytes = MASTER) -> bytes:
    """Pack an Ethernet frame, padded to the minimum length.

    Raises:
        ValueError: no datagram, more than fits a frame, or a field out of range.
    """
    parts, rows = [], list(datagrams)
    for number, row in enumerate(rows, 1):
        follows = MORE if number < len(rows) else 0
        try:
            length = len(row.data) | follows | (ROUND if row.circulating else 0)
            parts.append(
                _HEADER.pack(row.command, row.index, row.adp, row.ado, length, row.irq)
                + row.data
                + row.wkc.to_bytes(2, "little")
            )
        except (struct.error, OverflowError, TypeError, AttributeError) as error:
            raise ValueError(f"datagram {number} {tuple(row)!r:.80}: {error}") from None
    body = b"".join(parts)
    if not rows or len(body) > LONGEST - 16:
        raise ValueError(f"{len(rows)} datagrams with {len(body)} bytes: a frame holds at least 1 "
                         f"datagram and at most {LONGEST - 16} bytes; send several frames")
    head = BROADCAST + source + ETHERTYPE.to_bytes(2, "big")
    frame = head + (len(body) | DATAGRAMS << 12).to_bytes(2, "little") + body
    return frame.ljust(SHORTEST, b"\0")


def body_of(frame: bytes) -> int:
    """Offset of the EtherCAT header in a frame (with VLAN tag or UDP); -1 if there is none."""
    at = 12
    kind = int.from_bytes(frame[at : at + 2], "big")
    if kind == VLAN:
        at += 4
        kind = int.from_bytes(frame[at : at + 2], "big")
    if kind == ETHERTYPE:
        return at + 2
    if kind == IP and len(frame) > at + 30 and frame[at + 2] >> 4 == 4 and frame[at + 11] == 17:
        udp = at + 2 + 4 * (frame[at + 2] & 0x0F)
        if int.from_bytes(frame[udp + 2 : udp + 4], "big") == UDP_PORT:
            return udp + 8
    return -1


def unpack(frame: bytes) -> list[Datagram]:
    """Unpack the datagrams of an Ethernet frame.

    Raises:
        ValueError: not an EtherCAT frame, of another type, or shorter than stated.
    """
    at = body_of(frame)
    if at < 0 or len(frame) < at + 2:
        raise ValueError("no EtherCAT frame: the type is not 88A4h, nor UDP to port 88A4h")
    header = int.from_bytes(frame[at : at + 2], "little")
    if header >> 12 != DATAGRAMS:
        raise ValueError(f"EtherCAT type {header >> 12}: datagrams are type {DATAGRAMS}")
    return list(_datagrams(frame[at + 2 : at + 2 + (header & LENGTH)], header & LENGTH))


def _datagrams(body: bytes, length: int) -> Iterator[Datagram]:
    at, more = 0, True
    while more:
        if at + HEADER + TAIL > len(body):
            raise ValueError(f"a datagram at byte {at} of {length} is cut off")
        command, index, adp, ado, size, irq = _HEADER.unpack_from(body, at)
        end = at + HEADER + (size & LENGTH)
        if end + TAIL > len(body):
            raise ValueError(f"the datagram at byte {at} is longer than its frame")
        wkc = int.from_bytes(body[end : end + TAIL], "little")
        yield Datagram(command, adp, ado, body[at + HEADER : end], wkc, index, irq,
                       bool(size & ROUND))
        at, more = end + TAIL, bool(size & MORE)


def text(frame: bytes) -> str:
    """Format a frame in one line."""
    return " | ".join(map(str, unpack(frame)))
