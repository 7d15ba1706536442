"""Set-point profiles for point-to-point moves: planned once from the first observation, streamed.

| name | velocity | acceleration | jerk |
|------|----------|--------------|------|
| trapezoid | 6081h | 6083h | unlimited: the drive's pp profile, 6086h = 0 |
| jerk_limited | 6081h | 6083h | 60A4h: the drive's pp profile, 6086h = 3 |
| ruckig | of action 1 | what the maximum torque 6072h leaves for the heaviest payload | in 10 ms |
| ruckig+zv | as ruckig, through a zero-vibration shaper for the nominal resonance | | |
| ruckig+zvd | as ruckig, through that shaper twice (ZVD): slower, less sensitive | | |
| ruckig+ei | as ruckig, through an extra-insensitive shaper that leaves 5 % of vibration | | |
| s_curve | 6081h | 6083h | the acceleration builds up in one period of the resonance |
| ruckig+notch | as ruckig, through a notch filter of the set-point at the nominal resonance | | |
"""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import ruckig

from .datasheet import Axis, Bounds, Datasheet, Vibration
from .numbers import Range, Tunable

Path = Callable[[np.ndarray], np.ndarray]  # times (s) -> positions along the move (m)
TORQUE_SHARE = 0.8  # of the maximum torque; the rest lets the controller hold the path
ALLOWED = 0.05  # vibration that an EI shaper leaves at the resonance
NOTCH_CYCLE, NOTCH_CYCLES = 1e-3, 4  # s, longest cycle of the filter; least cycles in a period
FINE = 20.0  # tolerances, the range of the fine distance in an observation
JERK_TIME = 0.01  # s in which the acceleration builds up, two set-points


def of_the_profile(axis: Axis) -> Bounds:
    """Return the limits that are commissioned for profile position mode."""
    return axis.profile


def of_the_drive(axis: Axis) -> Bounds:
    """Return the limits of the drive with the heaviest payload declared."""
    acceleration = (TORQUE_SHARE * axis.force - axis.lost) / axis.mass(axis.heaviest)
    if acceleration <= 0.0:
        raise ValueError(
            f"{TORQUE_SHARE:.0%} of the maximum torque are {TORQUE_SHARE * axis.force:.0f} N at "
            f"the carriage, friction and weight take {axis.lost:.0f} N: choose a smaller payload "
            f"than {axis.heaviest:g} kg"
        )
    return Bounds(axis.speed, acceleration, acceleration / JERK_TIME)


def trapezoid(way: float, bounds: Bounds) -> Path:
    """Return a path of trapezoidal velocity, triangular if the way is short."""
    sign, way = math.copysign(1.0, way), abs(way)
    rate = bounds.acceleration
    speed = max(min(bounds.velocity, math.sqrt(way * rate)), 1e-12)
    ramp = speed / rate
    total = way / speed + ramp

    def path(times: np.ndarray) -> np.ndarray:
        t = np.clip(times, 0.0, total)
        middle = speed * (t - ramp / 2)
        end = way - 0.5 * rate * (total - t) ** 2
        rising = np.where(t < ramp, 0.5 * rate * t**2, middle)
        return sign * np.where(t < total - ramp, rising, end)

    return path


def time_optimal(way: float, bounds: Bounds, brake: float | None = None) -> Path:
    """Return the shortest jerk-limited path (ruckig).

    Args:
        way: its length with sign (m).
        bounds: its limits.
        brake: deceleration (m/s²); by default that of `bounds`.
    """
    wanted, trajectory = ruckig.InputParameter(1), ruckig.Trajectory(1)
    wanted.current_position, wanted.target_position = [0.0], [way]
    if brake is not None and way > 0.0:
        wanted.min_acceleration = [-brake]
    wanted.max_velocity = [bounds.velocity]
    wanted.max_acceleration = [bounds.acceleration]
    if brake is not None and way <= 0.0:
        wanted.max_acceleration, wanted.min_acceleration = [brake], [-bounds.acceleration]
    wanted.max_jerk = [bounds.jerk]
    ruckig.Ruckig(1).calculate(wanted, trajectory)

    def path(times: np.ndarray) -> np.ndarray:
        inside = np.clip(times, 0.0, trajectory.duration)
        return np.array([trajectory.at_time(float(t))[0][0] for t in inside])

    return path


