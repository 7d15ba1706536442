"""Controlword, statusword, states, modes and limits: bits by name, one table each.

Sources: CiA 402-2 / IEC 61800-7-201, device control (states, commands, statusword patterns) and
the mode chapters (bits 4-6, 8-9 of the controlword, 10, 12, 13 of the statusword).
"""

from collections.abc import Mapping
from enum import IntEnum
from typing import Any, NamedTuple


class State(IntEnum):
    """The eight states of the CiA 402 device control."""

    NOT_READY_TO_SWITCH_ON = 0
    SWITCH_ON_DISABLED = 1
    READY_TO_SWITCH_ON = 2
    SWITCHED_ON = 3
    OPERATION_ENABLED = 4
    QUICK_STOP_ACTIVE = 5
    FAULT_REACTION_ACTIVE = 6
    FAULT = 7


# statusword pattern: state -> (mask, value), bits 0-3, 5, 6
STATE_PATTERN = {
    State.NOT_READY_TO_SWITCH_ON: (0x4F, 0x00),
    State.SWITCH_ON_DISABLED: (0x4F, 0x40),
    State.READY_TO_SWITCH_ON: (0x6F, 0x21),
    State.SWITCHED_ON: (0x6F, 0x23),
    State.OPERATION_ENABLED: (0x6F, 0x27),
    State.QUICK_STOP_ACTIVE: (0x6F, 0x07),
    State.FAULT_REACTION_ACTIVE: (0x4F, 0x0F),
    State.FAULT: (0x4F, 0x08),
}


class Command(IntEnum):
    """Device control commands, in the order of their rows in the standard."""

    NONE = 0
    SHUTDOWN = 1
    SWITCH_ON = 2  # the same pattern is DISABLE_OPERATION in OPERATION_ENABLED
    ENABLE_OPERATION = 3
    DISABLE_VOLTAGE = 4
    QUICK_STOP = 5
    FAULT_RESET = 6


class Mode(IntEnum):
    """Modes of operation 6060h."""

    NONE = 0
    PROFILE_POSITION = 1
    VELOCITY = 2
    PROFILE_VELOCITY = 3
    PROFILE_TORQUE = 4
    HOMING = 6
    INTERPOLATED_POSITION = 7
    CYCLIC_SYNC_POSITION = 8
    CYCLIC_SYNC_VELOCITY = 9
    CYCLIC_SYNC_TORQUE = 10

    @classmethod
    def _missing_(cls, value: object) -> "Mode | None":
        """-1 to -16, of a drive model: `Mode(-3)` is ``MANUFACTURER_3``; none of the members."""
        if not isinstance(value, int) or not -16 <= value < 0:
            return None
        mode = int.__new__(cls, value)
        mode._name_, mode._value_ = f"MANUFACTURER_{-value}", value
        return cls._value2member_map_.setdefault(value, mode)  # type: ignore[return-value]


def mode_bit(mode: int) -> int:
    """Bit of a mode in 6502h: 0-15 the standard's, 16-31 the maker's, -1 first (inferred)."""
    return mode - 1 if mode > 0 else 15 - mode


class ModeWords(NamedTuple):
    """Names of a mode of operation and of its bits; empty names are those of unused bits."""

    name: str  # the standard's abbreviation, or the name in drive.toml
    bits: tuple[str, str, str] = ("", "", "")  # statusword bits 10, 12 and 13
    bit_4: str = ""  # of the controlword
    bits_5_6_9: tuple[str, str, str] = ("", "", "")  # of the controlword
    section: str = ""  # of the manual of a drive model that brings the mode


# mode chapters of CiA 402-2
MODE_WORDS = {
    Mode.NONE: ModeWords("-"),
    Mode.PROFILE_POSITION: ModeWords(
        "pp", ("target_reached", "set_point_acknowledge", "following_error"), "new_set_point",
        ("change_set_immediately", "relative", "change_on_set_point"),
    ),
    Mode.VELOCITY: ModeWords(
        "vl", ("target_reached", "", ""), "enable_ramp", ("unlock_ramp", "reference_ramp", "")
    ),
    Mode.PROFILE_VELOCITY: ModeWords(
        "pv", ("target_reached", "speed_is_zero", "max_slippage_error")
    ),
    Mode.PROFILE_TORQUE: ModeWords("tq", ("target_reached", "", "")),
    Mode.HOMING: ModeWords(
        "hm", ("target_reached", "homing_attained", "homing_error"), "homing_operation_start"
    ),
    Mode.INTERPOLATED_POSITION: ModeWords(
        "ip", ("target_reached", "ip_mode_active", ""), "enable_ip_mode"
    ),
    Mode.CYCLIC_SYNC_POSITION: ModeWords("csp", ("", "drive_follows_command", "following_error")),
    Mode.CYCLIC_SYNC_VELOCITY: ModeWords("csv", ("", "drive_follows_command", "")),
    Mode.CYCLIC_SYNC_TORQUE: ModeWords("cst", ("", "drive_follows_command", "")),
}
MODE_ABBREVIATION = {mode: words.name for mode, words in MODE_WORDS.items()}


