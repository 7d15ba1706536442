"""A patient master in one process: brings a drive of a machine where it is wanted, and waits.

It commands the drive through its objects only, as a PLC does over SDO, and steps the machine while
it waits. What does not come in time raises TimeoutError with the decoded statusword.
"""

from collections.abc import Callable

from ..drive.words import ENABLED, TO_ENABLED, Mode, State
from ..drive.words import Controlword as C
from ..drive.words import Statusword as S
from .machine import Machine


class Supervisor:
    """Commands one drive of a machine.

    Args:
        machine: the machine that is stepped while waiting.
        name: the drive's name.
        on_step: called after every look, for traces and displays.
        stride: position cycles between two looks at the drive while waiting.
    """

    def __init__(
        self,
        machine: Machine,
        name: str,
        on_step: Callable[[], None] | None = None,
        stride: int = 1,
    ) -> None:
        self.machine = machine
        self.stride = stride
        self.drive = machine.drives[name]
        self.on_step = on_step

    def step(self, cycles: int = 1) -> None:
        """Let position cycles pass."""
        if self.on_step is None:
            self.machine.step(cycles)
            return
        for _ in range(cycles):
            self.machine.step()
            self.on_step()

    def _look(self) -> None:
        self.machine.step(self.stride)
        if self.on_step is not None:
            self.on_step()

    def until(self, condition: Callable[[], bool], timeout: float, what: str) -> None:
        """Step until `condition`; TimeoutError after `timeout` (s), RuntimeError on a fault."""
        end = self.machine.time + timeout
        while not condition():
            if self.drive.state == State.FAULT:
                raise RuntimeError(
                    f"{what}: the drive is in FAULT, {self.drive.fault}; "
                    "remove the cause and reset the fault (controlword bit 7)"
                )
            if self.machine.time >= end:
                raise TimeoutError(
                    f"{what}: not within {timeout:g} s; statusword {self.drive.describe()}; "
                    f"{self.drive.why()}"
                )
            self._look()

    def status(self, mask: int) -> bool:
        """Whether all bits of `mask` are set in the statusword."""
        return int(self.drive.axis.od.statusword) & mask == mask

    def control(self, controlword: int) -> None:
        """Write the controlword and let one cycle pass."""
        self.drive.write("controlword", controlword)
        self.step()

    def enable(self, timeout: float = 1.0) -> None:
        """Walk to OPERATION_ENABLED, one state at a time."""
        end = self.machine.time + timeout
        while self.drive.state != State.OPERATION_ENABLED:
            self.control(TO_ENABLED[self.drive.state])
            if self.machine.time >= end:
                self.until(lambda: False, 0.0, "enable")
        self.control(ENABLED)

    def mode(self, mode: Mode, timeout: float = 0.1) -> None:
        """Select a mode of operation and wait until 6061h shows it."""
        self.drive.write("modes_of_operation", mode)
        self.until(lambda: self.drive.mode == mode, timeout, f"mode {mode.name}")

    def home(self, method: int | None = None, timeout: float = 60.0) -> None:
        """Home with a method of 6098h (the one set if not given) and take the start bit back."""
        if method is not None:
            self.drive.write("homing_method", method)
        self.mode(Mode.HOMING)
        self.control(ENABLED)
        self.control(ENABLED | C.NEW_SET_POINT)
        self.until(lambda: self.status(S.MODE_12 | S.TARGET_REACHED) or self.homing_failed, timeout,
                   f"homing method {self.drive.read('homing_method')}")  # fmt: skip
        if self.homing_failed:
            error = (
                self.drive.read("homing_error") if "homing_error" in self.drive.objects.names else 0
            )
            raise RuntimeError(f"homing failed with error {error}: {self.drive.describe()}")
        self.control(ENABLED)

    @property
    def homing_failed(self) -> bool:
        """Statusword bit 13 in homing mode."""
        return self.status(S.MODE_13)

    def move(self, target: int, *, bits: int = 0, timeout: float = 30.0) -> None:
        """One profile position set-point with the whole handshake; returns when it is reached.

        Args:
            target: target position (position units).
            bits: further bits of the controlword, such as relative.
            timeout: for the whole move (s).
        """
        self.mode(Mode.PROFILE_POSITION)
        self.drive.write("target_position", target)
        self.control(ENABLED | bits)
        self.until(lambda: not self.status(S.MODE_12), timeout, "set-point acknowledge to fall")
        self.control(ENABLED | bits | C.NEW_SET_POINT)
        self.until(lambda: self.status(S.MODE_12), timeout, "set-point acknowledge")
        self.control(ENABLED | bits)
        self.until(lambda: self.status(S.TARGET_REACHED), timeout, f"target {target} to be reached")

    def quick_stop(self, timeout: float = 10.0) -> None:
        """Quick stop, until the option code's end state is reached."""
        self.control(C.SWITCH_ON | C.ENABLE_VOLTAGE | C.ENABLE_OPERATION)
        stays = int(self.drive.axis.od.quick_stop_option_code) >= 5
        self.until(
            lambda: self.status(S.TARGET_REACHED) if stays
            else self.drive.state == State.SWITCH_ON_DISABLED,
            timeout, "quick stop",
        )  # fmt: skip

    def reset_fault(self, timeout: float = 1.0) -> None:
        """Rising edge of fault reset, until the drive has left FAULT."""
        self.drive.write("controlword", 0)
        self.step()
        self.drive.write("controlword", C.FAULT_RESET)
        end = self.machine.time + timeout
        while self.drive.state == State.FAULT:
            self.step()
            if self.machine.time >= end:
                raise TimeoutError(f"fault reset: {self.drive.why()}")
        self.control(0)
