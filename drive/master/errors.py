"""What a master raises.

::

    ServoError
     +-- NoPower (RuntimeError)       a motion was commanded or under way, without power
     +-- DriveFault (RuntimeError)    a drive has a fault
     +-- HomingFailed (RuntimeError)  a drive did not find its home
     +-- Interlock (RuntimeError)     what the caller watches over gave an alarm; all were stopped
     +-- Refused (ValueError)         a command that cannot be carried out; the drive did not move
     +-- Timeout (TimeoutError)       what was waited for did not come in time
     +-- BusError (ConnectionError)   the bus takes no frames, or two nodes answer to one node-id
"""

from typing import NamedTuple

from .. import advice
from ..kernel.words import State, state_of


class Status(NamedTuple):
    """What a drive showed, and what it was last told."""

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
    """Base of all errors of a master.

    Args:
        expected: what was commanded or waited for.
        received: what came instead.
        next_step: what to do.
        status: of the drives that it is about.
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
        """Names of the drives that it is about."""
        return tuple(status.axis for status in self.status)

    @property
    def state(self) -> State | None:
        """State of the first of them."""
        return self.status[0].state if self.status else None

    @property
    def statusword(self) -> int | None:
        """6041h of the first of them."""
        return self.status[0].statusword if self.status else None


class NoPower(ServoError, RuntimeError):
    """A motion needs OPERATION_ENABLED, and the drive is in another state."""


class DriveFault(ServoError, RuntimeError):
    """A drive has a fault; `received` begins with its error code 603Fh."""


class HomingFailed(ServoError, RuntimeError):
    """Homing error, statusword bit 13."""


class Interlock(ServoError, RuntimeError):
    """The caller's own alarm."""


class Refused(ServoError, ValueError):
    """Refused by the master, or by the drive with the SDO abort that is its `__cause__`."""


class Timeout(ServoError, TimeoutError):
    """Not within the time allowed; the drive goes on with what it was told."""


class BusError(ServoError, ConnectionError):
    """The bus cannot be relied on: it takes no frames, or two nodes answer to one node-id."""
