"""Object dictionary: SDO access to the memory of one drive, with the abort codes of CiA 301.

Order of the checks: object, sub-index, access, length, range, device state, side effects. A refused
write changes nothing. Further effects of a write are rows of `HOOKS`.
"""

import functools
from collections.abc import Iterable, Mapping

import numpy as np

from ..kernel.factors import units_changed
from ..model.model import DriveModel
from ..model.names import hint
from ..model.rows import Object
from .abort import Abort, SdoAbort
from .communication import READ_RULES, RULES
from .device import Device
from .hooks import HOOKS, WHEN, Hook, hook_of
from .kept import FACTOR, place, written
from .mapping import RULES_OF_RANGES, all_objects, unfit_for_rpdo
from .slots import Names, Slot, Slots


@functools.cache
def patterns(model: DriveModel) -> tuple[dict[tuple[int, int], Slot], dict[str, tuple[int, int]]]:
    """The objects of a model by address, which all its drives share, and addresses by name.

    Raises ValueError with file, line and reason for an unknown hook and an impossible mapping.
    """
    rows = all_objects(model)
    for row in rows:
        if row.when and row.when not in WHEN:
            known = ", ".join(WHEN)
            raise ValueError(f"{row.where}: when {row.when!r} is unknown, use one of {known}")
        if why := unfit_for_rpdo(row):
            raise _not_by_pdo(row, why, "rx out")
    slots = {
        (row.index, row.subindex): Slot(
            row, None, RULES.get(row.index) or RULES_OF_RANGES.get(row.index & 0xFE00),
            place(model, row), READ_RULES.get((row.index, row.subindex)), _hook(model, row),
        )
        for row in rows
    }
    return slots, {row.name: (row.index, row.subindex) for row in rows}


def _hook(model: DriveModel, row: Object) -> Hook | None:
    """The hook of an object. A hook that process data would bypass is refused."""
    if not row.hook:
        return None
    try:
        hook = hook_of(model, row.hook)
    except LookupError:
        remark = hint(row.hook, HOOKS, f"use one of {', '.join(HOOKS)}, or write it in hooks.py")
        raise ValueError(f"{row.where}: hook {row.hook!r} is unknown: {remark}") from None
    except ValueError as error:
        raise ValueError(f"{row.where}: hook {row.hook!r}: {error}") from None
    if row.hook not in HOOKS:
        if (hook.write or hook.raw) and "rx" in row.pdo:
            raise _not_by_pdo(row, "runs no hook", f"rx out, or the write of the hook {row.hook!r}")
        if (hook.read or hook.raw) and "tx" in row.pdo:
            raise _not_by_pdo(row, "runs no hook", f"tx out, or the read of the hook {row.hook!r}")
    return hook


def _not_by_pdo(row: Object, why: str, leave: str) -> ValueError:
    return ValueError(
        f"{row.where}: pdo {row.pdo!r}: process data are bytes moved by compiled code, which "
        f"{why}: leave {leave}"
    )


@functools.cache
def indices(model: DriveModel) -> frozenset[int]:
    """The indices of a model's objects."""
    return frozenset(index for index, _ in patterns(model)[0])


