"""A CAN frame, and the identifiers of the predefined connection set (CiA 301)."""

import re
from collections.abc import Callable
from enum import IntEnum
from typing import NamedTuple

Route = tuple[int, Callable[[bytes, int], None]]  # identifier, receiver of data and time (µs)
SYNCHRONOUS = range(241)  # transmission types of synchronous PDOs


class Frame(NamedTuple):
    """A classical CAN frame; `id` has 11 bits, or 29 if `extended`."""

    id: int
    data: bytes = b""
    remote: bool = False
    extended: bool = False

    def __str__(self) -> str:
        return f"{self.id:03X}#{'R' if self.remote else self.data.hex().upper()}"


class Base(IntEnum):
    """First identifier of each service; the node-id is added."""

    NMT = 0x000
    SYNC = 0x080
    EMCY = 0x080
    SDO_RESPONSE = 0x580
    SDO_REQUEST = 0x600
    ERROR_CONTROL = 0x700
    LSS_RESPONSE = 0x7E4  # CiA 305: one identifier in each direction for all nodes
    LSS_REQUEST = 0x7E5


SYNC = Frame(Base.SYNC)
_SHORT = re.compile(r"([0-9A-Fa-f]{1,8})#(?:(R)[0-8]?|((?:[0-9A-Fa-f]{2}){0,8}))", re.I)


def parse(text: str) -> Frame:
    """Parse candump's short form, such as ``601#4041600000000000`` or ``701#R``.

    Raises:
        ValueError: not a classical frame, or the identifier has more than 11 or 29 bits.
    """
    found = _SHORT.fullmatch(text.strip()) if isinstance(text, str) else None
    extended = found is not None and len(found[1]) > 3
    if found is None or int(found[1], 16) >= 1 << (29 if extended else 11):
        raise ValueError(
            f"{text!r} is not a frame of classical CAN: write identifier#data in hexadecimal with "
            "at most 8 bytes, such as 601#4041600000000000, or 701#R for a remote frame"
        )
    return Frame(int(found[1], 16), bytes.fromhex(found[3] or ""), bool(found[2]), extended)
