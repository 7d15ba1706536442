"""Process data: PDO records, their mapping compiled to byte offsets, images as bytes.

A PDO of the drive is one `PDO` record: its communication parameters (CiA 301, 1400h/1800h), its
mapping (1600h/1A00h), and the mapping compiled to offsets into the AXIS record. The *process image*
of a drive consists of all its valid RPDOs (or TPDOs) in order. `latch` and `collect` only move
bytes, so the reinforcement learning loop, the CANopen node and the tests exchange the same bytes.
Objects of the kernel are not checked: a value out of range stays in the object as it was sent, and
the cycle limits its effect. An object in the model's own bytes keeps its value if process data
bring one that SDO would refuse.
"""

import numpy as np

from .jit import block, entry
from .record import AXIS, accessible
from .words import Latched

ENTRIES = 16  # mapped objects a PDO can have
MAX_BITS = 64  # of a PDO on CAN, and of one that is mapped by the master
DUMMY_BITS = {2: 8, 3: 16, 4: 32, 5: 8, 6: 16, 7: 32}  # CiA 301, dummy mapping, by data type
DUMMY = -1  # offset of bytes that go nowhere: CiA 301 dummy mapping 0002h-0007h
INVALID = 0x80000000  # bit 31 of a COB-ID

PDO = np.dtype(
    [
        ("cob_id", "<u4"),
        ("transmission_type", "u1"),
        ("inhibit_time", "<u2"),  # 100 µs
        ("event_timer", "<u2"),  # ms
        ("sync_start", "u1"),
        ("count", "u1"),
        ("mapping", "<u4", (ENTRIES,)),  # index << 16 | subindex << 8 | bits
        ("valid", "u1"),
        ("offset", "<i4", (ENTRIES,)),  # in the AXIS record (byte)
        ("length", "<i4", (ENTRIES,)),  # of the entry (byte)
        ("held", "<i4", (ENTRIES,)),  # of the value in the record (byte), < 0: it has a sign
        ("width", "<i4"),  # of the PDO (byte)
        ("bounded", "u1"),  # some entries have a range of their own
        ("low", "<i8", (ENTRIES,)),  # least and greatest value that is taken over, as `ordinal`
        ("high", "<i8", (ENTRIES,)),
        ("floating", "u1", (ENTRIES,)),  # the entry is a REAL32 or REAL64
    ],
    align=True,
)


# objects of a PDO: first index -> area, and field of the record by sub-index
PARAMETER_FIELDS = {1: "cob_id", 2: "transmission_type", 3: "inhibit_time", 5: "event_timer"}
PARAMETERS = (
    (0x1400, "rpdo", PARAMETER_FIELDS),
    (0x1600, "rpdo", None),
    (0x1800, "tpdo", PARAMETER_FIELDS | {6: "sync_start"}),
    (0x1A00, "tpdo", None),
)
MAX_PDOS = 512


def parameter_place(index: int, subindex: int) -> tuple[str, int] | None:
    """Area and byte offset of a PDO parameter object (CiA 301); None for any other object."""
    for first, area, fields in PARAMETERS:
        if first <= index < first + MAX_PDOS:
            base = (index - first) * PDO.itemsize
            if fields is None:
                field, more = ("mapping", 4 * (subindex - 1)) if subindex else ("count", 0)
            elif subindex in fields:
                field, more = fields[subindex], 0
            else:
                return "constant", 0
            return area, base + PDO.fields[field][1] + more  # type: ignore[index]
    return None


def make(n: int) -> np.ndarray:
    """`n` empty PDOs, all invalid, shape ``(n,)``."""
    pdos = np.zeros(n, accessible(PDO))
    pdos["cob_id"] = INVALID
    return pdos


def memory(axes: np.ndarray) -> np.ndarray:
    """The bytes of records, shape ``(n, AXIS.itemsize)``; a view, not a copy."""
    return np.asarray(axes).view(np.uint8).reshape(len(axes), AXIS.itemsize)


def raw(array: np.ndarray) -> memoryview:
    """The bytes of an array, writable."""
    return memoryview(np.asarray(array).view(np.uint8)).cast("B")  # type: ignore[arg-type]


@block
def latch(bytes_of_axis, axis, rpdos, image, at):
    """Write an RPDO image into the objects of one axis; the next position cycle uses them.

    The image begins at `at`; -> position behind it.
    """
    for i in range(len(rpdos)):
        if rpdos[i].valid:
            at = move(image, bytes_of_axis, rpdos[i], at, True)
    axis.parameters_changed = 1
    axis.sync = Latched.CYCLIC
    axis.sync_pulse = 1
    return at


@block
def collect(bytes_of_axis, tpdos, image, at):
    """Copy the mapped objects of one axis into a TPDO image from `at` on; -> position behind it."""
    for i in range(len(tpdos)):
        if tpdos[i].valid:
            at = move(bytes_of_axis, image, tpdos[i], at, False)
    return at


@block
def move(source, target, pdo, at, latching):
    """Copy one PDO between the objects of an axis and its place `at` in an image.

    When `latching`, it is copied from the image to the objects, otherwise back. A value that
    becomes longer is extended by zeros or its sign. Returns the position behind the PDO, even if
    the image is shorter.
    """
    objects, image = (len(target), len(source)) if latching else (len(source), len(target))
    for e in range(min(pdo.count, ENTRIES)):
        offset, length = pdo.offset[e], max(pdo.length[e], 0)
        held = abs(pdo.held[e])
        fits = 0 <= offset <= objects - held and at + length <= image and min(length, held) > 0
        if fits and latching and pdo.bounded:
            number = ordinal(source, at, length, pdo.low[e] < 0, pdo.floating[e])
            fits = pdo.low[e] <= number <= pdo.high[e]
        if fits:
            begin, end = (at, offset) if latching else (offset, at)
            given, taken = (length, held) if latching else (held, length)
            minus = pdo.held[e] < 0 and source[begin + given - 1] & 0x80
            for b in range(taken):
                target[end + b] = source[begin + b] if b < given else 0xFF * (minus != 0)
        at += length
    return at


@block
def ordinal(image, at, length, signed, floating):
    """The number at a place of an image as an integer.

    Floating-point numbers become integers in the same order, as IEEE 754 provides: the bits of
    negative ones count backwards. What is not a number lies beyond the infinities.
    """
    number = 0
    for b in range(length):
        number |= int(image[at + b]) << 8 * b
    sign = 1 << (8 * int(length) - 1)
    if (signed or floating) and number & sign:
        number -= 2 * sign  # 0 for eight bytes, which have their sign
    if floating and number < 0:
        number ^= sign - 1
    return number


@entry
def latch_axis(all_bytes, axes, index, rpdos, image):
    """`latch` for ``axes[index]``."""
    latch(all_bytes[index], axes[index], rpdos, image, 0)


@entry
def collect_axis(all_bytes, index, tpdos, image):
    """`collect` for ``axes[index]``."""
    collect(all_bytes[index], tpdos, image, 0)
