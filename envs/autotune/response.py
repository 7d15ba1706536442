"""Frequency responses of a drive's loops, and their margins.

The loops consist of the measured plant and the controllers that `kernel.cascade` computes, with the
gains of the drive:

    velocity loop = kp (1 + T / Ti / (z - 1)) plant
    position loop = kv hold kp (1 + T / Ti / (z - 1)) / (1 + velocity loop) plant of the position
"""

import csv
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from ..plants.loops import Filters, Gains, LoopPlant
from .margins import TOO_HIGH, Margins, margins
from .plant import Plant, sampled

CERTAIN = 3.0  # gain of a loop above which lower frequencies do not affect its stability
GRID = 300  # frequencies
NEIGHBOURS = np.array([1.0, 3.0, 4.0, 3.0, 1.0])  # weights of a mean over measured lines
APART = 0.3  # distance (logarithm) beyond the measured lines from which the fit is used
TRUST = 20.0  # weight of the fit, that of a measurement with a coherence of 0.95


def mean_of_neighbours(values: np.ndarray) -> np.ndarray:
    """A weighted mean over neighbouring lines, shape ``(n,)``."""
    return np.convolve(values, NEIGHBOURS, "same") / np.convolve(
        np.ones(len(values)), NEIGHBOURS, "same"
    )


