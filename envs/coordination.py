"""A patient master of several drives: what it writes, all of them hear in the same SYNC.

It commands the drives through their objects only, as a PLC does that sends its SYNC after it has
written to every axis. When one drive fails, all of them make a quick stop.
"""

from collections.abc import Callable, Iterable, Mapping

from ..drive.words import ENABLED, TO_ENABLED, Mode, State
from ..drive.words import Controlword as C
from ..drive.words import Statusword as S
from .gantry import Gantry
from .machine import Machine
from .supervisor import Supervisor

QUICK_STOP = C.SWITCH_ON | C.ENABLE_VOLTAGE | C.ENABLE_OPERATION
# what makes a profile, if the drive has it; in proportion to the way they make the same time law
PROFILE = ("profile_velocity", "profile_acceleration", "profile_deceleration", "profile_jerk_1")


class Group:
    """Commands several drives of a machine together.

    Args:
        machine: the machine that is stepped while waiting.
        names: of the drives; all of the machine if not given.
        on_step: called after every cycle, for traces and displays.

    Raises:
        ValueError: a name without a drive, or no name at all.
    """

    def __init__(
        self,
        machine: Machine,
        names: Iterable[str] | None = None,
        on_step: Callable[[], None] | None = None,
    ) -> None:
        names = list(machine.drives if names is None else names)
        missing = [name for name in names if name not in machine.drives]
        if missing or not names:
            raise ValueError(f"names = {names}: choose some of the drives {[*machine.drives]}")
        self.machine = machine
        self.on_step = on_step
        self.masters = {name: Supervisor(machine, name) for name in names}

    def step(self, cycles: int = 1) -> None:
        """Let position cycles pass."""
        for _ in range(cycles):
            self.machine.step()
            if self.on_step is not None:
                self.on_step()

    def control(self, controlword: int) -> None:
        """Write the controlword to all drives and let one cycle pass."""
        for master in self.masters.values():
            master.drive.write("controlword", controlword)
        self.step()

    def until(
        self,
        condition: Callable[[Supervisor], bool],
        timeout: float,
        what: str,
        alarm: Callable[[], str] = str,
    ) -> None:
        """Step until `condition` holds for every drive; else stop all of them and raise.

        Args:
            condition: of one drive.
            timeout: (s)
            what: is waited for, for the message.
            alarm: a reason to stop at once, or an empty text.

        Raises:
            RuntimeError: a drive is in FAULT, or the alarm.
            TimeoutError: naming the drives that are late.
        """
        end = self.machine.time + timeout
        while late := [name for name, master in self.masters.items() if not condition(master)]:
            reason = alarm() or self._fault()
            if reason:
                self.control(QUICK_STOP)
                raise RuntimeError(f"{what}: {reason}; all drives were stopped")
            if self.machine.time >= end:
                self.control(QUICK_STOP)
                states = "; ".join(f"{x}: {self.masters[x].drive.describe()}" for x in late)
                raise TimeoutError(f"{what}: not within {timeout:g} s; {states}")
            self.step()

    def _fault(self) -> str:
        for name, master in self.masters.items():
            if master.drive.state in (State.FAULT, State.FAULT_REACTION_ACTIVE):
                return f"drive {name!r} has the fault {master.drive.fault}"
        return ""

    def enable(self, timeout: float = 1.0) -> None:
        """Walk all drives to OPERATION_ENABLED, one state at a time."""

        def enabled(master: Supervisor) -> bool:
            state = master.drive.state
            master.drive.write("controlword", TO_ENABLED.get(state, ENABLED))
            return state == State.OPERATION_ENABLED

        self.until(enabled, timeout, "enable")
        self.control(ENABLED)

    def require(self, mode: Mode) -> None:
        """Raise ValueError, naming the drives, where a mode of operation is not supported."""
        without = [x for x, master in self.masters.items() if mode not in master.drive.model.modes]
        if without:
            model = self.masters[without[0]].drive.model.name
            raise ValueError(
                f"drive = {model!r} of {', '.join(without)} has no mode {mode.name}: choose a "
                "drive model that has it, see `servogym drives`"
            )

    def mode(self, mode: Mode, timeout: float = 0.1) -> None:
        """Select a mode of operation in all drives and wait until 6061h shows it.

        Raises ValueError for a mode that a drive does not have.
        """
        self.require(mode)
        for master in self.masters.values():
            master.drive.write("modes_of_operation", mode)
        self.until(lambda master: master.drive.mode == mode, timeout, f"mode {mode.name}")

    def home(self, timeout: float = 60.0, alarm: Callable[[], str] = str) -> None:
        """Home all drives at the same time, each with its own method 6098h."""

        def failed() -> str:
            names = [name for name, master in self.masters.items() if master.homing_failed]
            return f"homing of {', '.join(names)} failed" if names else alarm()

        self.mode(Mode.HOMING)
        self.control(ENABLED)
        self.control(ENABLED | C.NEW_SET_POINT)
        self.until(lambda m: m.status(S.MODE_12 | S.TARGET_REACHED), timeout, "homing", failed)
        self.control(ENABLED)

    def move(self, targets: Mapping[str, int], timeout: float = 60.0) -> None:
        """A straight line: profile position moves that start in one SYNC and arrive together.

        Speed, acceleration and jerk of each drive are made proportional to its way, none above what
        its objects 6081h, 6083h, 6084h and 60A4h say now; they are as before afterwards. They are
        whole drive units, so a drive with less than some hundred units to go may arrive early or
        late. The drives have the same units of speed per position unit.

        Args:
            targets: target position by drive name, for every drive of the group (position units).
            timeout: for the whole move (s).

        Raises ValueError if `targets` does not name just the drives of the group, or one of them
        has no profile position mode.
        """
        if targets.keys() != self.masters.keys():
            raise ValueError(f"targets = {[*targets]}: give one for each of {[*self.masters]}")
        drives = {name: master.drive for name, master in self.masters.items()}
        self.mode(Mode.PROFILE_POSITION)
        ways = {name: abs(targets[name] - d.read("position_demand_value"))
                for name, d in drives.items()}  # fmt: skip
        kept = {(name, what): d.read(what) for name, d in drives.items() for what in PROFILE
                if what in d.objects.names and ways[name]}  # fmt: skip
        pace = {what: min((value / ways[name] for (name, w), value in kept.items() if w == what),
                          default=0.0) for what in PROFILE}  # fmt: skip
        try:
            for name, what in kept:
                drives[name].write(what, max(1, round(pace[what] * ways[name])))
            for name, drive in drives.items():
                drive.write("target_position", targets[name])
            self._set_point(timeout)
        finally:
            for (name, what), value in kept.items():
                drives[name].write(what, value)

    def _set_point(self, timeout: float) -> None:
        """The handshake of profile position, until the targets are reached."""
        self.control(ENABLED)
        self.until(lambda m: not m.status(S.MODE_12), 1.0, "set-point acknowledge to fall")
        self.control(ENABLED | C.NEW_SET_POINT)
        self.until(lambda m: m.status(S.MODE_12), 1.0, "set-point acknowledge")
        self.control(ENABLED)
        self.until(lambda m: m.status(S.TARGET_REACHED), timeout, "targets to be reached")


