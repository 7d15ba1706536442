"""The type of a hook: functions an object of the dictionary may have beside its bytes."""

from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

from ..abort import Abort

if TYPE_CHECKING:
    from ..drive import Drive
    from ..objects import ObjectDictionary
    from ..rows import Object


class Hook(NamedTuple):
    """What an object does.

    `write` as described in `hooks`; `read` gives the value a master sees, or an abort code, instead
    of the stored one; `power_on` runs once when the parameters of a drive have been restored; `raw`
    takes the bytes of a write, or None for a read, and gives bytes and abort code.
    """

    write: Callable[["ObjectDictionary", "Object", int], Abort] | None = None
    read: Callable[["ObjectDictionary", "Object"], int | Abort] | None = None
    power_on: Callable[["Drive"], None] | None = None
    raw: Callable[["ObjectDictionary", "Object", bytes | None], tuple[bytes, Abort]] | None = None
