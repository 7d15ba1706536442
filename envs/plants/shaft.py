"""What a drive sees at its motor shaft, computed from the model alone: nothing moves.

One velocity cycle is a linear system: the physics step as MuJoCo linearises it, the speed as the
filtered difference of the shaft angle, and the lag of the current loop. Dry friction keeps its sign
in motion and is left out, backlash is on one flank, the other drives hold their joints.
"""

import math

import mujoco
import numpy as np

from ..engine.machine import Machine
from .loops import Seen

GRID = 260  # frequencies
AROUND = np.linspace(-6.0, 6.0, 25)  # more of them around a resonance, in units of its width
LOWEST = 0.1  # Hz
WITHOUT = (
    mujoco.mjtDisableBit.mjDSBL_FRICTIONLOSS, mujoco.mjtDisableBit.mjDSBL_LIMIT,
    mujoco.mjtDisableBit.mjDSBL_CONTACT,
)  # fmt: skip


def seen(machine: Machine, name: str) -> Seen:
    """The plant of the drive `name`, at the present place of the machine."""
    drive = machine.drives[name]
    number = [*machine.drives].index(name)
    coupling, mechanics = machine.couplings[number], machine.mechanics[number]
    gear, dof = float(coupling.gear), int(coupling.dof)
    period = float(drive.model.cycle_time["velocity"])
    a, b, dofs, inertia = _mechanics(machine, number, round(period / machine.model.opt.timestep))
    n = len(dofs)
    filter_time = float(drive.axis.od.velocity_filter_time) * 1e-6
    share = _share(period, filter_time)
    lag = _share(period, drive.model.torque_time_constant)
    place = [dofs.index(dof)]
    if drive.axis.od.position_source and mechanics["guide"] >= 0:
        place.append(dofs.index(int(mechanics["elastic_dof"])))
    # states: mechanics, torque, angle before, speed before; sampled, then the torque changes
    size = 2 * n + 3
    whole, into, out = np.zeros((size, size)), np.zeros(size), np.zeros((2, size))
    whole[: 2 * n, : 2 * n], whole[: 2 * n, 2 * n] = a, b * (1 - lag)
    into[: 2 * n], into[2 * n] = b * lag, lag
    whole[2 * n, 2 * n] = 1 - lag
    whole[-2, place[0]] = gear
    out[0, place[0]], out[0, -2:] = share / period * gear, (-share / period, 1 - share)
    out[1, place] = gear
    whole[-1] = out[0]
    frequencies = _grid(a, period)
    z = np.exp(2j * np.pi * frequencies * period)
    states = np.linalg.solve(
        z[:, None, None] * np.eye(size) - whole, np.broadcast_to(into[:, None], (len(z), size, 1))
    )
    velocity, position = (out @ states[..., 0].T).reshape(2, -1)
    cycles = round(drive.model.cycle_time["position"] / period)
    return Seen(frequencies, velocity, position, period, cycles, inertia)


def _share(period: float, time: float) -> float:
    return -math.expm1(-period / time) if time > 0.0 else 1.0


def _mechanics(
    machine: Machine, number: int, steps: int
) -> tuple[np.ndarray, np.ndarray, list[int], float]:
    """State matrix and input (Nm at the shaft) of a velocity cycle, the dofs, and the inertia."""
    model, data = machine.model, mujoco.MjData(machine.model)
    data.qpos[:] = machine.data.qpos
    flags, gravity = int(model.opt.disableflags), model.opt.gravity.copy()
    nv = model.nv
    a, b = np.zeros((2 * nv + model.na,) * 2), np.zeros((2 * nv + model.na, model.nu))
    try:
        for flag in WITHOUT:
            model.opt.disableflags |= int(flag)
        model.opt.gravity[:] = 0.0  # what hangs, or stands on its head, is slower than any loop
        mujoco.mj_forward(model, data)
        mujoco.mjd_transitionFD(model, data, 1e-6, True, a, b, None, None)
    finally:
        model.opt.disableflags = flags
        model.opt.gravity[:] = gravity
    own = machine.couplings[number]
    held = {int(other.dof) for other in machine.couplings} - {int(own.dof)}
    dofs = [dof for dof in range(nv) if dof not in held]
    rows = [*dofs, *(nv + dof for dof in dofs)]
    a, b = a[np.ix_(rows, rows)], b[rows, int(own.ctrl)]
    mass = np.zeros((nv, nv))
    mujoco.mj_fullM(model, data, mass)
    # what no spring takes along stays behind: of a cable's load its part in the motion is left out
    free = [dof for dof in dofs if float(model.jnt_stiffness[model.dof_jntid[dof]]) == 0.0]
    mobility = np.linalg.inv(mass[np.ix_(free, free)])[free.index(own.dof), free.index(own.dof)]
    return (
        np.linalg.matrix_power(a, steps),
        sum(np.linalg.matrix_power(a, k) for k in range(steps)) @ b,
        dofs, float(1.0 / mobility / own.gear**2),
    )  # fmt: skip


def _grid(a: np.ndarray, period: float) -> np.ndarray:
    """Frequencies (Hz) up to the Nyquist frequency, closer where the mechanics resonate."""
    half = a.shape[0] // 2
    motor_still = np.delete(np.delete(a, [0, half], axis=0), [0, half], axis=1)
    places = [np.geomspace(LOWEST, 0.499 / period, GRID)]
    for matrix in (a, motor_still):
        poles = np.linalg.eigvals(matrix)
        poles = np.log(poles[np.abs(poles) > 1e-9]) / period
        for pole in poles[poles.imag > 2 * np.pi * LOWEST]:
            width = max(-pole.real / abs(pole), 1e-3)
            places.append(abs(pole) / (2 * np.pi) * (1 + width * AROUND))
    frequencies = np.unique(np.concatenate(places))
    return frequencies[(frequencies >= LOWEST) & (frequencies <= 0.499 / period)]
