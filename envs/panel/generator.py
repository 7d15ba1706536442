"""Function generator: set-points over time within the limits of an axis.

A wave begins and ends where the set-point is 0. It is refused with the reason if its peak speed or
acceleration exceeds the limits of the axis.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

from ...drive.diagrams import Mode

Wave = Callable[[float], float]  # of the time (s)


class AxisLimits(NamedTuple):
    """Limits of an axis (SI at the load)."""

    velocity: float
    acceleration: float


class Kind(NamedTuple):
    """The quantity of a set-point."""

    name: str  # of the object
    modes: tuple[Mode, ...]  # a drive gets the first one that it has
    shapes: tuple[str, ...]
    wave: Callable[[str, float, float, AxisLimits], Wave]  # of shape, size, frequency (Hz), limits


def travel(way: float, most: AxisLimits) -> tuple[Wave, float]:
    """Plan a rest-to-rest motion from 0 to `way`: a trapezoid of velocity, in closed form.

    Returns the wave and its duration (s).
    """
    distance, sign = abs(way), math.copysign(1.0, way)
    speed = min(most.velocity, math.sqrt(distance * most.acceleration))
    ramp = speed / most.acceleration
    total = distance / speed + ramp if distance else 0.0

    def wave(time: float) -> float:
        if time >= total:
            return way
        if time < ramp:
            return sign * most.acceleration * time * time / 2
        if time > total - ramp:
            return sign * (distance - most.acceleration * (total - time) ** 2 / 2)
        return sign * speed * (time - ramp / 2)

    return wave, total


def position(shape: str, way: float, frequency: float, most: AxisLimits) -> Wave:
    """A wave to `way` and back at a frequency (Hz). Raises ValueError beyond the limits."""
    half = 0.5 / frequency
    if shape == "sine":
        rate = 2 * math.pi * frequency
        _within("speed", abs(way) / 2 * rate, most.velocity)
        _within("acceleration", abs(way) / 2 * rate * rate, most.acceleration)
        return lambda time: way / 2 * (1 - math.cos(rate * time))
    out, needed = travel(way, most)
    if needed > half:
        raise ValueError(f"there and back takes {2 * needed:.3g} s with 6081h and 6083h: "
                         f"choose at most {0.5 / needed:.3g} Hz, or a shorter way")

    def wave(time: float) -> float:
        turn = time % (2 * half)
        return out(turn) if turn < half else way - out(turn - half)

    return wave


def velocity(shape: str, size: float, frequency: float, most: AxisLimits) -> Wave:
    """A wave of speeds up to `size` in both directions. Raises ValueError beyond the limits."""
    _within("speed", abs(size), most.velocity)
    if shape == "sine":
        _within("acceleration", abs(size) * 2 * math.pi * frequency, most.acceleration)
    return torque(shape, size, frequency, most)


def torque(shape: str, size: float, frequency: float, _: AxisLimits) -> Wave:
    """A wave up to `size` in both directions, without limits."""
    if shape == "sine":
        return lambda time: size * math.sin(2 * math.pi * frequency * time)
    return lambda time: size if time * frequency % 1.0 < 0.5 else -size


def _within(what: str, peak: float, most: float) -> None:
    if peak > most * (1 + 1e-9):
        raise ValueError(
            f"its peak {what} is {peak:.4g}, but the axis may have {most:.4g} at most (SI): choose "
            "less, or a lower frequency"
        )


KINDS = {
    "position": Kind("target_position", (Mode.CYCLIC_SYNC_POSITION,), ("sine", "to and fro"),
                     position),
    "velocity": Kind("target_velocity", (Mode.PROFILE_VELOCITY, Mode.CYCLIC_SYNC_VELOCITY),
                     ("sine", "square"), velocity),
    "torque": Kind("target_torque", (Mode.PROFILE_TORQUE, Mode.CYCLIC_SYNC_TORQUE),
                   ("sine", "square"), torque),
}
