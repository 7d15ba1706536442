"""SDO information: lists, objects and entries of the dictionary (ETG.1000.6, 5.6.3; tables 43-49).

The information comes from the rows of the model. An answer that does not fit the mailbox is split
into fragments, each of which states how many follow.
"""

import functools
import math
import struct
from collections.abc import Iterable
from enum import IntEnum

from ..model.model import DriveModel
from ..model.rows import DATA_TYPES, Object
from ..objects.abort import Abort
from ..objects.mapping import described
from .coe_header import Service, header
from .mailbox import Answer, MailboxError


class Opcode(IntEnum):
    """Opcode of an SDO information telegram: table 43."""

    LIST_REQUEST = 1
    LIST = 2
    OBJECT_REQUEST = 3
    OBJECT = 4
    ENTRY_REQUEST = 5
    ENTRY = 6
    ERROR = 7


class ObjectCode(IntEnum):
    """Object codes of CiA 301."""

    VAR = 7
    ARRAY = 8
    RECORD = 9


# first and last index -> data type of a record: ETG.1000.6, 5.6.7
RECORDS = (
    (0x1018, 0x1018, 0x0023),  # identity
    (0x1400, 0x15FF, 0x0020),  # PDO communication parameter
    (0x1600, 0x17FF, 0x0021),  # PDO mapping
    (0x1800, 0x19FF, 0x0020),
    (0x1A00, 0x1BFF, 0x0021),
    (0x1C32, 0x1C33, 0x0029),  # synchronisation parameter
)
READ, WRITE = 0x0007, 0x0038  # access in PRE_OP, SAFE_OP and OP
RX, TX, BACKUP = 0x0040, 0x0080, 0x0100
UNIT, DEFAULT, MINIMUM, MAXIMUM = 0x08, 0x10, 0x20, 0x40  # value information
LENGTHS = 0  # list of the lengths of the others
LISTS = 5  # largest number of a list
INCOMPLETE = 0x80  # bit 7 of the opcode: fragments follow
_HEAD = struct.Struct("<BxH")


def members(model: DriveModel) -> dict[int, list[Object]]:
    """Return the rows of a model by index, both in ascending order."""
    found: dict[int, list[Object]] = {}
    for row in described(model):
        found.setdefault(row.index, []).append(row)
    return found


def object_name(rows: list[Object]) -> str:
    """Name of an object, from that of sub-index 0, because rows name entries only."""
    name = rows[0].name
    for affix in ("_entries", "_number_of_mapped_objects", "_number_of_mapped_entries"):
        name = name.removesuffix(affix)
    return name.removeprefix("number_of_").removeprefix("entries_")


def object_code(rows: list[Object]) -> ObjectCode:
    """Object code of the object that consists of these rows."""
    if len(rows) == 1 and rows[0].object_type not in ("ARRAY", "RECORD"):
        return ObjectCode.VAR
    return ObjectCode.ARRAY if rows[0].object_type == "ARRAY" else ObjectCode.RECORD


def data_type(rows: list[Object]) -> int:
    """Data type of an object: of its value, of its elements, or of the record."""
    code = object_code(rows)
    if code == ObjectCode.RECORD:
        index = rows[0].index
        return next((number for low, high, number in RECORDS if low <= index <= high), 0)
    return DATA_TYPES[rows[-1].data_type]


def bits(row: Object) -> int:
    """Length of an entry (bit); for a string, that of its default."""
    if row.data_type == "BOOLEAN":
        return 1
    return 8 * (row.size or len(row.initial))


def access(row: Object) -> int:
    """Access rights of an entry: table 48."""
    rights = READ if row.access != "wo" else 0
    rights |= WRITE if row.access in ("rw", "wo") else 0
    rights |= RX if "rx" in row.pdo else 0
    rights |= TX if "tx" in row.pdo else 0
    return rights | (BACKUP if row.storable else 0)


