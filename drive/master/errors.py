"""Errors of a master.

::

    ServoError
     +-- NoPower (RuntimeError)       a motion was commanded, or under way, on a drive without power
     +-- DriveFault (RuntimeError)    a drive has a fault
     +-- HomingFailed (RuntimeError)  a drive did not find its home position
     +-- Interlock (RuntimeError)     the caller's own supervision gave an alarm; all drives stopped
     +-- Refused (ValueError)         a command cannot be carried out; the drive did not move
     +-- Timeout (TimeoutError)       an awaited status did not come in time
     +-- BusError (ConnectionError)   the bus takes no frames, or two nodes answer to one node-id
"""

from typing import NamedTuple

from .. import advice
from ..kernel.words import State, state_of


class Status(NamedTuple):
    """The status of a drive, and the last command sent to it."""

    axis: str
    statusword: int
    controlword: int
    mode: int

    @property
    def state(self) -> State | None:
        """State of the device control, None where the statusword fits no pattern."""
        return state_of(self.statusword)

    def __str__(self) -> str:
        """In words."""
        said = advice.situation(self.statusword, self.controlword, self.mode)
        return f"{self.axis}: {said}"


class ServoError(Exception):
    """Base class of all errors of a master.

    Args:
        expected: what was commanded or awaited.
        received: what happened instead.
        next_step: what to do about it.
        status: status of the drives concerned.
    """

    def __init__(
        self, expected: str, received: str, next_step: str = "", status: tuple[Status, ...] = ()
    ):
        said = "; ".join(filter(None, (received, *map(str, status), next_step)))
        super().__init__(f"{expected}: {said}")
        self.expected = expected
        self.received = received
        self.next_step = next_step
        self.status = status

    def __reduce__(self):
        return type(self), (self.expected, self.received, self.next_step, self.status)

    @property
    def axes(self) -> tuple[str, ...]:
        """Names of the drives concerned."""
        return tuple(status.axis for status in self.status)

    @property
    def state(self) -> State | None:
        """State of the first drive concerned."""
        return self.status[0].state if self.status else None

    @property
    def statusword(self) -> int | None:
        """Statusword (6041h) of the first drive concerned."""
        return self.status[0].statusword if self.status else None


class NoPower(ServoError, RuntimeError):
    """A motion needs OPERATION_ENABLED, but the drive is in another state."""


class DriveFault(ServoError, RuntimeError):
    """A drive has a fault; `received` begins with its error code 603Fh."""


class HomingFailed(ServoError, RuntimeError):
    """Homing ended with an error (statusword bit 13)."""


class Interlock(ServoError, RuntimeError):
    """The caller's own supervision gave an alarm, and all drives were stopped."""


class Refused(ServoError, ValueError):
    """A command was refused by the master, or by the drive (its SDO abort is the `__cause__`)."""


class Timeout(ServoError, TimeoutError):
    """An awaited status did not come in time; the drive continues with its last command."""


class BusError(ServoError, ConnectionError):
    """The bus is unreliable: it takes no frames, or two nodes answer to the same node-id."""
