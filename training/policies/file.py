"""A policy of the user's own: a class or a function, in a file or behind an entry point."""

import importlib.util
import inspect
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from ...envs.engine.checks import error_line, misfit
from .datasheet import Datasheet

SUFFIX = ".py"


def policy_of(name: str, made: Any, datasheet: Datasheet, seed: int) -> Any:
    """Make a policy from the content of a file or an entry point.

    Args:
        name: of the policy.
        made: a class, called with ``(datasheet, seed)``, whose objects have ``reset`` and ``act``;
            or a function ``act(observation) -> action``. ``TASKS`` of a class may list its tasks.
        datasheet: of the environment.
        seed: seed of the policy's random numbers.

    Raises:
        ValueError: it is neither, or is made for other tasks.
    """
    tasks = getattr(made, "TASKS", ())
    if tasks and datasheet.task not in tasks:
        raise ValueError(f"policy {name!r} is for {', '.join(tasks)}, not for {datasheet.task}")
    if not isinstance(made, type):
        if callable(made):
            _takes(name, made, "observation")
            return Own(name, Function(made), datasheet.actions)
        raise ValueError(f"policy {name!r} is {made!r}: it has to be a class or a function")
    for method in ("reset", "act"):
        if not callable(getattr(made, method, None)):
            raise ValueError(f"policy {name!r}: class {made.__name__} lacks the method {method}")
    _takes(name, made, "datasheet", "seed")
    _takes(name, vars(made).get("reset"), "self", "observation", "info")
    _takes(name, vars(made).get("act"), "self", "observation")
    try:
        return Own(name, made(datasheet, seed), datasheet.actions)
    except Exception as error:
        raise ValueError(
            f"policy {name!r}: {made.__name__}(datasheet, seed) fails: {error_line(error)}"
        ) from error


def _takes(name: str, function: Any, *arguments: str) -> None:
    """Raise ValueError if a user's function does not accept the arguments it will get."""
    if isinstance(function, staticmethod | classmethod) or not callable(function):
        return  # inherited, or of a kind of its own: it tells by itself
    if inspect.iscoroutinefunction(function) or inspect.isgeneratorfunction(function):
        raise ValueError(
            f"policy {name!r}: {function.__name__} is a coroutine or a generator, give a function "
            "that returns the action"
        )
    if why := misfit(function, *arguments):
        given = ", ".join(each for each in arguments if each != "self")
        raise ValueError(
            f"policy {name!r}: {function.__name__} is called with ({given}), which it does not "
            f"take: {why}"
        )


class Own:
    """A policy of the user's own: its errors name file and line, its actions are numbers."""

    def __init__(self, name: str, policy: Any, actions: int):
        self._name, self._policy, self._actions = name, policy, actions

    def reset(self, observation: np.ndarray, info: dict[str, Any]) -> None:
        """Begin an episode."""
        self._called("reset", observation, info)

    def act(self, observation: np.ndarray) -> np.ndarray:
        """Return the action. Raises ValueError unless it consists of finite numbers."""
        action = self._called("act", observation)
        try:
            with np.errstate(over="ignore"):  # what is too large is told below
                numbers = np.asarray(action, np.float32)
        except (TypeError, ValueError):
            numbers = np.array([np.nan])
        if numbers.shape != (self._actions,) or not np.isfinite(numbers).all():
            raise ValueError(
                f"policy {self._name!r}: act gave {action!r}, an action is an array of finite "
                f"numbers -1..1, {self._actions} of them in this environment"
            )
        return numbers

    def _called(self, method: str, *arguments: Any) -> Any:
        try:
            return getattr(self._policy, method)(*arguments)
        except (Exception, SystemExit) as error:
            raise ValueError(f"policy {self._name!r}, {method}: {error_line(error)}") from error


class Function:
    """A function ``act(observation) -> action`` as a policy."""

    def __init__(self, act: Callable[[np.ndarray], np.ndarray]):
        self.act = act

    def reset(self, observation: np.ndarray, info: dict[str, Any]) -> None:
        """Do nothing, because a function has no memory."""


def from_file(name: str) -> Any:
    """Load the object named by ``FILE.py:name``.

    Raises:
        ValueError: there is no such file or name, or the file cannot be run.
    """
    file, colon, function = name.rpartition(":")
    if not colon:
        given = name if name.endswith(SUFFIX) else f"FILE{SUFFIX}"
        raise ValueError(f"policy {name!r}: which of its functions? Write {given}:function")
    return _load(name, Path(file), function)


def _load(name: str, path: Path, function: str) -> Callable[[np.ndarray], np.ndarray]:
    spec = importlib.util.spec_from_file_location(path.stem, path)
    if path.suffix != SUFFIX or not path.is_file() or spec is None or spec.loader is None:
        raise ValueError(f"policy {name!r}: there is no Python file {path}, write FILE.py:function")
    module = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    except Exception as error:
        raise ValueError(f"policy {name!r}: {path} fails: {error_line(error)}") from error
    act = getattr(module, function, None)
    if not callable(act):
        functions = [n for n, value in vars(module).items() if callable(value) and n[0] != "_"]
        raise ValueError(
            f"policy {name!r}: {path} has no function {function!r}, "
            f"only {', '.join(functions) or 'none'}"
        )
    return act
