"""What a drive model states, and whether its drive does so: a data sheet that is checked.

Each row of an object, a fault, a mode and a homing method is a statement with a source: a section
of the manual or of a standard, somebody's file, an observation, or an inference. What a statement
says is tried on a drive of the model: read, written in and out of its range, injected.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from .drive import Drive
from .kernel.faults import Cause, Reaction
from .kernel.record import OD
from .kernel.words import State
from .model.model import DriveModel, load
from .model.rows import Object
from .objects.abort import Abort, SdoAbort

KINDS = ("manual or standard", "file", "observed", "inferred", "without a source")
FILES = ("EDS", "EtherCAT")  # sections of rows that were made from a file
METHODS = range(-36, 41)
NUMBERS = range(-10, 12)
BEYOND = (Abort.VALUE_TOO_LOW, Abort.VALUE_TOO_HIGH, Abort.INVALID_VALUE, Abort.DEVICE_STATE)
POWER_UP = (0x06, 0x07, 0x0F)
CYCLES = 400  # until a fault has been reacted to, or a state is reached
VENDOR = OD.fields["vendor"][1]  # type: ignore[index]


class Statement(NamedTuple):
    """What is stated, from where, and what came of trying it."""

    text: str
    kind: str
    wrong: str | None  # "": it holds; None: it cannot be tried


def kind_of(section: str, note: str = "") -> str:
    """Where a row comes from."""
    if "inferred" in section or "inferred" in note:
        return "inferred"
    if section.startswith("observed"):
        return "observed"
    if section in FILES:
        return "file"
    return "manual or standard" if section else "without a source"


def statements(model: str | Path | DriveModel) -> Iterator[Statement]:
    """The statements of a model, each tried. Raises ValueError for what is not a model."""
    drive = Drive(model)
    for row in drive.model.objects.values():
        yield Statement(
            f"{row.index:04X}h:{row.subindex:02X}h {row.name}", kind_of(row.section, row.note),
            _object(drive, row),
        )
    yield from _choices(drive)
    for fault in drive.model.faults:
        yield Statement(
            f"fault {fault.name} {fault.code:04X}h {fault.meaning}".replace("  ", " "),
            kind_of(fault.section), _fault(drive.model, fault),
        )


def _answer(drive: Drive, row: Object, value: int | float) -> Abort:
    if row.format:
        return drive.objects.write(row.index, row.subindex, row.code.pack(value))
    return drive.objects.write(row.index, row.subindex, b"x")


def _object(drive: Drive, row: Object) -> str | None:
    """Access, default, length and range; "" where all of them are as the row says."""
    data, abort = drive.objects.read(row.index, row.subindex)
    if row.access == "wo":
        if abort is not Abort.WRITE_ONLY:
            return "it can be read"
    elif abort not in (Abort.NONE, Abort.NO_DATA):
        return None if row.hook else f"reading it is refused: {abort.name}"
    elif abort is Abort.NONE and row.format and len(data) != row.size:
        return f"{len(data)} bytes are read"
    if row.access in ("ro", "const"):
        code = _answer(drive, row, 0)
        return "" if code is Abort.READ_ONLY else f"a write is answered by {code.name}"
    computed = bool(row.hook) or row.when or not row.format or row.area in ("rpdo", "tpdo")
    if computed or row.real:
        return None if computed else ""
    if row.access == "rw" and abort is Abort.NONE and not row.per_node:
        value = row.code.unpack(data)[0]
        live = row.offset < VENDOR and row.area == "axis" and "rx" in row.pdo
        if value != row.default and not live:
            return f"it is {value} at power-on, not {row.default}"
    for beyond in (row.minimum - 1, row.maximum + 1):
        try:
            row.pack(int(beyond))
        except ValueError:  # the type ends there
            continue
        code = _answer(drive, row, int(beyond))
        if code not in BEYOND:
            return f"{beyond:.0f} is answered by {code.name}"
    return ""


def _choices(drive: Drive) -> Iterator[Statement]:
    """Modes of operation and homing methods: those there are, and no others."""
    model = drive.model
    modes, methods = {int(mode) for mode in model.modes}, set(model.homing_methods)
    for name, listed, tried in (
        ("modes_of_operation", modes, NUMBERS), ("homing_method", methods, METHODS)
    ):
        row = model.names.get(name)
        if row is None or row.access not in ("rw", "wo"):
            continue
        for number in tried:
            if number == 0 or not row.minimum <= number <= row.maximum:
                continue
            taken = _answer(drive, row, number) is Abort.NONE
            drive.cycle(0.0)
            # without its hook an object takes what it is sent; older numbers stand for newer ones
            free = row.hook not in ("mode", "homing_method") or (
                name == "homing_method" and model.quirk("old_homing_numbers")
            )
            right = taken if number in listed else (not taken or free)
            wrong = "" if right else f"{'taken' if taken else 'refused'}"
            if number in listed or wrong:
                yield Statement(f"{name} {number}", kind_of(row.section, row.note), wrong)


def _fault(model: DriveModel, fault) -> str | None:
    """Whether its cause leads to its code and reaction."""
    if not fault.cause or fault.reaction < Reaction.OPTION_CODE:
        return None
    if next(f for f in model.faults if f.cause == fault.cause) is not fault:
        return None  # the first row of a cause is the one that comes
    drive = Drive(model)
    for word in POWER_UP:
        try:
            drive.write("controlword", word)
        except SdoAbort:
            return None
        for _ in range(CYCLES):
            drive.cycle(0.0)
    if drive.state is not State.OPERATION_ENABLED:
        return None  # it needs more than controlwords to be enabled
    try:
        drive.inject(Cause(fault.cause))
    except ValueError:
        return None
    for _ in range(CYCLES):
        drive.cycle(0.0)
    if drive.state is State.OPERATION_ENABLED:
        return "the drive goes on"
    code = int(drive.axis.od.error_code)
    return "" if code == fault.code else f"603Fh is {code:04X}h"


def data_sheet(model: str | Path | DriveModel) -> str:
    """The statements of a model by source, how many were tried and how many hold (Markdown)."""
    found = [*statements(load(model))]
    lines = ["| source | statements | tried | hold |", "|---|---|---|---|"]
    for kind in KINDS:
        of = [statement for statement in found if statement.kind == kind]
        tried = [statement for statement in of if statement.wrong is not None]
        held = [statement for statement in tried if not statement.wrong]
        if of:
            lines.append(f"| {kind} | {len(of)} | {len(tried)} | {len(held)} |")
    wrong = [f"- {s.text}: {s.wrong}" for s in found if s.wrong]
    return "\n".join(["## Data sheet", "", *lines, *(["", *wrong] if wrong else [])]) + "\n"
