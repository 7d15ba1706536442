"""A master for drives on any port: device control, modes, set-points, homing (CiA 402-2).

>>> master = Master(port)                    # all drives of the port, or some by name
>>> master.enable()
>>> master.home(method=17)
>>> master.move_to(0.25)

A value applies to all drives of the master; a mapping by name gives each drive its own. Reading
returns the value itself for a single drive and a dict for several. Positions and velocities are in
SI units at the load if the port knows the factors, otherwise in drive units (`Port.units`). Times
are in seconds of the port's time. When one of several drives fails, the others make a quick stop.
"""

from collections.abc import Callable, Mapping
from contextlib import suppress

from ..kernel.words import (
    ENABLED,
    MODE_ABBREVIATION,
    SWITCHED_ON,
    TO_ENABLED,
    Mode,
    State,
    state_of,
)
from ..kernel.words import Controlword as C
from ..kernel.words import Statusword as S
from ..model.names import hint
from .drives import QUICK_STOP, Drives, in_fault
from .errors import HomingFailed, Refused, ServoError, Timeout

BY_NAME = {mode.name.lower(): mode for mode in Mode} | {
    short: mode for mode, short in MODE_ABBREVIATION.items() if mode
}
COMMAND = 0x000F  # controlword bits of the device control
STAYS = range(5, 9)  # 605Ah: values that end in QUICK_STOP_ACTIVE
RAMP = C.NEW_SET_POINT | C.CHANGE_SET_IMMEDIATELY | C.RELATIVE  # what lets vl turn
TORQUE = (Mode.PROFILE_TORQUE, Mode.CYCLIC_SYNC_TORQUE)
COASTS = 1.0  # s until an axis has to stand if halt may only remove its torque (inferred)
AT_REST: dict[int, str] = {  # by mode: the set-point that is dropped by a stop
    Mode.VELOCITY: "vl_target_velocity", Mode.PROFILE_VELOCITY: "target_velocity",
    Mode.PROFILE_TORQUE: "target_torque", Mode.CYCLIC_SYNC_POSITION: "target_position",
    Mode.CYCLIC_SYNC_VELOCITY: "target_velocity", Mode.CYCLIC_SYNC_TORQUE: "target_torque",
}
HOMED = S.TARGET_REACHED | S.MODE_12
# objects of a profile; in proportion to the distance they give all drives one time law
PROFILE = ("profile_velocity", "profile_acceleration", "profile_deceleration", "profile_jerk_1")


