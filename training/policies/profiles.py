"""Set-point profiles for point-to-point moves: planned once from the first observation, streamed.

| name | velocity | acceleration | jerk |
|------|----------|--------------|------|
| trapezoid | 6081h | 6083h | unlimited: the drive's pp profile, 6086h = 0 |
| jerk_limited | 6081h | 6083h | 60A4h: the drive's pp profile, 6086h = 3 |
| ruckig | 607Fh | what the maximum torque 6072h leaves for the heaviest payload | that in 10 ms |
| ruckig+zv | as ruckig, through a zero-vibration shaper for the nominal resonance | | |
| ruckig+zvd | through it twice: slower, and less particular about the resonance (ZVD) | | |
"""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import ruckig

from ...envs.linear_axis import GRAVITY
from .known import Known

Path = Callable[[np.ndarray], np.ndarray]  # times (s) -> positions along the move (m)
# What the controller needs to hold the path is left to it.
TORQUE_SHARE = 0.8
JERK_TIME = 0.01  # s, in which the acceleration builds up; two set-points


class Bounds(NamedTuple):
    """Of a profile."""

    velocity: float  # m/s
    acceleration: float  # m/s²
    jerk: float  # m/s³


def of_the_profile(known: Known) -> Bounds:
    """Commissioned for profile position mode."""
    p = known.nominal
    return Bounds(p.max_velocity, p.max_acceleration, p.max_jerk)


def of_the_drive(known: Known) -> Bounds:
    """The most the drive can do with the heaviest payload declared."""
    p = known.nominal
    slope = math.radians(p.inclination)
    mass = known.mass(known.heaviest)
    carried = p.carriage_mass + known.heaviest
    lost = carried * GRAVITY * abs(math.sin(slope))
    lost += max(p.coulomb_friction, p.static_friction)
    lost += p.chain_drag + p.chain_drag_growth * known.stroke
    lost += p.viscous_friction * known.speed
    acceleration = (TORQUE_SHARE * known.force - lost) / mass
    if acceleration <= 0.0:
        raise ValueError(
            f"{TORQUE_SHARE:.0%} of the maximum torque are {TORQUE_SHARE * known.force:.0f} N at "
            f"the carriage, friction and weight take {lost:.0f} N: choose a smaller payload than "
            f"{known.heaviest:g} kg"
        )
    return Bounds(known.speed, acceleration, acceleration / JERK_TIME)


def trapezoid(way: float, bounds: Bounds) -> Path:
    """Trapezoidal velocity; a triangle where the way is short."""
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


def time_optimal(way: float, bounds: Bounds) -> Path:
    """Jerk-limited, as short as it can be (ruckig)."""
    wanted, trajectory = ruckig.InputParameter(1), ruckig.Trajectory(1)
    wanted.current_position, wanted.target_position = [0.0], [way]
    wanted.max_velocity = [bounds.velocity]
    wanted.max_acceleration = [bounds.acceleration]
    wanted.max_jerk = [bounds.jerk]
    ruckig.Ruckig(1).calculate(wanted, trajectory)

    def path(times: np.ndarray) -> np.ndarray:
        inside = np.clip(times, 0.0, trajectory.duration)
        return np.array([trajectory.at_time(float(t))[0][0] for t in inside])

    return path


def shaped(path: Path, frequency: float, ratio: float) -> Path:
    """Zero-vibration shaper (Singer, Seering 1990): two pulses half a damped period apart.

    Args:
        path: to be shaped.
        frequency: of the vibration, undamped (rad/s).
        ratio: its damping ratio.
    """
    root = math.sqrt(1.0 - ratio**2)
    share = math.exp(-math.pi * ratio / root)
    half = math.pi / (frequency * root)
    return lambda times: (path(times) + share * path(times - half)) / (1.0 + share)


def resonance(known: Known) -> tuple[float, float]:
    """Nominal vibration against a motor that is held: frequency (rad/s), damping ratio."""
    p = known.nominal
    if p.stiffness > 0.0:
        stiffness, damping, mass = p.stiffness, p.structural_damping, p.payload
    elif p.transmission_stiffness > 0.0:
        stiffness, damping = p.transmission_stiffness, p.transmission_damping
        mass = p.payload + p.carriage_mass
    else:
        raise ValueError(
            f"a shaper is of no use: the axis of {known.task} has no spring that could vibrate, "
            "use ruckig"
        )
    return math.sqrt(stiffness / mass), damping / (2.0 * math.sqrt(stiffness * mass))


class Profile:
    """Streams a path to the goal as velocities of the set-point.

    Args:
        known: of the environment.
        plan: way (m) -> path.
    """

    def __init__(self, known: Known, plan: Callable[[float], Path]):
        self._known, self._plan = known, plan
        self._times = np.arange(known.steps + 1) * known.step_time

    def reset(self, observation: np.ndarray, info: dict[str, Any]) -> None:
        """Plan from what is seen at rest."""
        way = float(observation[0]) * self._known.stroke  # goal minus position
        self._places = self._plan(way)(self._times)
        self._step, self._place = 0, 0.0

    def act(self, observation: np.ndarray) -> np.ndarray:
        """The velocity that brings the set-point to the next place of the path."""
        self._step = min(self._step + 1, self._known.steps)
        farthest = self._known.speed * self._known.step_time
        wanted = (self._places[self._step] - self._place) / farthest
        action = np.zeros(self._known.actions, np.float32)
        action[0] = min(max(wanted, -1.0), 1.0)
        self._place += float(action[0]) * farthest  # what rounding took comes in the next step
        return action


def trapezoid_policy(known: Known, seed: int = 0) -> Profile:
    """The drive's pp profile without jerk limit."""
    bounds = of_the_profile(known)
    return Profile(known, lambda way: trapezoid(way, bounds))


def jerk_limited_policy(known: Known, seed: int = 0) -> Profile:
    """The drive's pp profile with jerk limit."""
    bounds = of_the_profile(known)
    return Profile(known, lambda way: time_optimal(way, bounds))


def ruckig_policy(known: Known, seed: int = 0) -> Profile:
    """Time-optimal at the drive's limits."""
    bounds = of_the_drive(known)
    return Profile(known, lambda way: time_optimal(way, bounds))


def ruckig_zv_policy(known: Known, seed: int = 0) -> Profile:
    """The same, shaped."""
    bounds, (frequency, ratio) = of_the_drive(known), resonance(known)
    return Profile(known, lambda way: shaped(time_optimal(way, bounds), frequency, ratio))


def ruckig_zvd_policy(known: Known, seed: int = 0) -> Profile:
    """Shaped twice."""
    bounds, place = of_the_drive(known), resonance(known)
    return Profile(known, lambda way: shaped(shaped(time_optimal(way, bounds), *place), *place))
