"""The drives of a master as it observes them: objects, status, and waiting for a status."""

from collections.abc import Callable, Mapping
from contextlib import suppress
from numbers import Real
from typing import Any, SupportsFloat, TypeVar

from .. import advice
from ..kernel.words import SWITCHED_ON, Mode, State, state_of
from ..kernel.words import Controlword as C
from ..kernel.words import Statusword as S
from ..objects.abort import SdoAbort
from .errors import (
    DriveFault,
    HomingFailed,
    Interlock,
    NoPower,
    Refused,
    ServoError,
    Status,
    Timeout,
)
from .port import Port

T = TypeVar("T")
QUICK_STOP = SWITCHED_ON & ~C.QUICK_STOP
LOST = (
    State.SWITCH_ON_DISABLED, State.READY_TO_SWITCH_ON, State.SWITCHED_ON, State.QUICK_STOP_ACTIVE
)
CYCLIC = (Mode.CYCLIC_SYNC_POSITION, Mode.CYCLIC_SYNC_VELOCITY, Mode.CYCLIC_SYNC_TORQUE)
UNHEARD = (ServoError, SdoAbort, ValueError)  # errors of a command to a drive


def in_fault(statusword: int) -> bool:
    """Whether a drive has a fault; some models show the same statusword during its reaction."""
    return state_of(statusword) in (State.FAULT, State.FAULT_REACTION_ACTIVE)


