"""AXIS: one servo axis as one record. Every parameter, state, input and output is a named field.

The record has two halves, and each quantity lives in exactly one of them:

``od``
    the object dictionary's variables, in *drive units* and in the CiA 301 type of their object
    (``od.target_position`` is an INTEGER32 in position units). SDO and PDO move these bytes
    and nothing else.
everything else
    what the control cycle works on, in SI units at the motor shaft (rad, rad/s, Nm, s), and the
    counters, which are whole cycles.

`__init__.pyi` declares the types of all fields for editors and mypy; ``make stub`` generates it
from these tables.

A quantity is one row with its object, its unit and its field in SI (`variables.OBJECTS`, see
`quantity`). The rows generate the fields, the conversions of `factors`, which is the only place
that converts, the values that keep their meaning when units change, and the stub. A reset assigns a
record, a snapshot copies its bytes, many drives are an array, and two drives cannot share hidden
state.
"""

import functools

import numpy as np

from .fields import (
    FIELDS,
    IP_RECORDS,
    KINDS,
    MAKER_LEGS,
    MAKER_METHODS,
    OWN,
    OWN_STORED,
    PLACES,
    QUIRKS,
    SEGMENTS,
    SET_POINTS,
    STORED,
)
from .quantity import RAD_S_PER_MINUTE, SIZES, Kind, Quantity
from .variables import (
    ANALOG_INPUTS,
    FAULT_CAUSES,
    FAULT_ROWS,
    HISTORY,
    OBJECTS,
    VENDOR_BYTES,
)

__all__ = [
    "ANALOG_INPUTS", "AXIS", "FAULT_CAUSES", "FAULT_ROWS", "FIELDS", "HISTORY", "IP_RECORDS",
    "KINDS", "MAKER_LEGS", "MAKER_METHODS", "OBJECTS", "OD", "OWN", "OWN_STORED", "PLACES",
    "QUIRKS", "RAD_S_PER_MINUTE", "SEGMENTS", "SET_POINTS", "SIZES", "STORED", "UNITS",
    "VENDOR_BYTES", "Axis", "Kind", "Objects", "Quantity", "accessible", "make",
]

Axis = Objects = np.record  # types of a record and of its `od`: see __init__.pyi


def _dtype(rows):
    return [(name, *kind) if isinstance(kind, tuple) else (name, kind) for name, kind, *_ in rows]


OD = np.dtype(_dtype(OBJECTS), align=True)
AXIS = np.dtype([("od", OD), *_dtype(FIELDS)], align=True)
UNITS = {f"od.{row.field}": row.unit for row in OBJECTS} | {
    name: unit for name, _, unit, _ in FIELDS
}


@functools.cache
def accessible(dtype: np.dtype) -> np.dtype:
    """Return a dtype whose elements have their fields as attributes, as the kernel needs them.

    It is always the same object: with an equal dtype that is another object, a compiled function
    compares all fields at each call, which takes 2 µs.
    """
    return np.dtype((np.record, dtype))


def make(n: int) -> np.ndarray:
    """Records of `n` axes, all zero, shape ``(n,)``; `model.DriveModel.reset` fills them."""
    return np.zeros(n, accessible(AXIS))
