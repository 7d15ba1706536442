"""Makes a drive model, a folder that every command accepts, from an EDS or DCF (CiA 306).

The file lists the objects with types, ranges, defaults and PDOs, but does not describe behaviour.
Objects that the profile defines behave as in the model `generic`; the others store what is written.
Anything that could not be used as it stands is a repair in the README of the folder.
"""

from dataclasses import dataclass
from pathlib import Path

from ..canopen.sheet import Sheet, read_sheet
from ..model.made import ModelFolder, Repair, check_place, line, write
from ..objects.abort import SdoAbort
from ..statements import data_sheet
from .can_pdos import default_pdos
from .dictionary import fill
from .rows import ObjectRows


@dataclass(frozen=True)
class Imported:
    """The result of an import."""

    folder: Path
    objects: int
    unknown: tuple[str, ...]  # objects that only keep what is written to them
    left_out: tuple[str, ...]
    repairs: tuple[Repair, ...]
    node_id: int | None  # of a DCF


def import_eds(eds: Path, folder: Path, *, strict: bool = False) -> Imported:
    """Make a drive model from an EDS or DCF.

    Args:
        eds: the file.
        folder: of the model; must not exist, or be empty.
        strict: refuse a file that needs a repair; for authors of EDS files.

    Raises:
        ValueError: the file is not an EDS of a CiA 402 drive, it needs repairs and `strict` forbids
            them, or the folder is not empty.
    """
    if not eds.exists():
        raise ValueError(f"{eds}: there is no such file")
    check_place(folder)
    sheet = read_sheet(eds)
    made = model_of(sheet)
    if strict and made.repairs:
        listed = "\n".join(f"{eds}, {repair}" for repair in made.repairs)
        raise ValueError(f"{listed}\n{eds}: {len(made.repairs)} departures from CiA 306 (--strict)")
    try:
        write(made, folder, data_sheet)
    except (SdoAbort, ValueError) as error:
        raise ValueError(f"{eds}: {error}") from None
    return Imported(
        folder, len(made.objects), tuple(made.unknown), tuple(made.left_out), tuple(made.repairs),
        sheet.node_id,
    )


def model_of(sheet: Sheet) -> ModelFolder:
    """The model that a sheet describes. Raises ValueError if it is not that of a CiA 402 drive."""
    title = line(sheet.text("DeviceInfo", "ProductName") or sheet.path.stem) or "drive"
    made = ModelFolder(title, sheet.path.name, "servogym drives --from-eds", repairs=sheet.repairs)
    objects = ObjectRows(sheet)
    fill(made, objects, lambda: default_pdos(objects))
    return made
