"""Parameter storage 1010h/1011h: one small file, replaced as a whole or not at all.

The file is JSON with a format version, the model, values by object address with their ranges, and a
checksum. A file that is truncated, altered, of another model, or contains impossible values is
named in a warning and ignored; the drive then starts with its factory defaults, never with half of
a set.
"""

import contextlib
import glob
import json
import os
import tempfile
import warnings
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

from ..model.files import content

Values = dict[str, int | float]
Ranges = dict[str, list[int]]
VERSION = 2  # of the file format
SUFFIX = ".tmp"
LEFT_OVER = 60.0  # s; an older temporary file is from a process that was killed


def _checksum(values: dict[str, Any]) -> int:
    return zlib.crc32(json.dumps(values, sort_keys=True).encode())


def encode(model: str, values: Values, ranges: Ranges | None = None) -> str:
    """The text of a parameter file; `ranges` are those of the values."""
    content = {"version": VERSION, "model": model, "values": values, "ranges": ranges or {}}
    return json.dumps(content | {"crc32": _checksum(content)}, indent=1)


def decode(text: str, model: str, check: Callable[[str, int | float], str] | None = None) -> Values:
    """The values of the text of a parameter file. Raises ValueError if it cannot be trusted.

    `check` returns why the drive cannot have a value at an address, or an empty text.
    """
    try:
        content = json.loads(text)
        if not isinstance(content, dict):
            raise ValueError("it is not a table of parameters")
        if content["model"] != model:
            raise ValueError(f"it belongs to the model {content['model']!r}, not {model!r}")
        if content.get("version") != VERSION:
            raise ValueError(f"it has the form {content.get('version')!r}, not {VERSION}")
        if content.pop("crc32") != _checksum(content):
            raise ValueError("its checksum does not match")
        values, ranges = content["values"], content["ranges"]
        for address, value in values.items():
            if isinstance(value, bool) or not isinstance(value, int | float):
                raise ValueError(f"{address} = {value!r} is not a number")
            wrong = check(address, value) if check else ""
            if wrong:
                then = ranges.get(address)
                then = f" ({then[0]}..{then[1]} when it was stored)" if then else ""
                raise ValueError(f"{address} = {value} {wrong}{then}")
    except (LookupError, TypeError, AttributeError, RecursionError, json.JSONDecodeError) as error:
        reason = f"it lacks {error}" if isinstance(error, LookupError) else str(error)
        raise ValueError(f"it cannot be read ({reason})") from None
    return values


def save(path: Path, model: str, values: Values, ranges: Ranges | None = None) -> None:
    """Write a parameter set; a process killed in the middle leaves the old file. Raises OSError."""
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=path.name, suffix=SUFFIX)
    try:
        with os.fdopen(handle, "w", encoding="utf-8") as file:
            file.write(encode(model, values, ranges))
            file.flush()
            os.fsync(file.fileno())
            now = os.fstat(file.fileno()).st_mtime
        os.replace(name, path)
        clean(path, now)
    except BaseException:
        Path(name).unlink(missing_ok=True)
        raise


def clean(path: Path, now: float) -> None:
    """Remove old temporary files of killed processes beside a parameter file; `now` in s."""
    for left in path.parent.glob(f"{glob.escape(path.name)}*{SUFFIX}"):
        with contextlib.suppress(OSError):
            if now - left.stat().st_mtime > LEFT_OVER:
                left.unlink()


def read(path: Path, model: str, check: Callable[[str, int | float], str] | None = None) -> Values:
    """The values of a parameter file, empty if there is none.

    Raises ValueError with the reason if it cannot be trusted.
    """
    try:
        return decode(content(path, "a parameter file").decode(), model, check)
    except FileNotFoundError:
        return {}
    except UnicodeDecodeError:
        raise ValueError("it is not a text") from None
    except OSError as error:
        raise ValueError(f"it cannot be read ({error})") from None
    except ValueError as error:
        raise ValueError(str(error).replace(f"{path} ", "it ", 1)) from None


def load(path: Path, model: str, check: Callable[[str, int | float], str] | None = None) -> Values:
    """The values that a drive loads at power-on; none, and a warning, if they are not reliable."""
    try:
        return read(path, model, check)
    except ValueError as error:
        ignored(path, str(error))
    return {}


def ignored(path: Path, reason: str) -> None:
    """Warn that a parameter file is not used."""
    warnings.warn(
        f"parameter file {path} is ignored, the drive starts with factory defaults: {reason}; "
        "store the parameters again (1010h) to replace it",
        stacklevel=3,
    )
