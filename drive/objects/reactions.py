"""What a drive does about a fault where a master may choose it (2100h; CMMP-AS 5.18)."""

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


def reaction_code(drive: Device, main: int) -> int:
    """The reaction to faults of a main number: the one set, else the most severe one listed."""
    chosen = int(drive.axis.od.reaction_code[main])
    if chosen:
        return chosen - 1
    faults = [fault for fault in drive.model.faults if fault.main == main]
    return max((CODES[fault.reaction] for fault in faults), default=0)


def reaction_to(drive: Device, fault: Fault) -> Reaction:
    """What the drive does about one fault."""
    chosen = int(drive.axis.od.reaction_code[fault.main or 0])
    return REACTIONS[chosen - 1] if chosen else fault.reaction


def set_reaction(drive: Device, main: int, code: int) -> None:
    """Change the reaction to all faults of a main number, down to the least one allowed."""
    faults = [fault for fault in drive.model.faults if fault.main == main]
    least = max((CODES[fault.reaction] for fault in faults if not fault.changeable), default=0)
    code = max(code, least)
    drive.axis.od.reaction_code[main] = code + 1
    for fault in faults:
        if fault.cause != Cause.NONE:
            drive.axis.od.fault_reaction[fault.cause] = REACTIONS[code]
