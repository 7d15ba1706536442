"""Completes a drive model from a dictionary: objects, units, PDOs, modes and homing methods."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from ..canopen.sheet import Sheet
from ..kernel.words import MODE_ABBREVIATION, Mode, mode_bit
from ..model.made import ModelFolder, PdoRow
from .can_pdos import limit_mappable
from .rows import FEED, NEEDED, PERIOD, ObjectRows
from .units import fit_factors, fit_period

MOST = 1 << 16  # objects
# modes by the objects that a master needs for them, where 6502h has no value (inferred)
NEEDS = {
    Mode.PROFILE_POSITION: (0x607A, 0x6081), Mode.VELOCITY: (0x6042,),
    Mode.PROFILE_VELOCITY: (0x60FF,), Mode.PROFILE_TORQUE: (0x6071,), Mode.HOMING: (0x6098,),
    Mode.INTERPOLATED_POSITION: (0x60C1,), Mode.CYCLIC_SYNC_POSITION: (0x607A, PERIOD),
    Mode.CYCLIC_SYNC_VELOCITY: (0x60FF, PERIOD), Mode.CYCLIC_SYNC_TORQUE: (0x6071, PERIOD),
}
_SUPPORTED_MODES, _SUPPORTED_METHODS, _MODE_OF_OPERATION = 0x6502, 0x60E3, 0x6060
# set-point in an RPDO -> mode (inferred)
_SET_POINTS = {0x607A: Mode.CYCLIC_SYNC_POSITION, 0x60FF: Mode.CYCLIC_SYNC_VELOCITY,
               0x6071: Mode.CYCLIC_SYNC_TORQUE}


def fill(
    made: ModelFolder, objects: ObjectRows, pdos: Callable[[], list[PdoRow]],
    needs: Mapping[Mode, Iterable[int]] = NEEDS,
) -> None:
    """Fill in a model from the sheet of `objects`.

    Args:
        made: the model; its repairs are those of the sheet.
        objects: the rows, none of which is made yet.
        pdos: makes the rows of the PDOs as soon as those of the objects are there.
        needs: the objects of each mode.

    Raises:
        ValueError: it is not the dictionary of a CiA 402 drive, or it has too many objects.
    """
    sheet = objects.sheet
    _check(sheet)
    for entry in sheet.entries.values():
        objects.take(entry)
    fixed: dict[str, Any] = {}
    in_rpm = fit_factors(objects, fixed)
    fit_period(objects)
    made.pdos = pdos()
    limit_mappable(objects, made.pdos)
    made.objects = objects.sorted
    capabilities, modes_from, methods_from = _capabilities(objects, made.pdos, fixed, needs)
    made.toml = {
        "buses": ["can"], "without": sorted({f"{index:04X}h" for index, _ in objects.base.objects}),
        "fixed": fixed, "capabilities": capabilities,
    }
    made.unknown, made.left_out = objects.unknown, objects.left_out
    units = (
        "those of 608Fh, 6091h and 6092h" if (FEED, 1) in objects.rows else
        "a position unit is an increment of the encoder (`inferred`), since 6092h is missing"
    )
    velocity = " Velocities are in 1/min (60A9h)." if in_rpm else ""
    made.notes = [
        "An EDS or ESI file lists objects, types, ranges, defaults and PDOs. It does not describe "
        "behaviour: objects that CiA 402 defines behave as in the model `generic` (`inferred`).",
        "Cycle times, motor and faults: `inferred`, those of `generic`. Correct them in "
        "`drive.toml`.",
        f"Modes of operation: {modes_from}. Homing methods: {methods_from}.",
        f"Units: {units}.{velocity} Gains, and which manufacturer-specific objects 1010h stores: "
        "`inferred`.",
    ]
    if sheet.node_id is not None:
        made.notes.append(
            f"The file is the DCF of node {sheet.node_id}: defaults are its values. Serve it with "
            f"`--node-id {sheet.node_id}`."
        )
    made.repairs.sort(key=lambda repair: repair.line)


def _check(sheet: Sheet) -> None:
    """Refuse a dictionary without the objects of a CiA 402 drive."""
    for index in NEEDED:
        if (index, 0) not in sheet.entries or sheet.entries[index, 0].kind != "VAR":
            listed = any(repair.where == f"{index:04X}h" for repair in sheet.repairs)
            reason = (
                "is listed, but has no section: is the file complete?" if listed else
                "is missing: it is not the EDS of a CiA 402 drive"
            )
            last = max((entry.line for entry in sheet.entries.values()), default=1)
            raise ValueError(f"{sheet.path}, line {last}: {index:04X}h {reason}")
    if len(sheet.entries) > MOST:
        raise ValueError(f"{sheet.path}: {len(sheet.entries)} objects, at most {MOST}")


def _capabilities(
    objects: ObjectRows, pdos: Iterable[PdoRow], fixed: dict[str, Any],
    needs: Mapping[Mode, Iterable[int]],
) -> tuple[dict[str, Any], str, str]:
    """The table `[capabilities]`, and where modes and methods come from."""
    bits = objects.stated(_SUPPORTED_MODES, 0) or 0
    standard = [mode for mode in objects.base.modes if mode > 0]
    modes = [mode for mode in standard if bits >> mode_bit(mode) & 1]
    modes_from = "those of 6502h"
    if not modes:
        modes_from = "those whose objects exist (`inferred`), since 6502h has no default"
        indices = {index for index, _ in objects.rows}
        modes = [mode for mode in standard if indices.issuperset(needs.get(mode, ()))]
    stated = {objects.stated(_SUPPORTED_METHODS, n) for n in range(1, 255)}
    methods = [method for method in objects.base.homing_methods if method in stated]
    methods_from = "those of 60E3h" if methods else (
        "those of `generic` (`inferred`), since 60E3h names none")
    if (mode := _only_mode(objects, pdos, fixed, modes)) is not None:
        modes = sorted({*modes, mode})
    table: dict[str, Any] = {}
    if modes:
        table["modes"] = [MODE_ABBREVIATION[mode] for mode in modes]
    if methods:
        table["homing_methods"] = methods
    return table, modes_from, methods_from


def _only_mode(
    objects: ObjectRows, pdos: Iterable[PdoRow], fixed: dict[str, Any], modes: Sequence[int]
) -> Mode | None:
    """The mode of a drive whose 6060h cannot be written, from the set-point in its RPDOs."""
    row = objects.rows.get((_MODE_OF_OPERATION, 0))
    if row is not None and row["access"] not in ("ro", "const"):
        return None
    mapped = {int(pdo.index, 0) for pdo in pdos if pdo.direction == "rx" and pdo.index}
    mode = next((mode for index, mode in _SET_POINTS.items() if index in mapped), None)
    if mode is not None and row is None:
        objects.sheet.tell(0, "6060h", "missing", str(int(mode)), "its PDO has this set-point")
        fixed["modes_of_operation"] = int(mode)
        return mode
    if mode is None or row is None or int(row["default"]) in modes:
        return None
    objects.replace_default(_MODE_OF_OPERATION, 0, int(mode),
                            "it is read-only, and its PDO has this set-point")
    return mode
