"""Policies on a machine that is already running: they take it over, or are compared on copies.

An environment is made around the machine as it stands: its `place`, which otherwise moves a machine
to the start of an episode, only enables the drives. Its process images pass through the loop that
advances time. `envs.tasks.fitting` states which task, goal and displayed value fit a machine.
"""

import copy
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from ...drive.diagrams import Mode, State
from ...drive.master import Master
from ...envs.engine import loop
from ...envs.engine.machine import Machine
from ...envs.masters.port import MachinePort
from ...envs.panel.bench import Interrupted
from ...envs.tasks.fitting import LINEAR, Fitting
from . import Bound, BuiltIn, make, needed

TIME = 1.5  # s, the length of a comparison


class Course(NamedTuple):
    """The result of a policy in a comparison."""

    policy: str
    time: np.ndarray  # s
    value: np.ndarray  # displayed value, in the unit of `Fitting.shown`
    torque: np.ndarray  # of the first drive, % of the rated torque
    settling_time: float  # s, until it stays within the tolerance; nan if it does not
    figures: Mapping[str, str]
    fault: str


Late = Callable[[], float]  # delay of a set-point (s)


class _Line:
    """Carries process images to the drives and lets time pass, cycle by cycle."""

    def __init__(self, env: Any, pilot: "TakeOver", cycle: Callable[[], None], late: Late):
        self.env, self.pilot, self.cycle, self.late = env, pilot, cycle, late

    def run(self, worlds: np.ndarray, ticks: int, rpdos: np.ndarray, tpdos: np.ndarray) -> None:
        """Run cycles as `loop.run` does, for one world."""
        machine, drives = self.env.machine, self.env.drives
        cycles = ticks // machine.physics_steps
        late = min(round(self.late() / machine.cycle_time), cycles - 1)
        for number in range(cycles):
            if number == late:
                for drive, image in zip(drives, rpdos.reshape(len(drives), -1), strict=True):
                    drive.latch(image.tobytes())
            self.cycle()
            if self.pilot.released:  # during the cycle, so the mapping has changed
                raise Interrupted
        for drive, image in zip(drives, tpdos.reshape(len(drives), -1), strict=True):
            image[:] = np.frombuffer(drive.collect(), np.uint8)

    def look(self, worlds: np.ndarray, rpdos: np.ndarray, tpdos: np.ndarray) -> None:
        """Fill the TPDO images without running a cycle."""
        loop.run(worlds, 0, rpdos[None], tpdos[None])


class TakeOver:
    """A policy that commands a machine from where it stands.

    Args:
        machine: homed, without a fault.
        policy: as `policies.make` takes it for the task.
        goal: in the unit of the fitting.
        fitting: of the machine; that of a linear axis if not given.
        cycle: lets one position cycle pass; the machine's own step if not given.
        late: delay of a set-point (s).

    Raises:
        ValueError: a machine, a policy or a goal that does not fit.
        ServoError: a drive cannot be enabled.
    """

    def __init__(
        self, machine: Machine, policy: str, goal: float, fitting: Fitting | None = None,
        cycle: Callable[[], None] | None = None, late: Late = lambda: 0.0,
    ):
        fits = fitting or LINEAR
        given, arguments, options = _asked(fits, machine, fits.goal.si(goal))
        self.name, self.machine = policy, machine
        passing: Callable[[], None] = cycle or machine.step
        pilot, self.released = self, False
        self._before = [
            (drive, drive.rpdos.copy(), drive.tpdos.copy(), drive.read("following_error_window"))
            for drive in machine.drives.values()
        ]

        class Here(fits.task):  # type: ignore[misc,name-defined]
            """The task on the machine as it stands."""

            def _make(self, model: Any) -> Machine:
                fits.beside(self, partial(super()._make, model), given)
                return machine

            def join(self, batch: Any, row: int) -> None:
                """Send its process images through the line."""
                super().join(batch, row)
                batch.lines[int(batch.worlds[row])] = _Line(self, pilot, passing, late)

            def place(self, positions: Any, believed: Any = None) -> None:
                """Enable the drives in the mode of the task."""
                port = MachinePort(machine)
                port.exchange = passing  # type: ignore[method-assign]
                names = [*(self.DRIVES or machine.drives)]
                master = Master(port, *names)
                master.enable()
                fits.begin(self, master, positions)
                at = [drive.read("position_actual_value") for drive in self.drives]
                for drive, position in zip(self.drives, at, strict=True):
                    drive.write("target_position", position)
                master.set_mode(Mode(self.MODES[0]))
                self._part.rpdos["target_position"][0] = at

        try:
            first = next(iter(machine.drives.values()))
            self.env = Here(first.model, **arguments, **needed(policy))
            made = make(policy, self.env, 0)
            if isinstance(made, BuiltIn | Bound):
                raise ValueError(
                    f"policy {policy!r} gives no actions and cannot take over: choose another one"
                )
            self.policy = made
            self._observation, info = self.env.reset(seed=0, options=options)
        except BaseException:
            self.release()
            raise
        self.policy.reset(self._observation, info)

    def step(self) -> None:
        """Take one step of the policy."""
        action = self.policy.act(self._observation)
        self._observation, *_ = self.env.step(action)

    def release(self) -> None:
        """Restore PDO mapping and following error window; the axes come to rest and hold."""
        self.released = True
        for drive, rpdos, tpdos, window in self._before:
            if drive.state == State.OPERATION_ENABLED and _moves(drive):  # not at once: its ramp
                drive.write("target_velocity", 0)
                drive.write("modes_of_operation", Mode.PROFILE_VELOCITY)
            drive.rpdos[:], drive.tpdos[:] = rpdos, tpdos
            drive.write("following_error_window", window)
            drive.image_changed()


