"""A drive model made from an existing file: its folder, and a README about what was converted.

The reader of each kind of file (an EDS, a device description, an EEPROM, answers of a real drive)
fills in a `ModelFolder`; the folder is written here, as a whole or not at all.
"""

import csv
import json
import shutil
import tempfile
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any, NamedTuple

from .rows import OBJECT_COLUMNS

HEADING = "| line | object | the file says | used | reason |\n|---|---|---|---|---|\n"


@dataclass(frozen=True)
class PdoRow:
    """A row of pdo.csv: an entry of a PDO, or a PDO without entries."""

    direction: str  # rx, tx
    number: int
    cob_id: str
    transmission_type: int = 0
    inhibit_time: int = 0
    position: int | str = ""
    index: str = ""
    subindex: str = ""
    bits: int | str = ""
    note: str = ""
    section: str = ""


PDO_COLUMNS = tuple(column.name for column in fields(PdoRow))


class Repair(NamedTuple):
    """A statement of a file that could not be used as it is, and its replacement."""

    line: int  # of the file, 0: of no line
    where: str  # object or section
    says: str
    taken: str
    why: str

    def __str__(self) -> str:
        at = f"line {self.line}, " if self.line else ""
        return f"{at}{self.where}: {self.says}; used: {self.taken} ({self.why})"


@dataclass
class ModelFolder:
    """A model to be written."""

    title: str
    source: str  # name of the file, or of the drive that was asked
    command: str  # that makes it, as `servogym drives --from-eds`
    base: str = "generic"
    toml: dict[str, Any] = field(default_factory=dict)  # further keys of drive.toml
    objects: list[dict[str, Any]] = field(default_factory=list)  # rows of objects.csv
    pdos: list[PdoRow] | None = field(default_factory=list)  # None: those of the base
    more: dict[str, str] = field(default_factory=dict)  # further files, as ethercat.toml
    notes: list[str] = field(default_factory=list)  # sources of everything else, one line each
    repairs: list[Repair] = field(default_factory=list)
    unknown: list[str] = field(default_factory=list)  # objects that only store values
    left_out: list[str] = field(default_factory=list)

    def tell(self, line: int, where: str, says: object, taken: object, why: str) -> None:
        """Add a repair."""
        self.repairs.append(Repair(line, where, str(says), str(taken), why))


def check_place(folder: Path) -> None:
    """Refuse a folder that cannot be made.

    Raises:
        ValueError: it is not empty, or its parent folder does not exist.
    """
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise ValueError(f"{folder} exists already: choose a folder that is new or empty")
    if not folder.parent.is_dir():
        raise ValueError(f"{folder}: there is no folder {folder.parent}; make it first")


def write(made: ModelFolder, folder: Path, check: Callable[[Path], str]) -> None:
    """Write the folder of a model.

    Args:
        made: the model.
        folder: must not exist, or be empty.
        check: makes a drive of the folder and returns a section for the README; if it raises,
            nothing is left behind.

    Raises:
        ValueError: the folder cannot be made, or `check` refuses it.
    """
    check_place(folder)
    place = Path(tempfile.mkdtemp(dir=folder.parent, prefix=f".{folder.name}."))
    try:
        _table(place / "objects.csv", OBJECT_COLUMNS, made.objects)
        if made.pdos is not None:
            _table(place / "pdo.csv", PDO_COLUMNS, map(asdict, made.pdos))
        for name, text in made.more.items():
            (place / name).write_text(text, encoding="utf-8")
        (place / "drive.toml").write_text(_toml(made), encoding="utf-8")
        try:
            section = check(place)
            (place / "README.md").write_text(f"{readme(made)}\n{section}", encoding="utf-8")
        except ValueError as error:
            error.args = (str(error).replace(str(place), str(folder)),)
            raise
        if folder.exists():
            folder.rmdir()
        place.chmod(0o755)
        place.rename(folder)
    except BaseException:
        shutil.rmtree(place, ignore_errors=True)
        raise


def _table(path: Path, columns: Iterable[str], rows: Iterable[Mapping[str, Any]]) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, [*columns], restval="")
        writer.writeheader()
        writer.writerows(rows)


def _toml(made: ModelFolder) -> str:
    head = {"title": made.title, "based_on": made.base}
    plain = {key: value for key, value in made.toml.items() if not isinstance(value, dict)}
    lines = [f"# From {line(made.source)}; see README.md for what is inferred."]
    lines += [f"{key} = {json.dumps(value)}" for key, value in (head | plain).items()]
    for name, table in made.toml.items():
        if isinstance(table, dict) and table:
            lines += ["", f"[{name}]"]
            lines += [f"{key} = {json.dumps(value)}" for key, value in table.items()]
    return "\n".join(lines) + "\n"


def line(text: object, most: int = 120) -> str:
    """A text as one printable line."""
    return "".join(c for c in " ".join(str(text).split()) if c.isprintable())[:most]


def readme(made: ModelFolder) -> str:
    """The README of a model: its sources and all repairs."""

    def listed(items: list[str]) -> str:
        return "\n".join(f"- {item}" for item in items) or "- none"

    repairs = "\n".join(
        f"| {repair.line or ''} | " + " | ".join(_cell(text) for text in repair[1:]) + " |"
        for repair in made.repairs
    )
    return f"""# {line(made.title)}

Made from `{line(made.source)}` by `{made.command}`.

{listed(made.notes)}

## Repairs: statements of the file that could not be used as they stand

{HEADING + repairs if repairs else "- none"}

## Unknown: objects that store what is written to them and do nothing else

{listed(made.unknown)}

## Left out

{listed(made.left_out)}
"""


def _cell(text: str) -> str:
    return line(text, 200).replace("|", "\\|")
