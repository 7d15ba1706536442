"""The plant that a drive sees at its motor shaft, computed from the model without any motion.

One velocity cycle is a linear system: the physics step as linearised by MuJoCo, the speed as the
filtered difference of the shaft angle, and the lag of the current loop. Dry friction keeps its sign
in motion and is omitted, backlash stays on one flank, and the other drives hold their joints. The
loss of a gear is proportional to its load: the load appears heavier while the motor pushes, and
lighter while the load pushes. An undamped vibration has no finite response at its frequency, so it
gets the damping `LEAST`.
"""

import math
from collections.abc import Iterable, Mapping

import mujoco
import numpy as np

from ...drive.drive import Drive
from ..engine.machine import Machine
from .loops import LoopPlant, filters_of

GRID = 260  # frequencies
AROUND = np.linspace(-6.0, 6.0, 25)  # more of them around a resonance, in units of its width
LOWEST = 0.1  # Hz
RIGID = 0.5  # Hz, at which all masses move together
APART = 1.005  # smallest ratio of a resonance to its antiresonance
LEAST = 1e-4  # smallest damping of a vibration, lower than that of any machine (inferred)
HELD = 1e9  # kg or kg·m², armature of a joint that is held
WITHOUT = (
    mujoco.mjtDisableBit.mjDSBL_FRICTIONLOSS, mujoco.mjtDisableBit.mjDSBL_LIMIT,
    mujoco.mjtDisableBit.mjDSBL_CONTACT,
)


def plant_at_shaft(
    machine: Machine, names: str | Mapping[str, float], *, pushes: float = 1.0
) -> LoopPlant:
    """Return the plant of a drive at the present position of the machine.

    Args:
        machine: the machine, which does not change.
        names: name of the drive; for several drives on one beam a sign each, ``{"x1": 1, "x2":
            -1}``: torque and motion are then half the sum.
        pushes: 1 while the motor pushes, -1 while the load pushes, 0 for a gear without losses.
    """
    signs = {names: 1.0} if isinstance(names, str) else dict(names)
    numbers = {name: machine.number(name) for name in signs}
    drive = machine.drives[next(iter(signs))]
    period = float(drive.model.cycle_time["velocity"])
    steps = round(period / machine.model.opt.timestep)
    a, b = _mechanics(machine, numbers.values(), still=False)
    n, size = len(a) // 2, len(a) + 6
    torque, angle, place = np.zeros(2 * n), np.zeros(2 * n), np.zeros(2 * n)
    for name, sign in signs.items():
        coupling, mechanics = machine.couplings[numbers[name]], machine.mechanics[numbers[name]]
        torque += sign * b[:, int(coupling.ctrl)]
        share = sign * float(coupling.gear) / len(signs)
        angle[int(coupling.dof)] += share
        place[int(coupling.dof)] += share
        if drive.axis.od.position_source and mechanics["guide"] >= 0:
            place[int(mechanics["elastic_dof"])] += share
        a += pushes * _lost(machine, numbers[name], b[:, int(coupling.ctrl)])
    torque = sum(np.linalg.matrix_power(a, k) for k in range(steps)) @ torque
    filters = filters_of(drive)
    filtered = _share(period, float(drive.axis.od.velocity_filter_time) * 1e-6)
    lag = _share(period, drive.model.torque_time_constant)
    # states: mechanics, torque, observer, previous angle, previous speed; they are sampled before
    # the torque changes
    whole, into, out = np.zeros((size, size)), np.zeros(size), np.zeros((2, size))
    whole[: 2 * n, : 2 * n] = np.linalg.matrix_power(a, steps)
    whole[: 2 * n, 2 * n] = torque * (1 - lag)
    into[: 2 * n], into[2 * n] = torque * lag, lag
    whole[2 * n, 2 * n] = 1 - lag
    whole[-2, : 2 * n] = angle
    out[0, : 2 * n], out[0, -2:] = filtered / period * angle, (-filtered / period, 1 - filtered)
    if filters.observed:
        watched = slice(2 * n + 1, 2 * n + 4)
        gain, ahead, pushed = _observer(drive, period)
        left = np.eye(3) - np.outer(gain, [1.0, 0.0, 0.0])
        whole[watched, : 2 * n] = np.outer(gain, angle)
        whole[watched, 2 * n], whole[watched, watched] = left @ pushed, left @ ahead
        out[0] = whole[2 * n + 2]
    out[1, : 2 * n] = place
    whole[-1] = out[0]
    still, _ = _mechanics(machine, numbers.values(), still=True)
    vibrations = [_vibrations(each, machine.model.opt.timestep) for each in (still, a)]
    frequencies = _grid([*vibrations[0], *vibrations[1]], period)
    # a decaying frequency is equivalent to a plant with that much more damping
    lacking = LEAST - min((damping for each in vibrations for _, damping in each), default=LEAST)
    z = np.exp((2j + 2 * min(max(lacking, 0.0), LEAST)) * np.pi * frequencies * period)
    states = np.linalg.solve(
        z[:, None, None] * np.eye(size) - whole, np.broadcast_to(into[:, None], (len(z), size, 1))
    )
    velocity, position = (out @ states[..., 0].T).reshape(2, -1)
    low = int(np.searchsorted(frequencies, RIGID))
    inertia = float((1 / velocity[low]).imag / (2 * np.pi * frequencies[low]))
    return LoopPlant(
        frequencies, velocity, position, period,
        round(drive.model.cycle_time["position"] / period), inertia,
        # a vibration that a held motor does not change is not visible at its shaft
        tuple((x, y) for (x, _), (y, _) in zip(*vibrations, strict=False) if y > APART * x),
        filters,
    )


