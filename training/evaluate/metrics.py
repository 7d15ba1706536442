"""The metrics of an episode, and how many episodes are summarised.

The figures come from the physics, at every physics step (`servogym.envs.engine.probe`), and from
the infos at every step of the agent. A metric that does not apply to a task is NaN and left out of
tables.
"""

import math
from functools import lru_cache
from statistics import NormalDist
from typing import NamedTuple

import numpy as np

from ...drive.model.names import hint
from ...envs.environment.servo_env import ServoEnv
from ...envs.view.about import Metric, in_unit

RESAMPLES = 2000
CONFIDENCE = 0.95
BOOTSTRAP_SEED = 1
TAIL = 0.05  # share of the worst episodes, which are reported separately


METRICS: dict[str, Metric] = {
    "episode_return": Metric("return", "high", "sum of the rewards"),
    "success": Metric("success", "high", "whether the task is fulfilled at the end of the episode"),
    "settling_time": Metric(
        "settling (s)", "low",
        "time after which the moved part stays in the window to the end; if success ends the "
        "task, the time until then; without success, the whole episode",
    ),
    "overshoot": Metric("overshoot (µm)", "low", "largest excursion beyond the goal"),
    "tracking_error": Metric("rms tracking error (µm)", "low", "reference minus position"),
    "peak_error": Metric("peak following error (µm)", "low", "60F4h, demand minus actual"),
    "rms_error": Metric("rms following error (µm)", "low", "60F4h, demand minus actual"),
    "peak_torque": Metric("peak torque / rated", "", "of the motor"),
    "rms_torque": Metric("rms torque / rated", "low", "of the motor, over the episode"),
    "rms_jerk": Metric("rms jerk (m/s³)", "low", "of the driven joint, up to 100 Hz"),
    "energy": Metric("energy (J)", "low", "positive mechanical work at the shaft"),
    "vibration": Metric(
        "residual vibration (µm)", "low",
        "half the peak-to-peak elastic deflection in the last quarter of a full-length episode",
    ),
    "sway": Metric(
        "residual sway (mrad)", "low",
        "largest angle of the cable at a step, in the last quarter of a full-length episode",
    ),
    "reference_error": Metric("homing error (µm)", "low", "home found minus true home, absolute"),
    "impact_energy": Metric("impact (J)", "low", "total energy brought into the end stops"),
    "limited": Metric(
        "at a limit", "low", "share of the time with statusword bit 11 set, at physics steps"
    ),
    "faults": Metric("faults", "low", "share of the episodes that ended with a fault of the drive"),
}


def metrics(task: type[ServoEnv]) -> dict[str, Metric]:
    """Return the common metrics and those of a task. Raises ValueError for an unknown METRIC."""
    known = {**METRICS, **task.METRICS}
    if task.METRIC not in known:
        remark = hint(str(task.METRIC), known)
        raise ValueError(f"task {task.__name__}: METRIC = {task.METRIC!r} is unknown: {remark}")
    return {
        name: row._replace(heading=in_unit(row.heading, task.UNIT)) for name, row in known.items()
    }


def iqm(values: np.ndarray) -> np.ndarray:
    """Return the mean of the middle half along the last axis, without a quarter at each end.

    NaNs do not count; without any number the result is NaN.
    """
    values = np.sort(values, axis=-1)  # NaNs come last
    n = np.isfinite(values).sum(axis=-1, keepdims=True)
    if n.size and n.min() == n.max():
        n = n[(slice(1),) * n.ndim]  # all rows have the same weights
    rank = np.arange(1, values.shape[-1] + 1)
    weights = np.clip(np.minimum(rank, n + 1 - rank) - n / 4, 0.0, 1.0)
    total = np.where(weights > 0.0, values * weights, 0.0).sum(axis=-1)
    return _ratio(total, weights.sum(axis=-1))


