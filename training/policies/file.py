"""A policy of the user's own: a class or a function, in a file or behind an entry point."""

import importlib.util
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from .datasheet import Datasheet

SUFFIX = ".py"


def policy_of(name: str, made: Any, datasheet: Datasheet, seed: int) -> Any:
    """A policy of what a file or an entry point has.

    Args:
        name: of the policy.
        made: a class, made with ``(datasheet, seed)``, whose objects have ``reset`` and ``act``; or
            a function ``act(observation) -> action``. A class may say in ``TASKS`` for which ids.
        datasheet: of the environment.
        seed: of what is random in it.

    Raises:
        ValueError: it is neither, or for other tasks.
    """
    tasks = getattr(made, "TASKS", ())
    if tasks and datasheet.task not in tasks:
        raise ValueError(f"policy {name!r} is for {', '.join(tasks)}, not for {datasheet.task}")
    if not isinstance(made, type):
        if callable(made):
            return Function(made)
        raise ValueError(f"policy {name!r} is {made!r}: it has to be a class or a function")
    for method in ("reset", "act"):
        if not callable(getattr(made, method, None)):
            raise ValueError(f"policy {name!r}: class {made.__name__} lacks the method {method}")
    try:
        return made(datasheet, seed)
    except TypeError as error:
        raise ValueError(
            f"policy {name!r}: {made.__name__}(datasheet, seed) fails: {error}"
        ) from error


class Function:
    """A function ``act(observation) -> action`` as a policy."""

    def __init__(self, act: Callable[[np.ndarray], np.ndarray]):
        self.act = act

    def reset(self, observation: np.ndarray, info: dict[str, Any]) -> None:
        """A function remembers nothing."""


def from_file(name: str) -> Any:
    """What stands behind ``FILE.py:name``.

    Raises:
        ValueError: there is no such file or name, or the file cannot be run.
    """
    file, _, function = name.rpartition(":")
    return _load(name, Path(file), function)


def _load(name: str, path: Path, function: str) -> Callable[[np.ndarray], np.ndarray]:
    spec = importlib.util.spec_from_file_location(path.stem, path)
    if path.suffix != SUFFIX or not path.is_file() or spec is None or spec.loader is None:
        raise ValueError(f"policy {name!r}: there is no Python file {path}, write FILE.py:function")
    module = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    except Exception as error:
        raise ValueError(
            f"policy {name!r}: {path} fails: {type(error).__name__}: {error}"
        ) from error
    act = getattr(module, function, None)
    if not callable(act):
        functions = [n for n, value in vars(module).items() if callable(value) and n[0] != "_"]
        raise ValueError(
            f"policy {name!r}: {path} has no function {function!r}, "
            f"only {', '.join(functions) or 'none'}"
        )
    return act
