"""Results as a page (Markdown), data (JSON and CSV) and a picture (PNG).

The bytes are the same every time: nothing in them depends on when or how fast they were computed.
"""

import csv
import io
import json
import os
import platform
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib.metadata import version
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

PACKAGES = ("servogym", "mujoco", "gymnasium", "numpy", "numba", "ruckig")
ROUNDING = 1e-12  # in any unit: a smaller value is a rounding error and counts as 0
INK = "#1f5fa8"
GRID: Any = {"alpha": 0.3, "lw": 0.6}  # of every picture


def origin(command: str) -> dict[str, Any]:
    """The command, the machine and the versions, for the head of every file of results."""
    return {
        "command": command,
        "machine": f"{platform.system()} {platform.machine()}, {os.cpu_count()} cores",
        "python": platform.python_version(),
        **{package: version(package) for package in PACKAGES},
    }


def unseen(share: float) -> None:
    """Ignore the progress."""


@contextmanager
def progress(console: Console | None, what: str, total: float) -> Iterator[Callable[[float], None]]:
    """Show a progress bar with the remaining time, if the console is a terminal.

    Yields a function that adds a share of `total` to the progress.
    """
    if console is None or not console.is_terminal:
        yield unseen
        return
    with Progress(*Progress.get_default_columns(), console=console, transient=True) as bar:
        row = bar.add_task(what, total=total)
        yield lambda share: bar.advance(row, share)


def interrupted(error: BaseException | None) -> bool:
    """Whether Ctrl-C has caused an error: while a file is closed, it appears as another error."""
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__context__
    return error is not None


def writable(option: str, path: Path, *, file: bool) -> None:
    """Refuse a path that cannot be written, before anything is computed for it.

    Args:
        option: the option that contains the path.
        path: path of a file or folder, which need not exist yet.
        file: whether it is a file.

    Raises ValueError with the obstacle.
    """
    place = path.parent if file else path
    if file and path.is_dir():
        raise ValueError(f"{option} {path} is a folder: name a file in it")
    while not place.exists() and place != place.parent:
        place = place.parent
    if not place.is_dir():
        raise ValueError(f"{option} {path}: {place} is a file, no folder; give another path")
    if not os.access(path if file and path.exists() else place, os.W_OK):
        raise ValueError(f"{option} {path} cannot be written: no permission for {place}")


def kept_folder(out: Path | None, name: str, file: str, command: str) -> Path:
    """Return the folder for the results of `command`, so that it overwrites no other results.

    Args:
        out: folder given by the user; by default a folder in ``out``, numbered if necessary.
        name: name of that folder.
        file: name of the JSON file with the results and their command.
        command: the present command; it may overwrite its own results, which are the same again.

    Raises ValueError if `out` contains the results of another command.
    """
    if out is not None:
        if (other := _made_by(out / file)) not in ("", command):
            raise ValueError(
                f"--out {out} has the results of `{other}`: give another folder, or remove them"
            )
        return out
    numbered = (Path("out", f"{name}-{n}" if n > 1 else name) for n in count(1))
    return next(folder for folder in numbered if _made_by(folder / file) in ("", command))


def _made_by(file: Path) -> str:
    """The command that has written a file of results; empty if there is no such file."""
    if not file.exists():
        return ""
    try:
        return str(json.loads(file.read_text(encoding="utf-8"))["command"])
    except (OSError, ValueError, KeyError, TypeError):
        return f"something else ({file.name})"


def number(value: float, digits: int = 3) -> str:
    """Format a number with some significant digits; a dash for NaN and infinity."""
    if not np.isfinite(value):
        return "–"
    if abs(value) < ROUNDING:
        return "0"
    if abs(value) < 1e-4:
        return f"{value:.{digits - 1}e}"
    places = max(digits - 1 - int(np.floor(np.log10(abs(value)))), 0)
    return f"{value:.{places}f}"


def table(heading: Sequence[str], rows: Iterable[Sequence[str]], title: str) -> Table:
    """A table for the terminal."""
    shown = Table(*heading, title=title)
    for row in rows:
        shown.add_row(*row)
    return shown


def markdown(heading: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A Markdown table with text in its first column and numbers in the others."""
    lines = [heading, ["---", *["---:"] * (len(heading) - 1)], *rows]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def write_page(path: Path, title: str, table: str, source: Mapping[str, Any], notes: str) -> None:
    """Write a page with a title, a table, notes, and the command that made it."""
    parts = [f"{name} {source[name]}" for name in ("python", *PACKAGES)]
    text = f"# {title}\n\n{table}\n{notes}\n\n```sh\n{source['command']}\n```\n\n"
    text += f"{', '.join(parts)}; {source['machine']}\n"
    write_text(path, text)


def write_json(path: Path, values: Mapping[str, Any]) -> None:
    """Write values as JSON; NaN and infinity become null."""

    def clean(value: Any) -> Any:
        if isinstance(value, Mapping):
            return {name: clean(inner) for name, inner in value.items()}
        if isinstance(value, list | tuple | np.ndarray):
            return [clean(inner) for inner in value]
        if isinstance(value, float | np.floating):
            return float(value) if np.isfinite(value) else None
        return value

    write_text(path, json.dumps(clean(values), indent=1, ensure_ascii=False) + "\n")


def write_csv(path: Path, source: Mapping[str, Any], rows: Sequence[Mapping[str, Any]]) -> None:
    """Write rows with equal keys; comments at the top say how the file was made."""
    file = io.StringIO(newline="")
    file.writelines(f"# {name}: {value}\n" for name, value in source.items())
    writer = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    write_text(path, file.getvalue())


def write_text(path: Path, text: str) -> None:
    """Write text as `write_bytes` writes bytes."""
    write_bytes(path, text.encode())


def write_bytes(path: Path, data: bytes) -> None:
    """Write a file completely or not at all: on a full disk, the old file remains."""
    path.parent.mkdir(parents=True, exist_ok=True)
    scratch = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        scratch.write_bytes(data)
        scratch.replace(path)
    except OSError as error:
        scratch.unlink(missing_ok=True)
        raise type(error)(f"{path} cannot be written: {error.strerror or error}") from None