@dataclass(frozen=True)
class Response:
    """The measured plant of one drive, and its loops with some gains.

    Arrays have shape ``(n,)``, one value per frequency.
    """

    drive: str
    model: str
    frequencies: np.ndarray  # Hz
    plant: np.ndarray  # complex, velocity of the shaft as measured over torque command, rad/s/Nm
    position_plant: np.ndarray  # complex, measured position over torque command, rad/Nm
    coherence: np.ndarray  # 0..1 of velocity and torque command
    gains: Gains
    cycle: float  # s, velocity controller
    cycles: int  # velocity cycles in a position cycle
    velocity_filter: float  # share of the new sample, per velocity cycle
    amplitude: float  # rms of the excitation, share of the rated torque
    speed: float  # of travel, m/s or rad/s of the joint
    unit: str  # of the joint
    filters: Filters | None = None  # of the torque command
    note: str = ""
    fitted: Plant | None = None
    fitted_load: Plant | None = None  # fit to the speed of a second encoder, at the load
    # responses to other excitations, by name; the smallest margins of all count
    also: tuple[tuple[str, "Response"], ...] = ()

    def with_gains(self, gains: Gains) -> "Response":
        """Return the response of the same plant with other gains."""
        if not isinstance(gains, Gains):
            raise ValueError(f"gains = {gains!r}: give Gains, such as gains_of(drive)")
        also = tuple((name, other.with_gains(gains)) for name, other in self.also)
        return replace(self, gains=gains, also=also)

    @cached_property
    def wide(self) -> "Response":
        """The fitted plant on a fine grid to the Nyquist frequency, corrected by the measurement.

        The correction is a mean over neighbouring lines, weighted by their accuracy. A narrow
        antiresonance between two lines therefore stays at the frequency of the fit.
        """
        if self.fitted is None:
            return self
        frequencies = np.geomspace(0.1, 0.98 / (2 * self.cycle), GRID)
        narrow = [
            f * (1 + max(damping, 1e-3) * np.linspace(-6, 6, 25))
            for fit in (self.fitted, self.fitted_load)
            if fit
            for r in fit.resonances
            for f, damping in ((r.antiresonance, r.antidamping), (r.resonance, r.damping))
        ]
        frequencies = np.unique(np.concatenate([frequencies, *narrow]))
        frequencies = frequencies[(frequencies > 0.05) & (frequencies < 0.499 / self.cycle)]
        expected = self._sampled(self.fitted)
        plant = self.fitted(frequencies) * self._smooth(self.plant / expected, frequencies)
        load, fitted = self.fitted_load, self.fitted_load or self.fitted
        per_velocity = self._position_per_velocity
        turned = self._sampled(lambda f: fitted(f) * per_velocity(f))
        if load:  # its antiresonances differ from those of the motor
            position = load(frequencies) * self._smooth(self.position_plant / turned, frequencies)
        else:
            ratio = self.position_plant / turned / (self.plant / expected)
            position = plant * self._smooth(ratio, frequencies)
        return replace(
            self, frequencies=frequencies, plant=plant,
            position_plant=position * per_velocity(frequencies),
            coherence=np.ones(len(frequencies)), fitted=None, fitted_load=None, also=(),
        )

    @property
    def of_load(self) -> "Response":
        """The response from torque to the speed at the encoder that measures the position."""
        per_velocity = self._position_per_velocity(self.frequencies)
        return replace(self, plant=self.position_plant / per_velocity)

    def _sampled(self, response: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
        return sampled(response, self.frequencies, self.cycle, self.cycles)

    def _smooth(self, ratio: np.ndarray, frequencies: np.ndarray) -> np.ndarray:
        """Smooth a ratio at the measured frequencies and interpolate it at others."""
        weight = mean_of_neighbours(self._weight)
        mean = (mean_of_neighbours(ratio * self._weight) + TRUST) / (weight + TRUST)
        # beyond the measured lines the fit is used alone
        place, known = np.log(frequencies), np.log(self.frequencies)
        known = np.concatenate([known[:1] - APART, known, known[-1:] + APART])
        mean = np.concatenate([[1.0], mean, [1.0]])
        return np.interp(place, known, mean.real) + 1j * np.interp(place, known, mean.imag)

    @property
    def _weight(self) -> np.ndarray:
        """Weight of the measurement: the inverse of its relative variance."""
        return self.coherence / np.maximum(1 - self.coherence, 1e-3)

    def with_earlier(self, other: "Response | None") -> "Response":
        """Return the response with its plant averaged with an earlier measurement, by weight.

        A stiff loop suppresses the excitation at low frequencies, a soft one does not.
        """
        if other is None:
            return self
        # with other gains the lines may differ
        _, at, there = np.intersect1d(self.frequencies, other.frequencies, return_indices=True)
        own, earlier = self._weight[at], other._weight[there]
        both = np.maximum(own + earlier, 1e-9)
        plant, position = self.plant.copy(), self.position_plant.copy()
        coherence = self.coherence.copy()
        plant[at] = (own * plant[at] + earlier * other.plant[there]) / both
        position[at] = (own * position[at] + earlier * other.position_plant[there]) / both
        coherence[at] = both / (1 + both)
        return replace(self, plant=plant, position_plant=position, coherence=coherence)

    def differs(self, other: "Response") -> float:
        """Return the rms logarithm of the ratio of two plants, weighted by their accuracy."""
        weight = 1 / (1 / self._weight + 1 / other._weight)
        ratio = np.abs(np.log(other.plant / self.plant)) ** 2
        return math.sqrt(float((weight * ratio).sum() / weight.sum()))

    @property
    def inertia(self) -> float:
        """Inertia of the fitted plant (kg·m²); NaN without a fit."""
        return self.fitted.inertia if self.fitted else math.nan

    def _position_per_velocity(self, frequencies: np.ndarray) -> np.ndarray:
        """Response from filtered velocity to position, of the motor's own encoder."""
        z = np.exp(2j * np.pi * frequencies * self.cycle)
        return (
            self.cycle / (1 - 1 / z) * (1 - (1 - self.velocity_filter) / z) / self.velocity_filter
        )

    @cached_property
    def _plant(self) -> LoopPlant:
        """The plant as measured, behind the controllers of a drive."""
        return LoopPlant(
            self.frequencies, self.plant, self.position_plant, self.cycle, self.cycles,
            self.inertia, filters=self.filters,
        )

    @property
    def wide_plant(self) -> LoopPlant:
        """The plant of `wide`, with the inertia of the fit."""
        return replace(self.wide._plant, inertia=self.inertia)

    @property
    def velocity_loop(self) -> np.ndarray:
        """Open loop of the velocity controller."""
        return self._plant.velocity_loop(*self.gains.cascade[:2])[0]

    @property
    def position_loop(self) -> np.ndarray:
        """Open loop of the position controller, with the velocity loop closed."""
        if self.gains.pid is not None:
            return self._plant.pid_loop(self.gains.pid)
        return self._plant.position_loop(*self.gains.cascade)[0]

    @cached_property
    def velocity_margins(self) -> Margins:
        """Stability margins of the velocity loop."""
        wide = self.wide
        own = self._margins(wide.frequencies, wide.velocity_loop)
        return own.and_of(other.velocity_margins for _, other in self.also)

    @cached_property
    def position_margins(self) -> Margins:
        """Stability margins of the position loop, up to its own Nyquist frequency."""
        wide = self.wide
        below = wide.frequencies < 0.49 / (self.cycle * self.cycles)
        own = self._margins(wide.frequencies[below], wide.position_loop[below])
        inner = self.gains.pid is not None or self.velocity_margins.stable
        own = replace(own, stable=own.stable and inner)
        return own.and_of(other.position_margins for _, other in self.also)

    def _margins(self, frequencies: np.ndarray, loop: np.ndarray) -> Margins:
        first = int(np.searchsorted(frequencies, self.frequencies[0]))
        if self.fitted is None:
            first = 0
        begin = 0
        if abs(loop[first]) > CERTAIN:
            begin = first + int(np.argmax(abs(loop[first:]) < TOO_HIGH))
        return margins(frequencies[begin:], loop[begin:])

    def __str__(self) -> str:
        lines = [
            f"drive {self.drive} ({self.model}): {self.gains}",
            *([f"plant: {self.fitted}"] if self.fitted else []),
            f"velocity loop: {self.velocity_margins}",
            f"position loop: {self.position_margins}",
        ]
        return "\n".join([*lines, *([self.note] if self.note else [])])

    def save(self, path: str | Path) -> None:
        """Write the response: numbers with the suffix .csv, a picture with the suffix .png.

        Raises ValueError for another suffix.
        """
        path = Path(path)
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.suffix == ".csv":
            self._write(path)
        elif path.suffix == ".png":
            from .drawing import draw_bode

            draw_bode([("in force", self)], path)
        else:
            raise ValueError(f"{path}: use the suffix .csv or .png")

    def _write(self, path: Path) -> None:
        columns: list[tuple[str, Any]] = [
            ("frequency (Hz)", self.frequencies), ("coherence", self.coherence),
        ]
        for name, values in (
            ("plant (rad/s/Nm)", self.plant), ("velocity loop", self.velocity_loop),
            ("position loop", self.position_loop),
        ):
            columns += [
                (f"{name} (dB)", 20 * np.log10(np.abs(values))),
                (f"{name} (degree)", np.degrees(np.unwrap(np.angle(values)))),
            ]
        with path.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            writer.writerow([name for name, _ in columns])
            writer.writerows(zip(*(np.asarray(x).tolist() for _, x in columns), strict=True))