def shaped(path: Path, frequency: float, ratio: float) -> Path:
    """Apply a zero-vibration shaper (Singer, Seering 1990): pulses half a damped period apart.

    Args:
        path: the path to be shaped.
        frequency: of the vibration, undamped (rad/s).
        ratio: its damping ratio.
    """
    root = math.sqrt(1.0 - ratio**2)
    share = math.exp(-math.pi * ratio / root)
    half = math.pi / (frequency * root)
    return lambda times: (path(times) + share * path(times - half)) / (1.0 + share)


def extra_insensitive(path: Path, frequency: float, ratio: float) -> Path:
    """Apply an EI shaper: three pulses, and `ALLOWED` of the vibration at the resonance.

    Singhose, Seering, Singer: Residual vibration reduction using vector diagrams to generate shaped
    inputs, 1994, for little damping.
    """
    half = math.pi / (frequency * math.sqrt(1.0 - ratio**2))
    outer, inner = (1.0 + ALLOWED) / 4.0, (1.0 - ALLOWED) / 2.0
    return lambda times: (
        outer * path(times) + inner * path(times - half) + outer * path(times - 2 * half)
    )


def notched(path: Path, frequency: float, ratio: float) -> Path:
    """Filter the set-point by the notch ``(s² + 2 ζ ω s + ω²) / (s + ω)²``.

    It is sampled at 1 ms or a quarter of a period by Tustin's rule, exactly at the resonance.

    Args:
        path: the path to be filtered, which begins at rest at 0.
        frequency: of the vibration, undamped (rad/s).
        ratio: its damping ratio.
    """
    cycle = min(NOTCH_CYCLE, 2 * math.pi / frequency / NOTCH_CYCLES)
    k = frequency / math.tan(0.5 * frequency * cycle)
    middle, damping = 2.0 * (frequency**2 - k**2), 2.0 * ratio * frequency * k
    b = np.array([k**2 + damping + frequency**2, middle, k**2 - damping + frequency**2])
    a = np.array([(k + frequency) ** 2, middle, (k - frequency) ** 2])
    (b0, b1, b2), (_, a1, a2) = (b / a[0]).tolist(), (a / a[0]).tolist()

    def filtered(times: np.ndarray) -> np.ndarray:
        grid = np.arange(0.0, times[-1] + cycle, cycle)
        out, one, two = [], 0.0, 0.0
        for x in path(grid).tolist():  # direct form II, transposed
            y = b0 * x + one
            one, two = b1 * x - a1 * y + two, b2 * x - a2 * y
            out.append(y)
        return np.interp(times, grid, out)

    return filtered


def resonance(datasheet: Datasheet, axis: Axis) -> Vibration:
    """Return the nominal vibration behind a held axis. Raises ValueError if nothing can swing."""
    if axis.vibration is None:
        raise ValueError(
            f"a shaper is of no use: the axis of {datasheet.task} has no spring that could "
            "vibrate, use ruckig"
        )
    return axis.vibration


class Profile:
    """Streams a path to the goal, one for each axis, as velocities of the set-points.

    Args:
        datasheet: of the environment.
        seed: not used.
        bounds: gives the limits of the path for an axis.
        shapers: how often the path is shaped for the nominal resonance.
        shape: shapes a path for a frequency and a damping ratio.
    """

    def __init__(
        self, datasheet: Datasheet, seed: int = 0, *,
        bounds: Callable[[Axis], Bounds] = of_the_drive, shapers: int = 0,
        shape: Callable[[Path, float, float], Path] = shaped,
    ):
        self._shape = shape
        self._known = datasheet
        self._plans = [
            (axis, bounds(axis), [resonance(datasheet, axis) for _ in range(shapers)])
            for axis in (datasheet.axis, *datasheet.axes[1:])
        ]
        self._times = np.arange(datasheet.steps + 1) * datasheet.step_time
        self._farthest = [axis.speed * datasheet.step_time for axis in datasheet.axes]

    def plan(self, way: float, bounds: Bounds) -> Path:
        """Return the path before it is shaped: the shortest one."""
        return time_optimal(way, bounds)

    def reset(self, observation: np.ndarray, info: dict[str, Any]) -> None:
        """Plan from the observation at rest."""
        self._places = []
        named_by_axis = self._known.named_by_axis(observation)
        for (axis, bounds, shapers), seen in zip(self._plans, named_by_axis, strict=True):
            path = self.plan(float(seen.distance) * axis.stroke, bounds)
            for shaper in shapers:
                path = self._shape(path, *shaper)
            self._places.append(path(self._times))
        self._step, self._place = 0, [0.0] * len(self._places)

    def act(self, observation: np.ndarray) -> np.ndarray:
        """Return the velocities that bring the set-points to the next points of their paths."""
        self._step = min(self._step + 1, self._known.steps)
        velocities = np.zeros(len(self._places), np.float32)
        for d, (places, farthest) in enumerate(zip(self._places, self._farthest, strict=True)):
            wanted = (places[self._step] - self._place[d]) / farthest
            velocities[d] = min(max(wanted, -1.0), 1.0)
            self._place[d] += float(velocities[d]) * farthest  # the next step makes up for rounding
        return self._known.action(velocity=velocities)


