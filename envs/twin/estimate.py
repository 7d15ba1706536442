"""Least squares on re-simulation, with residuals made white.

The encoder's noise passes through the control loop, so the residuals of a correct model are
coloured, in position and torque together. Ordinary least squares would be consistent, but its
confidence intervals would be wrong. The residuals of position and torque are therefore filtered by
the inverse of an autoregression fitted to them, the prediction-error method (Ljung, System
Identification, 1999, chapter 7). The filtered residuals are white and give the covariance of the
estimate. Noise is not stationary where friction holds the axis, so a sandwich estimator over short
blocks corrects the intervals (White 1980); the wider interval is used.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from .candidates import LAG, Candidates
from .experiment import Experiment

ORDER = 6  # of the autoregression
BLOCK, MOVE = 0.05, 0.25  # s, blocks of the sandwich; with a coarse encoder a block is a move
TRIES = (0.03, 1.0, 30.0)  # factors of the damping, simulated in parallel
SMALL = 1e-4  # share of the cost; a search from far away ends with a smaller gain
CLOSE = 0.05  # the same near the optimum, in the sum of squares of white residuals
GRAINS = 20  # shortest difference of a rounded value, in its increments
REACH = 10  # standard errors over which a derivative is taken, to either side
FINEST = 1e-5  # shortest difference of a derivative, of the value or of the first difference
DIFFERENCES = 3  # order of differences that keep noise and little of a model error


@dataclass(frozen=True)
class FreeParameter:
    """A parameter to be estimated.

    Args:
        name: name of the parameter, or `LAG`.
        start: start value of the search.
        low: lowest value.
        high: highest value.
        step: difference over which the derivative is taken.
        log: the search uses ratios.
        grain: increment to which the drive rounds the value, over the value.
        share: share of `step` over which the derivative is taken.
    """

    name: str
    start: float
    low: float
    high: float
    step: float
    log: bool = False
    grain: float = 0.0
    share: float = 1.0

    def inner(self, value: float) -> float:
        """In the coordinate of the search."""
        return math.log(value) if self.log else value / self.step

    def outer(self, inner: float) -> float:
        """The value, within its bounds."""
        value = math.exp(min(max(inner, -700.0), 700.0)) if self.log else inner * self.step
        return min(max(value, self.low), self.high)

    @property
    def width(self) -> float:
        """Width of the difference quotient, in the coordinate of the search."""
        return self.share * (math.log1p(self.step) if self.log else 1.0)

    def finer(self, error: float) -> "FreeParameter":
        """Return the parameter with differences of some standard errors.

        A shorter difference would measure single events. The position at which an axis sticks, or a
        gap closes, changes with each value, and this effect is worth about seven standard errors
        however short the difference is. Differences also stay longer than the drive's rounding.
        """
        full = math.log1p(self.step) if self.log else 1.0
        least = max(FINEST, GRAINS * self.grain) / self.step
        return replace(self, share=min(max(REACH * error / full, least), 1.0))


@dataclass
class Noise:
    """A whitening filter: an autoregression, and the covariance of its innovations."""

    scales: tuple[float, float]  # of position (m or rad) and torque (Nm)
    coefficients: np.ndarray = field(default_factory=lambda: np.zeros((0, 2, 2)))
    inverse: np.ndarray = field(default_factory=lambda: np.eye(2))  # of the covariance's factor

    def white(self, residuals: np.ndarray) -> np.ndarray:
        """Return residuals ``(n, 2)`` or ``(k, n, 2)``, in their units, as white ones of size 1."""
        scaled = residuals / np.array(self.scales)
        left = scaled.copy()
        for lag, matrix in enumerate(self.coefficients, 1):
            left[..., lag:, :] -= scaled[..., :-lag, :] @ matrix.T
        return left @ self.inverse.T


def colour(
    residuals: Sequence[np.ndarray], moving: Sequence[np.ndarray], order: int = ORDER
) -> Noise:
    """Fit the autoregression to residuals ``(n, 2)`` of several experiments.

    Only samples of motion count. At rest, dry friction keeps the position that noise has left. That
    looks like noise of very low frequency and would hide a constant error of the torque.
    """
    ahead, behind = [], []
    for each, on in zip(residuals, moving, strict=True):
        if len(each) <= 4 * order:
            continue
        run = np.lib.stride_tricks.sliding_window_view(on, order + 1).all(axis=1)
        ahead.append(each[order:][run])
        behind.append(
            np.concatenate([each[order - k : -k] for k in range(1, order + 1)], axis=1)[run])
    both = np.concatenate([each[on] for each, on in zip(residuals, moving, strict=True)])
    scales = np.maximum(np.sqrt(np.mean(both**2, axis=0)), 1e-12)
    noise = Noise((float(scales[0]), float(scales[1])))
    if sum(map(len, ahead)) < 10 * order:
        return noise
    y, x = np.concatenate(ahead) / scales, np.concatenate(behind) / np.tile(scales, order)
    gram = x.T @ x + 1e-6 * len(x) * np.eye(x.shape[1])
    solution = np.linalg.solve(gram, x.T @ y)
    left = y - x @ solution
    covariance = left.T @ left / max(len(y) - x.shape[1], 1) + 1e-9 * np.eye(2)
    noise.coefficients = solution.T.reshape(2, order, 2).transpose(1, 0, 2)
    noise.inverse = np.linalg.inv(np.linalg.cholesky(covariance))
    return noise


@dataclass
class Estimate:
    """The result of a search."""

    values: dict[str, float]
    cost: float  # mean square of the white residuals, about 1 where the noise explains it
    covariance: np.ndarray  # of the inner coordinates
    free: list[FreeParameter]
    noise: Noise
    jacobian: np.ndarray  # of the white residuals by the inner coordinates

    def finer(self, smooth: bool = True) -> list[FreeParameter]:
        """Return the free parameters with differences of some standard errors, others held.

        They stay as they are if the machine is not `smooth`, as increments hide short differences.
        """
        if not smooth:
            return self.free
        sizes = np.maximum(np.linalg.norm(self.jacobian, axis=0), 1e-300)
        errors = math.sqrt(self.cost) / sizes
        return [f.finer(float(error)) for f, error in zip(self.free, errors, strict=True)]

    def interval(self, name: str, quantile: float = 2.07) -> tuple[float, float]:
        """Return the interval of a parameter, 95 % by default (t of 23 degrees of freedom)."""
        at = [each.name for each in self.free].index(name)
        free = self.free[at]
        inner = free.inner(max(self.values[name], 1e-300) if free.log else self.values[name])
        width = quantile * math.sqrt(max(float(self.covariance[at, at]), 0.0))
        if free.log:
            width = min(width, 50.0)
        return free.outer(inner - width), free.outer(inner + width)

    def correlation(self) -> np.ndarray:
        """Correlation matrix of the estimates."""
        sizes = np.sqrt(np.maximum(np.diag(self.covariance), 1e-300))
        return self.covariance / np.outer(sizes, sizes)


class Search:
    """Search for the parameters of one family in one or several experiments.

    Args:
        candidates: machines of the family.
        experiments: the experiments to repeat.
        fixed: values of known parameters.
        progress: called after each step with the values and the cost.
    """

    def __init__(
        self, candidates: Candidates, experiments: Sequence[Experiment],
        fixed: Mapping[str, float] | None = None,
        progress: Callable[[Mapping[str, float], float], object] = lambda values, cost: None,
    ):
        self.candidates = candidates
        self.experiments = list(experiments)
        self._moving = [each.moving for each in self.experiments]
        self.fixed = dict(fixed or {})
        self.progress = progress

    def residuals(self, values: Sequence[Mapping[str, float]]) -> list[np.ndarray]:
        """Measured minus expected, for each experiment, shape ``(len(values), m, 2)``."""
        found = []
        for experiment in self.experiments:
            run = self.candidates.simulate(experiment, [self.fixed | dict(v) for v in values])
            found.append(experiment.residuals(run.position, run.torque))
        return found

    def white(self, values: Sequence[Mapping[str, float]], noise: Noise) -> list[np.ndarray]:
        """White residuals of the samples of motion."""
        return [
            noise.white(r)[:, moving]
            for r, moving in zip(self.residuals(values), self._moving, strict=True)
        ]

    def noise(self, values: Mapping[str, float]) -> Noise:
        """Fit the whitening filter to the residuals of some values."""
        return colour([each[0] for each in self.residuals([values])], self._moving)

    def start_noise(self) -> Noise:
        """Return the noise before anything is known, from high differences of the measured values.

        For a coarse encoder it is one increment, and a tenth of the highest torque: runs of one
        machine differ by the cycle in which an encoder edge comes, which has no such colour.
        """
        if self.candidates.coarse:
            highest = max(float(np.abs(each.torque).max()) for each in self.experiments)
            return Noise((self.candidates.increment, 0.1 * highest))
        parts = [(_rough(each.position), _rough(each.torque)) for each in self.experiments]
        p, t = (math.sqrt(np.mean(np.square(column))) for column in zip(*parts, strict=True))
        q_p, q_t = self.experiments[0].quanta
        return Noise((max(p, q_p, 1e-9), max(t, q_t, 1e-6)))

    def cost(self, values: Sequence[Mapping[str, float]], noise: Noise) -> np.ndarray:
        """Return the mean square of the white residuals for each set of values."""
        parts = self.white(values, noise)
        total = sum(np.sum(np.square(part), axis=(1, 2)) for part in parts)
        count = sum(part.shape[1] * 2 for part in parts)
        cost: np.ndarray = np.nan_to_num(total / count, nan=1e30, posinf=1e30)
        return cost

    def descend(
        self, free: Sequence[FreeParameter], values: Mapping[str, float], noise: Noise,
        steps: int = 10, close: bool = False,
    ) -> Estimate:
        """Minimise the cost by Levenberg-Marquardt, with candidates in parallel.

        With `close`, the search ends when the sum of squares changes by a small part of one, which
        is a standard error, and the last Jacobian is central; otherwise when the relative gain is
        small. Residuals jump where an axis only just sticks. If no step helps, each derivative is
        taken on the quieter side.
        """
        free = list(free)
        x = np.array([f.inner(max(values[f.name], f.low)) for f in free])
        damping, best, side = 1.0, math.inf, 1.0
        failed: np.ndarray | None = None  # the Jacobian with which no step was lower
        for n in range(steps + 1):
            last = n == steps
            white, jacobian = self._linear(free, x, noise, last and close, side)
            if failed is not None and not last:
                quieter = np.linalg.norm(failed, axis=0) < np.linalg.norm(jacobian, axis=0)
                jacobian = np.where(quieter, failed, jacobian)
            best = float(np.mean(white**2))
            here = {f.name: f.outer(c) for f, c in zip(free, x, strict=True)}
            self.progress(self.fixed | here, best)
            if last:
                break
            gram, slope = jacobian.T @ jacobian, jacobian.T @ white
            size = np.maximum(np.diag(gram), 1e-12)
            trials = []
            for factor in TRIES:
                step = np.linalg.solve(gram + damping * factor * 1e-3 * np.diag(size), -slope)
                step = np.clip(step, -_most(free), _most(free))
                trials.append(self._inside(free, x + step))
            costs = self.cost(
                [{f.name: f.outer(c) for f, c in zip(free, t, strict=True)} for t in trials], noise
            )
            winner = int(np.argmin(costs))
            if not costs[winner] < best:
                damping *= 1.0 if failed is None else 100.0
                failed, side = jacobian, -side
                if damping > 1e7:
                    steps = n
                    white, jacobian = self._linear(free, x, noise, close)
                    break
                continue
            failed, side = None, 1.0
            gained = best - float(costs[winner])
            x, damping = trials[winner], damping * TRIES[winner]
            if gained < (CLOSE / len(white) if close else SMALL * best):
                white, jacobian = self._linear(free, x, noise, close)
                best = float(np.mean(white**2))
                break
        values = self.fixed | {f.name: f.outer(c) for f, c in zip(free, x, strict=True)}
        covariance = self._covariance(free, x, white, jacobian)
        return Estimate(values, best, covariance, free, noise, jacobian)

    def bootstrapped(self, estimate: Estimate) -> Estimate:
        """Widen the covariance to that of a parametric bootstrap, linearised.

        The replicas of each experiment are rounded as the log is. A Gauss-Newton step gives the
        estimate that each replica would have led to (Efron, Tibshirani 1993, chapter 6).

        Args:
            estimate: of this search, whose experiments have replicas.
        """
        jacobian = estimate.jacobian
        gram = jacobian.T @ jacobian
        size = np.sqrt(np.maximum(np.diag(gram), 1e-30))
        inverse = np.linalg.pinv(gram / np.outer(size, size), rcond=1e-10) / np.outer(size, size)
        away = []
        for experiment, moving in zip(self.experiments, self._moving, strict=True):
            assert experiment.replicas is not None
            run = self.candidates.simulate(experiment, [estimate.values])
            quiet = np.stack([run.position[0], run.torque[0]], axis=-1)
            quanta = np.maximum(experiment.quanta, 1e-12)
            logged = np.round((quiet + experiment.replicas.added) / quanta) * quanta
            left = estimate.noise.white(logged - quiet - experiment.replicas.mean)[:, moving]
            away.append(left.reshape(len(left), -1))
        steps = (np.concatenate(away, axis=1) @ jacobian) @ inverse
        spread = np.sqrt(np.var(steps, axis=0, ddof=1) * (1 + 1 / len(steps)))
        known = np.sqrt(np.maximum(np.diag(estimate.covariance), 1e-300))
        wider = np.maximum(spread / known, 1.0)
        return replace(estimate, covariance=estimate.covariance * np.outer(wider, wider))

    def _inside(self, free: Sequence[FreeParameter], x: np.ndarray) -> np.ndarray:
        return np.array([
            f.inner(max(f.outer(c), 1e-300) if f.log else f.outer(c))
            for f, c in zip(free, x, strict=True)
        ])

    def _linear(
        self, free: Sequence[FreeParameter], x: np.ndarray, noise: Noise, central: bool,
        side: float = 1.0,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the white residuals and their derivatives by the inner coordinates."""
        points = [x]
        for n, f in enumerate(free):
            for sign in (1.0, -1.0) if central else (side,):
                point = x.copy()
                point[n] += sign * f.width
                points.append(point)
        sets = [{f.name: f.outer(c) for f, c in zip(free, p, strict=True)} for p in points]
        inner = [
            [f.inner(max(v[f.name], 1e-300) if f.log else v[f.name]) for f in free] for v in sets
        ]
        parts = self.white(sets, noise)
        flat = np.concatenate([p.reshape(len(sets), -1) for p in parts], axis=1)
        flat = np.nan_to_num(flat, nan=1e6, posinf=1e6, neginf=-1e6)
        jacobian = np.zeros((flat.shape[1], len(free)))
        per = 2 if central else 1
        for n in range(len(free)):
            ahead = 1 + per * n
            behind = ahead + 1 if central else 0
            gap = inner[ahead][n] - inner[behind][n]
            if abs(gap) < 1e-12:  # at its upper bound
                continue
            jacobian[:, n] = (flat[ahead] - flat[behind]) / gap
        self._lengths = [p.shape[1] * 2 for p in parts]
        return flat[0], jacobian

    def _covariance(
        self, free: Sequence[FreeParameter], x: np.ndarray, white: np.ndarray, jacobian: np.ndarray
    ) -> np.ndarray:
        """Return the covariance of the inner coordinates: white noise or blocks, the wider one."""
        gram = jacobian.T @ jacobian
        scale = max(float(np.mean(white**2)), 1e-12)
        size = np.sqrt(np.maximum(np.diag(gram), 1e-30))
        bread = np.linalg.pinv(gram / np.outer(size, size), rcond=1e-10) / np.outer(size, size)
        plain = scale * bread
        meat, blocks, begin = np.zeros_like(gram), 0, 0
        for length, experiment in zip(self._lengths, self.experiments, strict=True):
            period = experiment.duration / max(length // 2 - 1, 1)
            block = max(int((MOVE if self.candidates.coarse else BLOCK) / period), 4) * 2
            for at in range(begin, begin + length, block):
                part = slice(at, min(at + block, begin + length))
                score = jacobian[part].T @ white[part]
                meat += np.outer(score, score)
                blocks += 1
            begin += length
        sandwich = bread @ meat @ bread * (blocks / max(blocks - len(free), 1))
        wider = np.sqrt(np.maximum(np.diag(sandwich) / np.maximum(np.diag(plain), 1e-300), 1.0))
        return plain * np.outer(wider, wider)


def _most(free: Sequence[FreeParameter]) -> np.ndarray:
    """Return the longest step of the search: a factor of two, or ten differences."""
    return np.array([0.7 if f.log else 10.0 for f in free])


def _rough(values: np.ndarray) -> float:
    """Return the standard deviation of the noise, from high differences."""
    left = np.diff(values, DIFFERENCES)
    ordered = np.sort(np.abs(left))
    if len(ordered) == 0:
        return 0.0
    middle = float(np.median(ordered)) / 0.6745
    return middle / math.sqrt(math.comb(2 * DIFFERENCES, DIFFERENCES))


__all__ = ["LAG", "Candidates", "Estimate", "FreeParameter", "Noise", "Search", "colour"]
