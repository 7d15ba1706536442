"""The least time to be in a window and stay there, with a certificate for each episode.

Is there a torque within the limits of the drive that has the load within its window from a physics
step on? A linear program (`scipy.optimize.linprog`, HiGHS) minimises by how much it lies outside,
over torques that are constant for `COARSE` cycles. What it finds is no proof, but its multipliers
are: for any of them, weak duality gives a number below all that *any* torque and disturbance of
every single cycle can reach, in closed form (a sum of absolute values). Where that number is above
0, nothing is within the window in time. So the tolerances of the solver do not matter; a solver
that fails makes the bound lower, never wrong.

Only some of the instants in the window are asked for, which is to the controller's advantage too.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from .plant import LOAD, MOTOR, SPEED, Plant

COARSE = 8  # cycles of a torque in the program, or so many
PIECES = 120  # that there are no more than these; in the certificate every cycle counts
ASKED = 40  # instants in the window, and as many before
MARGIN = 1e-9  # m, that rounding may take


class Question(NamedTuple):
    """When is the load at rest? Lengths in m or rad."""

    goal: float
    window: float  # half of it
    ticks: int  # physics steps from which on, and then every as many, it has to be in the window
    last: int  # physics steps of the episode
    tail: int  # physics steps in the window that are looked at
    speed: float = np.inf  # that a set-point can have; the motor side is not farther ahead of it
    ahead: float = np.inf  # than this: the window of the following error
    resting: float = np.inf  # that the load may have in the window


def scipy() -> object:
    """`scipy.optimize`. Raises ImportError with the command that installs it."""
    try:
        from scipy import optimize
    except ModuleNotFoundError as error:
        raise ImportError(f"bound needs scipy ({error}): pip install 'servogym[lqr]'") from None
    return optimize


def least_ticks(plant: Plant, asked: Question) -> int:
    """Physics steps before which no torque within the limits has it settled, certified."""

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
    """How far outside its window the load is at some time from `ticks` on, at least (m).

    At most 0 where that is not known.
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
    """Of the rows, not negative, `slack` times them at most 1 in sum; None: the solver failed."""
    coarse, bounds = [], []
    for response, matrix in zip(plant.inputs, exact, strict=True):
        span = max(COARSE, matrix.shape[1] // PIECES)
        whole = np.pad(matrix, ((0, 0), (0, -matrix.shape[1] % span)))
        joined = whole.reshape(len(whole), -1, span).sum(axis=2)
        scale = max(abs(response.low), abs(response.high))
        coarse.append(scale * joined)
        bounds += [(response.low / scale, response.high / scale)] * joined.shape[1]
    unit = 1e3  # mm: the program is scaled as its solver likes it
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
