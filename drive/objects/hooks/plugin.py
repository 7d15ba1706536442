"""Behaviour that comes with a model: hooks in its folder, or in an installed package.

``hooks.py`` in a model's folder, or in that of a model it is based on, has a dictionary ``HOOKS``
of `Hook` by name, which the column ``hook`` of objects.csv refers to. It is a program, and run only
after consent: `run_code`. A package declares a hook by an entry point of the group
``servogym.hooks``; to install it was consent.
"""

import functools
import importlib.util
from collections.abc import Iterator
from importlib import metadata
from pathlib import Path

from ...model.model import DriveModel, load
from .hook import Hook

FILE = "hooks.py"
ENTRY_POINTS = "servogym.hooks"
_consented: set[Path] = set()


def run_code(model: str | Path | DriveModel) -> None:
    """Consent to run ``hooks.py`` in the folder of a model, whose text you have read.

    Raises ValueError where there is no such model.
    """
    _consented.update(_folders(load(model)))


def _folders(model: DriveModel) -> Iterator[Path]:
    """The folder of a model and those it is based on, where they bring hooks."""
    folder: Path | None = model.folder
    while folder is not None:
        if (folder / FILE).is_file():
            yield folder
        folder = load(folder).based_on


@functools.cache
def foreign_hook(model: DriveModel, name: str) -> Hook:
    """The hook of this name that a model's folder or a package brings.

    Raises LookupError where there is none, ValueError without consent or for what is not a hook.
    """
    for folder in _folders(model):
        if folder not in _consented:
            raise ValueError(
                f"{folder / FILE} is a program: read it, and consent with --run-code, in Python "
                f"with servogym.drive.run_code({str(folder)!r})"
            )
        if name in (hooks := _hooks(folder)):
            return _checked(hooks[name], f"{folder / FILE}: HOOKS[{name!r}]")
    for point in metadata.entry_points(group=ENTRY_POINTS, name=name):
        where = f"the entry point {point.value}"
        try:
            found = point.load()
        except Exception as error:
            raise ValueError(f"{where} fails ({type(error).__name__}: {error})") from error
        return _checked(found, where)
    raise LookupError(name)


@functools.cache
def _hooks(folder: Path) -> dict:
    spec = importlib.util.spec_from_file_location(f"hooks of {folder.name}", folder / FILE)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
        return dict(module.HOOKS)
    except Exception as error:
        raise ValueError(f"{folder / FILE} fails ({type(error).__name__}: {error})") from error


def _checked(found: object, where: str) -> Hook:
    if not isinstance(found, Hook):
        raise ValueError(f"{where} is {found!r:.60}: it has to be a servogym Hook")
    return found
