"""The packages that the mathematics needs: the extra ``servogym[tune]``."""

import importlib
from functools import cache
from types import ModuleType


@cache
def _package(name: str) -> ModuleType:
    try:
        return importlib.import_module(name)
    except ImportError:
        package = name.partition(".")[0]
        raise ImportError(f"tune and bode need {package}: pip install 'servogym[tune]'") from None


def control() -> ModuleType:
    """python-control. Raises ImportError with the command that installs it."""
    return _package("control")


def scipy(module: str) -> ModuleType:
    """A module of scipy. Raises ImportError with the command that installs it."""
    return _package(f"scipy.{module}")
