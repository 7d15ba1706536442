"""Input shaping with a resonance that is identified during the first motion.

The first pulse of an input shaper does not depend on the resonance, only slightly on its damping
ratio: the axis starts with a share of the fastest path. By the time of the second pulse, half a
period later, the resonance is known from the sensor of the load (as in Pereira, Trapero, Díaz,
Feliu 2012, Adaptive input shaping for single-link flexible manipulators). The time of each pulse
follows from the resonance identified by then.

Each resonance of a bank predicts the deflection and its rate a step ahead from the step before and
the acceleration of the axis between them, exactly if the acceleration is constant in the step. The
share of the acceleration that acts on the load is fitted by least squares: it is 1 for a load on a
spring and depends on the length of a cable. Steps at the end of the sensor's range are left out.
The resonance is the minimum of a parabola through the least sum of squared errors and its
neighbours. `robust` adds a second pulse (ZVD), which ends half a period later but is less
sensitive.

The residual vibration after the path is damped by the state feedback of `lqr` for the identified
resonance.
"""

import math
from functools import lru_cache
from typing import Any

import numpy as np

from .datasheet import Axis, Bounds, Datasheet, Vibration
from .lqr import gain, sensed
from .numbers import Range, Tunable
from .profiles import resonance, time_optimal

LOWEST, HIGHEST, MODELS = 0.4, 2.6, 97  # of the nominal resonance, in equal ratios
SURE = 4  # steps of motion before the identified resonance is used
MOVING = 1e-4  # of the top speed, the least change of velocity that counts as motion
FULL = 0.999  # of the range of the sensor, beyond which its value is not used
FINE = 1e-3  # s, spacing of the table of a path