def mean(values: np.ndarray) -> np.ndarray:
    """Return the mean along the last axis, without NaNs."""
    finite = np.isfinite(values)
    return _ratio(np.where(finite, values, 0.0).sum(axis=-1), finite.sum(axis=-1))


def _ratio(total: np.ndarray, count: np.ndarray) -> np.ndarray:
    return np.where(count > 0, total / np.maximum(count, 1e-300), math.nan)


class Summary(NamedTuple):
    """Summary of the values of one metric."""

    mean: float
    iqm: float  # interquartile mean
    low: float  # of the 95 % interval of the interquartile mean; for a share, of the mean
    high: float
    worst_training: float = math.nan  # interquartile mean of the worst training
    tail: float = math.nan  # mean of the worst 5 % of the episodes


class Difference(NamedTuple):
    """Difference of two policies on the same episodes, with its 95 % interval."""

    value: float
    low: float
    high: float


def summarise(values: np.ndarray, better: str = "high", *, share: bool = False) -> Summary:
    """Means and their interval by a two-level bootstrap.

    Each of 2,000 resamples draws trainings with replacement and episodes with replacement. The
    episodes are the same for all trainings, since they all play the same. The interval thus
    contains the variation between trainings and between episodes (a crossed bootstrap: Owen 2007,
    The pigeonhole bootstrap). For zeros and ones it is joined with Wilson's interval for as many
    episodes, because a resample that consists only of ones cannot show how rare a zero may be.

    Args:
        values: of one metric, shape ``(trainings, episodes)``; NaN where it does not apply.
        better: "high" or "low"; if empty, there is no worst value.
        share: report the mean instead of the interquartile mean.
    """
    statistic = mean if share else iqm
    low, high = _interval(_estimates(values, 0, share))
    finite = np.sort(values[np.isfinite(values)])
    if share and np.isin(finite, (0.0, 1.0)).all():
        bounds = _wilson(float(finite.mean()), int(np.isfinite(values).any(axis=0).sum()))
        low, high = min(low, bounds[0]), max(high, bounds[1])
    worst = tail = math.nan
    if better:
        count = math.ceil(TAIL * len(finite))
        each = statistic(values)
        worst = float(np.nanmin(each) if better == "high" else np.nanmax(each))
        tail = float((finite[:count] if better == "high" else finite[-count:]).mean())
    return Summary(
        float(finite.mean()), float(iqm(values.reshape(1, -1))[0]), low, high, worst, tail
    )


def difference(one: np.ndarray, other: np.ndarray, *, share: bool = False) -> Difference:
    """Return the difference of two policies' (interquartile) means, paired by episode.

    Both are resampled with the same episodes, each with trainings of its own.

    Args:
        one: values, shape ``(trainings, episodes)``.
        other: of the same episodes.
        share: of the means instead of the interquartile means.
    """
    statistic = mean if share else iqm
    value = statistic(one.reshape(1, -1))[0] - statistic(other.reshape(1, -1))[0]
    low, high = _interval(_estimates(one, 0, share) - _estimates(other, 1, share))
    return Difference(float(value), low, high)


class Paired(NamedTuple):
    """How one policy compares with another, episode by episode."""

    iqm: float  # interquartile mean of the paired differences, the first less the second
    low: float  # lower end of its 95 % interval
    high: float
    improved: float  # share of the pairs in which the first is better
    probability: float  # that the first is better in unpaired episodes; ties count half
    needed: float  # episodes to detect a difference of `SEEN`; inf: more trainings are needed


SEEN, POWER = 0.10, 0.80
Z = NormalDist().inv_cdf(0.5 + 0.5 * CONFIDENCE)


