"""What is told of an episode, and how many of them are summed up.

The figures come from the physics, at every physics step (`servogym.envs.probe`), and from the infos
at every step of the agent. What does not apply to a task is not a number and left out of tables.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

RESAMPLES = 2000
CONFIDENCE = 0.95
BOOTSTRAP_SEED = 1


class Metric(NamedTuple):
    """A row: what the values mean."""

    heading: str  # with unit
    better: str  # "high" or "low"; empty: neither
    what: str


METRICS = {
    "episode_return": Metric("return", "high", "sum of the rewards"),
    "success": Metric("success", "high", "of the task, at the end of the episode"),
    "settling_time": Metric(
        "settling (s)", "low",
        "after it what is moved stays in the window to the end; where the task ends with success: "
        "until then; the whole episode where there was none",
    ),
    "overshoot": Metric("overshoot (µm)", "low", "farthest beyond the goal"),
    "tracking_error": Metric("rms tracking error (µm)", "low", "reference minus position"),
    "peak_error": Metric("peak following error (µm)", "low", "60F4h, demand minus actual"),
    "rms_error": Metric("rms following error (µm)", "low", "60F4h, demand minus actual"),
    "peak_torque": Metric("peak torque / rated", "", "of the motor"),
    "rms_torque": Metric("rms torque / rated", "low", "of the motor, over the episode"),
    "rms_jerk": Metric("rms jerk (m/s³)", "low", "of the driven joint, up to 100 Hz"),
    "energy": Metric("energy (J)", "low", "positive mechanical work at the shaft"),
    "vibration": Metric(
        "residual vibration (µm)", "low",
        "half the span of what is elastic, in the last quarter of an episode of full length",
    ),
    "sway": Metric(
        "residual sway (mrad)", "low",
        "greatest angle of the cable at a step, in the last quarter of an episode of full length",
    ),
    "reference_error": Metric("homing error (µm)", "low", "home found minus true home, absolute"),
    "impact_energy": Metric("impact (J)", "low", "brought into the end stops, sum"),
    "limited": Metric("at a limit", "low", "share of the steps with statusword bit 11"),
    "faults": Metric("faults", "low", "share of the episodes that a fault of the drive ended"),
}  # fmt: skip


def iqm(values: np.ndarray) -> np.ndarray:
    """Mean of the middle half along the last axis; a quarter is left out at each end."""
    values = np.sort(values, axis=-1)
    n = values.shape[-1]
    weights = np.clip(np.minimum(np.arange(1, n + 1), np.arange(n, 0, -1)) - n / 4, 0.0, 1.0)
    return (values * weights).sum(axis=-1) / weights.sum()


class Summary(NamedTuple):
    """Of the values of one metric."""

    mean: float
    iqm: float  # interquartile mean
    low: float  # of the 95 % interval of the interquartile mean
    high: float


def summarise(strata: Sequence[np.ndarray]) -> Summary:
    """Mean, interquartile mean and its interval by a stratified bootstrap (Agarwal et al. 2021).

    Args:
        strata: values of one metric, an array a stratum; each resample draws with replacement
            within each stratum as many as there are, 2,000 times, from a seed of its own.
    """
    pooled = np.concatenate(strata)
    generator = np.random.default_rng(BOOTSTRAP_SEED)
    drawn = np.concatenate(
        [values[generator.integers(0, len(values), (RESAMPLES, len(values)))] for values in strata],
        axis=1,
    )
    tail = 50.0 * (1.0 - CONFIDENCE)
    low, high = np.percentile(iqm(drawn), [tail, 100.0 - tail])
    return Summary(float(pooled.mean()), float(iqm(pooled)), float(low), float(high))