@lru_cache(maxsize=64)
def bank(frequency: float, ratio: float, dt: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return resonances (rad/s) and what a step and a unit acceleration make of the swinging load.

    Shapes ``(n,)``, ``(n, 2, 2)``, ``(n, 2)``.
    """
    w = frequency * np.geomspace(LOWEST, HIGHEST, MODELS)
    damped = w * math.sqrt(1.0 - ratio**2)
    decay, share = np.exp(-ratio * w * dt), ratio * w / damped
    s, c = decay * np.sin(damped * dt), decay * np.cos(damped * dt)
    rows = [[c + share * s, s / damped], [-(w**2) / damped * s, c - share * s]]
    swing = np.array(rows).transpose(2, 0, 1)
    pushed = (np.array([1.0, 0.0]) - swing[:, :, 0]) * (-1.0 / w**2)[:, None]
    return w, swing, pushed


class Identified:
    """The controller of one axis: its path, the resonance identified so far, and the pulses."""

    def __init__(self, datasheet: Datasheet, axis: Axis, robust: bool, numbers: dict[str, float]):
        self._sensor = sensed(datasheet, axis)
        self._axis, self._dt = axis, datasheet.step_time
        self._nominal = resonance(datasheet, axis)
        self._frequencies, self._swing, self._pushed = bank(*self._nominal, self._dt)
        rate = numbers["share"] * axis.force - axis.lost
        rate = max(rate, 0.05 * axis.force) / axis.mass(axis.heaviest)
        self._bounds = Bounds(axis.speed, rate, rate / numbers["jerk_time"])
        incline = axis.weight / (axis.carriage + axis.payload)
        self._rest = -incline / self._nominal.frequency**2
        self._steps = datasheet.steps
        decay = math.exp(-math.pi * self._nominal.ratio / math.sqrt(1.0 - self._nominal.ratio**2))
        pulses = np.array([1.0, 2.0 * decay, decay**2] if robust else [1.0, decay])
        self._shares = pulses / pulses.sum()

    def reset(self, seen: Any) -> None:
        """Plan from the observation of the axis at rest."""
        way = float(seen.distance) * self._axis.stroke - self._rest
        self._times = np.arange(0.0, (self._steps + 2) * self._dt, FINE)
        self._path = time_optimal(way, self._bounds)(self._times)
        self._sums = np.zeros((3, MODELS))  # of what is left over, its products, the inputs
        self.frequency = self._nominal.frequency
        self._moved, self._step = 0, 0
        self._late = np.full(len(self._shares), math.inf)  # s, when each pulse began
        self._late[0] = 0.0
        self._way, self._end = way, float(self._times[np.abs(self._path - way) > 1e-9].max())
        self._place = self._velocity = self._last = 0.0
        self._gain: np.ndarray | None = None
        self._before = self._look(seen)

    def _look(self, seen: Any) -> tuple[np.ndarray, float, bool]:
        """Return deflection and rate, velocity of the axis (m, m/s), and if all are in range."""
        share, rate = float(seen[self._sensor.name]), float(seen[self._sensor.rate_name])
        state = [share * self._sensor.deflection - self._rest, rate * self._sensor.rate]
        whole = max(abs(share), abs(rate)) < FULL
        return np.array(state), float(seen.velocity) * self._axis.fastest, whole

    def identify(self, seen: Any) -> None:
        """Process the step from the last observation to this one."""
        (state, velocity, known), (now, faster, whole) = self._before, self._look(seen)
        self._before = now, faster, whole
        if not (known and whole):
            return
        pull = (faster - velocity) / self._dt
        scale = np.array([self._nominal.frequency, 1.0])
        left = (now - self._swing @ state) * scale
        inputs = self._pushed * pull * scale
        self._sums += [(left**2).sum(axis=1), (left * inputs).sum(axis=1), (inputs**2).sum(axis=1)]
        self._moved += abs(faster - velocity) > MOVING * self._axis.fastest
        if self._moved < SURE:
            return
        leftover, products, squares = self._sums
        errors = leftover - products**2 / np.maximum(squares, 1e-30)
        k = int(errors.argmin())
        between = 0.0
        if 0 < k < MODELS - 1:
            before, here, after = errors[k - 1 : k + 2]
            bend = before - 2.0 * here + after
            between = 0.5 * (before - after) / bend if bend > 0.0 else 0.0
        ratio = math.log(HIGHEST / LOWEST) / (MODELS - 1)
        self.frequency = float(self._frequencies[k]) * math.exp(ratio * between)

    def act(self, seen: Any) -> float:
        """Return the set-point at the end of the step, relative to its start (m)."""
        if self._step:
            self.identify(seen)
        self._step += 1
        now = self._step * self._dt
        half = math.pi / (self.frequency * math.sqrt(1.0 - self._nominal.ratio**2))
        for pulse in range(1, len(self._late)):
            if math.isinf(self._late[pulse]) and now >= pulse * half:
                self._late[pulse] = pulse * half
        begun = np.maximum(now - self._late, 0.0)
        place = float(self._shares @ np.interp(begun, self._times, self._path))
        velocity = (place - self._place) / self._dt
        if now - self._late[-1] > self._end + self._dt:
            velocity = self._velocity + self.regulated()
        self._last, self._velocity = velocity - self._velocity, velocity
        self._place += velocity * self._dt
        return self._place

    def regulated(self) -> float:
        """Return the change of velocity by state feedback (m/s); it is 0 at rest at the goal."""
        if self._gain is None:
            self._gain = gain(Vibration(self.frequency, self._nominal.ratio), self._dt)
        (deflection, rate), *_ = self._before
        away = self._place - self._way
        state = np.array([away, self._velocity, deflection, rate, self._last])
        most = self._bounds.acceleration * self._dt
        return min(max(-float(self._gain @ state), -most), most)


class IdentifiedZv(Tunable):
    """Identifies and shapes each axis separately.

    Args:
        datasheet: of the environment.
        seed: of nothing.
    """

    NAME, ROBUST = "identified+zv", False
    RANGES = {  # noqa: RUF012
        "share": Range(0.4, 1.0, 0.8),  # of the maximum torque
        "jerk_time": Range(0.002, 0.04, 0.01),  # s, in which the acceleration builds up
    }

    def __init__(self, datasheet: Datasheet, seed: int = 0):
        self._known, found = datasheet, self.numbers(datasheet.task)
        self._axes = [
            Identified(datasheet, axis, self.ROBUST, found)
            for axis in (datasheet.axis, *datasheet.axes[1:])
        ]
        self._farthest = [axis.speed * datasheet.step_time for axis in datasheet.axes]

    def reset(self, observation: np.ndarray, info: dict[str, Any]) -> None:
        """Plan the paths."""
        self._places = [0.0] * len(self._axes)
        for one, seen in zip(self._axes, self._known.named_by_axis(observation), strict=True):
            one.reset(seen)

    def act(self, observation: np.ndarray) -> np.ndarray:
        """Return velocities that bring the set-points to the next points of their paths."""
        velocities = np.zeros(len(self._axes), np.float32)
        seen_of_axes = self._known.named_by_axis(observation)
        for d, (one, seen) in enumerate(zip(self._axes, seen_of_axes, strict=True)):
            wanted = (one.act(seen) - self._places[d]) / self._farthest[d]
            velocities[d] = min(max(wanted, -1.0), 1.0)
            self._places[d] += float(velocities[d]) * self._farthest[d]
        return self._known.action(velocity=velocities)


class IdentifiedZvd(IdentifiedZv):
    """Identifies the resonance and shapes with a ZVD shaper."""

    NAME, ROBUST = "identified+zvd", True
