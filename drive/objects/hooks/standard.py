"""Hooks of objects of CiA 301 and CiA 402."""

import math
from fractions import Fraction

from ...kernel.factors.units import FRACTION_LIMIT
from ...kernel.statusword import POWERED
from ...model.rows import TEXT_BYTES, Object
from ..abort import Abort
from ..device import Dictionary
from .hook import Hook

# objects that define a position unit, and their fields; a drive may lack some
FRACTION = {
    0x608F: "position_encoder_resolution", 0x6091: "gear_ratio", 0x6092: "feed_constant",
}
SAVE, LOAD = 0x65766173, 0x64616F6C  # "save", "load"


def _clear_history(od: Dictionary, row: Object, value: int) -> Abort:
    if value != 0:
        return Abort.INVALID_VALUE
    od.drive.axis.od.error_field[:] = 0
    return Abort.NONE


def _mode(od: Dictionary, row: Object, value: int) -> Abort:
    return Abort.NONE if value == 0 or value in od.drive.model.modes else Abort.INVALID_VALUE


def _homing_method(od: Dictionary, row: Object, value: int) -> Abort:
    """0: no method is assigned (CiA 402-2)."""
    known = value == 0 or value in od.drive.model.homing_methods
    return Abort.NONE if known else Abort.INVALID_VALUE


def _factor(od: Dictionary, row: Object, value: int) -> Abort:
    """608Fh, 6091h, 6092h: the exact fraction they make together has to stay computable."""
    fractions = []
    for index, field in FRACTION.items():
        upside_down = index != 0x6092
        parts = []
        for subindex in (1, 2):
            here = (index, subindex) == (row.index, row.subindex)
            parts.append(value if here else int(od.drive.axis.od[field][subindex - 1]))
        fractions.append(Fraction(*(reversed(parts) if upside_down else parts)))
    product = math.prod(fractions)
    too_long = max(product.numerator, product.denominator) > FRACTION_LIMIT
    return Abort.INTERNAL_INCOMPATIBLE if too_long else Abort.NONE


def _shortest_period(od: Dictionary, row: Object, value: int) -> Abort:
    """60C2h: the set-points of a bus come no faster than the position controller works."""
    fields = od.drive.axis.od.interpolation_time_units, od.drive.axis.od.interpolation_time_index
    units, index = (value if row.subindex == n else int(fields[n - 1]) for n in (1, 2))
    shortest = Fraction(round(od.drive.model.cycle_time["position"] * 1e9), 10**9)
    return Abort.VALUE_TOO_LOW if units * Fraction(10) ** index < shortest else Abort.NONE


def _save(od: Dictionary, row: Object, value: int) -> Abort:
    if value != SAVE:
        return Abort.NOT_TRANSFERABLE
    return Abort.STORED if od.drive.parameters.save() else Abort.HARDWARE


def _load(od: Dictionary, row: Object, value: int) -> Abort:
    if value != LOAD:
        return Abort.NOT_TRANSFERABLE
    if od.drive.model.quirk("load_at_once"):
        if POWERED[od.drive.axis.state]:  # Metronix 6.1.2.1, CMMP-AS 5.1: power stage off
            return Abort.DEVICE_STATE
        od.drive.parameters.load_defaults()
        return Abort.STORED
    return Abort.STORED if od.drive.parameters.forget() else Abort.HARDWARE


def _bytes(od: Dictionary, row: Object, data: bytes | None) -> tuple[bytes, Abort]:
    """Read or write an object stored as bytes: a string, or a number of an unusual length."""
    address = row.index, row.subindex
    if data is None:
        return od.texts.get(address, row.initial), Abort.NONE
    if row.length and len(data) != row.length:
        return b"", Abort.LENGTH_TOO_HIGH if len(data) > row.length else Abort.LENGTH_TOO_LOW
    od.texts[address] = data
    return b"", Abort.NONE


def _shown(od: Dictionary, row: Object) -> int | str:
    data, _ = _bytes(od, row, None)
    if row.length:
        return int.from_bytes(data, "little", signed=row.data_type.startswith("INTEGER"))
    return data.decode("utf-16-le" if row.data_type == "UNICODE_STRING" else "utf-8", "replace")


HOOKS = {
    TEXT_BYTES: Hook(raw=_bytes, read=_shown),
    "clear_history": Hook(_clear_history),
    "save": Hook(_save),
    "load": Hook(_load),
    "shortest_period": Hook(_shortest_period, judges=True),
    "mode": Hook(_mode, judges=True),
    "homing_method": Hook(_homing_method, judges=True),
    "factor": Hook(_factor, judges=True),
}