class ObjectDictionary:
    """The objects of one drive. `read` and `write` use bytes and abort codes and never raise."""

    def __init__(self, drive: Device, views: Mapping[str, memoryview | None]):
        self.drive = drive
        shared, names = patterns(drive.model)
        self.slots = Slots(shared, views)
        self.names = Names(names, self.slots)
        self.results: dict[int, bytes] = {}  # of a parameter channel, by sub-index
        self.texts: dict[tuple[int, int], bytes] = {}  # values of objects that are stored as bytes
        self._stores = drive.model.quirk("writes_are_stored")
        self._changed = drive.axes["parameters_changed"][drive.index : drive.index + 1]

    def find(self, index: int, subindex: int) -> tuple[Slot | None, Abort]:
        """The slot of an object, or the reason why there is none."""
        slot = self.slots.get((index, subindex))
        if slot is not None:
            return slot, Abort.NONE
        known = index in indices(self.drive.model)
        return None, Abort.NO_SUBINDEX if known else Abort.NO_OBJECT

    def value(self, index: int, subindex: int = 0, default: int = 0) -> int:
        """Value of a communication object, `default` if the model lacks it."""
        slot = self.slots.get((index, subindex))
        return int(slot.get()) if slot else default

    def read(self, index: int, subindex: int) -> tuple[bytes, Abort]:
        """SDO upload: the object's bytes, or an abort code."""
        slot = self.slots.get((index, subindex))
        if slot is None:
            return b"", self.find(index, subindex)[1]
        if slot.row.access == "wo":
            return b"", Abort.WRITE_ONLY
        if slot.raw:
            return slot.raw(self, slot.row, None)
        value = self.shown(slot)
        if isinstance(value, Abort):
            return b"", value
        return value.encode() if isinstance(value, str) else slot.code.pack(value), Abort.NONE

    def shown(self, slot: Slot) -> int | float | str | Abort:
        """Value of an object as a master reads it, or an abort code."""
        return slot.reads(self, slot.row) if slot.reads else slot.get()

    def write(self, index: int, subindex: int, data: bytes) -> Abort:
        """SDO download: store the bytes, or return the abort code and change nothing."""
        slot = self.slots.get((index, subindex))
        if slot is None:
            return self.find(index, subindex)[1]
        if not slot.writable:
            return Abort.READ_ONLY
        if slot.raw:
            return slot.raw(self, slot.row, data)[1]
        size = slot.code.size  # 0: a string
        if size and len(data) != size:
            return Abort.LENGTH_TOO_HIGH if len(data) > size else Abort.LENGTH_TOO_LOW
        return self.store(slot, slot.code.unpack(data)[0])

    def store(self, slot: Slot, value: int | float) -> Abort:
        """Store a value of the right type after the checks of range, state and side effects."""
        row = slot.row
        if not slot.writable:
            return Abort.READ_ONLY
        if not value >= row.minimum:
            return Abort.VALUE_TOO_LOW
        if value > row.maximum:
            return Abort.VALUE_TOO_HIGH
        if row.allowed is not None and value not in row.allowed:
            return Abort.INVALID_VALUE
        if row.when and not WHEN[row.when](self.drive):
            return Abort.DEVICE_STATE
        abort = slot.hook(self, row, int(value)) if slot.hook else Abort.NONE
        if abort is Abort.NONE:
            self.put(slot, value)
            self._changed[0] = 1
            if row.index < 0x2018:  # with the transmit masks of some models
                self.drive.communication_version += 1
        if abort not in (Abort.NONE, Abort.STORED):
            return abort
        if self._stores and (row.storable or row.hook) and not self.drive.parameters.save():
            return Abort.HARDWARE
        return Abort.NONE

    def put(self, slot: Slot, value: int | float) -> None:
        """Store a checked value; if it defines the units, numbers of other objects follow."""
        if slot.kept == FACTOR:
            self.put_factors([(slot, value)])
            return
        slot.put(value)
        if slot.kept is not None:
            written(self.drive, slot.kept)

    def put_factors(self, values: Iterable[tuple[Slot, int | float]]) -> None:
        """Store values that define the units, all at once."""
        units_changed(self.drive.axes, self.drive.index)  # the present units
        for slot, value in values:
            slot.put(value)
        units_changed(self.drive.axes, self.drive.index)

    def slot(self, index: int | str, subindex: int) -> Slot:
        """The slot of an address or name, for Python. Raises SdoAbort with a hint."""
        if isinstance(index, str):
            slot = self.names.get(index)
            if slot is None:
                remark = hint(index, self.names, "see objects.csv of its model")
                raise SdoAbort(Abort.NO_OBJECT, 0, 0, f"no object is called {index!r}: {remark}")
            if subindex not in (0, slot.row.subindex):
                raise TypeError(f"{index!r} is a name: it has no other sub-index {subindex!r}")
            return slot
        if not isinstance(index, int | np.integer):
            raise SdoAbort(
                Abort.NO_OBJECT, 0, 0, f"{index!r} is not an object: give its name, or its index"
            )
        slot, abort = self.find(index, subindex)
        if slot is None:
            raise SdoAbort(abort, index, subindex)
        return slot
