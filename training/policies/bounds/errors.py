"""The least error of a motion along a reference, with a certificate.

A reference asks for more than the torque gives where it jumps. Around the sharpest place of it, for
`SIDE` samples before and behind, the least squared error is bounded from below by Fenchel duality:
for any weights λ of the samples, of which the state at the beginning of that part sees nothing,

    |e|² ≥ max(λ (r - weight) - most that torques and disturbances make of λ, 0)² / |λ|²

in closed form over every cycle of the torque. The weights are the residuals of a bounded
least-squares program (`scipy.optimize.lsq_linear`) with torques that are constant for `COARSE`
cycles; if it ends early, the bound is lower and still holds. The state at the beginning, and the
torque that the motor has there, are free: what came before may be anything. All other samples
count with no error, so the bound says nothing of what is smooth: there it is 0.
"""

import numpy as np

from .plant import LOAD, SPEED, Plant
from .times import COARSE, scipy

SIDE = 12  # samples
EXACT = 1e-12  # relative, of what a state at the beginning may still add


def sharpest(reference: np.ndarray) -> int:
    """The sample at which the reference turns the most."""
    return 1 + int(np.argmax(np.abs(np.diff(reference, 2))))


def least_squares(plant: Plant, reference: np.ndarray, every: int, age: float) -> float:
    """The least sum of squared errors over all samples (m²), certified.

    Args:
        plant: over ``2 * SIDE * every`` physics steps at least.
        reference: where the load has to be, shape ``(samples,)``; the first is that of the start.
        every: physics steps from one sample to the next.
        age: of the place that is compared (s).
    """
    at = sharpest(reference)
    first = max(at - SIDE, 0)
    wanted = reference[first + 1 : at + SIDE + 1]
    ticks = every * (1 + np.arange(len(wanted)))

    def seen(outputs: np.ndarray) -> np.ndarray:
        return outputs[ticks, LOAD] - age * outputs[ticks, SPEED]

    wanted = wanted - seen(plant.begun)
    states, held = seen(plant.states), seen(plant.held)
    exact = [
        response.rows(ticks, LOAD) - age * response.rows(ticks, SPEED) for response in plant.inputs
    ]
    torque = plant.inputs[0]
    columns, low, high = [states, torque.high * held[:, None]], [], []
    free = np.full(states.shape[1], np.inf)
    low, high = [-free, np.array([torque.low / torque.high])], [free, np.ones(1)]
    for response, matrix in zip(plant.inputs, exact, strict=True):
        whole = np.pad(matrix, ((0, 0), (0, -matrix.shape[1] % COARSE)))
        joined = response.high * whole.reshape(len(whole), -1, COARSE).sum(axis=2)
        columns.append(joined)
        low.append(np.full(joined.shape[1], response.low / response.high))
        high.append(np.ones(joined.shape[1]))
    matrix = np.hstack(columns)
    found = scipy().lsq_linear(  # type: ignore[attr-defined]
        1e3 * matrix, 1e3 * wanted, bounds=(np.concatenate(low), np.concatenate(high)),
        max_iter=200,
    )
    weights = wanted - matrix @ found.x
    basis, _ = np.linalg.qr(states)
    for _ in range(2):
        weights = weights - basis @ (basis.T @ weights)
    size = float(weights @ weights)
    if size <= 0.0 or np.abs(weights @ basis).max() > EXACT:
        return 0.0
    value = float(weights @ wanted)
    remains = float(weights @ held)
    value -= max(remains * torque.low, remains * torque.high)
    for response, part in zip(plant.inputs, exact, strict=True):
        value += response.least(-(weights @ part))
    return max(value, 0.0) ** 2 / size
