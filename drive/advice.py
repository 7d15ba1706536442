"""What keeps a drive from obeying, as far as its statusword tells."""

from .words import Command, Statusword, command_of, decode_controlword, decode_statusword

# what has to be there for a command to be obeyed (CiA 402-2, transitions 2-16)
OBEYED = {
    Command.SHUTDOWN: "it is obeyed in SWITCH_ON_DISABLED, SWITCHED_ON and OPERATION_ENABLED",
    Command.SWITCH_ON: "it is obeyed in READY_TO_SWITCH_ON: send shutdown (0006h) first",
    Command.ENABLE_OPERATION: "it is obeyed in READY_TO_SWITCH_ON and SWITCHED_ON (and in "
    "QUICK_STOP_ACTIVE with 605Ah = 5..8): send shutdown (0006h), then switch on (0007h) first",
    Command.DISABLE_VOLTAGE: "the power stage is already off",
    Command.QUICK_STOP: "there is nothing to stop",
    Command.FAULT_RESET: "it is obeyed in FAULT, when the cause of the fault is gone",
}

# whatever the command: statusword mask, value, next step
HINDRANCES = (
    (Statusword.REMOTE, 0, "remote (bit 9) is 0: the drive is under local control, release it"),
    (
        Statusword.VOLTAGE_ENABLED,
        0,
        "voltage_enabled (bit 4) is 0: switch on the power, allow torque (STO)",
    ),
    (
        Statusword.INTERNAL_LIMIT_ACTIVE,
        Statusword.INTERNAL_LIMIT_ACTIVE,
        "internal_limit_active (bit 11): look for a limit switch or a limit of 607Dh, 6072h, 607Fh",
    ),
)


def describe(statusword: int, mode: int) -> str:
    """The statusword by name."""
    return f"{statusword:04X}h {' '.join(decode_statusword(statusword, mode))}"


def situation(statusword: int, controlword: int, mode: int) -> str:
    """What the drive shows and what it was last told."""
    told = " ".join(decode_controlword(controlword, mode))
    return f"statusword {describe(statusword, mode)}; last controlword {controlword:04X}h {told}"


def advice(statusword: int, controlword: int) -> str:
    """The next step where a drive does not do what the controlword says."""
    hindrances = [text for mask, value, text in HINDRANCES if statusword & mask == value]
    command = command_of(controlword)
    needed = f"{command.name}: {OBEYED[command]}; else look for a missing enable input (60FDh)"
    return "; ".join(hindrances) or needed
