"""A master for one drive on CANopen: device control, modes, set-points, homing (CiA 402-2).

The same object commands an emulated node in the process, one on python-can's virtual bus, or a real
drive over socketcan: frames and time pass through a `Port`. What does not come in time raises
TimeoutError with the decoded statusword, the last controlword and the next step; a fault on the way
raises RuntimeError with its error code.
"""

from collections.abc import Callable
from pathlib import Path

from .. import advice
from ..abort import SdoAbort
from ..model import DriveModel
from ..words import ENABLED, SWITCHED_ON, TO_ENABLED, Mode, State, state_of
from ..words import Controlword as C
from ..words import Statusword as S
from .port import Port
from .remote import RemoteObjects

COMMAND = 0x000F  # controlword bits of the device control
STAYS = range(5, 9)  # 605Ah: values that end in QUICK_STOP_ACTIVE
SETTLE = 0.02  # s; inferred: by then a drive has seen the start bit and its status bits are new
HOMED = S.TARGET_REACHED | S.MODE_12
OFF = (State.SWITCH_ON_DISABLED, State.FAULT)
LOST = (  # a motion; `until` itself ends at FAULT
    State.SWITCH_ON_DISABLED, State.READY_TO_SWITCH_ON, State.SWITCHED_ON, State.QUICK_STOP_ACTIVE
)  # fmt: skip


