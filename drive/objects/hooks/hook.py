"""The type of a hook: functions that an object of the dictionary may have."""

from collections.abc import Callable
from typing import NamedTuple

from ...model.rows import Object
from ..abort import Abort
from ..device import Device, Dictionary


class Hook(NamedTuple):
    """The effects of reading and writing an object.

    Attributes:
        write: called with dictionary, row and value as described in `hooks`.
        read: returns the value that a master reads instead of the stored one, or an abort code.
        power_on: runs when the parameters of a drive have been restored.
        raw: takes the bytes of a write, or None for a read; returns bytes and an abort code.
        judges: `write` only checks whether a value is compatible with those of other objects,
            independent of the order of writes, so stored values have to pass it as well. A check
            that depends on the order, such as a range in units that may change, is none.
    """

    write: Callable[[Dictionary, Object, int], Abort] | None = None
    read: Callable[[Dictionary, Object], int | str | Abort] | None = None
    power_on: Callable[[Device], None] | None = None
    raw: Callable[[Dictionary, Object, bytes | None], tuple[bytes, Abort]] | None = None
    judges: bool = False
