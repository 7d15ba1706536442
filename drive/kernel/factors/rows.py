"""The rows of the table of quantities as code of the kernel, one line each.

Numba accesses fields by name, so the lines are generated from `record.OBJECTS` when this file is
imported (`jit.block_of_lines`).
"""

import math
from collections.abc import Iterable, Iterator

import numpy as np

from ..jit import block, block_of_lines
from ..record import OBJECTS, PLACES, SIZES, Axis, Kind, Quantity
from . import stored

SIZE = {  # kind of unit -> expression of its size when a value is received
    Kind.POSITION: "axis.rad_per_position_unit",
    Kind.VELOCITY: "axis.rad_s_per_velocity_unit",
    Kind.WIDTH: "abs(axis.rad_per_position_unit)",
    Kind.SPEED: "abs(axis.rad_s_per_velocity_unit)",
    Kind.ACCELERATION: "axis.rad_s2_per_acceleration_unit",
}
PER = {  # unit of an object -> expression of units per SI unit when it is shown
    "position unit": "1.0 / axis.rad_per_position_unit",
    "velocity unit": "1.0 / axis.rad_s_per_velocity_unit",
    "rated torque/1000": "1e3 / axis.rated_torque",
    "rated current/1000": "1e3 / axis.rated_torque",  # a motor with a torque constant
    "vl unit": "1.0 / axis.vl_rad_s if axis.vl_rad_s != 0.0 else 0.0",
}
SATURATED = {"<i4": "integer32", "<i2": "integer16"}
RECEIVED = {  # how -> value in SI of `value` (SI) or, with a unit of its own, `number` times `size`
    "": "{value}",
    "rate": "rate({value}, {size})",
    "amount": "abs({value})",
    "limit": "limit({value})",
    "window": "window({number}, {value})",
    "cycles": "cycles(axis, int({number}))",
    "lag": "lag({value}, axis.velocity_period)",
    "slow lag": "lag({value}, axis.position_period)",
}


def _elements(row: Quantity) -> Iterator[tuple[str, str, int]]:
    """Object, field in SI (if any) and index of each value of a row."""
    names = row.si.split()
    for n in range(max(row.elements, 1)):
        index = f"[{n}]" if row.elements else ""
        field = names[n] if len(names) > 1 else f"{row.si}{index}"
        yield f"od.{row.field}{index}", f"axis.{field}", n


def _sizes(expressions: Iterable[str]) -> dict[str, str]:
    """A variable for each distinct expression."""
    return {text: f"size_{n}" for n, text in enumerate(dict.fromkeys(expressions))}


def _size(row: Quantity) -> str:
    return SIZE[row.kind] if row.kind is not None else str(SIZES[row.unit])


def receive_lines() -> Iterator[str]:
    """Lines that convert each object with a field in SI into that field."""
    rows = [row for row in OBJECTS if row.fields]
    sizes = _sizes(_size(row) for row in rows)
    yield from (f"{name} = {text}" for text, name in sizes.items())
    for row in rows:
        size = sizes[_size(row)]
        for number, si, n in _elements(row):
            kept = f"stored.value(axis, {PLACES.get(row.field, 0) + n}, {number}, {size})"
            text = kept if row.kept else f"{number} * {size}"
            yield f"{si} = " + RECEIVED[row.how].format(value=text, number=number, size=size)


def publish_lines() -> Iterator[str]:
    """Lines that set each object that shows a field in SI."""
    rows = [row for row in OBJECTS if row.how == "shown"]
    sizes = _sizes(PER[row.unit] for row in rows if row.unit)
    yield from (f"{name} = {text}" for text, name in sizes.items())
    for row in rows:
        shown = f"axis.{row.si}"
        if row.unit:
            shown = f"{SATURATED[row.code]}({shown} * {sizes[PER[row.unit]]})"
        yield f"od.{row.field} = {shown}"


def show_lines() -> Iterator[str]:
    """Lines that express each kept value in new units."""
    for row in OBJECTS:
        if row.kept:
            assert row.kind is not None
            range_ = np.iinfo(row.code)
            high = stored.OFF - 1 if row.how == "window" else range_.max
            for number, _, n in _elements(row):
                yield (
                    f"{number} = stored.shown(axis, {PLACES[row.field] + n}, np.int64({number}), "
                    f"{int(row.kind)}, new, {range_.min}, {high})"
                )


@block
def rate(value, unit):
    """An acceleration, where 0, which process data may bring, counts as one unit."""
    return value if value > 0.0 else unit


@block
def limit(value):
    """A limit that 0 switches off."""
    return value if value > 0.0 else math.inf


@block
def window(number, value):
    """A window that its largest number switches off."""
    return math.inf if number == stored.OFF else value


@block
def cycles(axis: Axis, milliseconds):
    """Whole position cycles, rounded up."""
    return int(math.ceil(milliseconds * 1e-3 / axis.position_period - 1e-9))


@block
def lag(time_constant, period):
    """Weight of a new sample in a first-order lag sampled with a period."""
    return 1.0 - math.exp(-period / time_constant) if time_constant > 0 else 1.0


@block
def integer32(value):
    """Nearest INTEGER32, saturated."""
    return int(math.floor(min(max(value, -2147483648.0), 2147483647.0) + 0.5))


@block
def integer16(value):
    """Nearest INTEGER16, saturated."""
    return int(math.floor(min(max(value, -32768.0), 32767.0) + 0.5))


_OD = "od = axis.od"
receive_rows = block_of_lines("receive_rows", "axis", [_OD, *receive_lines()], globals())
publish_rows = block_of_lines("publish_rows", "axis", [_OD, *publish_lines()], globals())
show_rows = block_of_lines("show_rows", "axis, new", [_OD, *show_lines()], globals())
