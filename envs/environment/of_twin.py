"""A task on a twin, a machine identified from a log by `servogym twin`."""

from pathlib import Path
from typing import Any

from ...drive.model.model import DriveModel
from ..plants.twins import Twin, read
from ..variation.randomisation import KNOBS

FROM = "twin"  # instead of ranges: the intervals of the identified parameters


def found(task: Any, twin: str | Path | None, drive: str | Path | DriveModel) -> tuple[Any, Any]:
    """Use the plant of a twin for the task; -> the twin (None without one) and the drive.

    Raises ValueError for a folder without a twin, another kind of machine or another drive.
    """
    if twin is None:
        return None, drive
    identified = read(twin)
    plant = identified.datasheet()
    if plant is None or type(task.datasheet) is not type(plant):
        raise ValueError(
            f"twin = {str(twin)!r} is a {identified.builder}, which is not the machine of "
            f"{type(task).__name__}"
        )
    name = getattr(drive, "name", drive)
    if name not in ("generic", identified.drive):
        raise ValueError(f"drive = {name!r}: the twin's is {identified.drive!r}, leave it out")
    task.datasheet = plant
    return identified, identified.drive if name == "generic" else drive


def ranges(given: Any, twin: Twin | None) -> Any:
    """Return the ranges to draw from. Raises ValueError for ``"twin"`` without a twin."""
    if given != FROM:
        return given
    if twin is None:
        raise ValueError('randomise = "twin" needs a twin: give its folder too, twin=FOLDER')
    inside = {
        name: (max(low, KNOBS[name].low), min(high, KNOBS[name].high))
        for name, (low, high) in twin.ranges.items()
    }
    return {name: (low, high) for name, (low, high) in inside.items() if low <= high}
