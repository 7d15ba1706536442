"""A policy from a Python file of the user's: ``FILE.py:function``."""

import importlib.util
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

SUFFIX = ".py"


class Function:
    """A function ``act(observation) -> action`` as a policy.

    Raises:
        ValueError: there is no such file or function, or the file cannot be run.
    """

    def __init__(self, name: str):
        file, _, function = name.rpartition(":")
        self.act = _load(name, Path(file), function)

    def reset(self, observation: np.ndarray, info: dict[str, Any]) -> None:
        """A function remembers nothing."""


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
