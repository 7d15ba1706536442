"""What a drive does about a fault where a master may choose it (2100h; CMMP-AS 5.18).

Default, least reaction and whether there is a choice belong to each fault, to main and sub-number
(CMMP-AS B.2, B.3). 2100h names the main number only: what is written there acts on each of its
faults, down to the least reaction of that fault; what is read is that of sub-number 0, the one that
6510h:22h, :37h and :38h choose as well (inferred).
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
    """The faults of a main number, or the one of them that `sub` names."""
    return [f for f in drive.model.faults if f.main == main and sub in (None, f.sub or 0)]


def reaction_code(drive: Device, fault: Fault) -> int:
    """The code of the reaction to one fault: the one set, else the one listed."""
    code = int(drive.axis.od.reaction_code[fault.row])
    return code - 1 if code else CODES[fault.reaction]


def reaction_to(drive: Device, fault: Fault) -> Reaction:
    """What the drive does about one fault."""
    return REACTIONS[reaction_code(drive, fault)] if chosen(drive, fault) else fault.reaction


def chosen(drive: Device, fault: Fault) -> bool:
    """Whether a master has chosen the reaction to a fault."""
    return bool(drive.axis.od.reaction_code[fault.row])


def set_reaction(drive: Device, faults: Iterable[Fault], code: int) -> None:
    """Change the reaction to faults, down to the least one of each."""
    for fault in faults:
        real = code if fault.changeable else max(code, CODES[fault.reaction])
        drive.axis.od.reaction_code[fault.row] = real + 1
        if fault.cause != Cause.NONE:
            drive.axis.od.fault_reaction[fault.cause] = REACTIONS[real]
