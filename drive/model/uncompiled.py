"""One-line errors for functions of users that Numba cannot compile: file, line, field and hint.

Numba itself reports a page of its own steps, and an unknown field of a record as a bare KeyError.
The place is taken from the code that Numba was compiling, or from its message; names are looked up
in the source.
"""

import ast
import functools
import linecache
import re
import sysconfig
import traceback
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numba
from numba import types

from .names import hint

HOUSE = (  # places of code that is not the user's
    *(str(Path(__file__).parents[2] / room) for room in ("drive", "envs", "training")),
    *(sysconfig.get_path(name) for name in ("stdlib", "purelib", "platlib")),
    "<",
)
NUMBA = str(Path(numba.__file__).parent)
_PLACES = re.compile(r'(?:at|from) (\S[^\n]*) \((\d+)\)|File "([^"\n]+)", line (\d+)')
_NO_NAME = re.compile(r"name '(\w+)' is not defined")
_CALLEE = re.compile(r"<function (\w+) at ")
_ENDS = ("During:", "File ", "There are ", "Raised from")


def telling(function: Callable[..., None], compiled: Callable[..., None]) -> Callable[..., None]:
    """`compiled`, with a one-line ValueError if `function` in it does not compile."""

    @functools.wraps(compiled)
    def explained(*arguments: Any) -> None:
        try:
            compiled(*arguments)
        except Exception as error:
            if isinstance(error, OSError) or not _in_numba(error):
                raise
            words = refusal(error, function)
        else:
            return
        raise ValueError(words)

    return explained


def _in_numba(error: BaseException) -> bool:
    frames = traceback.walk_tb(error.__traceback__)
    return any(frame.f_code.co_filename.startswith(NUMBA) for frame, _ in frames)


def refusal(error: Exception, function: Any) -> str:
    """File, line and reason of an error of Numba in `function`."""
    source = getattr(function, "py_func", function).__code__
    file, line = next(_places(error), (source.co_filename, 0))
    what = _field(error, file, line)
    if not what:
        what = _shortened(error)
        if name := _NO_NAME.search(what):  # Numba names only the function and its call
            callee = _CALLEE.search(str(error))
            line = _line_of(file, name[1], callee[1] if callee else source.co_name) or line
            known = getattr(getattr(function, "py_func", function), "__globals__", ())
            what = f"{name[0]}: {hint(name[1], known, 'import it, or write it above')}"
    line = line or source.co_firstlineno
    return f"{file}, line {line}, in {_function_at(file, line) or source.co_name}: {what}"


def _places(error: Exception) -> Iterator[tuple[str, int]]:
    """Places in the user's code that Numba was compiling, innermost first."""
    for frame, _ in reversed(list(traceback.walk_tb(error.__traceback__))):
        for value in frame.f_locals.values():
            place: Any = getattr(value, "loc", None)
            if isinstance(getattr(place, "line", None), int):
                yield from _own(str(place.filename), place.line)
    for found in _PLACES.finditer(str(error)):
        yield from _own(found[1] or found[3], int(found[2] or found[4]))


def _own(file: str, line: int) -> Iterator[tuple[str, int]]:
    path = file if file.startswith("<") else str(Path(file).resolve())
    if not path.startswith(HOUSE) and linecache.getline(path, line):
        yield path, line


def _field(error: Exception, file: str, line: int) -> str:
    """An unknown field of a record, with similar ones; empty for any other error."""
    if not isinstance(error, KeyError):
        return ""
    name = str(error.args[0]) if error.args else ""
    for frame, _ in reversed(list(traceback.walk_tb(error.__traceback__))):
        for record in frame.f_locals.values():
            if isinstance(record, types.Record) and name not in record.fields:
                text = linecache.getline(file, line)
                owner = re.search(rf"([\w.]+(?:\[[^]]*\])?)(?:\.{name}\b|\[.{name}.\])", text)
                shown = owner[0] if owner else name
                return f"{shown}: there is no {name!r} here: {hint(name, record.fields)}"
    return ""


def _shortened(error: Exception) -> str:
    """Numba's message without its steps and attempts."""
    kept: list[str] = []
    for text in map(str.strip, str(error).splitlines()):
        if kept and text.startswith(_ENDS):
            break
        if text and not text.startswith("Failed in "):
            kept.append(text)
    return f"it does not compile: {' '.join(kept).partition(' Raised from ')[0].rstrip('.')}"


@functools.cache
def _parsed(file: str) -> ast.Module:
    try:
        return ast.parse("".join(linecache.getlines(file)))
    except SyntaxError:  # a cell of a notebook with commands of its own, say
        return ast.Module([], [])


def _functions(file: str) -> list[ast.FunctionDef]:
    return [node for node in ast.walk(_parsed(file)) if isinstance(node, ast.FunctionDef)]


def _function_at(file: str, line: int) -> str:
    """Name of the innermost function around a line; empty if there is none."""
    around = [f for f in _functions(file) if f.lineno <= line <= (f.end_lineno or f.lineno)]
    return max(around, key=lambda f: f.lineno).name if around else ""


def _line_of(file: str, name: str, function: str) -> int:
    """Line in which a function first uses a name; 0 if it does not."""
    for one in _functions(file):
        if one.name == function:
            uses = [n.lineno for n in ast.walk(one) if isinstance(n, ast.Name) and n.id == name]
            return min(uses, default=0)
    return 0
