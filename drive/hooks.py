"""What reading or writing an object does beside moving its bytes: `hook` in objects.csv by name.

A write hook sees the value after the checks of type, range and state. It returns NONE to have the
value stored, STORED where that is already done, or the abort code of a refusal. `WHEN` are the
states of the drive a write may need.
"""

import math
from collections.abc import Callable
from fractions import Fraction
from typing import TYPE_CHECKING

from . import hooks_act, hooks_ars, hooks_ethercat
from .abort import Abort
from .factors import FRACTION_LIMIT
from .homing import Progress
from .hook import Hook

if TYPE_CHECKING:
    from .drive import Drive
    from .objects import ObjectDictionary
    from .rows import Object

SAVE, LOAD = 0x65766173, 0x64616F6C  # "save", "load"
RUNNING = (Progress.SEARCHING, Progress.STOPPING, Progress.TO_ZERO)

WHEN: dict[str, Callable[["Drive"], bool]] = {
    "disabled": lambda drive: not drive.energised,
    "not_homing": lambda drive: int(drive.axis.homing) not in RUNNING,
}


def _clear_history(od: "ObjectDictionary", row: "Object", value: int) -> Abort:
    if value != 0:
        return Abort.INVALID_VALUE
    od.drive.axis.od.error_field[:] = 0
    return Abort.NONE


def _mode(od: "ObjectDictionary", row: "Object", value: int) -> Abort:
    return Abort.NONE if value == 0 or value in od.drive.model.modes else Abort.INVALID_VALUE


def _homing_method(od: "ObjectDictionary", row: "Object", value: int) -> Abort:
    return Abort.NONE if value in od.drive.model.homing_methods else Abort.INVALID_VALUE


def _factor(od: "ObjectDictionary", row: "Object", value: int) -> Abort:
    """608Fh, 6091h, 6092h: the exact fraction they make together has to stay computable."""
    fractions = []
    for index, upside_down in ((0x608F, True), (0x6091, True), (0x6092, False)):
        parts = []
        for subindex in (1, 2):
            here = (index, subindex) == (row.index, row.subindex)
            parts.append(value if here else int(od.slots[index, subindex].get()))
        fractions.append(Fraction(*(reversed(parts) if upside_down else parts)))
    product = math.prod(fractions)
    too_long = max(product.numerator, product.denominator) > FRACTION_LIMIT
    return Abort.INTERNAL_INCOMPATIBLE if too_long else Abort.NONE


def _save(od: "ObjectDictionary", row: "Object", value: int) -> Abort:
    if value != SAVE:
        return Abort.NOT_TRANSFERABLE
    return Abort.STORED if od.drive.store_parameters() else Abort.HARDWARE


def _load(od: "ObjectDictionary", row: "Object", value: int) -> Abort:
    if value != LOAD:
        return Abort.NOT_TRANSFERABLE
    if od.drive.model.quirk("load_at_once"):
        if od.drive.energised:
            return Abort.DEVICE_STATE
        od.drive.load_defaults()
        return Abort.STORED
    return Abort.STORED if od.drive.forget_parameters() else Abort.HARDWARE


HOOKS: dict[str, Hook] = {
    "clear_history": Hook(_clear_history),
    "save": Hook(_save),
    "load": Hook(_load),
    "mode": Hook(_mode),
    "homing_method": Hook(_homing_method),
    "factor": Hook(_factor),
    **hooks_act.HOOKS,
    **hooks_ars.HOOKS,
    **hooks_ethercat.HOOKS,
}
