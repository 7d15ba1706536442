"""Reference trajectories along one axis: sampled tables of position, velocity and acceleration.

| name | what it is |
|------|------------|
| step | a small jump of the position, at most 2 mm and half the travel of one sample |
| s_curve | one jerk-limited move to a random position |
| sine | whole periods of a sine |
| sweep | a sine whose frequency rises |
| pick_and_place | back and forth between two positions, with a rest at each |
| way_points | through random or given positions, with a short rest at each |

All begin and end at rest and stay within `Limits`; moves are time-optimal (ruckig). All random
numbers come from the given generator.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from itertools import repeat
from typing import NamedTuple

import numpy as np
import ruckig

FREQUENCIES = (0.5, 8.0)  # Hz, of sine and sweep
SAMPLES_PER_PERIOD = 20  # smallest number
SHARES = (0.4, 1.0)  # range of the share of the limits of motion that is used
HIGHEST_STEP = 2e-3  # m
HANDLING = 0.1  # s, rest at each end of pick and place
PAUSE = 0.02  # s, rest at each way-point


class Limits(NamedTuple):
    """Limits of a reference."""

    low: float  # m
    high: float  # m
    velocity: float  # m/s
    acceleration: float  # m/s²
    jerk: float  # m/s³, of moves between positions


class Reference(NamedTuple):
    """Samples of a trajectory, each of shape ``(n,)``."""

    position: np.ndarray  # m
    velocity: np.ndarray  # m/s
    acceleration: np.ndarray  # m/s²


Maker = Callable[[np.random.Generator, Limits, float, np.ndarray], Reference]


def _leg(start: float, goal: float, limits: Limits) -> ruckig.Trajectory:
    """Plan a move from rest to rest."""
    wanted, trajectory = ruckig.InputParameter(1), ruckig.Trajectory(1)
    wanted.current_position, wanted.target_position = [start], [goal]
    wanted.max_velocity = [limits.velocity]
    wanted.max_acceleration = [limits.acceleration]
    wanted.max_jerk = [limits.jerk]
    ruckig.Ruckig(1).calculate(wanted, trajectory)
    return trajectory


def visit(
    goals: Iterator[float], pause: float, start: float, limits: Limits, times: np.ndarray
) -> Reference:
    """Travel from goal to goal with a `pause` (s) before each, as far as `times` (s) allow.

    The first goal is moved closer until it is reached in time; a pause lasts at most a tenth of the
    time.
    """
    pause = min(pause, 0.1 * times[-1])
    reference = Reference(np.full(len(times), start), np.zeros(len(times)), np.zeros(len(times)))
    begin, place = pause, start
    for goal in goals:
        leg = _leg(place, goal, limits)
        while begin == pause and begin + leg.duration > times[-1]:
            goal = place + 0.5 * (goal - place)
            leg = _leg(place, goal, limits)
        end = begin + leg.duration
        if end > times[-1]:
            break
        first, last = np.searchsorted(times, (begin, end))
        for i in range(first, last):
            (x,), (v,), (a,) = leg.at_time(times[i] - begin)
            reference.position[i], reference.velocity[i], reference.acceleration[i] = x, v, a
        reference.position[last:] = goal
        begin, place = end + pause, goal
    return reference


def _shared(generator: np.random.Generator, limits: Limits) -> Limits:
    """Reduce limits to a random share."""
    velocity, acceleration = generator.uniform(*SHARES, 2)
    return limits._replace(
        velocity=velocity * limits.velocity, acceleration=acceleration * limits.acceleration
    )


def _step(generator, limits, start, times):
    highest = min(0.5 * limits.velocity * (times[1] - times[0]), HIGHEST_STEP)
    height = generator.uniform(0.2, 1.0) * highest * generator.choice((-1.0, 1.0))
    if not limits.low <= start + height <= limits.high:
        height = -height
    at = int(len(times) * generator.uniform(0.1, 0.3))
    position = np.full(len(times), start)
    position[at:] += height
    return Reference(position, np.zeros(len(times)), np.zeros(len(times)))


def _s_curve(generator, limits, start, times):
    goal = generator.uniform(limits.low, limits.high)
    return visit(iter([goal]), PAUSE, start, _shared(generator, limits), times)


def _oscillate(generator, limits, start, times, first, last):
    """Whole periods of ``1 - cos`` with a frequency from `first` to `last` (Hz)."""
    duration = times[-1]
    rate = 2 * math.pi * (last - first) / duration  # of the angular frequency, rad/s²
    highest = 2 * math.pi * last
    room = max(limits.high - start, start - limits.low)
    sign = 1.0 if limits.high - start == room else -1.0
    amplitude = sign * min(
        room / 2, limits.velocity / highest, limits.acceleration / (highest**2 + rate)
    )
    phase = 2 * math.pi * first * times + rate * times**2 / 2
    omega = 2 * math.pi * first + rate * times
    moving = phase < 2 * math.pi * math.floor(phase[-1] / (2 * math.pi) + 1e-9)
    # the functions of NumPy differ in the last bit between processors
    sine, cosine = (np.array([*map(of, phase.tolist())]) for of in (math.sin, math.cos))
    return Reference(
        start + amplitude * (1.0 - cosine) * moving, amplitude * omega * sine * moving,
        amplitude * (omega**2 * cosine + rate * sine) * moving,
    )


def _frequencies(generator, times):
    """Draw two frequencies (Hz), the lower first, whose periods fit and have enough samples."""
    finest = 1 / (SAMPLES_PER_PERIOD * (times[1] - times[0]))
    low, high = (max(min(f, finest), 1 / times[-1]) for f in FREQUENCIES)
    return sorted(map(math.exp, generator.uniform(math.log(low), math.log(high), 2)))


def _sine(generator, limits, start, times):
    frequency = _frequencies(generator, times)[0]
    return _oscillate(generator, _shared(generator, limits), start, times, frequency, frequency)


def _sweep(generator, limits, start, times):
    low, high = _frequencies(generator, times)
    return _oscillate(generator, _shared(generator, limits), start, times, low, high)


def _pick_and_place(generator, limits, start, times):
    pick, place = generator.uniform(limits.low, limits.high, 2)
    goals = (goal for pair in repeat((pick, place)) for goal in pair)
    return visit(goals, HANDLING, start, _shared(generator, limits), times)


def _way_points(generator, limits, start, times):
    points = generator.uniform(limits.low, limits.high, 8)
    return visit(iter(points.tolist()), PAUSE, start, _shared(generator, limits), times)


REFERENCES: dict[str, Maker] = {
    "step": _step,
    "s_curve": _s_curve,
    "sine": _sine,
    "sweep": _sweep,
    "pick_and_place": _pick_and_place,
    "way_points": _way_points,
}


def make_reference(
    name: str, generator: np.random.Generator, limits: Limits, start: float, times: np.ndarray,
    way_points: Sequence[float] | None = None,
) -> Reference:
    """Return a random trajectory of the kind `name`, or one through given `way_points` (m).

    Args:
        name: key of `REFERENCES`.
        generator: source of all random numbers.
        limits: limits of position and motion.
        start: start position (m).
        times: times of the samples, evenly spaced from 0 on (s), shape ``(n,)``.
        way_points: positions visited in this order at the limits of motion, as far as time allows.
    """
    if way_points is not None:
        return visit(iter(way_points), PAUSE, start, limits, times)
    return REFERENCES[name](generator, limits, start, times)
