"""Loads the optional package scipy, of the extra ``servogym[tune]``."""

import importlib
from functools import cache
from types import ModuleType


@cache
def scipy(module: str) -> ModuleType:
    """Return a module of scipy. Raises ImportError with the command that installs it."""
    try:
        return importlib.import_module(f"scipy.{module}")
    except ImportError:
        raise ImportError("tune and bode need scipy: pip install 'servogym[tune]'") from None
