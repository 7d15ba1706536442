"""Policies on a machine that runs already: they take it over, give it back, or are compared on it.

An environment is made around the machine as it stands: its `place`, which brings a machine where an
episode begins, only enables the drives. Its process images go through whoever lets time pass. What
fits a machine is a row of `FITTING`: a task, what a goal is there, what is looked at.
"""

import copy
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ...drive.diagrams import Mode, State
from ...drive.master import Master
from ...envs.engine.machine import Machine
from ...envs.masters.port import MachinePort
from ...envs.panel.bench import Interrupted
from ...envs.plants.rotary import ROTARY_FAMILY
from ...envs.servo_env import ServoEnv
from ...envs.tasks import GantryContourEnv, LinearAxisEnv, RobotEnv, RotaryAxisEnv
from ...envs.tasks.contour import CENTRE
from . import Bound, BuiltIn, make, needed

NEAR = 1e-3  # m or rad that zeros of drive and axis may be apart
TIME = 1.5  # s that policies are compared for
UNIT = {"mm": 1e-3, "°": math.pi / 180}


class Goal(NamedTuple):
    """What a policy is told, in the unit people give it in."""

    name: str
    unit: str
    low: float
    high: float
    value: float  # at first

    def si(self, number: float) -> float:
        """In m or rad. Raises ValueError for one out of range."""
        if not self.low <= number <= self.high:
            raise ValueError(
                f"goal {number:g} is out of range {self.low:g}..{self.high:g} {self.unit}"
            )
        return number * UNIT[self.unit]


class Course(NamedTuple):
    """How a policy did."""

    policy: str
    time: np.ndarray  # s
    value: np.ndarray  # what is looked at, in the unit of `Fitting.shown`
    torque: np.ndarray  # of the first drive, % of the rated torque
    settling_time: float  # s, until it stays within the tolerance; nan: it did not
    figures: Mapping[str, str]
    fault: str


class Fitting(NamedTuple):
    """A task and a machine that fit each other."""

    task: type[ServoEnv]
    what: str  # in words
    names: tuple[str, ...]  # policies that are offered
    goal: Goal
    shown: str  # what is looked at, with its unit
    arguments: Mapping[str, Any] = {}
    axis: str = ""  # whose position is looked at; the first, where none is named

    def position(self, machine: Machine) -> float:
        """Of the drive (m or rad)."""
        axis = self.axis or next(iter(machine.drives))
        unit = MachinePort(machine).units(axis).position
        return int(machine.drives[axis].axis.od.position_actual_value) * unit


Late = Callable[[], float]  # delay of a set-point (s)


class _Line:
    """Carries process images to the drives and lets time pass, cycle by cycle."""

    def __init__(self, env: Any, pilot: "TakeOver", cycle: Callable[[], None], late: Late):
        self.env, self.pilot, self.cycle, self.late = env, pilot, cycle, late

    def run(self, worlds: np.ndarray, ticks: int, rpdos: np.ndarray, tpdos: np.ndarray) -> None:
        """As `loop.run`, for one world."""
        machine, drives = self.env.machine, self.env.drives
        cycles = ticks // machine.physics_steps
        late = min(round(self.late() / machine.cycle_time), cycles - 1)
        for number in range(cycles):
            if number == late:
                for drive, image in zip(drives, rpdos.reshape(len(drives), -1), strict=True):
                    drive.latch(image.tobytes())
            self.cycle()
            if self.pilot.released:  # by who was let in by the cycle: the mapping is another one
                raise Interrupted
        for drive, image in zip(drives, tpdos.reshape(len(drives), -1), strict=True):
            image[:] = np.frombuffer(drive.collect(), np.uint8)


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
    ):  # fmt: skip
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
            """The task on the machine that is there."""

            def _make(self, model: Any) -> Machine:
                if fits.task is RobotEnv:
                    super()._make(model)  # what it has beside the machine
                    self._own = dict(given)
                return machine

            def join(self, batch: Any, row: int) -> None:
                """Its images go through the line."""
                super().join(batch, row)
                batch.lines[int(batch.worlds[row])] = _Line(self, pilot, passing, late)

            def place(self, positions: Any, believed: Any = None) -> None:
                """The machine stays where it is; the drives are enabled in the mode of the task.

                A path is begun at its beginning: the axes go there first.
                """
                port = MachinePort(machine)
                port.exchange = passing  # type: ignore[method-assign]
                names = [*(self.DRIVES or machine.drives)]
                master = Master(port, *names)
                master.enable()
                if fits.task is GantryContourEnv:
                    master.move_to({name: positions[name] for name in names})
                    for drive in self.drives:  # a drive without feed-forward lags by more
                        drive.write("following_error_window", round(self._window * self.units))
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
                    f"policy {policy!r} gives no actions, there is nothing to take over"
                )
            self.policy = made
            self._observation, info = self.env.reset(seed=0, options=options)
        except BaseException:
            self.release()
            raise
        self.policy.reset(self._observation, info)

    def step(self) -> None:
        """One step of the policy."""
        action = self.policy.act(self._observation)
        self._observation, *_ = self.env.step(action)

    def release(self) -> None:
        """PDO mapping and following error window as they were; axes come to rest and hold."""
        self.released = True
        for drive, rpdos, tpdos, window in self._before:
            if drive.state == State.OPERATION_ENABLED and _moves(drive):  # not at once: its ramp
                drive.write("target_velocity", 0)
                drive.write("modes_of_operation", Mode.PROFILE_VELOCITY)
            drive.rpdos[:], drive.tpdos[:] = rpdos, tpdos
            drive.write("following_error_window", window)
            drive.image_changed()


