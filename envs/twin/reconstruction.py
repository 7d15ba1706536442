"""Estimates from the motion what a log does not contain: lost set-points and encoder noise.

A logger stamps frames late and misses some. The drive received all of them in time, and its motion
shows their values. The encoder's noise acts on the axis through the control loop.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from .candidates import LAG, SEED, Candidates
from .estimate import Noise
from .experiment import Experiment, Replicas

SHIFT, ROUNDS = 3, 3  # cycles by which a motion may begin before or after its stamp; iterations
ANSWER = 0.15  # s, response time of an axis to an error of a set-point
REPLICAS = 24  # runs with encoder noise
TRIMMED = 0.4377  # mean square of the quieter four fifths of standard normal values
ENOUGH = 20  # differences that tell a noise
ROUGH = 3  # order of the differences that leave noise and little of a model error


def timed(
    candidates: Candidates, experiment: Experiment, values: Mapping[str, float]
) -> Experiment:
    """Return an experiment whose motions begin in the position cycles that its samples show.

    The stamps of a logger are accurate to some tenths of a millisecond, and an RPDO waits for the
    next cycle of the drive. The error of a non-cyclic set-point is the distance travelled in that
    time. All set-points have one delay in common, `LAG`, and differ by whole cycles.
    """
    if experiment.events is None or not experiment.events.begins.any():
        return experiment
    count = int(np.count_nonzero(experiment.events.begins))
    shifts = np.arange(-SHIFT, SHIFT + 1)
    for _ in range(ROUNDS):
        events = experiment.events
        at = (events.at[events.begins] - experiment.begins) * experiment.cycle
        which = np.searchsorted(at + values.get(LAG, 0.0), experiment.time, "right")
        errors = np.zeros((len(shifts), count + 1))
        for row, shift in zip(errors, shifts, strict=True):
            run = candidates.simulate(experiment.moved(np.full(count, shift)), [values])
            row += np.bincount(which, (experiment.position - run.position[0]) ** 2, count + 1)
        errors = errors[:, 1:]
        best = np.clip(np.argmin(errors, axis=0), 1, len(shifts) - 2)
        below, here, above = (errors[best + n, np.arange(count)] for n in (-1, 0, 1))
        bend = above - 2 * here + below
        seen = bend > 1e-3 * np.nanmax(bend)
        if not seen.any():
            break
        wanted = shifts[best] + np.clip(0.5 * (below - above) / np.where(seen, bend, 1.0), -2, 2)
        turn = np.exp(2j * np.pi * wanted[seen]).mean()
        cycles = np.round(wanted - np.angle(turn) / (2 * np.pi)).astype(int)
        cycles = np.where(seen, cycles - round(float(np.median(cycles[seen]))), 0)
        if not cycles.any():
            break
        experiment = experiment.moved(cycles)
    return experiment


def restored(
    candidates: Candidates, experiment: Experiment, values: Mapping[str, float], noise: Noise
) -> Experiment:
    """Return an experiment with estimates of the set-points that were lost from its log.

    Each estimate combines the curve through its neighbours with the residual motion after it,
    weighted by the error of such curves in this log and by the noise (maximum a posteriori).
    Derivatives by set-points that are far apart are taken in one run.
    """
    lost = experiment.missed
    if lost is None or not len(lost.at) or lost.error == 0.0:
        return experiment

    def white(experiment: Experiment) -> np.ndarray:
        run = candidates.simulate(experiment, [values])
        return noise.white(experiment.residuals(run.position[0], run.torque[0]))

    def off(amounts: np.ndarray) -> Experiment:
        return replace(experiment, rows=lost.rows(experiment.rows, amounts))

    left = white(experiment)
    begins = (lost.at - experiment.begins) * experiment.cycle + values.get(LAG, 0.0)
    ends = begins + max(ANSWER, 4 * lost.per * experiment.cycle)
    step = max(round(lost.error), 1)
    slopes = np.zeros((len(lost.at), *left.shape))
    for group in _apart(begins, ends):
        amounts = np.zeros(len(lost.at), int)
        amounts[group] = step
        slope = (left - white(off(amounts))) / step
        for n in group:
            inside = (experiment.time >= begins[n] - experiment.period) & (
                experiment.time < ends[n])
            slopes[n, inside] = slope[inside]
    flat = slopes.reshape(len(slopes), -1)
    scale = max(float(np.mean(left[experiment.moving] ** 2)), 1e-12)
    gram = flat @ flat.T / scale + np.eye(len(flat)) / lost.error**2
    amounts = np.linalg.solve(gram, flat @ left.ravel() / scale)
    return off(np.round(amounts).astype(int))


def expected(
    candidates: Candidates, experiment: Experiment, values: Mapping[str, float]
) -> Experiment:
    """Return an experiment with replicas: the effect of encoder noise on a run with these values.

    Measured values are compared with the mean of noisy runs, not with a run without noise. Dry
    friction and rounding are not linear, so the two differ by micrometres, and a fit without the
    mean would put that difference into the parameters. The correction is that of indirect inference
    (Gourieroux, Monfort, Renault 1993). An encoder so coarse that its increments are the noise has
    no replicas.
    """
    if candidates.coarse:
        return experiment
    quiet = candidates.simulate(experiment, [values])
    path = np.concatenate([quiet.position, quiet.torque]).T

    def replicas(deviation: float) -> Replicas:
        run = candidates.simulate(experiment, [
            {**values, "encoder_noise": deviation, SEED: 2 * n + 12345} for n in range(REPLICAS)])
        expected = np.stack([run.position, run.torque], axis=-1).mean(axis=0)
        return Replicas(deviation, run.nearest - run.nearest.mean(axis=0) + expected - path)

    known = experiment.replicas
    if known is None or known.deviation == 0.0:
        known = replicas(experiment.quanta[0])
    experiment = replace(experiment, replicas=known)
    left = experiment.residuals(*quiet[:2])[0, :, 0]
    return replace(experiment, replicas=replicas(_noise(experiment, left)))


def _noise(experiment: Experiment, left: np.ndarray) -> float:
    """Return the standard deviation of the encoder noise (m or rad), from high differences.

    Differences of the residuals contain noise and model errors; differences of the position at rest
    contain noise and residual motion. The smaller estimate is used, so that the errors of a wrong
    model do not count as noise.

    Args:
        experiment: with replicas, whose noise may be of another size.
        left: residuals of position (m or rad), shape ``(m,)``.
    """
    known = experiment.replicas
    assert known is not None
    added = (known.added - known.mean)[:, :, 0]
    still = np.lib.stride_tricks.sliding_window_view(~experiment.moving, ROUGH + 1)
    rest = np.asarray(still.all(axis=1))
    everywhere = np.ones(len(rest), bool)
    sizes = []
    for values, at in ((left, everywhere), (experiment.position, rest)):
        if np.count_nonzero(at) < ENOUGH:
            continue
        rounding = math.comb(2 * ROUGH, ROUGH) * experiment.quanta[0] ** 2 / 12
        present = max(_variance(np.diff(values, ROUGH)[at]) - rounding, 0.0)
        made = _variance(np.diff(added, ROUGH, axis=1)[:, at].ravel())
        sizes.append(known.deviation * math.sqrt(present / made) if made > 0.0 else 0.0)
    return min(sizes, default=0.0)


def _variance(values: np.ndarray) -> float:
    """Return the variance of normal values about zero, from the smaller four fifths of them."""
    squares = np.sort(values**2)[: max(round(0.8 * len(values)), 1)]
    return float(np.mean(squares)) / TRIMMED


def _apart(begins: np.ndarray, ends: np.ndarray) -> Sequence[list[int]]:
    """Return groups of intervals that do not overlap."""
    groups: list[list[int]] = []
    for n in np.argsort(begins):
        group = next((each for each in groups if ends[each[-1]] <= begins[n]), None)
        if group is None:
            groups.append(group := [])
        group.append(int(n))
    return groups
