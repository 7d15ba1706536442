"""Complete access: a whole object in one transfer (ETG.1000.6, 5.6.2; ETG.1020).

The values of an array or record are concatenated, with sub-index 0 padded to 16 bits; a transfer
may start at sub-index 0 or 1.
"""

from ..objects.abort import Abort
from ..objects.dictionary import ObjectDictionary
from ..objects.slots import Slot

FIRST = 2  # bytes of sub-index 0


def _slots(objects: ObjectDictionary, index: int, first: int) -> tuple[list[Slot], Abort]:
    """The entries from sub-index `first` on, or the reason why complete access is impossible."""
    numbers = sorted(sub for i, sub in objects.slots if i == index and sub >= first)
    if not numbers:
        return [], objects.find(index, first)[1]
    if numbers == [0]:
        return [], Abort.UNSUPPORTED_ACCESS  # a variable
    return [objects.slots[index, number] for number in numbers], Abort.NONE


def _in_use(objects: ObjectDictionary, index: int, slots: list[Slot]) -> list[Slot]:
    """The entries in use: those counted by sub-index 0 if a master may write it, else all."""
    head = objects.slots.get((index, 0))
    if head is None or not head.writable:
        return slots
    return [slot for slot in slots if slot.row.subindex <= int(head.get())]


def read(objects: ObjectDictionary, index: int, subindex: int) -> tuple[bytes, Abort]:
    """Read all values from `subindex` (0 or 1) on; write-only values read as zeros."""
    slots, abort = _slots(objects, index, subindex)
    if abort:
        return b"", abort
    data = b""
    for slot in _in_use(objects, index, slots):
        value, abort = objects.read(index, slot.row.subindex)
        if abort is Abort.WRITE_ONLY:
            value = bytes(slot.row.size)
        elif abort:
            return b"", abort
        data += value.ljust(FIRST, b"\0") if slot.row.subindex == 0 else value
    return data, Abort.NONE


def write(objects: ObjectDictionary, index: int, subindex: int, data: bytes) -> Abort:
    """Write all values from `subindex` (0 or 1) on; if one is refused, none changes.

    Read-only values are skipped. If sub-index 0 counts the entries and is writable, it is 0 while
    they change, and the data end with the last entry in use.
    """
    slots, abort = _slots(objects, index, subindex)
    if abort:
        return abort
    if not any(slot.writable for slot in slots):
        return Abort.READ_ONLY
    parts, rest = [], data
    for slot in slots:
        size = FIRST if slot.row.subindex == 0 else slot.row.size
        part, rest = rest[:size], rest[size:]
        if not part:
            break
        if len(part) < size:
            return Abort.LENGTH_TOO_LOW
        parts.append((slot, part[: slot.row.size]))
    counted = subindex == 0 and slots[0].writable
    needed = 1 + int.from_bytes(parts[0][1], "little") if counted and parts else len(slots)
    if rest:
        return Abort.LENGTH_TOO_HIGH
    if len(parts) < needed:
        return Abort.LENGTH_TOO_LOW
    before = [(slot, slot.code.pack(slot.get())) for slot, _ in parts if slot.writable]
    abort = _write(objects, index, parts, counted)
    if abort:
        _write(objects, index, before, counted)
    return abort


def _write(
    objects: ObjectDictionary, index: int, parts: list[tuple[Slot, bytes]], counted: bool
) -> Abort:
    """Write entries in their order, their number last."""
    order = [(slot, part) for slot, part in parts if slot.writable]
    if counted:
        abort = objects.write(index, 0, bytes(order[0][0].row.size))
        if abort:
            return abort
        order = [*order[1:], order[0]]
    for slot, part in order:
        abort = objects.write(index, slot.row.subindex, part)
        if abort:
            return abort
    return Abort.NONE