class SdoInfo:
    """The SDO information of a model."""

    def __init__(self, model: DriveModel):
        self._members = members(model)
        self._rows = {(row.index, row.subindex): row for row in described(model)}

    def request(self, body: bytes, size: int) -> Answer:
        """Answer the body of a telegram; `size` is the longest body of an answer (bytes)."""
        if len(body) < 6:
            return MailboxError.SIZE_TOO_SHORT
        opcode = body[2] & 0x7F
        handler = {
            Opcode.LIST_REQUEST: self._list,
            Opcode.OBJECT_REQUEST: self._object,
            Opcode.ENTRY_REQUEST: self._entry,
        }.get(opcode)  # type: ignore[call-overload]
        data = body[6:]
        needed = 4 if opcode == Opcode.ENTRY_REQUEST else 2
        if handler is None:
            return self._error(Abort.COMMAND_SPECIFIER)
        if len(data) < needed:
            return MailboxError.SIZE_TOO_SHORT
        return handler(data, size)

    def _error(self, code: Abort) -> Answer:
        return (self._pack(Opcode.ERROR, struct.pack("<I", code)),)

    def _pack(self, opcode: int, data: bytes, left: int = 0) -> bytes:
        flag = INCOMPLETE if left else 0
        return header(Service.SDO_INFORMATION) + _HEAD.pack(opcode | flag, left) + data

    def _fragments(self, opcode: Opcode, data: bytes, size: int) -> list[bytes]:
        room = (size - 6) // 2 * 2
        parts = [data[at : at + room] for at in range(0, len(data), room)]
        return [self._pack(opcode, part, len(parts) - 1 - n) for n, part in enumerate(parts)]

    # ----------------------------------------------------------------- lists

    @functools.cached_property
    def lists(self) -> dict[int, list[int]]:
        """The lists by number: all, RPDO mappable, TPDO mappable, stored, start-up (table 44)."""
        wanted = {
            1: lambda row: True,
            2: lambda row: "rx" in row.pdo,
            3: lambda row: "tx" in row.pdo,
            4: lambda row: row.storable,
            5: lambda row: row.storable and row.index < 0x2000,
        }
        return {
            number: [index for index, rows in self._members.items() if any(map(fits, rows))]
            for number, fits in wanted.items()
        }

    def _list(self, data: bytes, size: int) -> Answer:
        number = int.from_bytes(data[:2], "little")
        if number > LISTS:
            return self._error(Abort.INVALID_VALUE)
        words: Iterable[int] = (
            [len(found) for found in self.lists.values()]
            if number == LENGTHS
            else self.lists[number]
        )
        content = b"".join(struct.pack("<H", word) for word in (number, *words))
        return self._fragments(Opcode.LIST, content, size)

    # ----------------------------------------------------- objects and entries

    def _object(self, data: bytes, size: int) -> Answer:
        index = int.from_bytes(data[:2], "little")
        rows = self._members.get(index)
        if rows is None:
            return self._error(Abort.NO_OBJECT)
        head = struct.pack("<HHBB", index, data_type(rows), rows[-1].subindex, object_code(rows))
        return self._fragments(Opcode.OBJECT, head + object_name(rows).encode(), size)

    def _entry(self, data: bytes, size: int) -> Answer:
        index, subindex, wanted = struct.unpack_from("<HBB", data)
        row = self._rows.get((index, subindex))
        if row is None:
            known = index in self._members
            return self._error(Abort.NO_SUBINDEX if known else Abort.NO_OBJECT)
        given = 0
        values = b""
        # bit 3 is never set, because units have no number in the model (ETG.1004)
        for bit, value in (
            (DEFAULT, row.default),
            (MINIMUM, row.minimum),
            (MAXIMUM, row.maximum),
        ):
            if wanted & bit and (content := _value(row, value)) is not None:
                given |= bit
                values += content
        head = struct.pack(
            "<HBBHHH", index, subindex, given, DATA_TYPES[row.data_type], bits(row), access(row)
        )
        return self._fragments(Opcode.ENTRY, head + values + row.name.encode(), size)


def _value(row: Object, value: float | str) -> bytes | None:
    """Pack a value in the data type of a row; None if there is no value."""
    if not row.format:
        return row.initial if isinstance(value, str) else None
    if row.real:
        return row.code.pack(value) if math.isfinite(float(value)) else None
    return struct.pack("<" + row.format, int(value))
