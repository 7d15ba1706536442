"""Parameter storage 1010h/1011h: one small file, replaced as a whole or not at all.

The file is JSON: model, revision, values by object address, and a checksum over them. A file that
is truncated, altered or of another model is named in a warning and ignored; the drive then starts
with its factory defaults, never with half of a set.
"""

import json
import os
import tempfile
import warnings
import zlib
from pathlib import Path

Values = dict[str, int | float]


def _checksum(model: str, values: Values) -> int:
    return zlib.crc32(json.dumps([model, values], sort_keys=True).encode())


def save(path: Path, model: str, values: Values) -> None:
    """Write a parameter set; a process killed in the middle leaves the old file. Raises OSError."""
    content = {"model": model, "values": values, "crc32": _checksum(model, values)}
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=path.name, suffix=".tmp")
    try:
        with os.fdopen(handle, "w", encoding="utf-8") as file:
            json.dump(content, file, indent=1)
            file.flush()
            os.fsync(file.fileno())
        os.replace(name, path)
    except BaseException:
        Path(name).unlink(missing_ok=True)
        raise


def load(path: Path, model: str) -> Values:
    """The values of a parameter file, empty if there is none or it cannot be trusted."""
    if not path.exists():
        return {}
    reason = ""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        values = content["values"]
        if content["model"] != model:
            reason = f"it belongs to the model {content['model']!r}, not {model!r}"
        elif content["crc32"] != _checksum(model, values):
            reason = "its checksum does not match"
        elif not all(isinstance(v, int | float) for v in values.values()):
            reason = "it holds something other than numbers"
        else:
            return values
    except (ValueError, KeyError, TypeError, AttributeError, OSError) as error:
        reason = f"it cannot be read ({type(error).__name__}: {error})"
    warnings.warn(
        f"parameter file {path} is ignored, the drive starts with factory defaults: {reason}; "
        "store the parameters again (1010h) to replace it",
        stacklevel=2,
    )
    return {}
