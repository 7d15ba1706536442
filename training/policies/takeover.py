"""Policies on a machine that runs already: they take it over, give it back, or are compared on it.

An environment is made around the machine as it stands: its `place`, which brings a machine where an
episode begins, only enables the drive. Its process images go through whoever lets time pass.
"""

import copy
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from ...drive.diagrams import Mode
from ...drive.master import Master
from ...envs import POINT_TO_POINT
from ...envs.engine.machine import Machine
from ...envs.masters.port import MachinePort
from . import Bound, BuiltIn, make, needed

METRE = 1e6  # position units
SETTLED = 50e-6  # m
STROKE = (0.0, 0.5)  # m, of LinearAxis-v0


class Course(NamedTuple):
    """How a policy went to its goal."""

    policy: str
    time: np.ndarray  # s
    position: np.ndarray  # m
    torque: np.ndarray  # % of the rated torque
    settling_time: float  # s, until it stays within 50 µm; nan: it did not
    overshoot: float  # m
    fault: str


class _Line:
    """Carries process images to the drive and lets time pass, cycle by cycle."""

    def __init__(self, machine: Machine, cycle: Callable[[], None], late: Callable[[], float]):
        self.machine, self.cycle, self.late = machine, cycle, late

    def run(self, worlds: np.ndarray, ticks: int, rpdos: np.ndarray, tpdos: np.ndarray) -> None:
        """As `loop.run`, for one world."""
        (drive,) = self.machine.drives.values()
        cycles = ticks // self.machine.physics_steps
        late = min(round(self.late() / self.machine.cycle_time), cycles - 1)
        for number in range(cycles):
            if number == late:
                drive.latch(np.asarray(rpdos).tobytes())
            self.cycle()
        tpdos.reshape(-1)[:] = np.frombuffer(drive.collect(), np.uint8)


class TakeOver:
    """A policy that commands a machine with one linear axis, from where it stands.

    Args:
        machine: homed, without a fault.
        policy: as `policies.make` takes it for LinearAxis-v0.
        goal: position of the axis (m).
        cycle: lets one position cycle pass; the machine's own step if not given.
        late: delay of a set-point (s).

    Raises:
        ValueError: a machine, a policy or a goal that does not fit.
        ServoError: the drive cannot be enabled.
    """

    def __init__(
        self, machine: Machine, policy: str, goal: float,
        cycle: Callable[[], None] | None = None, late: Callable[[], float] = lambda: 0.0,
    ):  # fmt: skip
        if len(machine.drives) != 1 or machine.joint(next(iter(machine.drives)))[1] != "m":
            raise ValueError(
                f"policies of {POINT_TO_POINT.ID} command one linear axis, not {machine!r}"
            )
        ((axis, drive),) = machine.drives.items()
        if not drive.axis.homed:
            raise ValueError("the axis is not referenced: home it first")
        here = float(drive.axis.od.position_actual_value) / METRE
        if not STROKE[0] - SETTLED <= here <= STROKE[1] + SETTLED:
            raise ValueError(  # a policy would begin with a jump to the nearest place it knows
                f"the axis stands at {here * 1e3:.2f} mm, a policy works within "
                f"{STROKE[0] * 1e3:g}..{STROKE[1] * 1e3:g} mm: move it there first"
            )
        self.name, self.machine, self.drive = policy, machine, drive
        passing: Callable[[], None] = cycle or machine.step
        self._before = drive.rpdos.copy(), drive.tpdos.copy()
        line = _Line(machine, passing, late)

        class Here(POINT_TO_POINT):
            """The task on the machine that is there."""

            def _make(self, model: Any) -> Machine:
                return machine

            def join(self, batch: Any, row: int) -> None:
                """Its images go through the line."""
                super().join(batch, row)
                batch.lines[int(batch.worlds[row])] = line

            def place(self, positions: Any, believed: Any = None) -> None:
                """The machine stays where it is; the drive is enabled in the mode of the task."""
                port = MachinePort(machine)
                port.exchange = passing  # type: ignore[method-assign]
                master = Master(port, axis)
                master.enable()
                position = drive.read("position_actual_value")
                drive.write("target_position", position)
                master.set_mode(Mode(self.MODES[0]))
                self._part.rpdos["target_position"][0] = position

        self.env = Here(drive.model, **needed(policy))
        made = make(policy, self.env, 0)
        if isinstance(made, BuiltIn | Bound):
            raise ValueError(f"policy {policy!r} gives no actions, there is nothing to take over")
        self.policy = made
        options = {"start": min(max(here, STROKE[0]), STROKE[1]), "goal": goal}
        self._observation, info = self.env.reset(seed=0, options=options)
        self.policy.reset(self._observation, info)

    def step(self) -> None:
        """One step of the policy."""
        action = self.policy.act(self._observation)
        self._observation, *_ = self.env.step(action)

    def release(self) -> None:
        """The PDO mapping as it was; the drive holds its position."""
        for now, before in zip((self.drive.rpdos, self.drive.tpdos), self._before, strict=True):
            now[:] = before
        self.drive.image_changed()


def compare(machine: Machine, policies: list[str], goal: float, time: float = 1.5) -> list[Course]:
    """Let policies bring copies of a machine to the same goal; it stays as it is."""
    courses = []
    for name in policies:
        twin = copy.deepcopy(machine)
        (drive,) = twin.drives.values()
        rows: list[tuple[float, float, float]] = []

        def cycle(twin: Machine = twin, drive: Any = drive, rows: list = rows) -> None:
            twin.step()
            od = drive.axis.od
            at, torque = od.position_actual_value / METRE, od.torque_actual_value * 0.1
            rows.append((twin.time, float(at), float(torque)))

        pilot = TakeOver(twin, name, goal, cycle)
        rows.clear()
        begin = twin.time
        while twin.time - begin < time and not drive.fault:
            pilot.step()
        courses.append(_course(name, np.array(rows), begin, goal, drive.fault))
    return courses


def _course(name: str, rows: np.ndarray, begin: float, goal: float, fault: str) -> Course:
    times, position, torque = rows[:, 0] - begin, rows[:, 1], rows[:, 2]
    away = np.abs(position - goal) > SETTLED
    settled = 0.0 if not away.any() else float(times[np.flatnonzero(away)[-1]])
    ahead = np.sign(goal - position[0]) * (position - goal)
    return Course(
        name, times, position, torque, float("nan") if away[-1] else settled,
        max(float(ahead.max()), 0.0), fault,
    )  # fmt: skip


class Laboratory:
    """What the panel needs of the policies: names, one that takes over, several side by side."""

    names = ("ruckig", "jerk_limited", "trapezoid", "proportional", "learned")

    def agent(self, session: Any, name: str, goal: float) -> TakeOver:
        """A policy that commands the machine of a session."""
        return TakeOver(session.machine, name, goal, session.exchange, lambda: session.delay)

    def prepare(self, machine: Machine, name: str, goal: float) -> None:
        """What takes long when a policy is made for the first time; on a copy of the machine."""
        TakeOver(machine, name, goal).step()

    def compare(self, machine: Machine, names: list[str], goal: float) -> list[Course]:
        """Side by side, on copies."""
        return compare(machine, names, goal)