def _share(period: float, time: float) -> float:
    return -math.expm1(-period / time) if time > 0.0 else 1.0


def _observer(drive: Drive, period: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Gains of `kernel.observer`: its correction, and its prediction by state and torque."""
    od = drive.axis.od
    inertia = float(od.observer_inertia) * 1e-12 or float(od.acceleration_feed_forward) * 1e-9
    p = math.exp(-2 * math.pi * float(od.observer_bandwidth) * 0.1 * period)
    gain = np.array([1 - p**3, 1.5 * (1 - p) ** 2 * (1 + p) / period, (1 - p) ** 3 / period**2])
    ahead = np.array([[1.0, period, period**2 / 2], [0.0, 1.0, period], [0.0, 0.0, 1.0]])
    return gain, ahead, np.array([period**2 / 2, period, 0.0]) / max(inertia, 1e-15)


def _lost(machine: Machine, number: int, torque: np.ndarray) -> np.ndarray:
    """Losses of a gear as an addition to the state matrix, while the motor pushes.

    `torque` is the effect of 1 Nm at the shaft on the state; the law is in `engine.mechanics`.
    """
    m, model = machine.mechanics[number], machine.model
    lost = np.zeros((len(torque), len(torque)))
    if m["guide"] >= 0 and m["gear_loss"] > 0.0:
        dof = int(m["elastic_dof"])
        share = float(m["gear_loss"]) / float(machine.couplings[number].gear)
        stiffness = float(model.jnt_stiffness[model.dof_jntid[dof]])
        lost[:, dof] = share * stiffness * torque
        lost[:, len(torque) // 2 + dof] = share * float(model.dof_damping[dof]) * torque
    return lost


def _mechanics(
    machine: Machine, movers: Iterable[int], still: bool
) -> tuple[np.ndarray, np.ndarray]:
    """State matrix and inputs (Nm at the shaft) of a physics step.

    The other drives hold their joints, and if `still` the movers do as well.
    """
    model, data = machine.model, mujoco.MjData(machine.model)
    data.qpos[:] = machine.data.qpos
    held = [int(c.dof) for i, c in enumerate(machine.couplings) if still or i not in movers]
    nv = model.nv
    size = 2 * nv + model.na
    a, b = np.zeros((size, size)), np.zeros((size, model.nu))
    flags, gravity = int(model.opt.disableflags), model.opt.gravity.copy()
    armature, springs = model.dof_armature.copy(), model.jnt_stiffness.copy()
    try:
        for flag in WITHOUT:
            model.opt.disableflags |= int(flag)
        # pendulums and springs at driven joints are slower than any loop
        model.opt.gravity[:] = 0.0
        model.jnt_stiffness[[model.dof_jntid[c.dof] for c in machine.couplings]] = 0.0
        model.dof_armature[held] = HELD
        mujoco.mj_forward(model, data)
        mujoco.mjd_transitionFD(model, data, 1e-6, True, a, b, None, None)
    finally:
        model.opt.disableflags = flags
        model.opt.gravity[:] = gravity
        model.dof_armature[:], model.jnt_stiffness[:] = armature, springs
    return a[: 2 * nv, : 2 * nv], b[: 2 * nv]


def _vibrations(a: np.ndarray, step: float) -> list[tuple[float, float]]:
    """Frequency (Hz) and damping of the vibrations, the slowest first."""
    poles = np.linalg.eigvals(a)
    poles = np.log(poles[np.abs(poles) > 1e-9]) / step
    poles = poles[poles.imag > 2 * np.pi * LOWEST]
    return sorted((float(abs(p)) / (2 * np.pi), float(-p.real / abs(p))) for p in poles)


def _grid(vibrations: list[tuple[float, float]], period: float) -> np.ndarray:
    """Frequencies (Hz) up to the Nyquist frequency, denser around the vibrations."""
    places = [np.geomspace(LOWEST, 0.499 / period, GRID)]
    places += [f * (1 + max(damping, 1e-3) * AROUND) for f, damping in vibrations]
    frequencies = np.unique(np.concatenate(places))
    return frequencies[(frequencies >= LOWEST) & (frequencies <= 0.499 / period)]
