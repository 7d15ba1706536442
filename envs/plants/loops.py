"""Gains of the cascade for a known plant: the stiffest loops that keep their margins.

The velocity loop is a PI controller with an action time of `SHAPES` over its crossover (symmetrical
optimum: 3). The position loop keeps a phase margin of at least 60 degrees, so that a move does not
overshoot. Of all gains that keep the margins, those with the greatest stiffness kp (kv + 1 / Ti)
are chosen: the torque against a disturbance that is slow compared with the loops.

Commissioning takes the plant from the model (`shaft`), `tune` from a measurement. Both use this
module, so a commissioned axis is already tuned.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ...drive.drive import Drive
from ...drive.kernel.cascade import PID_FILTER, Structure

SHAPES = (3.0, 4.0, 5.0, 7.0, 10.0)  # action time times crossover
SEPARATIONS = 2.0 * 1.1 ** np.arange(32)  # crossover over position gain, 2..38
WITHOUT_OVERSHOOT = 60.0  # degree
STEP = 1.06  # ratio of the crossovers that are tried
LOWEST = 0.2  # Hz, lowest crossover; nothing is measured below
HIGHEST = 0.35  # of the position-controller rate, highest crossover
EASED = np.array([1.0, 0.75, 0.5])  # shares of the highest velocity gain that are tried
EASES = 0.8 ** np.arange(12)  # shares of the velocity gain that are tried for a PID controller
RESERVE_GAIN, RESERVE_PHASE = 1.0, 3.0  # dB and degree beyond the required margins
BEGIN = math.radians(225)  # phase lag at which a loop with two integrators may begin


@dataclass(frozen=True)
class Gains:
    """Gains of the cascade in SI units."""

    velocity_gain: float  # Nm·s/rad
    integral_time: float  # s; 0: no integral action
    position_gain: float  # 1/s
    # of a PID position controller with torque as its output (Nm/rad, Nm/(rad·s), Nm·s/rad)
    pid: tuple[float, float, float] | None = None

    def __str__(self) -> str:
        position = f"position {self.position_gain:.4g} 1/s"
        if self.pid is not None:
            p, i, d = self.pid
            position = f"PID {p:.4g} Nm/rad, {i:.4g} Nm/(rad·s), {d:.4g} Nm·s/rad"
        return (
            f"velocity {self.velocity_gain:.4g} Nm·s/rad, {self.integral_time * 1e3:.3g} ms, "
            f"{position}"
        )

    @property
    def cascade(self) -> tuple[list[float], list[float], list[float]]:
        """Velocity gain, integral time and position gain, each as an array of one."""
        return [self.velocity_gain], [self.integral_time], [self.position_gain]

    @property
    def as_pid(self) -> tuple[float, float, float]:
        """The PID controller that is equivalent to the cascade with velocity feed-forward."""
        rate = 1 / self.integral_time if self.integral_time > 0.0 else 0.0
        kp, kv = self.velocity_gain, self.position_gain
        return kp * (kv + rate), kp * kv * rate, kp

    @property
    def stiffness(self) -> float:
        """Torque per deviation against a disturbance slower than the loops (Nm/rad)."""
        integral = 1 / self.integral_time if self.integral_time > 0.0 else 0.0
        return self.velocity_gain * (self.position_gain + integral)


OBJECTS = {  # object: the gain that it holds, and its number of units per SI unit
    "velocity_control_gain": ("velocity_gain", lambda axis: 1 / axis.velocity_gain_unit),
    "velocity_control_time": ("integral_time", lambda axis: 1e6),
    "position_control_gain": ("position_gain", lambda axis: 1 / axis.position_gain_unit),
}


PID_OBJECTS = {"pid_gain": 1e6, "pid_integral_gain": 1e3, "pid_derivative_gain": 1e6}


def gains_of(drive: Drive) -> Gains:
    """The present gains of a drive."""
    axis = drive.axis
    raw = {name: float(getattr(axis.od, name)) for name in OBJECTS}
    values: dict[str, Any] = {to: raw[name] / per(axis) for name, (to, per) in OBJECTS.items()}
    if axis.od.control_structure == Structure.PID:
        values["pid"] = tuple(float(axis.od[name]) / n for name, n in PID_OBJECTS.items())
    return Gains(**values)


def in_units(drive: Drive, gains: Gains) -> dict[str, int]:
    """Convert gains to units of the drive by object, within the ranges of the objects."""
    values = {}
    for name, (of, per) in OBJECTS.items():
        value = round(getattr(gains, of) * per(drive.axis))
        row = drive.model.names.get(name)
        if row is not None:
            value = int(min(max(value, row.minimum), row.maximum))
        values[name] = value
    if drive.axis.od.control_structure == Structure.PID:
        for (name, n), gain in zip(PID_OBJECTS.items(), gains.pid or gains.as_pid, strict=True):
            values[name] = min(round(gain * n), 0xFFFFFFFF)
    return values


def ranges(drive: Drive) -> dict[str, tuple[float, float]]:
    """Lowest and highest value of each field of `Gains` (SI) that the drive accepts."""
    found = {}
    for name, (of, per) in OBJECTS.items():
        row, unit = drive.model.names.get(name), 1 / per(drive.axis)
        low, high = (row.minimum, row.maximum) if row is not None else (0, math.inf)
        found[of] = max(low, 1) * unit, high * unit
    return found


def measurable(allowed: Mapping[str, tuple[float, float]]) -> dict[str, tuple[float, float]]:
    """Restrict `ranges` to gains that a measurement can confirm.

    A position loop crosses over at its gain, which is therefore not below `LOWEST`. The action time
    is not longer than its inverse, so that the integral action overcomes friction in time.
    """
    rate = 2 * math.pi * LOWEST
    (shortest, longest), (low, high) = allowed["integral_time"], allowed["position_gain"]
    return {
        **allowed, "integral_time": (shortest, min(longest, 1 / rate)),
        "position_gain": (max(low, rate), high),
    }


@dataclass(frozen=True)
class Filters:
    """Filters of the torque command, as `kernel.filters` computes them."""

    cycle: float  # s, velocity controller
    low_pass: float = 0.0  # s; 0: none
    notches: tuple[tuple[float, float, float], ...] = ()  # frequency (Hz), damping, depth
    observed: bool = False  # an observer estimates the speed, also for the D part of a PID

    def __call__(self, frequencies: np.ndarray) -> np.ndarray:
        """Return the response at these frequencies (Hz), shape ``(n,)``."""
        z = np.exp(2j * np.pi * frequencies * self.cycle)
        response = np.ones(len(z), complex)
        if self.low_pass > 0.0:
            share = -math.expm1(-self.cycle / self.low_pass)
            response = response * share / (1 - (1 - share) / z)
        for frequency, damping, depth in self.notches:
            s = (z - 1) / (z + 1) / math.tan(math.pi * frequency * self.cycle)
            response = response * (s * s + 2 * damping * depth * s + 1)
            response = response / (s * s + 2 * damping * s + 1)
        return response


def filters_of(drive: Drive) -> Filters:
    """The filters of the torque command of a drive."""
    od, cycle = drive.axis.od, float(drive.model.cycle_time["velocity"])
    rows = zip(od.notch_frequency, od.notch_damping, od.notch_depth, strict=True)
    notches = ((0.1 * float(f), 1e-3 * float(d), 1e-3 * float(g)) for f, d, g in rows)
    return Filters(
        cycle, float(od.torque_command_filter_time) * 1e-6,
        tuple(each for each in notches if 0.0 < each[0] < 0.49 / cycle), od.observer_bandwidth > 0,
    )


# ranges of gains that no drive bounds
ANY = dict.fromkeys(("velocity_gain", "integral_time", "position_gain"), (0.0, math.inf))


@dataclass(frozen=True)
class RequiredMargins:
    """The smallest permitted margins of both loops."""

    gain: float = 6.0  # dB
    phase: float = 35.0  # degree


Margin = tuple[float, float, bool]  # gain (dB), phase (degree), stable


@dataclass(frozen=True)
class LoopPlant:
    """A plant as measured at the shaft of its drive; arrays have shape ``(n,)``."""

    frequencies: np.ndarray  # Hz, from far below the crossovers to the Nyquist frequency
    velocity: np.ndarray  # complex, measured velocity over torque command (rad/s/Nm)
    position: np.ndarray  # complex, measured position over torque command (rad/Nm)
    cycle: float  # s, velocity controller
    cycles: int  # velocity cycles in a position cycle
    inertia: float  # kg·m², total
    resonances: tuple[tuple[float, float], ...] = ()  # antiresonance and resonance (Hz)
    filters: Filters | None = None

    def velocity_loop(self, kp: ArrayLike, time: ArrayLike) -> np.ndarray:
        """Open loops of PI controllers of shape ``(m,)``, shape ``(m, n)``."""
        return self._controller(kp, time) * self.velocity

    def position_loop(self, kp: ArrayLike, time: ArrayLike, kv: ArrayLike) -> np.ndarray:
        """Open loops of position controllers with the velocity loop closed, shape ``(m, n)``."""
        z = np.exp(2j * np.pi * self.frequencies * self.cycle)
        hold = sum(z**-k for k in range(self.cycles)) / self.cycles
        controller = self._controller(kp, time)
        closed = controller / (1 + controller * self.velocity) * self.position
        return np.asarray(kv)[:, None] * hold * closed

    def _controller(self, kp: ArrayLike, time: ArrayLike) -> np.ndarray:
        z = np.exp(2j * np.pi * self.frequencies * self.cycle)
        kp, time = np.asarray(kp)[:, None], np.asarray(time)[:, None]
        filtered = 1.0 if self.filters is None else self.filters(self.frequencies)
        integral = np.where(time > 0.0, self.cycle / np.maximum(time, self.cycle), 0.0)
        return filtered * kp * (1 + integral / (z - 1))

    def pid_loop(self, pid: tuple[float, float, float]) -> np.ndarray:
        """Open loop of a PID position controller, shape ``(n,)``."""
        filters, cycle = self.filters or Filters(self.cycle), self.cycle
        gain, integral, derivative = pid
        z, share = np.exp(2j * np.pi * self.frequencies * cycle), 1.0
        if gain > 0.0 and derivative > 0.0:
            share = -math.expm1(-cycle * PID_FILTER * gain / derivative)
        difference = (1 - 1 / z) / cycle * share / (1 - (1 - share) / z) * self.position
        if filters.observed:
            difference = self.velocity
        straight = (gain + integral * cycle / (z - 1)) * self.position
        return filters(self.frequencies) * (straight + derivative * difference)

    def margins(self, gains: Gains) -> tuple[Margin, Margin]:
        """Gain (dB), phase (degree) and stability of the velocity and of the position loop."""
        velocity = margins_of(self.frequencies, self.velocity_loop(*gains.cascade[:2]))
        loops = self.position_loop(*gains.cascade)[:, self.below]
        if gains.pid is not None:
            loops = self.pid_loop(gains.pid)[None, self.below]
        position = margins_of(self.frequencies[self.below], loops)
        (a, b, c), (d, e, f) = ([x[0] for x in each] for each in (velocity, position))
        inner = bool(c) or gains.pid is not None  # a PID controller has no inner loop
        return (float(a), float(b), bool(c)), (float(d), float(e), bool(f and inner))

    @property
    def below(self) -> np.ndarray:
        """Whether a frequency is below the Nyquist frequency of the position loop."""
        return self.frequencies < 0.49 / (self.cycle * self.cycles)

    def crossover(self, gains: Gains) -> float:
        """Highest frequency (Hz) at which the velocity loop is 1."""
        loop = abs(self.velocity_loop(*gains.cascade[:2])[0])
        return float(self.frequencies[loop > 1].max(initial=0.0))


def margins_of(
    frequencies: np.ndarray, loops: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Gain margins (dB), phase margins (degree) and stability of open loops, shape ``(m, n)``.

    Gain (dB) and phase are interpolated linearly, so the grid has to be fine where a loop is not
    smooth. A loop is stable if it does not encircle -1 (Nyquist); it must have no unstable poles
    other than integrators.
    """
    decibel = 20 * np.log10(np.maximum(np.abs(loops), 1e-15))
    step = np.angle(loops[:, 1:] / loops[:, :-1])
    behind = np.angle(-loops)  # of -180 degrees

    def least(crossed: np.ndarray, share: np.ndarray, value: np.ndarray) -> np.ndarray:
        between = value[:, :-1] + share * (value[:, 1:] - value[:, :-1])
        return np.where(crossed, np.abs(between), np.inf).min(axis=1)

    after = behind[:, :-1] + step
    crossed = (behind[:, :-1] * after <= 0.0) & (step != 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.nan_to_num(-behind[:, :-1] / step)
        gain = least(crossed, np.clip(share, 0, 1), decibel)
        crossed = decibel[:, :-1] * decibel[:, 1:] <= 0.0
        share = np.nan_to_num(-decibel[:, :-1] / (decibel[:, 1:] - decibel[:, :-1]))
        share = np.clip(share, 0, 1)
        at = np.where(crossed, np.abs(behind[:, :-1] + share * step), np.inf)
        phase = np.degrees(at.min(axis=1))
    turned = np.unwrap(np.angle(1 + loops), axis=1)
    begin = (turned[:, 0] + BEGIN) % (2 * math.pi) - BEGIN
    return gain, phase, abs(begin + turned[:, -1] - turned[:, 0]) < math.pi / 2


def fastest(
    plants: Sequence[LoopPlant], asked: RequiredMargins, allowed: Mapping[str, tuple[float, float]],
    ease: float = 1.0,
) -> Gains | None:
    """Return the stiffest gains that keep the margins with a reserve; None without any.

    Args:
        plants: a plant, or the same in several situations: the loops with all of them keep the
            margins.
        asked: required margins.
        allowed: gains that the drive accepts, as `ranges` returns them.
        ease: share of the highest velocity gain that is used.
    """
    first = plants[0]
    top = 2 * math.pi * HIGHEST / (first.cycle * first.cycles)
    count = max(math.ceil(math.log(top / (2 * math.pi * LOWEST)) / math.log(STEP)), 1)
    crossovers = top * STEP ** -np.arange(count)
    best: Gains | None = None
    for shape in SHAPES:
        tried = _within(allowed, first.inertia, crossovers, shape)
        kept = _velocity_kept(plants, asked, *tried) & (tried[0] >= allowed["velocity_gain"][0])
        if not kept.any():
            continue
        crossover = np.repeat(crossovers[kept.argmax()] * EASED * ease, len(SEPARATIONS))
        kp, time = _within(allowed, first.inertia, crossover, shape)
        kv = np.clip(crossover / np.tile(SEPARATIONS, len(EASED)), *allowed["position_gain"])
        kept = _velocity_kept(plants, asked, kp, time) & _position_kept(plants, asked, kp, time, kv)
        for k in np.flatnonzero(kept):
            gains = Gains(float(kp[k]), float(time[k]), float(kv[k]))
            if best is None or gains.stiffness > best.stiffness:
                best = gains
    return best


def fastest_pid(
    plants: Sequence[LoopPlant], asked: RequiredMargins, allowed: Mapping[str, tuple[float, float]],
    ease: float = 1.0,
) -> Gains | None:
    """Return the fastest PID position controller that keeps the margins; None without any."""
    for share in ease * EASES:
        found = fastest(plants, asked, allowed, share)
        if found is None:
            return None
        found = replace(found, pid=found.as_pid)
        loops = [plant.margins(found)[1] for plant in plants]
        if all(
            stable and gain >= asked.gain + RESERVE_GAIN and phase >= asked.phase + RESERVE_PHASE
            for gain, phase, stable in loops
        ):
            return found
    return None


def _within(allowed, inertia, crossover, shape) -> tuple[np.ndarray, np.ndarray]:
    """Velocity gains and action times for crossovers of a rigid plant, in the allowed ranges."""
    kp = np.minimum(inertia * crossover, allowed["velocity_gain"][1])
    return kp, np.clip(shape / crossover, *allowed["integral_time"])


def _velocity_kept(plants, asked, kp, time) -> np.ndarray:
    """Whether a velocity loop keeps the margins with all plants, shape ``(m,)``."""
    kept = np.ones(len(kp), bool)
    for plant in plants:
        loops = plant.velocity_loop(kp, time)
        gain, phase, stable = margins_of(plant.frequencies, loops)
        kept &= stable & (gain >= asked.gain + RESERVE_GAIN)
        kept &= phase >= asked.phase + RESERVE_PHASE
    return kept


def _position_kept(plants, asked, kp, time, kv) -> np.ndarray:
    """Whether a position loop keeps the margins with all plants and does not overshoot."""
    kept = np.ones(len(kp), bool)
    for plant in plants:
        loops = plant.position_loop(kp, time, kv)[:, plant.below]
        gain, phase, stable = margins_of(plant.frequencies[plant.below], loops)
        kept &= stable & (gain >= asked.gain + RESERVE_GAIN)
        kept &= phase >= max(asked.phase + RESERVE_PHASE, WITHOUT_OVERSHOOT)
    return kept
