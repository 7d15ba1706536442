"""The type of a hook: functions an object of the dictionary may have beside its bytes."""

from collections.abc import Callable
from typing import NamedTuple

from ...model.rows import Object
from ..abort import Abort
from ..device import Device, Dictionary


class Hook(NamedTuple):
    """What an object does.

    `write` as described in `hooks`; `read` gives the value a master sees, or an abort code, instead
    of the stored one; `power_on` runs once when the parameters of a drive have been restored; `raw`
    takes the bytes of a write, or None for a read, and gives bytes and abort code. `judges`: all
    that `write` does is to say whether a value goes together with those of other objects, in
    whatever order they were written; stored values have to pass it. What depends on the order (a
    range in units that may change afterwards) is no such judge: what a drive took it gives back.
    """

    write: Callable[[Dictionary, Object, int], Abort] | None = None
    read: Callable[[Dictionary, Object], int | str | Abort] | None = None
    power_on: Callable[[Device], None] | None = None
    raw: Callable[[Dictionary, Object, bytes | None], tuple[bytes, Abort]] | None = None
    judges: bool = False
