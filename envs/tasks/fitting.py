"""Tasks for machines that are already running: their goals, and the quantity that is shown.

Each machine has a row in `FITTING`; `robot` makes one for a machine of the user.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ...drive.master import Master
from ..engine.machine import Machine
from ..environment.servo_env import ServoEnv
from ..masters.port import MachinePort
from ..plants.rotary_parameters import ROTARY_FAMILY
from . import GantryContourEnv, LinearAxisEnv, RobotEnv, RotaryAxisEnv
from .contour import CENTRE

NEAR = 1e-3  # m or rad, largest distance between the zeros of drive and axis
UNIT = {"mm": 1e-3, "°": math.pi / 180}


class Goal(NamedTuple):
    """The goal of a policy, in the unit in which people enter it."""

    name: str
    unit: str
    low: float
    high: float
    value: float  # initial value

    def si(self, number: float) -> float:
        """Convert a goal to m or rad. Raises ValueError if it is out of range."""
        if not self.low <= number <= self.high:
            raise ValueError(
                f"goal {number:g} is out of range {self.low:g}..{self.high:g} {self.unit}"
            )
        return number * UNIT[self.unit]


class Judged(NamedTuple):
    """The result of a policy."""

    value: np.ndarray  # the quantity shown, in the unit of `Fitting.shown`
    settling_time: float  # s, until it stays within the tolerance; NaN: it did not
    figures: Mapping[str, str]


@dataclass(frozen=True)
class Fitting:
    """A task and a machine that fit each other.

    Args:
        task: task whose policies take over.
        what: description of these policies.
        names: names of the policies that are offered.
        goal: their goal.
        shown: the quantity that is shown, with its unit.
        arguments: arguments of the environment.
        axis: axis whose position is shown; by default the first one.
    """

    task: type[ServoEnv]
    what: str
    names: tuple[str, ...]
    goal: Goal
    shown: str
    arguments: Mapping[str, Any] = field(default_factory=dict)
    axis: str = ""

    def position(self, machine: Machine) -> float:
        """Return the position of the drive (m or rad)."""
        axis = self.axis or next(iter(machine.drives))
        unit = MachinePort(machine).units(axis).position
        return int(machine.drives[axis].axis.od.position_actual_value) * unit

    def toward(self, goal: float) -> "Fitting":
        """Return the fitting for a goal (m or rad) that is an argument of the environment."""
        return self

    def options(self, machine: Machine, given: dict[str, float], goal: float) -> dict[str, Any]:
        """Return the options of the reset.

        Args:
            machine: the machine in its present state.
            given: positions of its drives by axis (m or rad).
            goal: the goal (m or rad).

        Raises:
            ValueError: the machine is not in a position from which the task can begin.
        """
        return {"goal": given | {self.axis or next(iter(given)): goal}}

    def beside(self, env: Any, make: Callable[[], Machine], given: dict[str, float]) -> None:
        """Set up the data of an environment besides its machine; `make` builds both."""

    def begin(self, env: Any, master: Master, positions: Mapping[str, float]) -> None:
        """Move enabled drives to the start of an episode; by default they stay."""

    def looked_at(self, machine: Machine, goal: float) -> float:
        """Return the quantity shown, as the drives report it, in its unit."""
        return self.position(machine) / UNIT[self.goal.unit]

    def away(self, value: np.ndarray, goal: float) -> np.ndarray:
        """Return the deviation from the goal, in its unit."""
        return value - goal

    def judged(self, times: np.ndarray, value: np.ndarray, goal: float, env: Any) -> Judged:
        """Return settling time and overshoot of the quantity shown."""
        away, unit = self.away(value, goal), UNIT[self.goal.unit]
        window = float(getattr(env, "tolerance", NEAR)) / unit
        outside = np.flatnonzero(np.abs(away) > window)
        settled = 0.0 if not len(outside) else float(times[outside[-1]])
        settled = math.nan if len(outside) and outside[-1] == len(away) - 1 else settled
        over = max(float((np.sign(-away[0]) * away).max()), 0.0)
        small, factor = ("µm", 1e3) if self.goal.unit == "mm" else ("°", 1.0)
        figures = {
            f"settled within {factor * window:.2g} {small}":
                "–" if math.isnan(settled) else f"{settled * 1e3:.0f} ms",
            "overshoot": f"{factor * over:.3g} {small}",
        }
        return Judged(goal + away, settled, figures)


class _Linear(Fitting):
    def options(self, machine: Machine, given: dict[str, float], goal: float) -> dict[str, Any]:
        """Return goal and start, which have to be within the stroke of the task."""
        (low, high), (name,) = (0.0, LinearAxisEnv.STROKE[0]), machine.drives
        if machine.joint(name)[1] != "m":
            raise ValueError(f"policies of {self.task.ID} command one linear axis, not {machine!r}")
        here = self.position(machine)
        if not low - 50e-6 <= here <= high + 50e-6:
            raise ValueError(  # a policy would begin with a jump into the stroke
                f"the axis stands at {here * 1e3:.2f} mm, a policy works within "
                f"{low * 1e3:g}..{high * 1e3:g} mm: move it there first"
            )
        return {"goal": goal, "start": min(max(here, low), high)}


class _Rotary(Fitting):
    def options(self, machine: Machine, given: dict[str, float], goal: float) -> dict[str, Any]:
        """Return goal and start, within one turn."""
        period = ROTARY_FAMILY[self.arguments["mechanics"]].period
        return {"goal": goal, "start": self.position(machine) % period}

    def away(self, value: np.ndarray, goal: float) -> np.ndarray:
        """Return the deviation along the shorter way."""
        turn = ROTARY_FAMILY[self.arguments["mechanics"]].period / UNIT[self.goal.unit]
        away = value - goal
        return away - turn * np.round(away / turn)


class _Contour(Fitting):
    def toward(self, goal: float) -> Fitting:
        """Return the fitting for a radius."""
        return replace(self, arguments={**self.arguments, "radius": goal})

    def options(self, machine: Machine, given: dict[str, float], goal: float) -> dict[str, Any]:
        """Return the start of the path; the zeros of drives and axes have to agree."""
        for name, position in given.items():
            place = float(machine.data.joint(name).qpos[0])
            if abs(place - position) > NEAR:
                raise ValueError(
                    f"{name}: the drive's zero is {1e3 * (place - position):.1f} mm off that of "
                    "the axis, where the contour lies: home it with method 17"
                )
        return {"start": 0.0}

    def begin(self, env: Any, master: Master, positions: Mapping[str, float]) -> None:
        """Move the drives to the start of the path."""
        master.move_to({name: positions[name] for name in self.task.DRIVES})
        for drive in env.drives:  # a drive without feed-forward lags by more
            drive.write("following_error_window", round(env._window * env.units))

    def looked_at(self, machine: Machine, goal: float) -> float:
        """Return the distance outside of the circle (µm)."""
        x, y = (
            replace(self, axis=name).position(machine) - middle
            for name, middle in zip(("x", "y"), CENTRE, strict=True)
        )
        return 1e6 * (math.hypot(x, y) - goal * UNIT[self.goal.unit])

    def judged(self, times: np.ndarray, value: np.ndarray, goal: float, env: Any) -> Judged:
        """Return mean and worst contour error."""
        figures = {
            "mean contour error": f"{np.abs(value).mean():.1f} µm",
            "worst": f"{np.abs(value).max():.1f} µm",
        }
        return Judged(value, math.nan, figures)


class _Robot(Fitting):
    def beside(self, env: Any, make: Callable[[], Machine], given: dict[str, float]) -> None:
        """Read ranges and goals from a machine of its own; set the positions of all joints."""
        make()
        env._own = dict(given)


def robot(mjcf: str | Path, machine: Machine, axis: str) -> Fitting:
    """Return the fitting of `RobotEnv` and a machine of the user, with a goal for one joint."""
    slides = machine.joint(axis)[1] == "m"
    unit = "mm" if slides else "°"
    low, high = (end / UNIT[unit] for end in machine.range(axis))
    if not (math.isfinite(low) and math.isfinite(high) and low < high):
        low, high = (-1000.0, 1000.0) if slides else (-360.0, 360.0)
    return _Robot(
        RobotEnv,
        "Policies of Robot-v0 for this MJCF command all its drives; the goal is that of this "
        "axis, the others stay where they are.",
        ("proportional", "trapezoid", "hold"),
        Goal("Goal", unit, round(low, 3), round(high, 3), round((low + high) / 2, 3)),
        f"position ({unit})", {"mjcf": str(mjcf), "drives": [*machine.drives]}, axis,
    )


def _rotary(mechanics: str) -> Fitting:
    period = math.degrees(ROTARY_FAMILY[mechanics].period)
    return _Rotary(
        RotaryAxisEnv,
        "Policies of RotaryAxis-v0 turn the axis to the goal, the shorter way round.",
        ("ruckig", "trapezoid", "proportional"), Goal("Goal", "°", 0, round(period, 3), 90),
        "angle (°)", {"mechanics": mechanics},
    )


LINEAR = _Linear(
    LinearAxisEnv, "Policies of LinearAxis-v0 bring the axis to the goal.",
    ("ruckig", "jerk_limited", "trapezoid", "proportional", "learned"),
    Goal("Goal", "mm", 0, 500, 300), "position (mm)",
)
FITTING: dict[str, Fitting] = {  # by the name of the axis in `envs.plants.catalogue`
    "linear": LINEAR, "vertical": LINEAR,
    "rotary-table": _rotary("rotary_table"), "conveyor": _rotary("conveyor"),
    "gantry": _Contour(
        GantryContourEnv,
        "Policies of GantryContour-v0 drive circles with X and Y, round the middle of the "
        "gantry; home both with method 17 first. The axes go to the beginning of the path. They "
        "differ where the drives lag, with a velocity feed-forward of 0.",
        ("full_feed", "constant_feed"), Goal("Radius", "mm", 5, 200, 40),
        "outside of the contour (µm)",
    ),
}
NONE = {
    "gantry-x1x2": "Policies of GantrySync-v0 start with a bridge that lies skew by an unknown "
    "amount; here each drive has been referenced by itself. No policy can take over; "
    "those of --axis linear, rotary-table, conveyor and gantry can, and those of --mjcf.",
}
