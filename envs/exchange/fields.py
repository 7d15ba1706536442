"""Vectors with named elements: observations and actions as records of floats.

A field is a name; a name with a shape; or a name, a shape, and the record of each element::

    AXIS = observation("distance", "velocity")
    observation("goal", ("preview", 4), ("axes", 2, AXIS))  # nine numbers
    observation(("path", (4, 2)))  # eight

Compiled code uses the fields of such a record (``seen.goal``, ``seen.preview[2]``,
``seen.axes[0].velocity``) and Gymnasium uses the vector, which is the same memory.
"""

from typing import Any

import numpy as np

from ...drive.kernel.record import accessible

Shape = int | tuple[int, ...]
Field = str | tuple[str, Shape] | tuple[str, Shape, np.dtype]


def observation(*fields: Field) -> np.dtype:
    """Return the record of an observation, float32."""
    return _record("f4", fields)


def action(*fields: Field) -> np.dtype:
    """Return the record of an action, float64."""
    return _record("f8", fields)


def _record(number: str, fields: tuple[Field, ...]) -> np.dtype:
    row: list[Any] = []
    for field in fields:
        name, shape, kind = (field, (), number) if isinstance(field, str) else (*field, number)[:3]
        row.append((name, kind, shape))
    return np.dtype(row)


def width(record: np.dtype) -> int:
    """Return the length of a record as a vector."""
    return record.itemsize // _number(record).itemsize


def _number(record: np.dtype) -> np.dtype:
    while record.names:
        record = record[0].base
    return record


def names(record: np.dtype) -> list[str]:
    """Return the names of all elements: ``"goal"``, ``"path[3, 1]"``, ``"axes[0].velocity"``."""
    found = []
    for name in record.names or ():
        kind, shape = record[name].base, record[name].shape
        inner = [f".{each}" for each in names(kind)] or [""]
        places = [str(list(place)) for place in np.ndindex(shape)] if shape else [""]
        found += [name + place + each for place in places for each in inner]
    return found


def slots(record: np.dtype) -> dict[str, slice]:
    """Return the slice of the vector that each field occupies."""
    size, offsets = _number(record).itemsize, dict(record.fields or {})
    return {
        name: slice(at // size, (at + kind.itemsize) // size)
        for name, (kind, at, *_) in offsets.items()
    }


def named(record: np.dtype, vector: np.ndarray) -> Any:
    """View the first elements of a vector as a record of float32, if possible without a copy."""
    numbers = np.ascontiguousarray(vector[: width(record)], np.float32)
    return numbers.view(accessible(record))[0]
