"""The objects with values in units of the factor group, and their places in the record.

See `kernel.factors.stored`. A value that has not been written since the units changed is stored as
it was written, with its unit of that time, and so survives a power-off.
"""

import functools
from typing import NamedTuple

from ..kernel.factors.stored import WRITTEN
from ..kernel.factors.units import FACTORS
from ..kernel.record import AXIS, OD, OWN, PLACES
from ..model.model import DriveModel
from ..model.rows import Object
from .device import Device

ARRAYS = ("kept_raw", "kept_unit", "kept_numerator", "kept_denominator")
FACTOR = -1  # place of an object that defines the units


def _span(field: str) -> list[int]:
    """Offsets of the elements of a field of `od`."""
    kind, offset = OD.fields[field][:2]  # type: ignore[index]
    return [offset + i * kind.base.itemsize for i in range(kind.shape[0] if kind.shape else 1)]


FIELD_PLACES = {  # place by offset in `od`
    offset: place + i for field, place in PLACES.items() for i, offset in enumerate(_span(field))
}
FACTOR_OFFSETS = {offset for field in FACTORS for offset in _span(field)}


def place(model: DriveModel, row: Object) -> int | None:
    """Place of an object's value in `AXIS.kept_raw`, FACTOR, or None for other objects."""
    if not model.quirk("values_keep_meaning") or row.area != "axis":
        return None
    if row.offset in FACTOR_OFFSETS:
        return FACTOR
    own = {offset: OWN + j for j, (offset, *_) in enumerate(model.own_stored)}
    return FIELD_PLACES.get(row.offset, own.get(row.offset))


class WrittenValue(NamedTuple):
    """A value as it was written."""

    raw: int
    unit: float
    numerator: int
    denominator: int


@functools.cache
def storable(model: DriveModel) -> dict[int, Object]:
    """Objects that 1010h stores, by place."""
    rows = {place(model, row): row for row in model.objects.values() if row.storable}
    return {n: row for n, row in rows.items() if n is not None and n != FACTOR}


@functools.cache
def factor_rows(model: DriveModel) -> tuple[Object, ...]:
    """The objects that make the units."""
    return tuple(row for row in model.objects.values() if place(model, row) == FACTOR)


def written(drive: Device, n: int) -> None:
    """Value `n` has been given a number in the present units."""
    if drive.axis.converted:
        drive.axis.kept_shown[n] = WRITTEN


def kept(drive: Device) -> dict[int, WrittenValue]:
    """Return, by place, storable values that have not been written since the units changed."""
    axis = drive.axis
    if not axis.converted:
        return {}
    shown = {
        n: drive.objects.slots[r.index, r.subindex].get() for n, r in storable(drive.model).items()
    }
    arrays = [axis[name].tolist() for name in ARRAYS]
    return {
        n: WrittenValue(*(array[n] for array in arrays))
        for n, number in shown.items()
        if axis.kept_shown[n] == number
    }


def keep(drive: Device, values: dict[int, WrittenValue]) -> None:
    """Restore `kept` values whose numbers are in the objects; all others are as written."""
    axis = drive.axis
    if values:
        axis.converted = 1
    if not axis.converted:
        return
    for n, row in storable(drive.model).items():
        if n not in values:
            axis.kept_shown[n] = WRITTEN
            continue
        axis.kept_shown[n] = drive.objects.slots[row.index, row.subindex].get()
        for name, part in zip(ARRAYS, values[n], strict=True):
            axis[name][n] = part


def factors(drive: Device) -> bytes:
    """The objects that define the units as bytes for comparison; empty if they do not matter."""
    slots = drive.objects.slots
    return b"".join(
        slot.code.pack(slot.get())
        for slot in (slots[row.index, row.subindex] for row in factor_rows(drive.model))
    )


assert all(name in (AXIS.names or ()) for name in ARRAYS)
