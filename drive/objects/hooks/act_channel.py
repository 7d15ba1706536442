"""Parameter channel 1 of a frequency inverter (Bonfiglioli ACT): object 2000h, chapter 8.6.

A request is written: number + 1000 * data set, SEL or ENQ, the value; its result is read from the
same sub-index: ACK with the value, or NAK with an error number. Sub-index 1 is for parameters of 16
bits, 2 for those of 32 bits, 3 for strings.
"""

import struct

from ...model.rows import Object
from ..abort import Abort
from ..device import Dictionary

FIRST = 0x2000  # object of parameter 0
SETS = (1, 2, 3, 4)  # data sets in the EEPROM
RAM = 5  # added to a data set
SELECT, ENQUIRE, ACK, NAK = 2, 5, 6, 15  # 15 is read as decimal (inferred)
CHANNEL = {1: "<h", 2: "<i", 3: ""}  # sub-index -> value
ERRORS = {
    Abort.INVALID_VALUE: 1,
    Abort.VALUE_TOO_HIGH: 1,
    Abort.VALUE_TOO_LOW: 1,
    Abort.NO_SUBINDEX: 2,
    Abort.WRITE_ONLY: 3,
    Abort.READ_ONLY: 4,
    Abort.LOCAL_CONTROL: 8,
    Abort.DEVICE_STATE: 8,
    Abort.INTERNAL_INCOMPATIBLE: 9,
    Abort.LENGTH: 10,
    Abort.NO_OBJECT: 11,
}


def channel(od: Dictionary, row: Object, data: bytes | None) -> tuple[bytes, Abort]:
    """Parameter channel 1, object 2000h (8.6): a request is written, its result is read."""
    if data is None:
        return od.results.get(row.subindex, bytes(row_size(row))), Abort.NONE
    if len(data) < 4:
        return b"", Abort.LENGTH_TOO_LOW
    if len(data) > row_size(row):
        return b"", Abort.LENGTH_TOO_HIGH
    word, command = struct.unpack_from("<HB", data)
    data_set, number = divmod(word, 1000)
    if command == ENQUIRE:
        value, error = _channel_read(od, number, data_set, row.subindex)
    elif command == SELECT:
        value = data[4:]
        error = _channel_write(od, number, data_set, row.subindex, value)
    else:
        value, error = b"", 0
    done = command in (ENQUIRE, SELECT) and error is None
    head = struct.pack("<HBB", word, ACK if done else NAK, 0)
    result = head + (value if done else bytes([error or 0]))
    od.results[row.subindex] = result.ljust(row_size(row), b"\0")[: row_size(row)]
    return b"", Abort.NONE


def row_size(row: Object) -> int:
    """Bytes of a request and of a result of the parameter channel (8.6)."""
    return {1: 6, 2: 8, 3: 36}[row.subindex]


def _fits(od: Dictionary, number: int, kind: int) -> int | None:
    """Error number where there is no such parameter of the type of the sub-index."""
    slot = od.slots.get((FIRST + number, 0))
    if slot is None or number == 0:
        return 11
    wanted = {0: 3, 2: 1, 4: 2}.get(slot.row.size)
    return None if wanted == kind else 10


def _channel_read(
    od: Dictionary, number: int, data_set: int, kind: int
) -> tuple[bytes, int | None]:
    error = _fits(od, number, kind)
    if error is not None:
        return b"", error
    if kind == 3:
        return str(od.slots[FIRST + number, 0].row.default).encode() + b"\0", None
    value, abort = od.read(FIRST + number, data_set)
    return value, ERRORS.get(abort, 15) if abort else None


def _channel_write(
    od: Dictionary, number: int, data_set: int, kind: int, data: bytes
) -> int | None:
    error = _fits(od, number, kind)
    if error is not None or kind == 3:
        return 4 if error is None else error
    fourfold = (FIRST + number, 1) in od.slots
    # other than 2nnnh, this channel writes data set 0 whatever the four contents are (8.6.3)
    places = {0: SETS, RAM: tuple(RAM + n for n in SETS)}.get(data_set) if fourfold else None
    size = struct.calcsize(CHANNEL[kind])
    for place in places or (data_set,):
        abort = od.write(FIRST + number, place, data[:size])
        if abort:
            return ERRORS.get(abort, 15)
    return None