class Master(Drives):
    """Commands the drives of a port together.

    Args:
        port: connection to the drives.
        axes: names of drives of the port; all of them if none are given.

    Raises:
        ValueError: the port has no drive of that name.
    """

    def __getitem__(self, axis: str) -> "Master":
        """The master of one of the drives."""
        return Master(self.port, axis)

    # ------------------------------------------------------- device control

    def control(self, controlword: int) -> None:
        """Send a controlword to all drives."""
        self.write("controlword", controlword)

    def enable(self, timeout: float = 2.0) -> None:
        """Go to OPERATION_ENABLED from any state except FAULT, one transition at a time."""

        def walk(axis: str, word: int) -> bool:
            state = state_of(word)
            if state is not None and not in_fault(word):
                self._tell(axis, "controlword", TO_ENABLED[state])
            return state is State.OPERATION_ENABLED

        self._until(walk, timeout, "enable")
        self.control(ENABLED)

    def disable(self, timeout: float = 10.0) -> None:
        """Remove the power; axes in motion come to rest first, as configured by 605Ch."""

        def off(axis: str) -> None:
            if state_of(self._word(axis)) is State.OPERATION_ENABLED:
                self._tell(axis, "controlword", SWITCHED_ON)  # is disable operation here

        self._to_each(off)
        self._until(lambda axis, word: state_of(word) is not State.OPERATION_ENABLED, timeout,
                    "disable operation", faulty=True)
        self.control(0)
        self._until(lambda axis, word: state_of(word) is State.SWITCH_ON_DISABLED or in_fault(word),
                    timeout, "disable voltage", faulty=True)

    def quick_stop(self, timeout: float = 10.0) -> None:
        """Make a quick stop; return when the axes stand in QUICK_STOP_ACTIVE or without power."""
        self._to_each(lambda axis: self._tell(axis, "controlword", QUICK_STOP))
        stays = {axis: self._known(axis, "quick_stop_option_code") in STAYS for axis in self.axes}

        def stopped(axis: str, word: int) -> bool:
            stands = state_of(word) is State.QUICK_STOP_ACTIVE and word & S.TARGET_REACHED
            return state_of(word) is State.SWITCH_ON_DISABLED or bool(stays[axis] and stands)

        self._until(stopped, timeout, "quick stop")

    def reset_fault(self, timeout: float = 2.0) -> None:
        """Reset faults until no drive has one; does nothing if there is none."""
        faulty = [axis for axis in self.axes if in_fault(self._fresh(axis))]
        if not faulty:
            return
        faults = ", ".join(f"{axis}: {self._fault(axis)}" for axis in faulty)
        end = self._end(timeout)
        while still := [axis for axis in faulty if in_fault(self._fresh(axis))]:
            if self._now() >= end:
                raise Timeout(
                    "fault reset", f"not within {timeout:g} s",
                    f"the cause of {faults} is still present", self._shown(*still),
                )
            for word in (0, C.FAULT_RESET):
                for axis in still:
                    self._tell(axis, "controlword", word)
                self.port.exchange()
            self.wait(self.port.latency)
        for axis in faulty:
            self._tell(axis, "controlword", 0)
        self.port.exchange()

    # --------------------------------------------------- modes of operation

    def set_mode(self, mode: Mode | str, timeout: float = 1.0) -> None:
        """Select a mode of operation and wait until 6061h shows it.

        Args:
            mode: a `Mode`, its name or the standard's abbreviation: ``"profile_torque"``, ``"tq"``;
                of a mode that the drive model brings, its name in drive.toml.
            timeout: (s)

        Raises:
            Refused: a drive model without the mode.
        """
        mode = self._named(mode)
        without = [axis for axis in self.axes if mode and mode not in self.port.models[axis].modes]
        if without:
            raise Refused(f"mode {mode.name}", f"drive {self.port.models[without[0]].name!r} of "
                          f"{', '.join(without)} does not have it",
                          "choose a drive model that has it, see `servogym drives`")
        self._put("modes_of_operation", mode)
        self._until(lambda axis, word: self._mode(axis) == mode, timeout, f"mode {mode.name}",
                    "6502h lists the modes of the drive")

    def follow(self, mode: Mode | str) -> None:
        """Prepare the drives, at rest, to follow set-points of a mode (objects in `AT_REST`).

        The first set-point is standstill itself, so that no earlier set-point takes effect; halt is
        released. Drives that already follow set-points of this mode continue.

        Raises:
            NoPower, DriveFault: a drive is not enabled.
            Refused: no such mode, or one that is not moved by set-points.
        """
        mode = self._named(mode)
        name = AT_REST.get(mode)
        if name is None:
            raise Refused(f"mode {mode.name}", "it is not moved by set-points",
                          f"choose one of {', '.join(Mode(m).name for m in AT_REST)}")
        self._power("set-points")
        if all(self._mode(a) == mode and not self._told(a) & C.HALT for a in self.axes):
            return
        for axis in self.axes:
            here = mode == Mode.CYCLIC_SYNC_POSITION
            self._tell(axis, name, self.port.read(axis, "position_actual_value") if here else 0)
        self.set_mode(mode)
        self.control(ENABLED)

    def move_to(
        self, position: float | Mapping[str, float], *, relative: bool = False,
        immediate: bool = False, change_on_set_point: bool = False, wait: bool = True,
        timeout: float = 30.0,
    ) -> None:
        """Command one profile position set-point with the complete handshake.

        Several drives travel on a straight line: they start at once and arrive together. For this,
        speed, acceleration and jerk of each drive are scaled with its distance, never above the
        present values of 6081h, 6083h, 6084h and 60A4h, which are restored afterwards. They are
        integers in drive units, so a drive with only some hundred units to travel may arrive early
        or late. All drives need the same ratio of speed unit to position unit.

        If a drive buffers set-points and its buffer is full, this waits until there is room.

        Args:
            position: target (SI at the load).
            relative: whether the target is relative, to the position selected by 60F2h.
            immediate: abort the present motion instead of queueing behind it.
            change_on_set_point: pass the present target without stopping (bit 9).
            wait: return when the target is reached instead of when it is acknowledged.
            timeout: limit for the whole motion (s).

        Raises:
            Refused: the target is beyond the software position limits 607Dh, or is not a value that
                a drive can take.
            NoPower: a drive is not enabled, or loses power on the way.
            DriveFault, Timeout: during the motion.
        """
        what = "move_to"
        self._power(what)
        targets = self._units_of(what, position, "position")
        if not relative:
            self._inside(targets)
        if len(self.axes) > 1 and not wait:
            raise Refused(what, "several drives with wait=False",
                          "on a straight line they are waited for: leave it out")
        if any(self._mode(axis) != Mode.PROFILE_POSITION for axis in self.axes):
            self.set_mode(Mode.PROFILE_POSITION)
        bits = ENABLED | relative * C.RELATIVE | immediate * C.CHANGE_SET_IMMEDIATELY
        bits |= change_on_set_point * C.CHANGE_ON_SET_POINT
        line = self._line(targets, relative) if len(self.axes) > 1 else {}
        try:
            for (axis, name), (_, value) in line.items():
                self._tell(axis, name, value)
            self._put("target_position", targets)
            shown = position if isinstance(position, Mapping) else f"{position:.9g}"
            self._set_point(bits, immediate, f"target {shown}", wait, timeout)
        finally:
            for (axis, name), (kept, _) in line.items():
                self._tell(axis, name, kept)

    def _set_point(self, bits: int, immediate: bool, what: str, wait: bool, timeout: float) -> None:
        """The handshake of profile position."""
        end = self._end(timeout)
        self.control(bits)
        full = immediate and any(self._word(axis) & S.MODE_12 for axis in self.axes)
        if full:  # such a set-point needs no room
            self.wait(self.port.latency)
        else:
            self._until(lambda axis, word: not word & S.MODE_12, end - self._now(),
                        "set-point acknowledge to fall", powered=True)
        self.control(bits | C.NEW_SET_POINT)
        if full:
            self.wait(self.port.latency)
        self._until(lambda axis, word: bool(word & S.MODE_12), end - self._now(),
                    "set-point acknowledge", powered=True)
        self.control(bits)
        if wait:
            self._until(lambda axis, word: word & HOMED == S.TARGET_REACHED, end - self._now(),
                        what, powered=True)

    def _line(
        self, targets: Mapping[str, int], relative: bool
    ) -> dict[tuple[str, str], tuple[float, int]]:
        """Profile objects on a straight line: present value, and value in proportion."""
        distances = {
            axis: abs(target - (0 if relative else self._ask(axis, "position_demand_value")))
            for axis, target in targets.items()
        }
        kept = {
            (axis, name): self._ask(axis, name)
            for axis, distance in distances.items() for name in PROFILE
            if distance and name in self.port.models[axis].names
        }
        pace = {
            name: min((value / distances[axis] for (axis, n), value in kept.items() if n == name),
                      default=0.0) for name in PROFILE
        }
        return {
            (axis, name): (value, max(1, round(pace[name] * distances[axis])))
            for (axis, name), value in kept.items()
        }

    def jog(
        self, velocity: float | Mapping[str, float], duration: float | None = None,
        timeout: float = 10.0,
    ) -> None:
        """Move at a velocity in profile velocity mode; 0 stops.

        Args:
            velocity: target (SI at the load).
            duration: time at that velocity before stopping (s); without it the motion continues.
            timeout: limit for reaching the velocity (s).

        Raises the same errors as `move_to`.
        """
        self._power("jog")
        self._put("target_velocity", self._units_of("jog", velocity, "velocity"))
        if any(self._mode(axis) != Mode.PROFILE_VELOCITY for axis in self.axes):
            self.set_mode(Mode.PROFILE_VELOCITY)
        self.control(ENABLED)
        self.wait(self.port.latency)
        self._until(lambda axis, word: bool(word & S.TARGET_REACHED), timeout,
                    f"velocity {velocity}", powered=True)
        if duration is not None:
            self.wait(duration)
            self.jog(0.0, timeout=timeout)

    def halt(self, timeout: float = 10.0) -> None:
        """Halt (bit 8) and return when the axes stand; `resume` continues the motion."""

        def hold(axis: str) -> None:
            self._power("halt", axis)
            self._tell(axis, "controlword", ENABLED | self._told(axis) & ~COMMAND | C.HALT)

        self._to_each(hold)
        self._until(self._stands, timeout, "halt", powered=True)

    def resume(self) -> None:
        """Release halt."""
        self._power("resume")
        self.write("controlword", {
            axis: ENABLED | self._told(axis) & ~(COMMAND | C.HALT) for axis in self.axes
        })

    def stop(self, timeout: float = 10.0) -> tuple[str, ...]:
        """Bring the axes to rest in any mode and keep them there until the next motion command.

        The axes are halted, their set-points are replaced by standstill (`AT_REST`), and halt
        remains set, so that no earlier set-point takes effect again. A drive that halt does not
        bring to rest in time, for example because it only removes its torque, makes a quick stop.
        Drives without power are left alone.

        Args:
            timeout: limit until the axes stand (s); one second at most in the torque modes.

        Returns:
            Names of the drives that were stopped.

        Raises:
            Timeout: halt did not bring an axis to rest; a quick stop has been commanded.
            DriveFault: while stopping.
        """
        powered: dict[str, int] = {}  # with the mode

        def hold(axis: str) -> None:
            if state_of(self._fresh(axis)) is State.OPERATION_ENABLED:
                powered[axis] = mode = self._mode(axis)
                ramp = self._told(axis) & RAMP if mode == Mode.VELOCITY else 0
                self._tell(axis, "controlword", ENABLED | ramp | C.HALT)

        self._to_each(hold)
        if not powered:
            return ()
        halted = Master(self.port, *powered)
        self.wait(self.port.latency)
        if any(mode in TORQUE for mode in powered.values()):
            timeout = min(timeout, COASTS)
        try:
            halted._until(lambda axis, word: state_of(word) is not State.OPERATION_ENABLED
                          or halted._stands(axis, word), timeout, "stop")
        except Timeout as error:
            halted._stop()
            raise Timeout("stop", f"halt did not bring it to rest within {timeout:g} s",
                          "a quick stop was commanded instead", error.status) from None
        for axis, mode in powered.items():
            self[axis]._drop(mode)
        self.port.exchange()
        return tuple(powered)

    def _drop(self, mode: int) -> None:
        """Drop the set-point of a halted drive; halt stays."""
        (axis,) = self.axes
        if state_of(self._fresh(axis)) is not State.OPERATION_ENABLED:
            return
        if mode == Mode.PROFILE_POSITION:  # its own position replaces the halted target
            at, bits = self.port.read(axis, "position_actual_value"), ENABLED | C.HALT
            with suppress(ServoError):  # not every drive takes one while it is halted
                self._tell(axis, "target_position", at)
                self._set_point(bits | C.CHANGE_SET_IMMEDIATELY, True, "stop", False, 0.2)
            self.control(bits)
        elif name := AT_REST.get(mode):
            here = mode == Mode.CYCLIC_SYNC_POSITION
            self._tell(axis, name, self.port.read(axis, "position_actual_value") if here else 0)

    def home(
        self, method: int | Mapping[str, int] | None = None, timeout: float = 60.0,
        alarm: Callable[[], str] | None = None,
    ) -> None:
        """Home all drives at the same time; return when all have finished.

        Args:
            method: homing method (6098h); the configured one if not given.
            timeout: limit for the whole search (s).
            alarm: called repeatedly; a text other than empty is a reason to stop at once.

        Raises:
            HomingFailed: names the drives that failed.
            Refused: a drive does not support the method.
            NoPower, DriveFault, Interlock, Timeout: during the search.
        """
        self._power("home")
        if method is not None:
            self._put("homing_method", method)
        self.set_mode(Mode.HOMING)
        end = self._end(timeout)
        self.control(ENABLED)
        self.control(ENABLED | C.NEW_SET_POINT)
        self.wait(self.port.latency)
        try:
            self._until(
                lambda axis, word: word & HOMED == HOMED, end - self._now(), "homing",
                powered=True, homing=True, alarm=alarm,
            )
        except (HomingFailed, Timeout):
            if len(self.axes) == 1:  # the start bit; several have made a quick stop
                self.control(ENABLED)
                self.wait(self.port.latency)
            raise
        self.control(ENABLED)
        self.wait(self.port.latency)

    def _named(self, mode: Mode | str) -> Mode:
        known = BY_NAME | {
            row.name.lower(): Mode(number)
            for axis in self.axes for number, row in self.port.models[axis].own_modes.items()
        }
        try:
            return known[mode.lower()] if isinstance(mode, str) else Mode(mode)
        except (KeyError, ValueError):
            raise Refused(f"mode {mode!r}", "there is none", hint(str(mode), [*known])) from None

    def _units_of(self, what: str, value: float | Mapping[str, float], unit: str) -> dict[str, int]:
        """Values (SI) in drive units, by drive; `unit` names the field of `Units`."""
        each = self._each(what, value)
        try:
            return {a: round(x / getattr(self.port.units(a), unit)) for a, x in each.items()}
        except (TypeError, ValueError, OverflowError) as error:
            raise Refused(what, f"{value!r} is not a finite number") from error

    def _inside(self, targets: Mapping[str, int]) -> None:
        """Refuse targets beyond the software position limits."""
        for axis, target in targets.items():
            low, high = (self._known(axis, f"{end}_position_limit") for end in ("min", "max"))
            if low is not None and high is not None and low < high and not low <= target <= high:
                unit = self.port.units(axis)
                raise Refused(
                    "move_to",
                    f"{axis}: {target * unit.position:g} {unit.name} is beyond the stroke "
                    f"{low * unit.position:g}..{high * unit.position:g} {unit.name} (software "
                    "position limits 607Dh)", "choose a target inside, or other limits",
                )