def square(
    gantry: Gantry,
    *,
    max_twist: float = 0.01,
    timeout: float = 60.0,
    on_step: Callable[[], None] | None = None,
) -> float:
    """Home ``x1`` and ``x2`` together and bring both to position 0; -> skew left (m).

    Both drives start in the same SYNC at the same speed, so the bridge travels as skew as it is
    until each side has found its own switch; the home offsets 607Ch hold how far the switches are
    from square. The skew is watched as by a sensor on the bridge.

    Args:
        gantry: with two drives in X.
        max_twist: change of the skew (m) at which both drives stop: a switch has been missed.
        timeout: for the homing (s).
        on_step: called after every cycle.

    Raises:
        ValueError: no drives x1 and x2, or without a mode, or `max_twist` is not above 0 m.
        RuntimeError: twisted too far, homing failed, or a drive is in FAULT.
        TimeoutError: naming the drives that have not found home.
    """
    if not max_twist > 0.0:
        raise ValueError(f"max_twist = {max_twist!r} is out of range: give more than 0 m")
    pair = Group(gantry, ("x1", "x2"), on_step)
    begin = gantry.skew

    def alarm() -> str:
        twist = abs(gantry.skew - begin)
        return f"the bridge is twisted by {twist * 1e3:.1f} mm" if twist > max_twist else ""

    pair.require(Mode.HOMING)
    pair.require(Mode.PROFILE_POSITION)
    pair.enable()
    pair.home(timeout, alarm)
    pair.move({"x1": 0, "x2": 0})
    return gantry.skew
