"""Captures in the format pcapng, which Wireshark reads: written block by block, and read back.

Source: draft-ietf-opsawg-pcapng (section header, interface description, enhanced and simple packet
blocks). Files of the older pcap format are read as well.
"""

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO, NamedTuple

from ..model.files import regular

SECTION, INTERFACE, SIMPLE, PACKET = 0x0A0D0D0A, 1, 3, 6
LONGEST = 1 << 24  # bytes of a block or frame; Wireshark takes no longer block either (inferred)
MAGIC = 0x1A2B3C4D
ETHERNET = 1  # link type
TIME_RESOLUTION, END = 9, 0  # options
CLASSIC = {  # magic of a pcap file -> byte order, ns in a unit of its fractions
    b"\xd4\xc3\xb2\xa1": ("<", 1000), b"\xa1\xb2\xc3\xd4": (">", 1000),
    b"\x4d\x3c\xb2\xa1": ("<", 1), b"\xa1\xb2\x3c\x4d": (">", 1),
}


class Packet(NamedTuple):
    """A captured frame."""

    time: int  # ns
    interface: int
    frame: bytes


class Writer:
    """A capture of Ethernet frames with times in ns.

    Args:
        file: name; an existing file is replaced.
        interfaces: names of the ports.
    """

    def __init__(self, file: str | Path, interfaces: tuple[str, ...] = ("ethercat",)):
        self._file: BinaryIO = Path(file).open("wb")  # noqa: SIM115
        self._block(SECTION, struct.pack("<IHHq", MAGIC, 1, 0, -1))
        for name in interfaces:
            text = name.encode()
            options = struct.pack("<HH", 2, len(text)) + _padded(text)  # if_name
            options += struct.pack("<HHB3x", TIME_RESOLUTION, 1, 9)
            self._block(INTERFACE, struct.pack("<HHI", ETHERNET, 0, 0) + options + bytes(4))

    def _block(self, kind: int, body: bytes) -> None:
        size = struct.pack("<I", 12 + len(body))
        self._file.write(struct.pack("<I", kind) + size + body + size)

    def write(self, frame: bytes | memoryview, time: int, interface: int = 0) -> None:
        """Append a frame that was seen at `time` (ns)."""
        head = struct.pack("<IIIII", interface, time >> 32, time & 0xFFFFFFFF, len(frame),
                           len(frame))
        self._block(PACKET, head + _padded(bytes(frame)))

    def flush(self) -> None:
        """Hand written data to the operating system, so that it survives a kill of the process."""
        self._file.flush()

    def close(self) -> None:
        """Finish the file."""
        self._file.close()


def _padded(data: bytes) -> bytes:
    return data + bytes(-len(data) % 4)


def read(file: str | Path) -> Iterator[Packet]:
    """Read the frames of a capture made by any program.

    Raises:
        ValueError: the file is no capture of Ethernet frames, or is truncated (with the byte).
        OSError: the file cannot be opened.
    """
    regular(file)
    with Path(file).open("rb") as stream:
        head = stream.read(4)
        stream.seek(0)
        try:
            yield from _classic(stream) if head in CLASSIC else _blocks(stream)
        except (struct.error, IndexError):
            raise ValueError(f"{file}, byte {stream.tell()}: cut off") from None
        except ValueError as error:
            raise ValueError(f"{file}, byte {stream.tell()}: {error}") from None


def _classic(stream: BinaryIO) -> Iterator[Packet]:
    order, unit = CLASSIC[stream.read(4)]
    *_, link = struct.unpack(order + "HHiIII", stream.read(20))
    _of_ethernet(link)
    while head := stream.read(16):
        seconds, fraction, length, _ = struct.unpack(order + "IIII", head)
        frame = _read(stream, length)
        if len(frame) < length:
            raise struct.error
        yield Packet(seconds * 1_000_000_000 + fraction * unit, 0, frame)


def _read(stream: BinaryIO, length: int) -> bytes:
    """Read a number of bytes, or what is left. Raises ValueError for unreasonably many."""
    if length > LONGEST:
        raise ValueError(f"{length} bytes follow, at most {LONGEST} at once")
    return stream.read(length)


def _blocks(stream: BinaryIO) -> Iterator[Packet]:
    order = "<"
    units: list[tuple[int, int]] = []
    while head := stream.read(8):
        (kind,) = struct.unpack(order + "I", head[:4])
        if kind == SECTION:
            magic = stream.read(4)
            stream.seek(-4, 1)
            order, units = "<" if magic == MAGIC.to_bytes(4, "little") else ">", []
            if magic not in (MAGIC.to_bytes(4, "little"), MAGIC.to_bytes(4, "big")):
                raise ValueError("neither pcapng nor pcap: record with `--log FILE.pcapng`")
        elif not stream.tell() > 8:
            raise ValueError("neither pcapng nor pcap: record with `--log FILE.pcapng`")
        (size,) = struct.unpack(order + "I", head[4:])
        body = _read(stream, max(size - 8, 0))
        if len(body) < size - 8 or size < 12:
            raise struct.error
        if kind == INTERFACE:
            units.append(_unit(order, body))
        elif kind == PACKET:
            interface, high, low, length, _ = struct.unpack_from(order + "IIIII", body)
            if interface >= len(units):
                raise ValueError(f"a frame of interface {interface}, which is not described")
            time = (high << 32 | low) * units[interface][0] // units[interface][1]
            yield Packet(time, interface, body[20 : 20 + length])
        elif kind == SIMPLE:
            (length,) = struct.unpack_from(order + "I", body)
            yield Packet(0, 0, body[4 : 4 + min(length, len(body) - 8)])


def _of_ethernet(link: int) -> None:
    if link != ETHERNET:
        raise ValueError(
            f"link type {link}: a capture of EtherCAT has type {ETHERNET}, Ethernet; record a CAN "
            "bus with `candump -l`"
        )


def _unit(order: str, body: bytes) -> tuple[int, int]:
    """Unit of the time stamps of an interface, as a fraction of ns."""
    (link,) = struct.unpack_from(order + "H", body)
    _of_ethernet(link)
    at = 8
    while at + 4 <= len(body) - 4:
        code, length = struct.unpack_from(order + "HH", body, at)
        if code == END:
            break
        if code == TIME_RESOLUTION:
            exponent = body[at + 4]
            if exponent & 0x80:
                return 1_000_000_000, 1 << (exponent & 0x7F)
            return 1_000_000_000, 10**exponent
        at += 4 + length + -length % 4
    return 1000, 1
