"""The least error of a motion along a reference, with a certificate.

Where a reference jumps, it demands more than the torque can give. For `SIDE` samples before and
after its sharpest turn, the squared error is bounded from below by Fenchel duality. For any weights
λ of the samples that are orthogonal to the effect of the state at the beginning of that part,

    |e|² ≥ max(λ (r - weight) - most that torques and disturbances add to λ, 0)² / |λ|²

in closed form over every cycle of the torque. The weights are the residuals of a bounded
least-squares program (`scipy.optimize.lsq_linear`) with torques that are constant for `COARSE`
cycles; if it ends early, the bound is lower and still holds. The state and the motor torque at the
beginning are free, because any motion may have come before. All other samples count as free of
error, so the bound is 0 for a smooth reference.
"""

import numpy as np

from .plant import LOAD, SPEED, Plant
from .times import COARSE, scipy

SIDE = 12  # samples
EXACT = 1e-12  # relative, the most that a state at the beginning may still add


def sharpest(reference: np.ndarray) -> int:
    """Return the sample at which the reference turns most sharply."""
    return 1 + int(np.argmax(np.abs(np.diff(reference, 2))))


def least_squares(plant: Plant, reference: np.ndarray, every: int, age: float) -> float:
    """Return a certified lower bound of the sum of squared errors over all samples (m²).

    Args:
        plant: of an episode, for at least ``2 * SIDE * every`` physics steps.
        reference: wanted positions of the load, shape ``(samples,)``, beginning with the start (m).
        every: physics steps from one sample to the next.
        age: age of the position that is compared (s).
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
