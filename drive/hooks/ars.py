"""Objects of the ARS family (Metronix ARS 2000, Festo CMMP-AS, CMMS, CMMD) that do something.

Fault management 2100h and the objects that are views on it (CMMP-AS 5.4, 5.5, 5.7, 5.18), limits
of the factor group (5.3), compatibility bits (5.2), the lock on 60C1h (7.4.2), set position (5.7).
"""

from typing import TYPE_CHECKING

from ..abort import Abort
from ..factors import FRACTION_LIMIT, reduced
from ..faults import Cause, Reaction
from ..words import Compatibility
from .hook import Hook

if TYPE_CHECKING:
    from ..drive import Drive
    from ..objects import ObjectDictionary
    from ..rows import Fault, Object

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
LARGEST_FACTOR = 1 << 24
# objects that loading the defaults leaves alone (CMMP-AS 5.5, ARS 2000 6.5.2)
KEPT = ("pole_number", "encoder_offset_angle")
UNDERVOLTAGE, FOLLOWING_ERROR, I2T = 2, 17, 31  # main fault numbers


def reaction_code(drive: "Drive", main: int) -> int:
    """The reaction to faults of a main number: the one set, else the most severe one listed."""
    chosen = int(drive.axis.od.reaction_code[main])
    if chosen:
        return chosen - 1
    faults = [fault for fault in drive.model.faults if fault.main == main]
    return max((CODES[fault.reaction] for fault in faults), default=0)


def reaction_to(drive: "Drive", fault: "Fault") -> Reaction:
    """What the drive does about one fault."""
    chosen = int(drive.axis.od.reaction_code[fault.main or 0])
    return REACTIONS[chosen - 1] if chosen else fault.reaction


def set_reaction(drive: "Drive", main: int, code: int) -> None:
    """Change the reaction to all faults of a main number, down to the least one allowed."""
    faults = [fault for fault in drive.model.faults if fault.main == main]
    least = max((CODES[fault.reaction] for fault in faults if not fault.changeable), default=0)
    code = max(code, least)
    drive.axis.od.reaction_code[main] = code + 1
    for fault in faults:
        if fault.cause != Cause.NONE:
            drive.axis.od.fault_reaction[fault.cause] = REACTIONS[code]


def _error_reaction(od: "ObjectDictionary", row: "Object", value: int) -> Abort:
    if value not in REACTIONS:
        return Abort.INVALID_VALUE
    set_reaction(od.drive, int(od.names["error_number"].get()), value)
    return Abort.STORED


def _error_reaction_now(od: "ObjectDictionary", row: "Object") -> int:
    return reaction_code(od.drive, int(od.names["error_number"].get()))


def _switch(main: int) -> Hook:
    """0 makes fault `main` a warning, 1 lets it take the controller enable away."""

    def write(od: "ObjectDictionary", row: "Object", value: int) -> Abort:
        set_reaction(od.drive, main, 5 if value else 3)
        return Abort.STORED

    def read(od: "ObjectDictionary", row: "Object") -> int:
        fault = next(f for f in od.drive.model.faults if (f.main, f.sub or 0) == (main, 0))
        return int(CODES[reaction_to(od.drive, fault)] >= 5)

    return Hook(write, read)


def _position_error_limit(od: "ObjectDictionary", row: "Object", value: int) -> Abort:
    set_reaction(od.drive, FOLLOWING_ERROR, 8 if value else 0)
    return Abort.NONE


def _position_error_limit_now(od: "ObjectDictionary", row: "Object") -> int:
    if reaction_code(od.drive, FOLLOWING_ERROR) != 8:
        return 0
    return int(od.drive.axis.od.position_error_limit)


def _older_factor(od: "ObjectDictionary", row: "Object", value: int) -> Abort:
    """6093h, 6094h: numerator / divisor is at most 2^24, and has to stay computable."""
    if value == 0:
        return Abort.VALUE_TOO_LOW
    parts = [int(od.slots[row.index, subindex].get()) for subindex in (1, 2)]
    parts[row.subindex - 1] = value
    numerator, divisor = parts
    if row.index != 0x6097 and numerator > LARGEST_FACTOR * divisor:
        return Abort.INTERNAL_INCOMPATIBLE
    if row.index == 0x6093 and max(_position_fraction(od, *parts)) > FRACTION_LIMIT:
        return Abort.INTERNAL_INCOMPATIBLE
    return Abort.NONE


def _position_fraction(od: "ObjectDictionary", numerator: int, divisor: int) -> tuple[int, int]:
    increments, turns = (int(v) for v in od.drive.axis.od.position_encoder_resolution)
    a, b = reduced(65536 * turns, increments)
    a, c = reduced(a, numerator)
    d, b = reduced(divisor, b)
    d, c = reduced(d, c)
    return a * d, b * c


def _compatibility(od: "ObjectDictionary", row: "Object", value: int) -> Abort:
    """Bits 0 and 2 mirror each other: setting one sets the other."""
    scheme = Compatibility.HOMING_METHOD_SCHEME
    od.drive.axis.od.compatibility_control = value | scheme if value & scheme else value
    return Abort.STORED


def _ip_data(od: "ObjectDictionary", row: "Object", value: int) -> Abort:
    """60C1h is locked until 60C4h:06 gives access."""
    return Abort.NONE if od.drive.axis.od.interpolation_buffer_clear else Abort.DEVICE_STATE


def _set_position(od: "ObjectDictionary", row: "Object", value: int) -> Abort:
    od.drive.axis.set_position_wanted = 1
    return Abort.NONE


HOOKS = {
    "error_reaction": Hook(_error_reaction, _error_reaction_now),
    "undervoltage_error": _switch(UNDERVOLTAGE),
    "i2t_error": _switch(I2T),
    "position_error_limit": Hook(_position_error_limit, _position_error_limit_now),
    "older_factor": Hook(_older_factor),
    "compatibility": Hook(_compatibility),
    "ip_data": Hook(_ip_data),
    "set_position": Hook(_set_position),
}
