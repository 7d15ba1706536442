"""An LQR that identifies the resonance with a bank of models, and uses the gain of the best one.

Each model of the bank is that of `lqr` with a different resonance. All of them predict deflection
and rate of the load from the previous step and the velocity of the axis. The model with the least
sum of squared errors so far provides the path, shaped for its resonance, and the feedback (multiple
models: Narendra, Balakrishnan 1997). Only the ends of the bank were chosen: they are those of the
loads that `CompliantAxis-v0` draws. Weights and shaper are those of `lqr`.
"""

import math
from functools import lru_cache
from typing import Any

import numpy as np

from .datasheet import Axis, Datasheet, Vibration
from .lqr import SHAPERS, Lqr, Regulated, gain, model
from .profiles import time_optimal

LOWEST, HIGHEST, MODELS = 0.5, 2.4, 33  # of the nominal resonance, in equal ratios


@lru_cache(maxsize=64)
def bank(vibration: Vibration, dt: float) -> tuple[np.ndarray, ...]:
    """Return resonances (rad/s), models, inputs and gains of the bank.

    Shapes ``(n,)``, ``(n, 5, 5)``, ``(n, 5)``, ``(n, 5)``.
    """
    frequencies = vibration.frequency * np.geomspace(LOWEST, HIGHEST, MODELS)
    members = [Vibration(float(frequency), vibration.ratio) for frequency in frequencies]
    pairs = [model(member, dt) for member in members]
    models, inputs = np.array([a for a, _ in pairs]), np.array([b[:, 0] for _, b in pairs])
    gains = np.array([gain(member, dt) for member in members])
    return frequencies, models, inputs, gains


class Identified(Regulated):
    """The controller of one axis: the bank, and path and feedback of its best model."""

    def __init__(self, datasheet: Datasheet, axis: Axis):
        super().__init__(datasheet, axis)
        self._frequencies, self._models, self._inputs, self._gains = bank(
            self._vibration, datasheet.step_time
        )

    def reset(self, seen: Any) -> None:
        """Plan a path for each resonance."""
        path = time_optimal(float(seen.distance) * self._axis.stroke - self._rest, self._bounds)
        times, ratio = self._times, self._vibration.ratio
        root = np.sqrt(1.0 - ratio**2)
        share = math.exp(-np.pi * ratio / root)  # of the second pulse, as `shaped` has it
        halves = np.pi / (self._frequencies * root)
        places = np.tile(path(times), (MODELS, 1))
        for _ in range(SHAPERS):
            late = [
                np.interp(times - half, times, place, left=0.0)
                for place, half in zip(places, halves, strict=True)
            ]
            places = (places + share * np.array(late)) / (1.0 + share)
        self._plans = np.diff(places, append=places[:, -1:]) / self._dt  # velocities (m/s)
        expected = np.zeros((MODELS, 5))
        self._expectations = np.zeros((len(times), MODELS, 5))
        for step in range(len(times) - 1):
            planned = self._plans[:, step] - expected[:, 1]
            expected = np.einsum("kij,kj->ki", self._models, expected)
            expected += self._inputs * planned[:, None]
            self._expectations[step + 1] = expected
        self._errors = np.zeros(MODELS)
        self._errors[np.argmin(np.abs(self._frequencies - self._vibration.frequency))] = -1e-12
        self._step, self._measured, self._swing = 0, 0.0, np.zeros(2)
        self._place = self._velocity = self._last = 0.0

    def act(self, seen: Any) -> float:
        """Return the velocity of the set-point (m/s)."""
        state = self.state(seen)
        measured = float(seen.velocity) * self._axis.fastest
        if self._step:
            pull = (measured - self._measured) / self._dt  # acceleration of the axis (m/s²)
            still = np.zeros((MODELS, 2))
            still[:, 0] = -pull / self._frequencies**2
            swing = self._models[:, 2:4, 2:4]
            off = still + np.einsum("kij,kj->ki", swing, self._swing - still) - state[2:4]
            self._errors += (self._vibration.frequency * off[:, 0]) ** 2 + off[:, 1] ** 2
        self._measured, self._swing = measured, state[2:4]
        k = int(self._errors.argmin())
        now = min(self._step, len(self._times) - 1)
        expected = self._expectations[now, k]
        planned = self._plans[k, now] - expected[1]
        self._step += 1
        return self.changed(planned - float(self._gains[k] @ (state - expected)))


class AdaptiveLqr(Lqr):
    """Identifies and regulates each axis separately."""

    AXIS = Identified