class Drives:
    """The drives of a port, observed together; `Master` adds the commands."""

    def __init__(self, port: Port, *axes: str):
        if not hasattr(port, "models"):
            raise ValueError(f"port = {port!r}: give a port, as MachinePort(machine) makes one")
        self.port = port
        self.axes = axes or tuple(port.models)
        if not set(self.axes) <= set(port.models):
            raise ValueError(f"axes = {[*axes]}: choose some of the drives {[*port.models]}")

    def __repr__(self) -> str:
        return f"{type(self).__name__}({type(self.port).__name__}: {', '.join(self.axes)})"

    # --------------------------------------------------------------- objects

    def read(self, name: str) -> Any:
        """Read an object (drive units). Raises Refused if the drive refuses."""
        return self._of_each(lambda axis: self._ask(axis, name))

    def write(self, name: str, value: float | Mapping[str, float]) -> None:
        """Write an object (drive units), wait one exchange. Raises Refused if a drive refuses."""
        self._put(name, value)
        self.port.exchange()

    @property
    def statusword(self) -> Any:
        """Statusword (6041h)."""
        return self._of_each(self._word)

    @property
    def state(self) -> Any:
        """State of the device control; None if the statusword matches no state."""
        return self._of_each(lambda axis: state_of(self._word(axis)))

    @property
    def mode(self) -> Any:
        """Mode of operation that the drive displays (6061h)."""
        return self._of_each(self._mode)

    @property
    def position(self) -> Any:
        """Position actual value (SI at the load)."""
        return self._of_each(
            lambda a: self.port.read(a, "position_actual_value") * self.port.units(a).position
        )

    def status(self, mask: int) -> bool:
        """Whether all bits of `mask` are set in every statusword."""
        return all(self._word(axis) & mask == mask for axis in self.axes)

    def describe(self) -> Any:
        """Return the statusword in words."""
        return self._of_each(lambda a: advice.describe(
            self._word(a), self._mode(a), self.port.models[a].own_modes
        ))

    # ------------------------------------------------------------------ time

    def wait(self, time: float) -> None:
        """Let `time` pass (s, 0 or more)."""
        if not (isinstance(time, SupportsFloat) and float(time) >= 0.0):
            raise ValueError(f"time = {time!r} s must be 0 or more")
        end = self.port.now() + time - 1e-9
        while self.port.now() < end:
            self.port.exchange()

    def wait_until(self, condition: Callable[[int], bool], timeout: float, what: str) -> None:
        """Wait until `condition` holds for every statusword.

        Args:
            condition: takes a statusword.
            timeout: longest wait (s).
            what: description of what is awaited, for the error message.

        Raises:
            Timeout: the condition was not met in time; names the drives that are late.
            DriveFault: a drive has a fault.
        """
        self._until(lambda axis, word: condition(word), timeout, what)

    # -------------------------------------------------------------- inside

    def _of_each(self, look: Callable[[str], T]) -> T | dict[str, T]:
        """The result of `look` for the only drive, or a dict of all by name."""
        found = {axis: look(axis) for axis in self.axes}
        return found if len(self.axes) > 1 else found[self.axes[0]]

    def _each(self, what: str, value: T | Mapping[str, T]) -> dict[str, T]:
        """A value for every drive."""
        if not isinstance(value, Mapping):
            return dict.fromkeys(self.axes, value)
        if value.keys() != set(self.axes):
            raise Refused(what, f"{dict(value)}", f"give one value for each of {[*self.axes]}")
        return dict(value)

    def _ask(self, axis: str, name: str) -> Any:
        try:
            return self.port.upload(axis, name)
        except (SdoAbort, ValueError) as error:
            raise Refused(f"read {name}", f"{axis}: {error}") from error

    def _known(self, axis: str, name: str) -> Any:
        """An object's value, None if the drive lacks it."""
        try:
            return self.port.upload(axis, name)
        except (SdoAbort, ValueError):
            return None

    def _put(self, name: str, value: float | Mapping[str, float]) -> None:
        """Set an object of all drives, to be sent with the next exchange."""
        for axis, number in self._each(name, value).items():
            self._tell(axis, name, number)

    def _tell(self, axis: str, name: str, value: float) -> None:
        try:
            self.port.write(axis, name, value)
        except (SdoAbort, TypeError, ValueError) as error:
            raise Refused(f"{name} = {value}", f"{axis}: {error}") from error

    def _word(self, axis: str) -> int:
        return int(self.port.read(axis, "statusword"))

    def _fresh(self, axis: str) -> int:
        """The present statusword: process data may be older than the last command."""
        return int(self.port.upload(axis, "statusword"))

    def _mode(self, axis: str) -> int:
        return int(self.port.read(axis, "modes_of_operation_display"))

    def _told(self, axis: str) -> int:
        return int(self._known(axis, "controlword") or 0)

    def _fault(self, axis: str) -> str:
        """Error code 603Fh and its meaning in the model."""
        code = int(self._known(axis, "error_code") or 0)
        return f"error code {advice.fault_named(self.port.models[axis], code) or '0000h'}"

    def _in_fault(self, what: str, axis: str, then: str = "reset_fault()") -> DriveFault:
        """The error for a fault, with its name and remedy."""
        code = int(self._known(axis, "error_code") or 0)
        remedy = advice.remedy_of(self.port.models[axis], code)
        said = f"FAULT, {self._fault(axis)}{self._touching(axis)}"
        step = f"{remedy}; remove the cause, then {then}"
        return DriveFault(what, said, step, self._shown(axis))

    def _shown(self, *axes: str) -> tuple[Status, ...]:
        return tuple(
            Status(axis, self._fresh(axis), self._told(axis), self._mode(axis)) for axis in axes
        )

    def _power(self, what: str, *axes: str) -> None:
        """Refuse a motion without power, as its controlwords would switch the power on."""
        for axis in axes or self.axes:
            word = self._fresh(axis)
            if in_fault(word):
                raise self._in_fault(what, axis, "reset_fault() and enable()")
            if state_of(word) is not State.OPERATION_ENABLED:
                raise self._no_power(what, axis)

    def _no_power(self, what: str, axis: str) -> NoPower:
        return NoPower(what, "no power", "it needs enable() first", self._shown(axis))

    def _until(
        self, condition: Callable[[str, int], bool], timeout: float, what: str, hint: str = "", *,
        faulty: bool = False, powered: bool = False, homing: bool = False,
        alarm: Callable[[], str] | None = None,
    ) -> None:
        """Wait until `condition` of name and statusword holds for all drives.

        Process data may be older than the last command, so an upload confirms them.

        Args:
            condition: may also write objects, which are sent with the next exchange.
            timeout: longest wait (s).
            what: description of what is awaited.
            hint: the next step, if the statusword does not show it.
            faulty: whether to continue waiting in FAULT.
            powered: whether waiting is useless without power.
            homing: whether statusword bit 13 is a homing error.
            alarm: returns a reason to stop all drives, or an empty text.
        """
        end = self._end(timeout)

        def holds(word: int, axis: str) -> bool:
            return (not powered or state_of(word) is State.OPERATION_ENABLED) and condition(
                axis, word
            )

        try:
            while late := [axis for axis in self.axes if not self._sure(axis, holds, axis)]:
                if alarm is not None and (reason := alarm()):
                    raise Interlock(what, f"{reason}; all drives were stopped")
                for axis in self.axes:
                    self._check(axis, what, faulty, powered, homing)
                if self._now() >= end:
                    shown = self._shown(*late)
                    step = hint or advice.advice(
                        self.port.models[late[0]], shown[0].statusword, shown[0].controlword
                    )
                    said = f"not within {timeout:g} s"
                    raise Timeout(what, said + self._touching(*late), step, shown)
                self.port.exchange()
        except ServoError as error:
            if len(self.axes) > 1 or isinstance(error, Interlock):
                self._stop()
            raise

    def _end(self, timeout: float) -> float:
        """End of a wait (s)."""
        if not isinstance(timeout, Real) or not timeout >= 0.0:
            raise ValueError(f"timeout = {timeout!r}: give seconds, 0 or more")
        return self._now() + float(timeout)

    def _now(self) -> float:
        """Time (s) without waiting for lost frames, which no time limit counts."""
        return self.port.now() - float(getattr(self.port, "silence", 0.0))

    def _touching(self, *axes: str) -> str:
        """Obstacles that touch the drives, if the port can detect them."""
        see = getattr(self.port, "obstacles", None)
        found = [contact for axis in axes for contact in see(axis)[:2]] if see else []
        return f"; {', '.join(found)}" if found else ""

    def _stop(self) -> None:
        """Command a quick stop of every drive that can be reached."""
        with suppress(*UNHEARD):
            self._to_each(lambda axis: self._tell(axis, "controlword", QUICK_STOP))

    def _to_each(self, tell: Callable[[str], None]) -> None:
        """Command every drive, even if one refuses; then raise the first error."""
        errors = []
        for axis in self.axes:
            try:
                tell(axis)
            except UNHEARD as error:
                errors.append(error)
        self.port.exchange()
        if errors:
            raise errors[0]

    def _stands(self, axis: str, word: int) -> bool:
        """Whether a halted drive stands.

        Bit 10 says so, except in the cyclic modes, where it is reserved: there the velocity 606Ch
        is within its threshold 606Fh, or a hundredth of the profile velocity where that is 0.
        """
        if self._mode(axis) not in CYCLIC:
            return bool(word & S.TARGET_REACHED)
        velocity = self._known(axis, "velocity_actual_value")
        slow = self._known(axis, "velocity_threshold")
        slow = slow or 0.01 * (self._known(axis, "profile_velocity") or 0)
        return velocity is None or abs(velocity) <= slow

    def _check(self, axis: str, what: str, faulty: bool, powered: bool, homing: bool) -> None:
        """Raise an error that makes waiting useless; see `_until`."""
        if homing and self._sure(axis, lambda word: bool(word & S.MODE_13)):
            step = "look at method, switches, speeds and time-out"
            if in_fault(self._fresh(axis)):  # to some models a fault as well
                raise HomingFailed("homing failed", f"FAULT, {self._fault(axis)}",
                                   f"{step}, then reset_fault()", self._shown(axis))
            number = self._known(axis, "homing_error")
            said = "" if number is None else f"error {number}"
            raise HomingFailed("homing failed", said, step, self._shown(axis))
        if not faulty and self._sure(axis, in_fault):
            raise self._in_fault(what, axis)
        if powered and self._sure(axis, lambda word: state_of(word) in LOST):
            raise self._no_power(what, axis)

    def _sure(self, axis: str, condition: Callable[..., bool], *arguments: Any) -> bool:
        """Whether the statusword fulfils a condition, which an upload confirms.

        Until the last command has arrived, the condition may hold because of an earlier one.
        """
        arrived = getattr(self.port, "arrived", None)
        return (
            condition(self._word(axis), *arguments)
            and (arrived is None or arrived(axis))
            and condition(self._fresh(axis), *arguments)
        )
