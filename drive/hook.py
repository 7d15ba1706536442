"""The type of a hook: functions an object of the dictionary may have beside its bytes."""

from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

from .abort import Abort

if TYPE_CHECKING:
    from .objects import ObjectDictionary
    from .rows import Object


class Hook(NamedTuple):
    """`write` as described in `hooks`; `read` gives the value instead of the stored one."""

    write: Callable[["ObjectDictionary", "Object", int], Abort] | None = None
    read: Callable[["ObjectDictionary", "Object"], int] | None = None