class Master:
    """Commands one drive; timeouts are in s of the port's time.

    Arguments and errors are those of `RemoteObjects`.
    """

    def __init__(
        self,
        port: Port,
        node_id: int,
        model: str | Path | DriveModel = "generic",
        sdo_timeout: float = 1.0,
    ):
        self.port = port
        self.objects = RemoteObjects(port, node_id, model, sdo_timeout)
        self._sent = 0  # controlword

    # --------------------------------------------------------------- status

    @property
    def statusword(self) -> int:
        """6041h."""
        return int(self.objects.read("statusword"))

    @property
    def state(self) -> State | None:
        """State of the device control, None where the statusword fits no pattern."""
        return state_of(self.statusword)

    @property
    def mode(self) -> int:
        """Mode of operation the drive shows (6061h)."""
        return int(self.objects.read("modes_of_operation_display"))

    def describe(self) -> str:
        """The statusword by name."""
        return advice.describe(self.statusword, self.mode)

    def until(
        self,
        condition: Callable[[int], bool],
        timeout: float,
        what: str,
        hint: str = "",
        in_fault: bool = False,
    ) -> int:
        """Look at the statusword until `condition` holds for it; -> the statusword.

        A TPDO may be older than the last command, so an upload confirms what it shows. `what` is
        waited for, `hint` the next step where the statusword does not tell it; `in_fault` goes on
        waiting in FAULT.

        Raises:
            TimeoutError: not within `timeout`; tells statusword, controlword and the next step.
            RuntimeError: the drive is in FAULT.
        """
        end = self.port.now() + timeout
        while True:
            word = self.statusword
            if condition(word) and condition(word := int(self.objects.upload("statusword"))):
                return word
            if state_of(word) is State.FAULT and not in_fault:
                raise RuntimeError(
                    f"{what}: the drive is in FAULT, error code {self._error_code()}; "
                    "remove the cause, then reset_fault()"
                )
            if self.port.now() >= end:
                raise TimeoutError(
                    f"{what}: not within {timeout:g} s; {self._situation(word)}; "
                    f"{hint or advice.advice(word, self._sent)}"
                )
            self.objects.exchange()

    def _error_code(self) -> str:
        return f"{int(self.objects.upload('error_code')):04X}h"

    def _situation(self, word: int) -> str:
        return advice.situation(word, self._sent, self.mode)

    # ------------------------------------------------------- device control

    def control(self, controlword: int) -> None:
        """Send a controlword."""
        self._sent = controlword
        self.objects.write("controlword", controlword)

    def enable(self, timeout: float = 2.0) -> None:
        """Walk to OPERATION_ENABLED from any state but FAULT, one state at a time."""

        def walk(word: int) -> bool:
            state = state_of(word)
            if state is not None and state is not State.OPERATION_ENABLED:
                self.control(TO_ENABLED[state])
            return state is State.OPERATION_ENABLED

        self.until(walk, timeout, "enable")
        if self._sent != ENABLED:  # by another master: its halt and start bits fall
            self.control(ENABLED)

    def disable(self, timeout: float = 10.0) -> None:
        """Take the power off; an axis in motion comes to rest first, as 605Ch says."""
        if self.state is State.OPERATION_ENABLED:
            self.control(SWITCHED_ON)  # is disable operation here
            self.until(lambda w: state_of(w) is not State.OPERATION_ENABLED, timeout,
                       "disable operation")  # fmt: skip
        self.control(0)
        self.until(lambda w: state_of(w) in OFF, timeout, "disable voltage")

    def quick_stop(self, timeout: float = 10.0) -> None:
        """Quick stop, until the axis stands in QUICK_STOP_ACTIVE or the power is off (605Ah)."""
        try:
            stays = self.objects.upload("quick_stop_option_code") in STAYS
        except SdoAbort:
            stays = False  # without the object, as with its default 2
        self.control(SWITCHED_ON & ~C.QUICK_STOP)

        def stopped(word: int) -> bool:
            stands = state_of(word) is State.QUICK_STOP_ACTIVE and word & S.TARGET_REACHED
            return state_of(word) is State.SWITCH_ON_DISABLED or bool(stays and stands)

        self.until(stopped, timeout, "quick stop")

    def reset_fault(self, timeout: float = 2.0) -> None:
        """Rising edge of fault reset, until the drive has left FAULT; nothing without a fault."""
        self.until(lambda w: state_of(w) is not State.FAULT_REACTION_ACTIVE, timeout,
                   "fault reaction", in_fault=True)  # fmt: skip
        if self.state is State.FAULT:
            hint = f"the cause of error code {self._error_code()} is still present"
            self.control(0)
            self.control(C.FAULT_RESET)
            self.until(lambda w: state_of(w) is not State.FAULT, timeout, "fault reset", hint, True)
            self.control(0)

    # --------------------------------------------------- modes of operation

    def set_mode(self, mode: Mode, timeout: float = 1.0) -> None:
        """Select a mode of operation and wait until 6061h shows it."""
        self.objects.write("modes_of_operation", mode)
        self.until(lambda _: self.mode == mode, timeout, f"mode {mode.name}",
                   "6502h tells the modes the drive has")  # fmt: skip

    def move_to(
        self,
        position: int,
        *,
        relative: bool = False,
        immediate: bool = False,
        change_on_set_point: bool = False,
        wait: bool = True,
        timeout: float = 30.0,
    ) -> None:
        """Hand over one profile position set-point with the whole handshake.

        Where the drive buffers set-points and has no room, this waits for room.

        Args:
            position: target position (position units).
            relative: the target counts from what 60F2h says.
            immediate: drop what the drive is doing instead of queueing behind it.
            change_on_set_point: pass the running target without a stop (bit 9).
            wait: return when the target is reached, not when it is acknowledged.
            timeout: for the whole of it.
        """
        self._power("move_to", self.statusword)
        if self.mode != Mode.PROFILE_POSITION:
            self.set_mode(Mode.PROFILE_POSITION)
        bits = ENABLED | relative * C.RELATIVE | immediate * C.CHANGE_SET_IMMEDIATELY
        bits |= change_on_set_point * C.CHANGE_ON_SET_POINT
        end = self.port.now() + timeout
        self.objects.write("target_position", position)
        self.control(bits)
        full = immediate and bool(self.statusword & S.MODE_12)  # such a set-point needs no room
        if full:
            self._settle()
        else:
            self._wait(lambda w: not w & S.MODE_12, end, "set-point acknowledge to fall")
        self.control(bits | C.NEW_SET_POINT)
        if full:
            self._settle()
        self._wait(lambda w: bool(w & S.MODE_12), end, "set-point acknowledge")
        self.control(bits)
        if wait:
            self._wait(lambda w: w & HOMED == S.TARGET_REACHED, end, f"target {position}")

    def _wait(self, condition: Callable[[int], bool], end: float, what: str) -> None:
        """`until` a time; without power what is waited for will not come."""

        def ended(word: int) -> bool:
            state = state_of(word)
            return state in LOST or (state is State.OPERATION_ENABLED and condition(word))

        self._power(what, self.until(ended, end - self.port.now(), what))

    def _power(self, what: str, word: int) -> None:
        """Refuse without power: the controlwords of a motion would switch it on."""
        if (state := state_of(word)) is not State.OPERATION_ENABLED:
            step = "reset_fault() and enable()" if state is State.FAULT else "enable()"
            raise RuntimeError(f"{what}: {self._situation(word)}; it needs {step} first")

    def halt(self, timeout: float = 10.0) -> None:
        """Halt (bit 8) until the axis stands; `resume` lets it go on."""
        self._power("halt", self.statusword)
        self.control(ENABLED | self._sent & ~COMMAND | C.HALT)
        self.until(lambda w: bool(w & S.TARGET_REACHED), timeout, "halt")

    def resume(self) -> None:
        """Take halt back."""
        self._power("resume", self.statusword)
        self.control(ENABLED | self._sent & ~(COMMAND | C.HALT))

    def home(self, method: int | None = None, timeout: float = 60.0) -> None:
        """Home with a method of 6098h (the one set if not given) and take the start bit back."""
        self._power("home", self.statusword)
        if method is not None:
            self.objects.write("homing_method", method)
        self.set_mode(Mode.HOMING)
        end = self.port.now() + timeout
        self.control(ENABLED)
        self.control(ENABLED | C.NEW_SET_POINT)
        self._settle()
        try:
            self._wait(lambda w: w & HOMED == HOMED or bool(w & S.MODE_13), end, "homing")
            situation, failed = self._situation(self.statusword), self.statusword & S.MODE_13
        except TimeoutError:
            self.control(ENABLED)  # stops it
            raise
        self.control(ENABLED)
        self._settle()
        if failed:
            raise RuntimeError(f"homing failed: {situation}")

    def _settle(self) -> None:
        end = self.port.now() + SETTLE
        while self.port.now() < end:
            self.objects.exchange()