OwnModes = Mapping[int, ModeWords]  # modes that a drive model brings, by number
NONE_OWN: OwnModes = {}


class Controlword(IntEnum):
    """Bit masks of 6040h."""

    SWITCH_ON = 0x0001
    ENABLE_VOLTAGE = 0x0002
    QUICK_STOP = 0x0004  # 0 stops
    ENABLE_OPERATION = 0x0008
    NEW_SET_POINT = 0x0010  # pp; start of homing in hm, enable ip in ip, enable ramp in vl
    CHANGE_SET_IMMEDIATELY = 0x0020  # pp; unlock ramp in vl
    RELATIVE = 0x0040  # pp; reference ramp in vl
    FAULT_RESET = 0x0080
    HALT = 0x0100
    CHANGE_ON_SET_POINT = 0x0200  # pp


class Statusword(IntEnum):
    """Bit masks of 6041h."""

    READY_TO_SWITCH_ON = 0x0001
    SWITCHED_ON = 0x0002
    OPERATION_ENABLED = 0x0004
    FAULT = 0x0008
    VOLTAGE_ENABLED = 0x0010
    QUICK_STOP = 0x0020  # 0 = quick stop is active
    SWITCH_ON_DISABLED = 0x0040
    WARNING = 0x0080
    MANUFACTURER_8 = 0x0100
    REMOTE = 0x0200
    TARGET_REACHED = 0x0400
    INTERNAL_LIMIT_ACTIVE = 0x0800
    MODE_12 = 0x1000
    MODE_13 = 0x2000
    MANUFACTURER_14 = 0x4000
    MANUFACTURER_15 = 0x8000


class Limit(IntEnum):
    """Why statusword bit 11 is set: bits of `AXIS.limits` and of object 2011h."""

    TORQUE = 0x01
    SPEED = 0x02
    SOFTWARE_POSITION_MIN = 0x04
    SOFTWARE_POSITION_MAX = 0x08
    NEGATIVE_LIMIT_SWITCH = 0x10
    POSITIVE_LIMIT_SWITCH = 0x20
    I2T = 0x40
    VELOCITY_AMOUNT = 0x80  # vl velocity min max amount 6046h
    VOLTAGE = 0x100  # the DC link drives no more current against the speed


class Latched(IntEnum):
    """How process data came since the last position cycle: `AXIS.sync`."""

    NOT = 0
    CYCLIC = 1  # with SYNC or a frame of process data: the next ones are due a period later
    ALONE = 2  # by an RPDO that acts when it comes (types 254, 255): no next one is due


class SetPointSource(IntEnum):
    """What the ramp of the velocity mode follows: `AXIS.od.vl_setpoint_source`."""

    BUS = 0  # 6042h
    INTERNAL = 1
    SUM = 2


class Compatibility(IntEnum):
    """Bits of 6510h:F0h, Festo CMMP-AS 5.2 and Metronix ARS 2000 6.2."""

    HOMING_METHOD_SCHEME = 0x05  # bits 0 and 2 mirror each other
    RESPONSE_AFTER_SAVE = 0x10
    HOMING_TO_ZERO = 0x40
    DEVICE_CONTROL = 0x80


class ManufacturerStatus(IntEnum):
    """Bits of 2000h:01, Festo CMMP-AS 6.1.5."""

    IS_REFERENCED = 0x1
    COMMUTATION_VALID = 0x2
    READY_FOR_ENABLE = 0x4


STATE_BITS = 0x6F  # of the statusword: the state, see `STATE_PATTERN`
COMMAND_BITS = 0x0F  # of the controlword: the command, see `COMMANDS`