def paired(one: np.ndarray, other: np.ndarray, better: str) -> Paired:
    """Return the interquartile mean of the differences, not the difference of those means.

    The difference of two interquartile means compares the middle halves of two distributions, each
    of which may leave out different episodes. The interquartile mean of the differences leaves out
    the episodes in which the two differ most, so it is the smaller one if hard episodes gain most.
    Both are reported. The probability of improvement is that of Mann and Whitney for unpaired
    episodes, as in rliable (Agarwal et al. 2021). The number of episodes needed to see a difference
    4 times of 5 follows from the wider side of the interval. What episodes contribute to it falls
    with their square root; what trainings contribute stays, so no number may be enough.

    Args:
        one: values, shape ``(trainings, episodes)``.
        other: of the same episodes.
        better: "high" or "low".
    """
    sign = 1.0 if better == "high" else -1.0
    apart = one - mean(other.T)[None, :]
    low, high = _interval(_estimates(apart, 0, False))
    finite = apart[np.isfinite(apart)]
    a, b = one[np.isfinite(one)], other[np.isfinite(other)]
    order = np.sign(sign * (a[:, None] - b[None, :]))
    middle = abs(float(iqm(other.reshape(1, -1))[0]))
    value = float(iqm(apart.reshape(1, -1))[0])
    whole, of_episodes = (
        (max(value - least, most - value) / Z) ** 2
        for least, most in ((low, high), _interval(_estimates(apart, None, False)))
    )
    allowed = (SEEN * middle / (Z + NormalDist().inv_cdf(POWER))) ** 2
    allowed -= max(whole - of_episodes, 0.0)
    needed = of_episodes * one.shape[1] / allowed if allowed > 0.0 else math.inf
    return Paired(
        value, low, high, float((sign * finite > 0.0).mean()), float(0.5 + 0.5 * order.mean()),
        max(needed, 2.0) if middle > 0.0 else math.nan,
    )


def _estimates(values: np.ndarray, stream: int | None, share: bool) -> np.ndarray:
    """Estimate each resample, shape ``(RESAMPLES,)``.

    Each stream draws other trainings; None takes them all, so that only episodes are drawn.

    The estimates are cached, because the interval of a policy and its differences from others
    need the same ones.
    """
    trainings, episodes = values.shape
    stream = stream if trainings > 1 else 0  # one training has one stream
    return _kept(np.asarray(values, float).tobytes(), trainings, episodes, stream, share)


@lru_cache(maxsize=512)
def _kept(
    values: bytes, trainings: int, episodes: int, stream: int | None, share: bool
) -> np.ndarray:
    drawn = np.frombuffer(values)[_chosen(trainings, episodes, stream)]
    return mean(drawn) if share else iqm(drawn)


@lru_cache(maxsize=4)
def _chosen(trainings: int, episodes: int, stream: int | None) -> np.ndarray:
    """Return the resamples, equal for all metrics, ``(RESAMPLES, trainings × episodes)``."""
    chosen = np.random.default_rng([BOOTSTRAP_SEED, 0])
    of_episodes = chosen.integers(0, episodes, (RESAMPLES, 1, episodes))
    of_trainings = np.arange(trainings)[None, :, None]
    if stream is not None:
        chosen = np.random.default_rng([BOOTSTRAP_SEED, 1 + stream])
        of_trainings = chosen.integers(0, trainings, (RESAMPLES, trainings, 1))
    return (of_trainings * episodes + of_episodes).reshape(RESAMPLES, -1)


def _interval(estimates: np.ndarray) -> tuple[float, float]:
    tail = 50.0 * (1.0 - CONFIDENCE)
    found = estimates[np.isfinite(estimates)]  # a resample may consist of NaNs
    low, high = np.percentile(found, [tail, 100.0 - tail])
    return float(low), float(high)


def _wilson(share: float, n: int) -> tuple[float, float]:
    """Return the interval of a share of `n` (Wilson 1927, Probable inference)."""
    centre = (share + Z * Z / (2 * n)) / (1 + Z * Z / n)
    half = Z / (1 + Z * Z / n) * math.sqrt(share * (1 - share) / n + Z * Z / (4 * n * n))
    return max(centre - half, 0.0), min(centre + half, 1.0)