def _moves(drive: Any) -> bool:
    """Whether a drive is faster than a hundredth of its profile velocity."""
    return abs(int(drive.axis.od.velocity_actual_value)) > 0.01 * drive.read("profile_velocity")


def _asked(
    fitting: Fitting, machine: Machine, goal: float
) -> tuple[dict[str, float], dict[str, Any], dict[str, Any]]:
    """Return positions, arguments of the environment and options of its reset.

    Raises ValueError if the machine is not referenced, moves, or does not fit the task.
    """
    task, port, given = fitting.task, MachinePort(machine), {}
    for name in task.DRIVES or machine.drives:
        drive = machine.drives.get(name)
        if drive is None:
            raise ValueError(f"policies of {task.ID} command {', '.join(task.DRIVES)}; {machine!r}")
        if not drive.axis.homed:
            raise ValueError(f"{name}: the axis is not referenced: home it first")
        if _moves(drive):
            raise ValueError(f"{name}: the axis moves: stop it first")
        given[name] = int(drive.axis.od.position_actual_value) * port.units(name).position
    options = fitting.options(machine, given, goal)
    return given, dict(fitting.toward(goal).arguments), options


def compare(
    machine: Machine, policies: list[str], goal: float, fitting: Fitting | None = None
) -> list[Course]:
    """Play policies towards the same goal on copies of a machine, which stays as it is."""
    fitting, courses = fitting or LINEAR, []
    for name in policies:
        twin = copy.deepcopy(machine)
        (drive, *_) = twin.drives.values()
        rows: list[tuple[float, float, float]] = []

        def cycle(twin: Machine = twin, drive: Any = drive, rows: list = rows) -> None:
            twin.step()
            torque = float(drive.axis.od.torque_actual_value) * 0.1
            rows.append((twin.time, fitting.looked_at(twin, goal), torque))

        pilot = TakeOver(twin, name, goal, fitting, cycle)
        rows.clear()
        begin = twin.time
        while twin.time - begin < TIME and not any(x.fault for x in twin.drives.values()):
            pilot.step()
        fault = next((x.fault for x in twin.drives.values() if x.fault), "")
        times, value, torque = np.array(rows).T
        judged = fitting.judged(times - begin, value, goal, pilot.env)
        figures = {**judged.figures, "peak torque": f"{np.abs(torque).max():.0f} %"}
        courses.append(
            Course(name, times - begin, judged.value, torque, judged.settling_time, figures, fault)
        )
    return courses


class Laboratory:
    """The policies as the panel uses them: one takes over, or several are compared.

    Args:
        fitting: returns what fits an axis, by its name.
        shipped_only: whether only the offered policies may be named, for users who must not choose
            which program runs here.
    """

    def __init__(
        self, fitting: Callable[[str], Fitting] = lambda axis: LINEAR, shipped_only: bool = False
    ):
        self._fitting, self.shipped_only = fitting, shipped_only

    def _allowed(self, axis: str, *names: str) -> Fitting:
        fitting = self._fitting(axis)
        for name in names if self.shipped_only else ():
            if name not in fitting.names:
                raise ValueError(f"policy {name!r} is not offered: {', '.join(fitting.names)}")
        return fitting

    def fitting(self, axis: str) -> Fitting:
        """Return what is offered for an axis."""
        return self._fitting(axis)

    def agent(self, session: Any, axis: str, name: str, goal: float) -> TakeOver:
        """Return a policy that commands the machine of a session."""
        return TakeOver(
            session.machine, name, goal, self._allowed(axis, name), session.cycle,
            lambda: session.delay,
        )

    def prepare(self, machine: Machine, axis: str, name: str, goal: float) -> None:
        """Make a policy on a copy of the machine, so that the first real one is quick."""
        TakeOver(machine, name, goal, self._allowed(axis, name)).step()

    def compare(self, machine: Machine, axis: str, names: list[str], goal: float) -> list[Course]:
        """Compare policies side by side, on copies."""
        return compare(machine, names, goal, self._allowed(axis, *names))
