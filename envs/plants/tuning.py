"""Controller gains for a known inertia: symmetrical optimum for speed, a safe ratio for position.

The delays of the velocity loop add up to T = 1.5 velocity cycles (sampling and hold) + the torque
time constant + the velocity filter. Symmetrical optimum with a = 3 (Leonhard, Control of Electrical
Drives, speed control): crossover w = 1 / (a T), integral action time a / w. The position loop stays
a factor 4 below the crossover of the speed loop.

Behind a spring the load is no longer felt above the resonance: there the loop closes around the
motor side alone and must cross below 1 / T, which leaves a gain margin of pi / 2. Where the load is
much heavier than the motor side, this is what lowers w.
"""

import mujoco
import numpy as np

from ...drive.drive import Drive

A = 3.0  # larger is softer and better damped
SEPARATION = 4.0  # velocity crossover over position gain


def inertia_at_shaft(model: mujoco.MjModel, data: mujoco.MjData, dof: int, gear: float) -> float:
    """Inertia the motor shaft feels (kg·m²): the joint's diagonal of the mass matrix / gear²."""
    mass = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, mass)
    return float(mass[dof, dof]) / gear**2


def inertia_of_motor_side(
    model: mujoco.MjModel, data: mujoco.MjData, dof: int, gear: float
) -> float:
    """Inertia a sudden torque feels (kg·m²), what is behind springs left out."""
    mass = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, mass)
    return 1.0 / float(np.linalg.inv(mass)[dof, dof]) / gear**2


def gains(drive: Drive, inertia: float, motor_side: float | None = None) -> dict[str, int]:
    """Objects 60F9h, 60FBh, 2010h for `inertia` (kg·m² at the shaft), in drive units.

    `motor_side` (kg·m²) is the part of it before any spring; all of it if not given.
    """
    axis = drive.axis
    filter_time = float(axis.od.velocity_filter_time) * 1e-6
    delay = (
        1.5 * drive.model.cycle_time["velocity"] + drive.model.torque_time_constant + filter_time
    )
    crossover = min(1.0 / A, (motor_side or inertia) / inertia) / delay
    return {
        "velocity_control_gain": round(inertia * crossover / axis.velocity_gain_unit),
        "velocity_control_time": round(A / crossover * 1e6),
        "position_control_gain": round(crossover / SEPARATION / axis.position_gain_unit),
        "acceleration_feed_forward": round(inertia * 1e9),
    }
