"""A plant with few parameters, fitted to a measured response: inertia, resonances, delay.

    plant(z) = lag(z) filter(z) exp(-s delay) 1 / (J (z - 1) / T + b) product of
               (s²/wa² + 2 da s/wa + 1) / (s²/wr² + 2 dr s/wr + 1),          s = 2 pi i f

The lag of the current loop and the filter of the velocity are those of the drive. At an
antiresonance wa the load vibrates on its spring while the motor stands still; at a resonance wr
both vibrate.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Resonance:
    """A pair of antiresonance and resonance."""

    antiresonance: float  # Hz
    resonance: float  # Hz
    damping: float  # share of critical, of the resonance
    antidamping: float

    def __str__(self) -> str:
        return f"{self.antiresonance:.3g}/{self.resonance:.3g} Hz"


@dataclass(frozen=True)
class Plant:
    """The plant of a drive, as seen at the motor shaft."""

    inertia: float  # kg·m², total
    viscous: float  # Nm·s/rad, of the fit; `Friction` has the measured value
    delay: float  # s, beyond lag and filter
    resonances: tuple[Resonance, ...]
    cycle: float  # s
    lag: float  # share of the new value in each velocity cycle
    filter: float  # the same
    error: float  # rms of the fit (dB)

    def __call__(self, frequencies: np.ndarray) -> np.ndarray:
        """Measured velocity (rad/s) over torque command (Nm) at `frequencies` (Hz)."""
        values = self.inertia, self.viscous, self.delay
        pairs = [(r.antiresonance, r.antidamping, r.resonance, r.damping) for r in self.resonances]
        drive = lag_and_filter(frequencies, self.cycle, self.lag, self.filter)
        return drive * mechanics(frequencies, self.cycle, values, pairs)

    def __str__(self) -> str:
        found = ", ".join(map(str, self.resonances)) or "none"
        return f"inertia {self.inertia:.4g} kg·m², antiresonance/resonance {found}"


def sampled(
    response: Callable[[np.ndarray], np.ndarray], frequencies: np.ndarray, cycle: float, cycles: int
) -> np.ndarray:
    """Return a response in z as sampled once per position cycle, with its input held for one.

    The hold has images at all multiples of that rate, which sampling folds back.

    Args:
        response: the response at frequencies of both signs (Hz).
        frequencies: frequencies (Hz), shape ``(n,)``.
        cycle: cycle of the response (s).
        cycles: number of these cycles in a position cycle.
    """
    rate, whole, first = 1 / cycle, np.zeros(len(frequencies), complex), None
    for k in range(cycles):
        image = (frequencies + (k / cycles + 0.5) * rate) % rate - 0.5 * rate
        z = np.exp(2j * np.pi * image * cycle)
        hold = sum(z**j for j in range(cycles))
        first = hold if first is None else first
        whole += response(image) * hold
    return whole / first


def lag_and_filter(frequencies: np.ndarray, cycle: float, lag: float, share: float) -> np.ndarray:
    """Response of current-loop lag and velocity filter, each given as its smoothing share."""
    z = np.exp(2j * np.pi * frequencies * cycle)
    return lag / (1 - (1 - lag) / z) * share / (1 - (1 - share) / z)


def mechanics(
    frequencies: np.ndarray, cycle: float, values: tuple[float, float, float],
    pairs: Iterable[tuple[float, float, float, float]],
) -> np.ndarray:
    """Response of inertia, viscous friction, delay, and damped resonance pairs (Hz)."""
    inertia, viscous, delay = values
    s = 2j * np.pi * frequencies
    z = np.exp(s * cycle)
    response: np.ndarray = np.exp(-s * delay) / (inertia * (z - 1) / cycle + viscous)
    for antiresonance, antidamping, resonance, damping in pairs:
        a, r = (1j * frequencies / f for f in (antiresonance, resonance))
        response = response * (a * a + 2 * antidamping * a + 1) / (r * r + 2 * damping * r + 1)
    return response
