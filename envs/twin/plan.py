"""Plans an experiment: moves that separate the parameters of an axis."""

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import ruckig

from ..engine.checks import in_range

REST, RINGING = 0.08, 0.5  # s after each move; after a move whose vibration has to decay
KINDS = {  # purpose -> shares of speed, acceleration and distance of moves in both directions
    "acceleration": ((1.0, 1.0, 0.6), (1.0, 0.5, 0.6), (0.6, 0.25, 0.4)),
    "speed": ((1.0, 1.0, 0.6), (0.33, 1.0, 0.2), (0.6, 1.0, 0.25), (0.33, 0.5, 0.2)),
    "slow": ((0.1, 0.5, 0.03), (0.05, 0.5, 0.02)),
    "ring": ((1.0, 1.0, 0.1), (0.6, 1.0, 0.05)),
    "sweep": (),
}
WHOLE = ("acceleration", "speed", "slow")  # the kinds in an experiment for an unknown axis
SWEEP = (5.0, 100.0, 3.0)  # first and last frequency (Hz), duration (s)
SHARE_OF_SWEEP = 0.3  # of the highest acceleration


@dataclass(frozen=True)
class Limits:
    """The limits of a plan at the joint (m or rad). Raises ValueError for invalid ones."""

    low: float
    high: float
    velocity: float
    acceleration: float
    jerk: float

    def __post_init__(self) -> None:
        in_range("velocity", self.velocity, 1e-6, 1e3, "m/s or rad/s")
        in_range("acceleration", self.acceleration, 1e-6, 1e5, "m/s² or rad/s²")
        in_range("jerk", self.jerk, 1e-6, 1e8, "m/s³ or rad/s³")
        if not self.high - self.low > 0.0:
            raise ValueError(
                f"range {self.low:g}..{self.high:g}: the upper end has to be above the lower"
            )


def plan(
    limits: Limits, period: float, *, kinds: Sequence[str] = WHOLE, sweep: bool = False
) -> np.ndarray:
    """Return the set-points of an experiment, one per bus cycle, shape ``(n,)``, from mid-range.

    Args:
        limits: limits of position, speed, acceleration and jerk.
        period: bus cycle (s).
        kinds: the kinds of moves, keys of `KINDS`.
        sweep: add a sine of rising frequency, for springs.
    """
    middle, half = 0.5 * (limits.low + limits.high), 0.5 * (limits.high - limits.low)
    here, parts = middle, [np.full(round(REST / period), middle)]
    rest = np.ones(round((RINGING if "ring" in kinds else REST) / period))
    moves = dict.fromkeys(move for kind in kinds for move in KINDS[kind])
    for speed, acceleration, far in moves:
        for goal in (middle + far * half, middle - far * half, middle):
            parts += [
                _move(here, goal, speed * limits.velocity, acceleration * limits.acceleration,
                      limits.jerk, period),
                goal * rest,
            ]
            here = goal
    if sweep or "sweep" in kinds:
        parts += [middle + _sweep(limits, period), np.full(round(REST / period), middle)]
    return np.concatenate(parts)


def _move(
    start: float, goal: float, velocity: float, acceleration: float, jerk: float, period: float
) -> np.ndarray:
    wanted, trajectory = ruckig.InputParameter(1), ruckig.Trajectory(1)
    wanted.current_position, wanted.target_position = [start], [goal]
    wanted.max_velocity, wanted.max_acceleration = [velocity], [acceleration]
    wanted.max_jerk = [jerk]
    ruckig.Ruckig(1).calculate(wanted, trajectory)
    times = np.arange(period, trajectory.duration, period)
    return np.array([trajectory.at_time(t)[0][0] for t in times] + [goal])


def _sweep(limits: Limits, period: float) -> np.ndarray:
    """Return an exponential sweep with constant acceleration amplitude."""
    first, last, duration = SWEEP
    last = min(last, 0.2 / period)
    time = np.arange(0.0, duration, period)
    rate = np.log(last / first) / duration
    frequency = first * np.exp(rate * time)
    phase = 2 * np.pi * first * (np.exp(rate * time) - 1) / rate
    peak = SHARE_OF_SWEEP * limits.acceleration
    amplitude = np.minimum(peak / (2 * np.pi * frequency) ** 2, 0.2 * (limits.high - limits.low))
    fade = np.minimum(1.0, np.minimum(time, time[-1] - time) / 0.2)
    return amplitude * fade * np.sin(phase)


def write(path: Path, set_points: np.ndarray, period: float, unit: float) -> None:
    """Write a table for a master: time (s) and target_position (drive units).

    Args:
        path: path of the CSV.
        set_points: positions (m or rad).
        period: bus cycle (s).
        unit: one position unit of the drive (m or rad).
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["time (s)", "target_position (position unit)"])
        for n, value in enumerate(set_points):
            writer.writerow([f"{n * period:.6f}", round(float(value) / unit)])
