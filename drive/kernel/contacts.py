"""What starts the drive: the controlword, contacts at its terminals, or both.

`AXIS.od.command_source` chooses. Frequency inverters are started by contacts: S1 enables, S2 starts
clockwise, S3 anticlockwise, S8 resets a fault (the meaning of the start and reset contacts is
inferred; Bonfiglioli ACT, CANopen manual, chapter 9).
"""

from enum import IntEnum

from .jit import block
from .record import Axis
from .words import Command, Controlword, State


class Source(IntEnum):
    """What starts and stops the drive and resets its faults."""

    CONTROLWORD = 0  # as in CiA 402; contacts have no effect
    CONTROLWORD_AND_CONTACTS = 1  # the controlword, while S1 and a start contact are closed
    CONTACTS = 2  # the terminals alone
    REMOTE_CONTACTS = 3  # the controlword's bits 0-7 are the contacts, with the terminal S1
    NOTHING = 4


S1, S2, S3, S8 = 0x01, 0x02, 0x04, 0x80
START = S2 | S3


@block
def in_use(axis: Axis):
    """Whether contacts have an effect."""
    return axis.od.command_source != Source.CONTROLWORD


@block
def alone(axis: Axis):
    """Whether the controlword is not a command of the state machine."""
    return axis.od.command_source > Source.CONTROLWORD_AND_CONTACTS


@block
def closed(axis: Axis):
    """The contacts in force: terminals, or the controlword with the hardware's S1."""
    source = axis.od.command_source
    if source == Source.REMOTE_CONTACTS:
        return int(axis.od.controlword) & 0xFF & (0xFE | (int(axis.terminals) & S1))
    if source == Source.NOTHING:
        return 0
    return int(axis.terminals)


@block
def enabled(axis: Axis):
    """Whether S1 and a start contact are closed."""
    now = closed(axis)
    return now & S1 and now & START


@block
def command(axis: Axis, asked):
    """The command that replaces that of the controlword, one transition at a time."""
    axis.contacts = axis.terminals
    if axis.od.command_source == Source.REMOTE_CONTACTS:
        axis.contacts = closed(axis)
    axis.reverse = 1 if alone(axis) and closed(axis) & START == S3 else 0
    if not alone(axis) and asked != Command.ENABLE_OPERATION:
        return asked
    if axis.state == State.SWITCH_ON_DISABLED:
        return Command.SHUTDOWN
    if axis.state == State.READY_TO_SWITCH_ON or not enabled(axis):
        return Command.SWITCH_ON
    return Command.ENABLE_OPERATION


@block
def blocked(axis: Axis):
    """Whether S1 is open, which blocks the power stage at any time: the motor coasts."""
    return not closed(axis) & S1


@block
def reset_bit(axis: Axis):
    """The fault reset: bit 7 of the controlword, or of the contacts."""
    if alone(axis):
        return 1 if closed(axis) & S8 else 0
    return 1 if int(axis.od.controlword) & Controlword.FAULT_RESET else 0


@block
def remote(axis: Axis):
    """Statusword bit 9: the bus may start the drive."""
    if axis.od.command_source == Source.CONTROLWORD_AND_CONTACTS:
        return enabled(axis)
    return axis.od.command_source == Source.REMOTE_CONTACTS and axis.terminals & S1
