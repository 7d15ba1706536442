"""Behaviour that comes with a model: programs in its folder or in an installed package.

A row of `KINDS` is a kind of behaviour: its file beside drive.toml, the dictionary in that file,
and the entry-point group for packages. The file is searched in the folder of the model and then in
that of the model it is based on. It runs only after consent (`run_code`); installing a package is
consent.
"""

import functools
import importlib.util
import zlib
from collections.abc import Iterator
from importlib import metadata
from pathlib import Path
from typing import Any, NamedTuple

from ..kernel.modes import own
from .model import DriveModel, load
from .uncompiled import telling


class Kind(NamedTuple):
    """The places where a kind of behaviour is found."""

    file: str
    attribute: str  # of the file: a dictionary by name
    entry_points: str


KINDS = {
    "Hook": Kind("hooks.py", "HOOKS", "servogym.hooks"),
    "ModeOfOperation": Kind("modes.py", "MODES", "servogym.modes"),
}
_consented: set[Path] = set()


def run_code(model: str | Path | DriveModel) -> None:
    """Consent to run the programs in the folder of a model, whose text you have read.

    Raises ValueError where there is no such model.
    """
    _consented.update(path for kind in KINDS.values() for path in _files(load(model), kind))


def _files(model: DriveModel, kind: Kind) -> Iterator[Path]:
    """The files of a kind in the folders of a model and of those it is based on."""
    folder: Path | None = model.folder
    while folder is not None:
        if (folder / kind.file).is_file():
            yield folder / kind.file
        folder = load(folder).based_on


@functools.cache
def plugin(model: DriveModel, wanted: type, name: str) -> tuple[Any, int]:
    """Behaviour of the class `wanted` by name, and a checksum of its program.

    Raises LookupError where there is none, ValueError without consent or for another class.
    """
    kind = KINDS[wanted.__name__]
    for file in _files(model, kind):
        if file not in _consented:
            raise ValueError(
                f"{file} is a program: read it, and consent with --run-code, in Python "
                f"with servogym.drive.run_code({str(model.folder)!r})"
            )
        found, number = _run(file, kind)
        if name in found:
            return _checked(found[name], wanted, f"{file}: {kind.attribute}[{name!r}]"), number
    for point in metadata.entry_points(group=kind.entry_points, name=name):
        where = f"the entry point {point.value}"
        try:
            loaded = point.load()
        except Exception as error:
            raise ValueError(f"{where} fails ({type(error).__name__}: {error})") from error
        return _checked(loaded, wanted, where), zlib.crc32(point.value.encode())
    raise LookupError(name)


@functools.cache
def _run(file: Path, kind: Kind) -> tuple[dict, int]:
    spec = importlib.util.spec_from_file_location(f"{file.stem} of {file.parent.name}", file)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
        return dict(getattr(module, kind.attribute)), zlib.crc32(file.read_bytes())
    except Exception as error:
        raise ValueError(f"{file} fails ({type(error).__name__}: {error})") from error


def _checked(found: object, wanted: type, where: str) -> Any:
    if not isinstance(found, wanted):
        raise ValueError(f"{where} is {found!r:.60}: it has to be a servogym {wanted.__name__}")
    return found


@functools.cache
def install_modes(model: DriveModel) -> int:
    """Compile the modes that the model defines; return their key, `own_modes` of a record.

    Raises ValueError with the place for a mode without a program, or one that does not compile.
    """
    modes, programs = {}, []
    for number, row in model.own_modes.items():
        where = f"{model.folder / 'drive.toml'}: modes.{row.name}"
        try:
            modes[number], program = plugin(model, own.ModeOfOperation, row.name)
        except LookupError:
            raise ValueError(
                f"{where}: there is no program: write MODES = {{{row.name!r}: "
                "ModeOfOperation(start, demand, status)} in modes.py beside it"
            ) from None
        except ValueError as error:
            raise ValueError(f"{where}: {error}") from None
        programs.append((number, row.name, program))
    key = 1 + zlib.crc32(repr(programs).encode()) if programs else 0
    for number, mode in modes.items():
        telling(mode.demand, own.install)(key, number, mode)
    return key