class SCurve(Profile):
    """The drive's speed and acceleration, with ramps of the acceleration fitted to the resonance.

    A ramp that lasts one period of a vibration leaves none of it (its transform is zero there).
    """

    def __init__(self, datasheet: Datasheet, seed: int = 0):
        frequency, _ = resonance(datasheet, datasheet.axis)
        period = 2 * math.pi / frequency

        def fitted(axis: Axis) -> Bounds:
            velocity, acceleration = axis.profile[:2]
            return Bounds(velocity, acceleration, acceleration / period)

        super().__init__(datasheet, bounds=fitted)


class Trapezoid(Profile):
    """The drive's pp profile without jerk limit."""

    def plan(self, way: float, bounds: Bounds) -> Path:
        """Return a path without jerk limit."""
        return trapezoid(way, bounds)


class TunedRuckig(Profile, Tunable):
    """Time-optimal by numbers of the tuner, with an outer loop on the lag.

    The set-point leads the path by a share of the distance by which the axis lagged behind the path
    at the end of the step before.
    """

    NAME = "tuned_ruckig"
    RANGES = {  # noqa: RUF012
        "share": Range(0.4, 1.0, TORQUE_SHARE),  # of the maximum torque, to speed up
        "brake": Range(0.4, 1.0, TORQUE_SHARE),  # and to brake
        "jerk_time": Range(0.002, 0.04, JERK_TIME),  # s, in which the acceleration builds up
        "lead": Range(0.05, 1.0, 0.05),  # share of the distance behind the path
    }

    def __init__(self, datasheet: Datasheet, seed: int = 0):
        super().__init__(datasheet, bounds=of_the_profile)
        self._fine = FINE * datasheet.tolerance

    def chosen(self, way: float) -> dict[str, float]:
        """Return the numbers for a way (m), which are the same for all here."""
        return self.numbers(self._known.task)

    def reset(self, observation: np.ndarray, info: dict[str, Any]) -> None:
        """Plan from the observation at rest."""
        axis, seen = self._known.axis, self._known.named(observation)
        self._way = float(seen.distance) * axis.stroke
        own = self.chosen(self._way)
        self._lead, mass = own["lead"], axis.mass(axis.heaviest)
        rates = [own[name] * axis.force - axis.lost for name in ("share", "brake")]
        rise, fall = (max(rate, 0.05 * axis.force) / mass for rate in rates)
        limits = Bounds(axis.speed, rise, rise / own["jerk_time"])
        self._places = [time_optimal(self._way, limits, fall)(self._times)]
        self._step, self._place = 0, [0.0]

    def act(self, observation: np.ndarray) -> np.ndarray:
        """Return the velocity that brings the set-point to its place at the end of the step."""
        axis, seen, path = self._known.axis, self._known.named(observation), self._places[0]
        left = float(seen.distance_fine) * self._fine
        if abs(float(seen.distance_fine)) >= 1.0:
            left = float(seen.distance) * axis.stroke
        behind = path[self._step] - (self._way - left)
        self._step = min(self._step + 1, self._known.steps)
        wanted = path[self._step] + self._lead * behind - self._place[0]
        velocity = np.float32(min(max(wanted / self._farthest[0], -1.0), 1.0))
        self._place[0] += float(velocity) * self._farthest[0]
        return self._known.action(velocity=velocity)
