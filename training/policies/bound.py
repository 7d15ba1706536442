"""A bound on time: how soon any controller could have settled, all parameters known.

A linear program (`scipy.optimize.linprog`, HiGHS) for each episode: is there a force within the
maximum torque that brings the load into its window after T, keeps it there and has it at rest, at
no more than the top speed? T is bisected until it is known to `RESOLUTION`. Friction counts as a
force that may take any value up to its own, to the controller's advantage; the drive's loops, its
set-points and what a step of the agent takes do not count. The force is constant over a `PARTS`-th
of T, so the bound is that of this grid, inferred to be within 1 % of the least time.
"""

import math
from typing import Any

import numpy as np

from ...envs.environment.servo_env import ServoEnv
from .datasheet import Axis, Datasheet, datasheet

PARTS = 30  # of the time until it has settled
RESTING = 10  # parts in which it comes to rest within the window
RESOLUTION = 5e-4  # s
LONGEST = 10.0  # s


class Bound:
    """Stands for no controller: the least time to the goal, of an episode that has begun."""

    def __init__(self, env: ServoEnv, seed: int = 0):
        scipy()
        self._env = env
        if not datasheet(env).tolerance:
            raise ValueError(f"policy 'bound': {env.ID} has no tolerance in which it settles")

    def seconds(self, observation: np.ndarray) -> float:
        """Until it has settled, of several axes the last (s)."""
        known = datasheet(self._env, self._env.parameters)
        axes = known.axes[: len(known.named_by_axis(observation))] or (known.axis,)
        return max(
            least_time(axis, float(seen.distance) * axis.stroke - _sag(axis), known)
            for axis, seen in zip(axes, known.named_by_axis(observation), strict=True)
        )


def scipy() -> Any:
    """`scipy.optimize` and `scipy.linalg`. Raises ImportError with the command that installs it."""
    try:
        from scipy import linalg, optimize
    except ModuleNotFoundError as error:
        raise ImportError(f"bound needs scipy ({error}): pip install 'servogym[lqr]'") from None
    return optimize, linalg


def _sag(axis: Axis) -> float:
    """How far the weight bends the spring (m)."""
    if axis.vibration is None:
        return 0.0
    return -axis.weight / (axis.carriage + axis.payload) / axis.vibration.frequency**2


def plant(axis: Axis) -> tuple[np.ndarray, np.ndarray]:
    """``x' = A x + B · force`` of the axis and what swings behind it.

    The state: place and velocity of the axis, deflection of the load and its rate; without anything
    that swings the first two. Shapes ``(n, n)``, ``(n,)``.
    """
    if axis.vibration is None:
        mass = axis.mass(axis.payload)
        return np.array([[0.0, 1.0], [0.0, -axis.viscous_friction / mass]]), np.array(
            [0.0, 1.0 / mass]
        )
    frequency, ratio = axis.vibration
    mass, load = axis.mass(0.0), axis.payload
    pull = load * np.array([frequency**2, 2.0 * ratio * frequency])  # on the axis, by deflection
    own = np.array([-axis.viscous_friction, *pull]) / mass  # acceleration by velocity and these
    a = np.zeros((4, 4))
    a[0, 1] = a[2, 3] = 1.0
    a[1, 1:] = own
    a[3, 1:] = -own
    a[3, 2:] -= pull / load
    return a, np.array([0.0, 1.0 / mass, 0.0, -1.0 / mass])


def least_time(axis: Axis, way: float, known: Datasheet) -> float:
    """For a way (m) from rest into the window of the tolerance (s).

    Args:
        axis: as it was drawn.
        way: of the load.
        known: with the tolerance.
    """
    way = abs(way)
    if way <= known.tolerance:
        return 0.0
    low, high = (
        0.0,
        max(way / axis.speed, 2.0 * math.sqrt(way * axis.mass(axis.payload) / axis.force)),
    )
    while not reached(axis, way, high, known.tolerance):
        low, high = high, 2.0 * high
        if high > LONGEST:
            return math.nan
    while high - low > RESOLUTION:
        middle = 0.5 * (low + high)
        if reached(axis, way, middle, known.tolerance):
            high = middle
        else:
            low = middle
    return high


def reached(axis: Axis, way: float, time: float, tolerance: float) -> bool:
    """Whether the load can be in its window from `time` (s) on."""
    optimize, linalg = scipy()
    a, b = plant(axis)
    n = len(b)
    settle = math.pi / axis.vibration.frequency if axis.vibration else 0.02
    force = axis.force + axis.coulomb_friction
    forced = np.zeros((n, PARTS + RESTING))  # the state by the shares of the forces
    rows, places = [], []  # velocities of the axis, places of the load, by the forces
    for k in range(PARTS + RESTING):
        if k in (0, PARTS):
            dt = time / PARTS if k == 0 else settle / RESTING
            joint = linalg.expm(np.block([[a, b[:, None]], [np.zeros((1, n + 1))]]) * dt)
            step, push = joint[:n, :n], force * joint[:n, n]
        forced = step @ forced
        forced[:, k] += push
        rows.append(forced[1].copy())
        if k >= PARTS - 1:
            places.append(forced[0] + (forced[2] if n > 2 else 0.0))
    velocity, place = np.array(rows), np.array(places)
    found = optimize.linprog(
        np.zeros(PARTS + RESTING),
        A_ub=np.vstack([velocity / axis.speed, -velocity / axis.speed, place / way, -place / way]),
        b_ub=np.concatenate([
            np.ones(2 * len(velocity)), np.full(len(place), 1.0 + tolerance / way),
            np.full(len(place), tolerance / way - 1.0),
        ]),
        A_eq=forced[1::2] / axis.speed, b_eq=np.zeros(n // 2), bounds=(-1.0, 1.0), method="highs",
    )  # fmt: skip
    return bool(found.status == 0)
