"""Compile the blocks of the cycle with Numba, or run them as plain Python.

`block` marks a box of the block diagram. It is compiled into its callers and never on its own.
`rare` marks a block that most cycles skip; its code is placed behind the code of the others.
`entry` marks the few functions that Python calls. Only entries are stored in `cache_directory`,
each under the digest (`reach`) of all the code that it consists of. Numba's own key covers a single
file, including its comments. ``NUMBA_DISABLE_JIT=1`` runs everything as ordinary Python.

This uses private names of Numba, which may change with any release. With a release that was not
tested, or with ``SERVOGYM_PLAIN_NUMBA=1``, all three are ``numba.njit``. The results are the same,
but each process compiles everything anew, which takes minutes for a machine.
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

TESTED = "0.68"  # release of Numba whose private names `dispatchers`, `compiler` and `reach` use
DISABLED = bool(numba.config.DISABLE_JIT)  # type: ignore[attr-defined]


def _unusable() -> str:
    """Why Numba's private names are not used; empty if they are."""
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
    say(f"{_why}: the code is compiled anew at each start (minutes); numba=={TESTED}.* stores it",
        always=True)
    block = rare = entry = numba.njit(  # type: ignore[assignment]
        error_model="numpy", nogil=True
    )
else:
    from .dispatchers import block, entry, rare


def block_of_lines(
    name: str, arguments: str, lines: Iterable[str], names: dict[str, Any]
) -> Callable[..., Any]:
    """Make a block from the lines of its body, which were generated from a table.

    The lines are ordinary source: tracebacks, debuggers and `inspect.getsource` show them, and
    without JIT they run line by line. `names` are their globals.
    """
    source = f"def {name}({arguments}):\n" + "".join(f"    {line}\n" for line in lines)
    file = f"<servogym {names['__name__']}.{name}>"
    linecache.cache[file] = len(source), None, source.splitlines(keepends=True), file
    exec(compile(source, file, "exec"), names)
    return block(names[name])
