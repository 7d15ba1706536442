"""Margins of an open loop that is given at some frequencies."""

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

import numpy as np

from .needs import scipy

LEAST_COHERENCE = 0.8  # from which a frequency counts as measured
TOO_HIGH = 30.0  # gain of a loop above which too little excitation is left to measure its phase
# possible error (degree) of a measured loop close to -180 degrees: near an antiresonance with 0.6 %
# damping, narrower than the distance of the lines, the phase was measured about 6 degrees off
UNSURE = 8.0
FARTHEST = math.radians(225)  # phase lag at which a loop with two integrators may begin

Loop = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Margins:
    """Stability margins of one loop; infinite if the loop has no such crossing."""

    gain: float  # dB
    phase: float  # degree
    crossover: float  # Hz
    phase_crossover: float  # Hz
    stable: bool
    # gain margin (dB) where the loop comes within UNSURE degrees of -180 and turns back; at a
    # resonance between two measured lines this cannot be distinguished from a crossing
    doubtful: float = field(default=math.inf, compare=False)

    @property
    def sure(self) -> float:
        """Gain margin (dB) if coming close to -180 degrees counts as crossing it."""
        return min(self.gain, self.doubtful)

    @property
    def measured(self) -> bool:
        """Whether the loop crosses 1 at a measured frequency; a slow position loop may not."""
        return math.isfinite(self.crossover)

    def and_of(self, others: Iterable["Margins"]) -> "Margins":
        """Return the smallest margins of several loops, and their frequencies."""
        loops = [self, *others]
        gain = min(loops, key=lambda each: each.gain)
        phase = min(loops, key=lambda each: each.phase)
        return Margins(
            gain.gain, phase.phase, phase.crossover, gain.phase_crossover,
            all(each.stable for each in loops), min(each.doubtful for each in loops),
        )

    def __str__(self) -> str:
        if not self.stable:
            return "unstable"
        text = f"{self.gain:.1f} dB"
        if self.measured:
            text += f", {self.phase:.0f}°, crossover {self.crossover:.3g} Hz"
        else:
            text += ", no crossover measured"
        if self.doubtful < self.gain:
            text += f", {self.doubtful:.1f} dB within {UNSURE:g}° of a crossing"
        return text


def crossings(omega: np.ndarray, loop: np.ndarray) -> tuple[np.ndarray, np.ndarray, Loop]:
    """Return where a loop crosses -180 degrees, where it crosses 1, and an interpolated loop.

    The interpolation is a cubic spline. The results are those of `stability_margins` of
    python-control, which evaluates its spline at one frequency at a time.
    """
    interpolate, brentq = scipy("interpolate"), scipy("optimize").brentq
    weights, degree = 1 / (np.abs(loop) + 0.001), min(3, len(loop) - 1)
    spline, _ = interpolate.splprep([loop.real, loop.imag], u=omega, w=weights, s=0.0, k=degree)

    def between(at: np.ndarray) -> np.ndarray:
        if not np.size(at):
            return np.zeros(0, complex)
        real, imaginary = interpolate.splev(at, spline)
        return real + 1j * imaginary

    def behind(at: np.ndarray) -> np.ndarray:
        return np.angle(-between(at))

    def above(at: np.ndarray) -> np.ndarray:
        return np.abs(between(at)) - 1

    def roots(function: Loop, where: np.ndarray) -> np.ndarray:
        at = np.flatnonzero((np.diff(np.sign(function(omega))) != 0) & where[:-1])
        return np.array([brentq(function, omega[k], omega[k + 1]) for k in at])

    left = between(omega).real <= 0
    return roots(behind, left), roots(above, np.ones_like(left)), between


def margins(frequencies: np.ndarray, loop: np.ndarray) -> Margins:
    """Return the margins of an open loop without unstable poles other than integrators.

    Args:
        frequencies: Hz, shape ``(n,)``, from far below the crossover to far above it.
        loop: complex, shape ``(n,)``.
    """
    at_phase, at_gain, between = crossings(2 * np.pi * frequencies, loop)
    gains = 1 / np.abs(between(at_phase))
    phases = np.remainder(np.angle(between(at_gain), deg=True), 360.0) - 180.0
    decibel = np.abs(20 * np.log10(np.maximum(gains, 1e-9)))
    worst = int(np.argmin(decibel)) if len(decibel) else None
    least = int(np.argmin(np.abs(phases))) if len(phases) else None
    # Nyquist: 1 + L begins at -90 degrees for each integrator and ends without encircling 0
    turned = np.unwrap(np.angle(1 + loop))
    begin = (turned[0] + FARTHEST) % (2 * math.pi) - FARTHEST
    end = begin + turned[-1] - turned[0]
    stable = abs(end) < math.pi / 2
    gain = math.inf if worst is None else float(decibel[worst])
    return Margins(
        gain=gain, phase=math.inf if least is None else float(abs(phases[least])),
        crossover=float(max(at_gain, default=math.nan) / (2 * np.pi)),
        phase_crossover=math.nan if worst is None else float(at_phase[worst] / (2 * np.pi)),
        stable=bool(stable), doubtful=_doubtful(2 * np.pi * frequencies, loop, at_phase),
    )


def _doubtful(omega: np.ndarray, loop: np.ndarray, crossed: np.ndarray) -> float:
    """Smallest gain margin (dB) where a loop comes close to -180 degrees without a crossing."""
    close = np.abs(np.angle(-loop, deg=True)) <= UNSURE
    ends = np.flatnonzero(np.diff(np.concatenate([[False], close, [False]])))
    least = math.inf
    for begin, end in ends.reshape(-1, 2):
        low, high = omega[max(begin - 1, 0)], omega[min(end, len(omega) - 1)]
        if begin > 0 and not ((crossed >= low) & (crossed <= high)).any():
            decibel = 20 * np.log10(np.maximum(np.abs(loop[begin:end]), 1e-9))
            least = min(least, float(np.abs(decibel).min()))
    return least
