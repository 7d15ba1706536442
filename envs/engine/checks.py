"""Checks of a user's arguments; the errors name argument, value, range and unit."""

import functools
import inspect
import math
import os
import traceback
from collections import UserDict
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import field, fields, replace
from typing import Any

import numpy as np

from ...drive.model.names import hint
from ...drive.model.uncompiled import HOUSE

THREADS = "SERVOGYM_THREADS"  # environment variable: threads granted to this process


def in_range(name: str, value: float, low: float, high: float, unit: str = "") -> float:
    """Return `value` as a float. Raises ValueError with name, value, range and unit."""
    try:
        number = float(value)
    except (TypeError, ValueError, OverflowError):
        number = math.nan
    if not low <= number <= high:
        raise ValueError(f"{name} = {value!r} is out of range {low:g}..{high:g} {unit}".rstrip())
    return number


def ranged(default: float | None, low: float, high: float, unit: str) -> Any:
    """Declare a number with a range in a dataclass of parameters; see `check_fields`."""
    return field(default=default, metadata={"range": (low, high, unit)})


def check_fields(parameters: Any) -> None:
    """Raise ValueError for a `ranged` field out of its range, or another one that is no flag.

    A ranged field whose default is None may be None. The error names field, value, range and unit.
    """
    for each in fields(parameters):
        value = getattr(parameters, each.name)
        if each.metadata and not (value is None and each.default is None):
            low, high, unit = each.metadata["range"]
            in_range(each.name, value, low, high, unit)
            if isinstance(value, str):
                raise ValueError(f"{each.name} = {value!r} is a text: give a number in {unit}")
        elif not each.metadata and not isinstance(value, bool):
            raise ValueError(f"{each.name} = {value!r}: use True or False")


def changed(parameters: Any, values: Mapping[str, Any], what: str) -> Any:
    """Return a dataclass of parameters with other `values`.

    Raises ValueError for a name that it lacks; the error calls the dataclass `what`.
    """
    names = [each.name for each in fields(parameters)]
    for name in values:
        if name not in names:
            raise ValueError(f"{what} has no parameter {name!r}: {hint(name, names)}")
    return replace(parameters, **values)


def whole(name: str, value: float, low: int, high: int) -> int:
    """Return `value` as an int. Raises ValueError with name, value and range."""
    try:
        number = low - 1 if isinstance(value, bool) else int(value)
    except (TypeError, ValueError, OverflowError):
        number = low - 1
    if number != value or not low <= number <= high:
        raise ValueError(f"{name} = {value!r} must be a whole number {low}..{high}")
    return number


def flag(name: str, value: bool) -> bool:
    """Return `value` as a bool. Raises ValueError with name and value."""
    if not isinstance(value, bool | np.bool_) and value not in (0, 1):
        raise ValueError(f"{name} = {value!r}: use True or False")
    return bool(value)


def misfit(function: Any, *arguments: Any) -> str:
    """Say why a function cannot be called so; empty if it can, or if it has no signature."""
    try:
        inspect.signature(function).bind(*arguments)
    except TypeError as error:
        return str(error)
    except ValueError:
        return ""
    return ""


def cores() -> int:
    """Number of processor cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def threads() -> int:
    """Number of threads of a vector by default: what is granted, otherwise one per core."""
    granted = os.environ.get(THREADS, "")
    return max(int(granted), 1) if granted.isdigit() else cores()


def choice(name: str, given: Any, known: Iterable[Any]) -> Any:
    """Return `given` if it is one of `known`. Raises ValueError with similar names."""
    names = [str(each) for each in known]
    if not isinstance(given, str) or given not in names:
        raise ValueError(f"{name} = {given!r}: {hint(str(given), names)}")
    return given


class UnknownArgument(TypeError):
    """An argument that an environment does not have.

    Its text is that of Python's own error, because libraries look for these words: torchrl tries an
    argument and omits it if it is unexpected.
    """

    words = ""  # the message for people


def refuse_unknown(task: type, arguments: Iterable[str]) -> None:
    """Raise UnknownArgument with similar names for an argument that a task does not have."""
    for name in arguments:
        if name not in accepted(task):
            remark, owner = hint(name, accepted(task)), task.__name__
            error = UnknownArgument(
                f"{owner}.__init__() got an unexpected keyword argument {name!r}: {remark}"
            )
            error.words = f"{owner} has no argument {name!r}: {remark}"
            raise error


def words(error: BaseException) -> str:
    """Return the message of an error for people, without the words that Gymnasium adds."""
    own = getattr(error.__cause__ or error, "words", "")
    return own or str(error).partition(" was raised from the environment")[0]


class Options(UserDict[str, Any]):
    """Options of a reset, which record the names that a task has asked for.

    A task that reads all of them at once (``drawn | options``) is taken to know them all.
    """

    def __init__(self, given: Mapping[str, Any]):
        self._asked: dict[str, None] = {}  # in their order
        super().__init__()
        self.data.update(given)

    def __contains__(self, name: object) -> bool:
        self._asked[str(name)] = None
        return name in self.data

    def __getitem__(self, name: str) -> Any:
        self._asked[name] = None
        return self.data[name]

    def __iter__(self) -> Iterator[str]:
        self._asked |= dict.fromkeys(self.data)
        return iter(self.data)

    def __ror__(self, other: Any) -> Any:
        return {**other, **self}

    def number(self, name: str, default: float, low: float, high: float, unit: str) -> float:
        """Return an option, or the default. Raises ValueError if it is out of range."""
        return in_range(f"options[{name!r}]", self.get(name, default), low, high, unit)

    def refuse_unread(self) -> None:
        """Raise ValueError for an option that the task has not asked for."""
        for name in self.data.keys() - self._asked.keys():
            remark = hint(name, self._asked)
            raise ValueError(
                f"options: there is no {name!r} here" + (f": {remark}" if remark else "")
            )


def place_of(error: BaseException) -> str:
    """File and line of the user's own code that raised an error; empty for any other code."""
    if isinstance(error, SyntaxError) and error.filename:
        return f"{error.filename}, line {error.lineno}"
    frames = traceback.extract_tb(error.__traceback__)
    entered = next((i for i, one in enumerate(frames) if one.filename.startswith(HOUSE)), 0)
    own = [one for one in frames[entered:] if not one.filename.startswith(HOUSE)]
    return f"{own[-1].filename}, line {own[-1].lineno}, in {own[-1].name}" if own else ""


def error_line(error: BaseException) -> str:
    """An error in one line: its place in the user's own code, its class and its message."""
    place = place_of(error)
    text = error.msg if isinstance(error, SyntaxError) else " ".join(str(error).split())
    return f"{place + ': ' if place else ''}{type(error).__name__}: {text}"


@functools.cache
def accepted(task: type) -> dict[str, inspect.Parameter]:
    """The arguments of a task by name, including those it passes on to its base classes."""
    found: dict[str, inspect.Parameter] = {}
    for kind in task.__mro__:
        if "__init__" not in vars(kind):
            continue
        taken = inspect.signature(vars(kind)["__init__"]).parameters
        for name, parameter in taken.items():
            if name != "self" and parameter.kind is not parameter.VAR_KEYWORD:
                found.setdefault(name, parameter)
        if not any(p.kind is p.VAR_KEYWORD for p in taken.values()):
            break
    return found
