"""AL state machine: transitions, and the status codes of refusals.

Source: ETG.1000.6, 6.4.1 (states, AL Control, AL Status) and table 11 (status codes); ETG.1020,
error acknowledge and explicit device identification. The table [al] of a model's `ethercat.toml`
states its departures.
"""

from collections.abc import Callable
from enum import IntEnum
from typing import ClassVar

from ..model.ethercat import Al


class AlState(IntEnum):
    """Bits 3-0 of AL Control 0120h and AL Status 0130h."""

    INIT = 1
    PRE_OPERATIONAL = 2
    BOOTSTRAP = 3
    SAFE_OPERATIONAL = 4
    OPERATIONAL = 8


class AlStatusCode(IntEnum):
    """AL Status Code 0134h (ETG.1000.6, table 11)."""

    NO_ERROR = 0x0000
    UNSPECIFIED = 0x0001
    INVALID_STATE_CHANGE = 0x0011
    UNKNOWN_STATE = 0x0012
    BOOTSTRAP_NOT_SUPPORTED = 0x0013
    INVALID_MAILBOX_BOOTSTRAP = 0x0015
    INVALID_MAILBOX = 0x0016
    INVALID_SYNC_MANAGER = 0x0017
    NO_VALID_INPUTS = 0x0018
    NO_VALID_OUTPUTS = 0x0019
    SYNCHRONISATION_ERROR = 0x001A
    WATCHDOG = 0x001B
    INVALID_OUTPUTS = 0x001D
    INVALID_INPUTS = 0x001E
    INVALID_WATCHDOG = 0x001F
    FATAL_SYNC_ERROR = 0x002C
    NO_SYNC_ERROR = 0x002D
    INVALID_DC_SYNC = 0x0030
    DC_CYCLE_TIME = 0x0035


_I, _P, _B, _S, _O = AlState
WITH_MAILBOX = (_P, _S, _O)
WITH_INPUTS = (_S, _O)
TRANSITIONS = frozenset(
    {
        (_I, _P), (_P, _S), (_S, _O),  # up, one by one
        (_O, _S), (_O, _P), (_O, _I), (_S, _P), (_S, _I), (_P, _I),  # down, at will
        (_I, _B), (_B, _I),
    }
)

REQUEST = 0x0F  # AL Control and AL Status, bits 3-0: the state
ERROR = ACKNOWLEDGE = 0x10  # bit 4: error of the drive, acknowledged by the master
IDENTIFICATION = 0x20  # bit 5: 0134h shows the identification value


class AlMachine:
    """The state machine of one slave; nothing else writes its state.

    Args:
        rules: the model's departures from the standard.
        check: checks a transition to a higher state; returns an error code, or NO_ERROR.
        entered: called with the old and the new state after each transition.
        identification: returns the value of explicit device identification.
    """

    KEPT: ClassVar = ("error", "_error_code", "_acknowledge", "_identify")  # in a snapshot

    def __init__(
        self, rules: Al, check: Callable[[AlState, AlState], AlStatusCode],
        entered: Callable[[AlState, AlState], None], identification: Callable[[], int],
    ):
        self._rules = rules
        self._check = check
        self._entered = entered
        self._identification = identification
        self.power_on()

    def power_on(self) -> None:
        """Enter INIT without an error and without calling `entered`."""
        self.state = AlState.INIT
        self.error = False
        self._error_code = 0
        self._acknowledge = False  # bit 4 of the last AL Control
        self._identify = False

    @property
    def status(self) -> int:
        """AL Status 0130h."""
        flags = ERROR * self.error | IDENTIFICATION * (self._identify and not self.error)
        return self.state | flags

    @property
    def code(self) -> int:
        """AL Status Code 0134h: the error, else the identification while it is requested."""
        if self.error:
            return self._error_code
        return self._identification() if self._identify else 0

    def control(self, value: int) -> None:
        """AL Control 0120h: request a state, acknowledge an error, request the identification."""
        request = value & REQUEST
        before, self._acknowledge = self._acknowledge, bool(value & ACKNOWLEDGE)
        acknowledged = self._acknowledge and not (before and self._rules.by_edge)
        if request == AlState.INIT and self._rules.init_acknowledges:
            acknowledged = True
        self._identify = bool(value & IDENTIFICATION)
        if self.error and not acknowledged:
            return
        self.error, self._error_code = False, 0
        if request == self.state:
            return
        code = self._refusal(request)
        if code:
            self._refuse(code)
        else:
            self._enter(AlState(request))

    def _refusal(self, request: int) -> AlStatusCode:
        """The reason to refuse a request of another state, or NO_ERROR."""
        if request not in AlState.__members__.values():
            return AlStatusCode.UNKNOWN_STATE
        if request == AlState.BOOTSTRAP and not self._rules.bootstrap:
            return AlStatusCode.BOOTSTRAP_NOT_SUPPORTED
        if (self.state, request) not in TRANSITIONS:
            return AlStatusCode.INVALID_STATE_CHANGE
        if request > self.state:
            return self._check(self.state, AlState(request))
        return AlStatusCode.NO_ERROR

    def fail(self, code: int, state: AlState) -> None:
        """Show an error of the drive, and enter `state` if it is lower than the present one."""
        self._refuse(code)
        if state < self.state:
            self._enter(state)

    def _refuse(self, code: int) -> None:
        """Show an error; the model may have its own number for a code of the standard."""
        if isinstance(code, AlStatusCode):
            code = self._rules.codes.get(code.name.lower(), int(code))
        self.error, self._error_code = True, code

    def _enter(self, state: AlState) -> None:
        before, self.state = self.state, state
        self._entered(before, state)
