"""A frequency inverter's ways to be started: contacts, remote contacts, or the state machine.

Source: Bonfiglioli ACT, CANopen manual, chapter 9. Parameter 412 (`AXIS.od.local_remote`) chooses:
0 the terminals S1IND-S8IND, 1 the controlword as a state machine, 2 the controlword as contacts.
S1IND enables, S2IND starts clockwise, S3IND anticlockwise, S8IND resets a fault (the meaning of the
start and reset contacts is inferred). Any other value, as the factory's 44, starts nothing.
Transition 5 follows parameter 392: coast, DC brake, or ramp.
"""

from enum import IntEnum

from .jit import block
from .stop import Stop
from .words import Command, Controlword, State, Statusword


class Source(IntEnum):
    """Who starts and stops: parameter 412."""

    CONTACTS = 0
    STATE_MACHINE = 1
    REMOTE_CONTACTS = 2


S1, S2, S3, S8 = 0x01, 0x02, 0x04, 0x80
START = S2 | S3
TRANSITION_5 = (int(Stop.NONE), int(Stop.CURRENT_LIMIT), int(Stop.SLOW_DOWN_RAMP))  # parameter 392
DC_BRAKE = 1


@block
def contacts(axis):
    """The contacts in force: terminals, or the controlword with the hardware's S1IND."""
    source = axis.od.local_remote
    if source == Source.CONTACTS:
        return int(axis.terminals)
    if source == Source.REMOTE_CONTACTS:
        return int(axis.od.controlword) & 0xFF & (0xFE | (int(axis.terminals) & S1))
    return 0


@block
def enabled(axis):
    """Whether the hardware lets the state machine enable: S1IND and one of S2IND and S3IND."""
    return axis.terminals & S1 and axis.terminals & START


@block
def command(axis, asked):
    """The command that counts instead of the controlword's."""
    axis.contacts = axis.terminals
    if axis.od.local_remote == Source.REMOTE_CONTACTS:
        axis.contacts = contacts(axis)
    if axis.od.local_remote == Source.STATE_MACHINE:
        if asked != Command.ENABLE_OPERATION:
            return asked
        go = enabled(axis)
    else:
        closed = contacts(axis)
        go = closed & S1 and closed & START
        axis.reverse = 1 if closed & START == S3 else 0
    if axis.state == State.SWITCH_ON_DISABLED:
        return Command.SHUTDOWN
    if axis.state == State.READY_TO_SWITCH_ON or not go:
        return Command.SWITCH_ON
    return Command.ENABLE_OPERATION


@block
def blocked(axis):
    """Whether S1IND is gone, which blocks the power stage at any time: the motor coasts."""
    if axis.od.local_remote == Source.STATE_MACHINE:
        return not axis.terminals & S1
    return not contacts(axis) & S1


@block
def reset_bit(axis):
    """The fault reset: bit 7 of the controlword, or of the contacts."""
    if axis.od.local_remote == Source.STATE_MACHINE:
        return 1 if int(axis.od.controlword) & Controlword.FAULT_RESET else 0
    return 1 if contacts(axis) & S8 else 0


@block
def statusword(axis, word):
    """9.1-9.3: what the statusword has of its own; the contact modes know three states only."""
    if axis.od.local_remote == Source.STATE_MACHINE:
        if enabled(axis):
            word |= Statusword.REMOTE
    elif axis.od.local_remote == Source.REMOTE_CONTACTS and axis.terminals & S1:
        word |= Statusword.REMOTE
    return word
