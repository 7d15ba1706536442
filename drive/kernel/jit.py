"""Compile the blocks of the cycle with Numba, or run them as plain Python.

`block` marks a box of the block diagram: compiled into whoever calls it, never on its own. `rare`
marks one that is not entered in most cycles: it takes no room between those that are.
`entry` marks the few functions Python calls; only these are kept, in `cache_directory`, each under
the digest (`reach`) of all the code it is made of. Numba's own key sees one file only, and every
comment in it. ``NUMBA_DISABLE_JIT=1`` runs all of it as ordinary Python.

That takes inner names of Numba, which another release may not have or mean otherwise. So with a
release that was not tested, or with ``SERVOGYM_PLAIN_NUMBA=1``, both are ``numba.njit`` and nothing
else of Numba: the same results, but all is compiled anew in each process, minutes for a machine.
"""

import linecache
import os
from collections.abc import Callable, Iterable
from typing import Any

import numba

from .code_cache import cache_directory, say

__all__ = [
    "DISABLED", "PLAIN", "TESTED", "block", "block_of_lines", "cache_directory", "entry", "rare",
]

TESTED = "0.68"  # releases of Numba whose inner names `dispatchers` and its like are written for
DISABLED = bool(numba.config.DISABLE_JIT)  # type: ignore[attr-defined]


def _unusable() -> str:
    """Why Numba's inner names are not used; empty where they are."""
    if os.environ.get("SERVOGYM_PLAIN_NUMBA"):
        return "SERVOGYM_PLAIN_NUMBA is set"
    if not numba.__version__.startswith(f"{TESTED}."):
        return f"Numba {numba.__version__} is not {TESTED}, which was tested"
    try:
        from . import dispatchers  # noqa: F401
    except (ImportError, AttributeError) as error:
        return f"this Numba {numba.__version__} is not as it was released ({error})"
    return ""


_why = "" if DISABLED else _unusable()
PLAIN = bool(_why)

if DISABLED:

    def block(function: Any) -> Any:
        """Return the function as it is."""
        return function

    rare = entry = block
elif PLAIN:
    say(f"{_why}: all is compiled anew at each start (minutes), numba=={TESTED}.* keeps it",
        always=True)
    block = rare = entry = numba.njit(error_model="numpy", nogil=True)
else:
    from .dispatchers import block, entry, rare


def block_of_lines(
    name: str, arguments: str, lines: Iterable[str], names: dict[str, Any]
) -> Callable[..., Any]:
    """A block from the lines of its body, which a table has made; they see `names`.

    They are ordinary source: a traceback, a debugger and `inspect.getsource` show them, and without
    JIT they run line by line.
    """
    source = f"def {name}({arguments}):\n" + "".join(f"    {line}\n" for line in lines)
    file = f"<servogym {names['__name__']}.{name}>"
    linecache.cache[file] = len(source), None, source.splitlines(keepends=True), file
    exec(compile(source, file, "exec"), names)
    return block(names[name])
