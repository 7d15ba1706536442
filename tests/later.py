"""Modules that are imported when a test first uses them.

Each worker collects all tests; so none of them loads the large libraries of tests it does not run.
"""

import importlib
from importlib.util import find_spec

import pytest


class Later:
    """A module, or something in it: ``PPO = Later("stable_baselines3", "PPO")``."""

    __slots__ = ("_module", "_name")

    def __init__(self, module, name=None):
        object.__setattr__(self, "_module", module)
        object.__setattr__(self, "_name", name)

    @property
    def __dict__(self):  # where monkeypatch looks for what it replaces
        return vars(self._found())

    def _found(self):
        module = importlib.import_module(self._module)
        return getattr(module, self._name) if self._name else module

    def __getattr__(self, name):
        if name.startswith(
            ("__", "_mock", "pytest")
        ):  # for which pytest asks everything it collects
            raise AttributeError(name)
        return getattr(self._found(), name)

    def __setattr__(self, name, value):
        setattr(self._found(), name, value)

    def __delattr__(self, name):
        delattr(self._found(), name)

    def __call__(self, *arguments, **named):
        return self._found()(*arguments, **named)

    def __getitem__(self, key):
        return self._found()[key]


def only_with(*modules, reason=""):
    """Skips the tests of a file where one of these is missing, without importing any."""
    missing = [name for name in modules if find_spec(name) is None]
    return pytest.mark.skipif(bool(missing), reason=reason or f"needs {', '.join(missing)}")
