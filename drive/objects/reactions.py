"""Reactions to faults that a master may choose (2100h; CMMP-AS 5.18).

Each fault, by main and sub-number, has a default, a least reaction, and a choice or none (CMMP-AS
B.2, B.3). 2100h has the main number only: a write acts on each of its faults, limited to the least
reaction of that fault; a read returns the reaction of sub-number 0, which 6510h:22h, :37h and :38h
choose as well (inferred).
"""

from collections.abc import Iterable

from ..kernel.faults import Cause, Reaction
from ..model.rows import Fault
from .device import Device

# reaction codes of 2100h:02 as the kernel's reactions; the manual prints no mapping (inferred)
REACTIONS = {
    0: Reaction.IGNORE,  # no action
    1: Reaction.IGNORE,  # entry in the buffer only, which no object shows
    3: Reaction.WARNING,
    5: Reaction.QUICK_STOP,  # controller enable off
    7: Reaction.CURRENT_LIMIT,  # brake with maximum current
    8: Reaction.DISABLE,  # power stage off
}
CODES = {reaction: code for code, reaction in REACTIONS.items() if code != 1}
CODES[Reaction.OPTION_CODE] = 5


def of(drive: Device, main: int, sub: int | None = None) -> list[Fault]:
    """The faults of a main number, or the one with the sub-number `sub`."""
    return [f for f in drive.model.faults if f.main == main and sub in (None, f.sub or 0)]


def reaction_code(drive: Device, fault: Fault) -> int:
    """The code of the reaction to a fault: the one set, otherwise the one listed."""
    code = int(drive.axis.od.reaction_code[fault.row])
    return code - 1 if code else CODES[fault.reaction]


def reaction_to(drive: Device, fault: Fault) -> Reaction:
    """The reaction of the drive to a fault."""
    return REACTIONS[reaction_code(drive, fault)] if chosen(drive, fault) else fault.reaction


def chosen(drive: Device, fault: Fault) -> bool:
    """Whether a master has chosen the reaction to a fault."""
    return bool(drive.axis.od.reaction_code[fault.row])


def set_reaction(drive: Device, faults: Iterable[Fault], code: int) -> None:
    """Change the reaction to faults, limited to the least one of each."""
    for fault in faults:
        real = code if fault.changeable else max(code, CODES[fault.reaction])
        drive.axis.od.reaction_code[fault.row] = real + 1
        if fault.cause != Cause.NONE:
            drive.axis.od.fault_reaction[fault.cause] = REACTIONS[real]
