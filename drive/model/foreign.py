"""Files from elsewhere: read as data that has a form. Nothing in them is run.

A policy, a submission, a drive model, a parameter file or a kept result may have come from anybody.
Each is a plain file of a bounded size (`files`), text or arrays without pickles, with the keys that
its form has and the checksum that it brings. Only a person lets a program in such a file run, with
``--run-code``.
"""

import hashlib
import io
import json
import tomllib
import zipfile
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from .files import content
from .names import hint

LARGEST_ARRAYS = 256 * 2**20  # of arrays, unpacked
DEEPEST = 64  # tables in one another


class Key(NamedTuple):
    """What a file may say under a name."""

    kinds: type | tuple[type, ...]
    needed: bool = False


def text(path: Path, what: str = "such a file") -> str:
    """The text of a file in UTF-8. Raises as `content` does, and ValueError naming a wrong line."""
    data = content(path, what)
    try:
        return data.decode()
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise ValueError(
            f"{path.name}, line {line} ({path.parent.name}): the byte {data[error.start]:02X}h is "
            "no UTF-8: save the file as UTF-8"
        ) from None


def table(path: Path, keys: Mapping[str, Key] | None = None) -> dict[str, Any]:
    """What a JSON or TOML file says; with `keys` nothing else than these.

    Raises as `text` does, and ValueError where it is damaged or has another form.
    """
    return parsed(text(path), str(path), keys)


def parsed(text: str | bytes, where: str, keys: Mapping[str, Key] | None = None) -> dict[str, Any]:
    """Parse text: TOML if the name `where` ends in .toml, otherwise JSON."""
    try:
        decoded = text if isinstance(text, str) else text.decode()
        found = tomllib.loads(decoded) if where.endswith(".toml") else json.loads(decoded)
    except (ValueError, RecursionError) as error:  # both kinds of syntax errors are ValueErrors
        raise ValueError(f"{where} is damaged: {error}") from None
    if not isinstance(found, dict):
        raise ValueError(f"{where} is damaged: a table of names and values is expected")
    _depth(found, where)
    return found if keys is None else checked(found, where, keys)


def _depth(found: Any, where: str, level: int = 0) -> None:
    if level > DEEPEST:
        raise ValueError(f"{where} is damaged: more than {DEEPEST} tables in one another")
    for value in found.values() if isinstance(found, dict) else found:
        if isinstance(value, dict | list):
            _depth(value, where, level + 1)


def checked(found: Mapping[str, Any], where: str, keys: Mapping[str, Key]) -> dict[str, Any]:
    """`found`, if it has what is needed, of the right kinds, and nothing else.

    Raises ValueError naming the key, with near ones for an unknown one.
    """
    for name, value in found.items():
        if name not in keys:
            raise ValueError(f"{where}: {name!r} is unknown: {hint(name, keys)}")
        kinds = keys[name].kinds
        kinds = kinds if isinstance(kinds, tuple) else (kinds,)
        if type(value) not in kinds and not (type(value) is int and float in kinds):
            wanted = " or ".join("nothing" if k is type(None) else k.__name__ for k in kinds)
            raise ValueError(f"{where}: {name} = {_short(value)} has to be a {wanted}")
    if missing := [name for name, key in keys.items() if key.needed and name not in found]:
        raise ValueError(f"{where} lacks {', '.join(missing)}")
    return dict(found)


def arrays(
    source: Path | bytes, largest: int = LARGEST_ARRAYS, where: str = ""
) -> dict[str, np.ndarray]:
    """The arrays of an npz file, by name, at most `largest` bytes unpacked; nothing is unpickled.

    Raises ValueError where it is no such file, damaged, or larger.
    """
    where = where or (str(source) if isinstance(source, Path) else "this archive")
    try:
        data = content(source, where, largest) if isinstance(source, Path) else source
        with zipfile.ZipFile(io.BytesIO(data)) as packed:
            if sum(entry.file_size for entry in packed.infolist()) > largest:
                raise ValueError(f"it is larger than {largest} bytes")
        with np.load(io.BytesIO(data), allow_pickle=False) as found:
            return {name: found[name] for name in found.files}
    except Exception as error:  # a damaged archive raises anything: zlib's, struct's, NumPy's
        raise ValueError(f"{where} holds no arrays that can be read: {error}") from None


def digest(parts: Iterable[tuple[str, bytes]]) -> str:
    """SHA-256 of names and contents, in hexadecimal digits: what a file is known by."""
    found = hashlib.sha256()
    for name, data in parts:
        found.update(f"{name} {len(data)}\n".encode() + data)
    return found.hexdigest()


def intact(where: str, data: bytes, stated: str) -> None:
    """Raise ValueError where the SHA-256 of `data` is another than `told`."""
    if (found := hashlib.sha256(data).hexdigest()) != stated:
        raise ValueError(
            f"{where} was changed or damaged: its SHA-256 is {found[:16]}…, not {stated[:16]}…"
        )


def consent(program: str, allowed: bool) -> None:
    """Raise ValueError where a program came with a file and nobody said that it may run."""
    if not allowed:
        raise ValueError(f"{program} is a program: read it, and say --run-code to run it")


def _short(value: Any) -> str:
    shown = repr(value)
    return shown if len(shown) <= 60 else f"{shown[:57]}..."