def _moves(drive: Any) -> bool:
    """Faster than a hundredth of its profile velocity."""
    return abs(int(drive.axis.od.velocity_actual_value)) > 0.01 * drive.read("profile_velocity")


def _asked(
    fitting: Fitting, machine: Machine, goal: float
) -> tuple[dict[str, float], dict[str, Any], dict[str, Any]]:
    """Positions, the arguments of the environment, the options of its reset.

    Raises ValueError for a machine that does not stand as the task needs it.
    """
    task, port, given = fitting.task, MachinePort(machine), {}
    arguments, options = dict(fitting.arguments), dict[str, Any](goal=goal)
    for name in task.DRIVES or machine.drives:
        drive = machine.drives.get(name)
        if drive is None:
            raise ValueError(f"policies of {task.ID} command {', '.join(task.DRIVES)}; {machine!r}")
        if not drive.axis.homed:
            raise ValueError(f"{name}: the axis is not referenced: home it first")
        if _moves(drive):
            raise ValueError(f"{name}: the axis moves: stop it first")
        given[name] = int(drive.axis.od.position_actual_value) * port.units(name).position
    here = fitting.position(machine)
    if task is LinearAxisEnv:
        (low, high), (name,) = (0.0, task.STROKE[0]), machine.drives
        if machine.joint(name)[1] != "m":
            raise ValueError(f"policies of {task.ID} command one linear axis, not {machine!r}")
        if not low - 50e-6 <= here <= high + 50e-6:
            raise ValueError(  # a policy would begin with a jump to the nearest place it knows
                f"the axis stands at {here * 1e3:.2f} mm, a policy works within "
                f"{low * 1e3:g}..{high * 1e3:g} mm: move it there first"
            )
        options["start"] = min(max(here, low), high)
    elif task is RotaryAxisEnv:
        options["start"] = here % ROTARY_FAMILY[arguments["mechanics"]].period
    elif task is GantryContourEnv:
        arguments["radius"], options = options.pop("goal"), {"start": 0.0}
        for name, position in given.items():
            place = float(machine.data.joint(name).qpos[0])
            if abs(place - position) > NEAR:
                raise ValueError(
                    f"{name}: the drive's zero is {1e3 * (place - position):.1f} mm off that of "
                    "the axis, where the contour lies: home it with method 17"
                )
    else:
        options = {"goal": given | {fitting.axis or next(iter(given)): goal}}
    return given, arguments, options


def compare(
    machine: Machine, policies: list[str], goal: float, fitting: Fitting | None = None,
    time: float = TIME,
) -> list[Course]:  # fmt: skip
    """Let policies do the same on copies of a machine; it stays as it is."""
    fitting, courses = fitting or LINEAR, []
    for name in policies:
        twin = copy.deepcopy(machine)
        (drive, *_) = twin.drives.values()
        rows: list[tuple[float, float, float]] = []

        def cycle(twin: Machine = twin, drive: Any = drive, rows: list = rows) -> None:
            twin.step()
            torque = float(drive.axis.od.torque_actual_value) * 0.1
            rows.append((twin.time, _looked_at(fitting, twin, goal), torque))

        pilot = TakeOver(twin, name, goal, fitting, cycle)
        rows.clear()
        begin = twin.time
        while twin.time - begin < time and not any(x.fault for x in twin.drives.values()):
            pilot.step()
        fault = next((x.fault for x in twin.drives.values() if x.fault), "")
        courses.append(_course(name, np.array(rows), begin, fitting, goal, pilot.env, fault))
    return courses


def _looked_at(fitting: Fitting, machine: Machine, goal: float) -> float:
    """In the unit of `Fitting.shown`, as the drives tell it."""
    unit = UNIT[fitting.goal.unit]
    if fitting.task is GantryContourEnv:
        x, y = (
            fitting._replace(axis=name).position(machine) - middle
            for name, middle in zip(("x", "y"), CENTRE, strict=True)
        )
        return 1e6 * (math.hypot(x, y) - goal * unit)
    return fitting.position(machine) / unit