_STATUSWORD = {bit: bit.name.lower() for bit in Statusword}
_CONTROLWORD = {bit: bit.name.lower() for bit in Controlword}


def command_of(controlword: int) -> Command:
    """The device control command in bits 0-3 of a controlword (without the fault reset edge)."""
    return Command(COMMANDS[controlword & COMMAND_BITS])


def state_of(statusword: int) -> State | None:
    """The state a statusword shows, None where it fits no pattern of the standard."""
    for state, (mask, value) in STATE_PATTERN.items():
        if statusword & mask == value:
            return state
    return None


def mode_words(mode: int, own: OwnModes = NONE_OWN) -> ModeWords:
    """Names of a mode and of its bits; `own` are the modes that the drive model brings."""
    return own.get(mode) or MODE_WORDS.get(mode) or ModeWords(f"{mode:.0f}")  # type: ignore


def statusword_names(mode: int, own: OwnModes = NONE_OWN) -> dict[Statusword, str]:
    """Names of the statusword's bits in `mode` (6061h); `own` as in `mode_words`."""
    bits = Statusword.TARGET_REACHED, Statusword.MODE_12, Statusword.MODE_13
    return _STATUSWORD | dict(zip(bits, mode_words(mode, own).bits, strict=True))


def controlword_names(mode: int, own: OwnModes = NONE_OWN) -> dict[Controlword, str]:
    """Names of the controlword's bits in `mode` (6060h); `own` as in `mode_words`."""
    words, bits = mode_words(mode, own), (
        Controlword.NEW_SET_POINT, Controlword.CHANGE_SET_IMMEDIATELY, Controlword.RELATIVE,
        Controlword.CHANGE_ON_SET_POINT,
    )
    return _CONTROLWORD | dict(zip(bits, (words.bit_4, *words.bits_5_6_9), strict=True))


def _set_bits(word: int, names: Mapping[Any, str], pattern: int) -> list[str]:
    """Names of the bits that are set in a word outside of a pattern."""
    return [
        name or f"bit_{bit.bit_length() - 1}"
        for bit, name in names.items() if word & bit & ~pattern
    ]


def decode_statusword(statusword: int, mode: int = 0, own: OwnModes = NONE_OWN) -> list[str]:
    """Names of what a statusword says: the state first, then every set bit outside the pattern.

    Bits 10, 12 and 13 have their names in `mode` (6061h); `own` as in `mode_words`.
    """
    state = state_of(statusword)
    return [
        state.name if state is not None else "INVALID",
        *_set_bits(statusword, statusword_names(mode, own), STATE_BITS),
    ]


def decode_controlword(controlword: int, mode: int = 0, own: OwnModes = NONE_OWN) -> list[str]:
    """Names of what a controlword asks for: the command first, then every further set bit."""
    further = _set_bits(controlword, controlword_names(mode, own), COMMAND_BITS)
    return [command_of(controlword).name, *further]


def _command(bits: int) -> Command:
    if not bits & Controlword.ENABLE_VOLTAGE:
        return Command.DISABLE_VOLTAGE
    if not bits & Controlword.QUICK_STOP:
        return Command.QUICK_STOP
    if not bits & Controlword.SWITCH_ON:
        return Command.SHUTDOWN
    return Command.ENABLE_OPERATION if bits & Controlword.ENABLE_OPERATION else Command.SWITCH_ON


COMMANDS = tuple(int(_command(bits)) for bits in range(16))  # by controlword bits 0-3

# ---- what a master sends

SHUTDOWN = Controlword.ENABLE_VOLTAGE | Controlword.QUICK_STOP
SWITCHED_ON = SHUTDOWN | Controlword.SWITCH_ON
ENABLED = SWITCHED_ON | Controlword.ENABLE_OPERATION

# the next controlword on the way to operation enabled, by state
TO_ENABLED = {
    State.NOT_READY_TO_SWITCH_ON: 0,
    State.SWITCH_ON_DISABLED: SHUTDOWN,
    State.READY_TO_SWITCH_ON: SWITCHED_ON,
    State.SWITCHED_ON: ENABLED,
    State.OPERATION_ENABLED: ENABLED,
    State.QUICK_STOP_ACTIVE: 0,  # disable voltage, then from the beginning
    State.FAULT_REACTION_ACTIVE: 0,
    State.FAULT: 0,
}
