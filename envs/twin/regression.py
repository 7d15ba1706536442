"""The closed-form stage: a regression of torque on acceleration, direction and speed.

It is the inverse dynamic identification of robots by least squares (Gautier, Khalil 1992), without
a simulation. It is accurate to a few per cent and starts the search by re-simulation near the
solution.
"""

from typing import NamedTuple

import numpy as np

from .experiment import Experiment

WINDOW = 0.015  # s, width of the smoothing polynomials
ORDER = 3
SLOW = 0.05  # share of the highest speed, below which samples are left out
LOSSES = 4  # iterations for the direction of power through a gear with losses


class Rough(NamedTuple):
    """Rough estimates at the motor shaft."""

    inertia: float  # kg·m²
    coulomb: float  # Nm
    viscous: float  # Nm·s/rad
    load: float  # Nm, in the positive direction of the axis taken by the motor
    explained: float  # share of the torque's variance
    one_way: bool  # it moves in one direction only
    accelerates: bool
    curve: tuple[np.ndarray, np.ndarray]  # speed (rad/s) and torque without inertia (Nm)


def regress(
    experiments: list[Experiment], gear: float, own: float = 0.0, loss: float = 0.0
) -> Rough:
    """Fit all experiments together.

    Args:
        experiments: measured positions and torques.
        gear: rad of motor shaft per m or rad.
        own: inertia of the motor side of the gear (kg·m²).
        loss: friction torque of the gear over the torque that it carries.
    """
    rows, torques, speeds = [], [], []
    for each in experiments:
        period, (position, torque) = each.even(each.position, each.torque)
        half = max(round(0.5 * WINDOW / period), 2)
        _, speed, acceleration = _derivatives(position * gear, half, period)
        torque, _, _ = _derivatives(torque, half, period)
        rows.append(np.stack([acceleration, speed], axis=1))
        torques.append(torque)
        speeds.append(speed)
    row, torque, speed = np.concatenate(rows), np.concatenate(torques), np.concatenate(speeds)
    highest = float(np.percentile(np.abs(speed), 98))
    moving = np.abs(speed) > SLOW * max(highest, 1e-9)
    sign = np.sign(speed)
    matrix = np.stack([row[:, 0], sign, row[:, 1], np.ones(len(sign))], axis=1)[moving]
    wanted = torque[moving]
    one_way = min(np.count_nonzero(sign[moving] > 0), np.count_nonzero(sign[moving] < 0)) < 0.03 * (
        len(wanted)
    )
    columns = [0, 1, 2] if one_way else [0, 1, 2, 3]
    scale = np.maximum(np.abs(matrix[:, columns]).max(axis=0), 1e-12)
    behind, drives, full = wanted - own * matrix[:, 0], np.ones(len(wanted)), np.zeros(4)
    for _ in range(LOSSES if loss else 1):
        less = (1.0 + loss * drives)[:, None]  # driving a load takes more torque than braking it
        weighed = less * matrix[:, columns] / scale
        full[columns] = np.linalg.lstsq(weighed, behind, rcond=1e-9)[0] / scale
        drives = np.sign((matrix @ full) * sign[moving])
    left = behind - less[:, 0] * (matrix @ full)
    full[0] += own
    spread = float(np.var(wanted))
    accelerating = float(np.std(row[moving, 0])) * abs(full[0])
    return Rough(
        float(full[0]), float(full[1]), float(full[2]), float(full[3]),
        1.0 - float(np.var(left)) / spread if spread > 0 else 0.0, bool(one_way),
        accelerating > 0.05 * np.sqrt(spread),
        (speed[moving], left + less[:, 0] * (matrix[:, 1:] @ full[1:])),
    )


def _derivatives(values: np.ndarray, half: int, period: float) -> tuple[np.ndarray, ...]:
    """Return smoothed values, slope and curvature (Savitzky, Golay 1964), without the ends."""
    at = np.arange(-half, half + 1)
    powers = np.vander(at, min(ORDER, 2 * half) + 1, increasing=True)
    weights = np.linalg.pinv(powers)
    windows = np.lib.stride_tricks.sliding_window_view(values, 2 * half + 1)
    smooth, slope, curve = (windows @ weights[k] for k in range(3))
    return smooth, slope / period, 2 * curve / period**2
