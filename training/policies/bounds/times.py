"""The least time to reach a window and stay there, with a certificate for each episode.

Is there a torque within the limits of the drive that keeps the load in its window from a given
physics step on? A linear program (`scipy.optimize.linprog`, HiGHS) minimises how far the load lies
outside, over torques that are constant for `COARSE` cycles. Its solution proves nothing, but its
multipliers do: for any multipliers, weak duality gives in closed form (a sum of absolute values) a
distance that *no* torque and disturbance can undercut, even if they change in every cycle. If this
distance is above 0, the load cannot be in the window in time. The tolerances of the solver
therefore do not matter; if the solver fails, the bound is lower, but never wrong.

Only some of the instants in the window are checked, which is also to the controller's advantage.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from .plant import LOAD, MOTOR, SPEED, Plant

COARSE = 8  # cycles for which a torque is constant in the program, or more, so that there are
PIECES = 120  # at most so many torques; the certificate counts every cycle
ASKED = 40  # instants checked in the window, and as many before
MARGIN = 1e-9  # m, for rounding


class Question(NamedTuple):
    """When has the load settled? Lengths are in m or rad."""

    goal: float
    window: float  # half its width
    ticks: int  # physics steps between two instants at which the load is judged
    last: int  # physics steps of the episode
    tail: int  # physics steps for which the load has to stay in the window
    speed: float = np.inf  # top speed of the set-point
    ahead: float = np.inf  # the farthest that the motor side can be ahead of the set-point
    resting: float = np.inf  # the highest speed of a load that counts as settled


def scipy() -> object:
    """Return `scipy.optimize`. Raises ImportError with the command that installs it."""
    try:
        from scipy import optimize
    except ModuleNotFoundError as error:
        raise ImportError(f"bound needs scipy ({error}): pip install 'servogym[lqr]'") from None
    return optimize


def least_ticks(plant: Plant, asked: Question) -> int:
    """Return the physics steps before which no torque can settle the load, certified."""

    def impossible(ticks: int) -> bool:
        return outside(plant, asked, ticks) > MARGIN

    if not impossible(asked.ticks):
        return 0
    low, high = 1, 2  # in units of `asked.ticks`: certified, not certified
    most = asked.last // asked.ticks
    while high < most and impossible(high * asked.ticks):
        low, high = high, 2 * high
    high = min(high, most)
    return asked.ticks * _last(lambda k: impossible(k * asked.ticks), low, high)


def _last(impossible: Callable[[int], bool], low: int, high: int) -> int:
    while high - low > 1:
        middle = (low + high) // 2
        if impossible(middle):
            low = middle
        else:
            high = middle
    return low


def outside(plant: Plant, asked: Question, ticks: int) -> float:
    """Return how far at least the load is outside its window at some time from `ticks` on (m).

    The value is at most 0 if this is not known.
    """
    end = min(ticks + asked.tail, asked.last)
    if ticks >= end:
        return 0.0
    every = max(-(-(end - ticks) // ASKED) // asked.ticks, 1) * asked.ticks
    within = np.arange(ticks, end + 1, every)
    before = np.unique(np.linspace(1, ticks, ASKED).astype(int))
    rows: list[tuple[np.ndarray, int, float, np.ndarray, float]] = [
        (within, LOAD, sign, np.full(len(within), sign * asked.goal + asked.window), 1.0)
        for sign in (1.0, -1.0)
    ]
    if np.isfinite(asked.resting):
        rows += [
            (within, SPEED, sign, np.full(len(within), asked.resting), asked.resting / asked.window)
            for sign in (1.0, -1.0)
        ]
    if np.isfinite(asked.ahead):
        reach = asked.ahead + asked.speed * plant.timestep * before
        begin = plant.free[0, MOTOR]
        rows += [(before, MOTOR, sign, sign * begin + reach, 0.0) for sign in (1.0, -1.0)]
    left = np.concatenate(
        [highest - sign * plant.free[at, output] for at, output, sign, highest, _ in rows]
    )
    slack = np.concatenate([np.full(len(at), share) for at, *_, share in rows])
    exact = []
    for response in plant.inputs:
        parts = [sign * response.rows(at, output) for at, output, sign, *_ in rows]
        width = max(part.shape[1] for part in parts)
        exact.append(np.vstack([np.pad(p, ((0, 0), (0, width - p.shape[1]))) for p in parts]))
    weights = _multipliers(plant, exact, left, slack)
    if weights is None:
        return 0.0
    value = -float(weights @ left)
    for response, matrix in zip(plant.inputs, exact, strict=True):
        value += response.least(weights @ matrix)
    return value


def _multipliers(
    plant: Plant, exact: list[np.ndarray], left: np.ndarray, slack: np.ndarray
) -> np.ndarray | None:
    """Return a multiplier ≥ 0 for each row, with ``slack @ multipliers`` = 1; None if it fails."""
    coarse, bounds = [], []
    for response, matrix in zip(plant.inputs, exact, strict=True):
        span = max(COARSE, matrix.shape[1] // PIECES)
        whole = np.pad(matrix, ((0, 0), (0, -matrix.shape[1] % span)))
        joined = whole.reshape(len(whole), -1, span).sum(axis=2)
        scale = max(abs(response.low), abs(response.high))
        coarse.append(scale * joined)
        bounds += [(response.low / scale, response.high / scale)] * joined.shape[1]
    unit = 1e3  # mm: the solver works best on numbers near 1
    matrix = unit * np.hstack([*coarse, -slack[:, None] / unit])
    cost = np.zeros(matrix.shape[1])
    cost[-1] = 1.0
    found = scipy().linprog(  # type: ignore[attr-defined]
        cost, A_ub=matrix, b_ub=unit * left, bounds=[*bounds, (0.0, None)], method="highs"
    )
    if found.status != 0:
        return None
    weights = np.maximum(-np.asarray(found.ineqlin.marginals), 0.0)
    total = float(weights @ slack)
    return weights / total if total > 0.0 else None