def _course(
    name: str, rows: np.ndarray, begin: float, fitting: Fitting, goal: float, env: Any, fault: str
) -> Course:
    times, value, torque = rows[:, 0] - begin, rows[:, 1], rows[:, 2]
    peak = {"peak torque": f"{np.abs(torque).max():.0f} %"}
    if fitting.task is GantryContourEnv:
        figures = {
            "mean contour error": f"{np.abs(value).mean():.1f} µm",
            "worst": f"{np.abs(value).max():.1f} µm",
        }
        return Course(name, times, value, torque, math.nan, figures | peak, fault)
    away, unit = value - goal, UNIT[fitting.goal.unit]
    if fitting.task is RotaryAxisEnv:
        turn = ROTARY_FAMILY[fitting.arguments["mechanics"]].period / unit
        away -= turn * np.round(away / turn)
        value = goal + away  # on the shorter way
    window = float(getattr(env, "tolerance", NEAR)) / unit
    outside = np.flatnonzero(np.abs(away) > window)
    settled = 0.0 if not len(outside) else float(times[outside[-1]])
    settled = math.nan if len(outside) and outside[-1] == len(away) - 1 else settled
    over = max(float((np.sign(-away[0]) * away).max()), 0.0)
    small, factor = ("µm", 1e3) if fitting.goal.unit == "mm" else ("°", 1.0)
    figures = {
        f"settled within {factor * window:.2g} {small}":
            "–" if math.isnan(settled) else f"{settled * 1e3:.0f} ms",
        "overshoot": f"{factor * over:.3g} {small}",
    }  # fmt: skip
    return Course(name, times, value, torque, settled, figures | peak, fault)


PROFILES = ("ruckig", "jerk_limited", "trapezoid", "proportional", "learned")
LINEAR = Fitting(
    LinearAxisEnv, "Policies of LinearAxis-v0 bring the axis to the goal.", PROFILES,
    Goal("Goal", "mm", 0, 500, 300), "position (mm)",
)  # fmt: skip


def _rotary(mechanics: str) -> Fitting:
    period = math.degrees(ROTARY_FAMILY[mechanics].period)
    return Fitting(
        RotaryAxisEnv,
        "Policies of RotaryAxis-v0 turn the axis to the goal, the shorter way round.",
        ("ruckig", "trapezoid", "proportional"), Goal("Goal", "°", 0, round(period, 3), 90),
        "angle (°)", {"mechanics": mechanics},
    )  # fmt: skip


FITTING: dict[str, Fitting] = {  # by the name of the axis in `envs.plants.catalogue`
    "linear": LINEAR, "vertical": LINEAR,
    "rotary-table": _rotary("rotary_table"), "conveyor": _rotary("conveyor"),
    "gantry": Fitting(
        GantryContourEnv,
        "Policies of GantryContour-v0 drive circles with X and Y, round the middle of the "
        "gantry; home both with method 17 first. The axes go to the beginning of the path. They "
        "differ where the drives lag, with a velocity feed-forward of 0.",
        ("full_feed", "constant_feed"), Goal("Radius", "mm", 5, 200, 40),
        "outside of the contour (µm)",
    ),
}  # fmt: skip
NONE = {
    "gantry-x1x2": "Policies of GantrySync-v0 start with a bridge that lies skew by an unknown "
    "amount; here each drive has been referenced by itself. No policy can take over; "
    "those of --axis linear, rotary-table, conveyor and gantry can, and those of --mjcf.",
}


def robot(mjcf: str | Path, machine: Machine, axis: str) -> Fitting:
    """Of a machine of one's own, with a goal for one of its joints."""
    slides = machine.joint(axis)[1] == "m"
    place = [*machine.drives].index(axis)
    unit = "mm" if slides else "°"
    low, high = (float(machine.mechanics[end][place]) / UNIT[unit] for end in ("low", "high"))
    if not (math.isfinite(low) and math.isfinite(high) and low < high):
        low, high = (-1000.0, 1000.0) if slides else (-360.0, 360.0)
    return Fitting(
        RobotEnv,
        "Policies of Robot-v0 for this MJCF command all its drives; the goal is that of this "
        "axis, the others stay where they are.",
        ("hold",), Goal("Goal", unit, round(low, 3), round(high, 3), round((low + high) / 2, 3)),
        f"position ({unit})", {"mjcf": str(mjcf), "drives": [*machine.drives]}, axis,
    )  # fmt: skip


class Laboratory:
    """What the panel needs of the policies: names, one that takes over, several side by side.

    Args:
        fitting: by the name of an axis; what fits there.
    """

    def __init__(self, fitting: Callable[[str], Fitting] = lambda axis: LINEAR):
        self._fitting = fitting

    def fitting(self, axis: str) -> Fitting:
        """What is offered at an axis."""
        return self._fitting(axis)

    def agent(self, session: Any, axis: str, name: str, goal: float) -> TakeOver:
        """A policy that commands the machine of a session."""
        return TakeOver(
            session.machine, name, goal, self._fitting(axis), session.exchange,
            lambda: session.delay,
        )  # fmt: skip

    def prepare(self, machine: Machine, axis: str, name: str, goal: float) -> None:
        """What takes long when a policy is made for the first time; on a copy of the machine."""
        TakeOver(machine, name, goal, self._fitting(axis)).step()

    def compare(self, machine: Machine, axis: str, names: list[str], goal: float) -> list[Course]:
        """Side by side, on copies."""
        return compare(machine, names, goal, self._fitting(axis))
