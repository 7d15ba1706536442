"""Loops of a drive from the known model: what MuJoCo linearises, behind the controllers in z.

An oracle for what `bode` measures: nothing here is excited or fitted. One velocity cycle of the
drive is a state-space model: the physics step by `mujoco.mjd_transitionFD`, the speed as filtered
difference of the shaft angle, the lag of the current loop, the PI controller; the position loop is
the same lifted to a position cycle. Friction keeps its sign in motion and is left out.
"""

import mujoco
import numpy as np
from later import Later

from servogym.envs.autotune.stand import gains_of

control = Later("control")


def plant(machine, names):
    """-> control.ss from torque command (Nm) to measured speed (rad/s) and position (rad).

    Of several drives that move one beam: one sign each in `names`, {name: sign}, half the sum.
    """
    machine.step()  # after which the drives know their filters
    model, data = machine.model, machine.data
    drives = {name: machine.drives[name] for name in names}
    n, axis = model.nv, next(iter(drives.values())).axis
    a = np.zeros((2 * n, 2 * n))
    b = np.zeros((2 * n, model.nu))
    mujoco.mjd_transitionFD(model, data, 1e-6, True, a, b, None, None)
    steps = round(float(axis.velocity_period) / model.opt.timestep)
    torque, angle = np.zeros((2 * n, 1)), np.zeros((1, 2 * n))
    place = np.zeros((1, 2 * n))  # of the encoder that the position loop has
    for name, sign in names.items():
        number = [*machine.drives].index(name)
        coupling, mechanics = machine.couplings[number], machine.mechanics[number]
        torque += sign * b[:, [int(coupling.ctrl)]]
        dofs = [int(coupling.dof)]
        if axis.od.position_source and mechanics["guide"] >= 0:
            dofs.append(int(mechanics["elastic_dof"]))
        angle[0, dofs[0]] += sign * float(coupling.gear) / len(names)
        place[0, dofs] += sign * float(coupling.gear) / len(names)
    torque = sum(np.linalg.matrix_power(a, k) for k in range(steps)) @ torque
    a = np.linalg.matrix_power(a, steps)
    share, period = float(axis.velocity_filter), float(axis.velocity_period)
    lag = float(axis.torque_filter)
    # states: mechanics, torque, angle before, speed before; sampled, then the torque changes
    size = 2 * n + 3
    speed = np.zeros((1, size))
    speed[0, : 2 * n], speed[0, -2], speed[0, -1] = (
        share / period * angle[0], -share / period, 1 - share,
    )
    whole, into = np.zeros((size, size)), np.zeros((size, 1))
    whole[: 2 * n, : 2 * n], whole[: 2 * n, [2 * n]] = a, torque * (1 - lag)
    into[: 2 * n], into[2 * n] = torque * lag, lag
    whole[2 * n, 2 * n] = 1 - lag
    whole[-2, : 2 * n] = angle[0]
    whole[-1] = speed[0]
    out = np.vstack([speed, np.hstack([place, np.zeros((1, 3))])])
    return control.ss(whole, into, out, 0, period)


def loops(machine, names, gains=None):
    """-> open velocity loop and open position loop (control.ss), with the gains in force."""
    first = machine.drives[next(iter(names))]
    gains = gains or gains_of(first)
    mechanics = plant(machine, names)
    period, cycles = mechanics.dt, int(first.axis.velocity_cycles)
    pi = control.ss(
        [[1.0]], [[period / gains.integral_time]], [[gains.velocity_gain]],
        [[gains.velocity_gain]], period,
    )
    velocity = control.series(pi, mechanics)
    # closed with its command held for a position cycle, the angle looked at as it begins
    closed = control.feedback(velocity, control.ss([], [], [], [[1.0, 0.0]], period))
    a, b = np.asarray(closed.A), np.asarray(closed.B)
    held = sum(np.linalg.matrix_power(a, k) for k in range(cycles)) @ b
    position = control.ss(
        np.linalg.matrix_power(a, cycles), held * gains.position_gain, closed.C[1:], 0,
        period * cycles,
    )
    return velocity[0, 0], position


def smallest(loop):
    """-> gain margin (dB), phase margin (degree), whether the closed loop is stable.

    Beside a narrow antiresonance a gain changes by 6 dB within 0.5 % of the frequency, so each
    crossing of a coarse grid is looked at on a finer one, and that once more.
    """
    poles = np.abs(np.linalg.eigvals(control.feedback(loop, 1).A))

    def value(omega):
        z = np.exp(1j * omega)[:, None, None]
        inner = np.linalg.solve(z * np.eye(len(loop.A)) - loop.A, loop.B)
        return (loop.C @ inner + loop.D)[:, 0, 0]

    def crossings(side):
        pairs = [(0.3 * loop.dt, np.pi)]
        for count in (6_000, 60, 60):
            grids = [np.geomspace(*pair, count) for pair in pairs]
            pairs = [g[k : k + 2] for g in grids for k in np.flatnonzero(np.diff(side(value(g))))]
        return value(np.array([begin for begin, _ in pairs]))

    at = crossings(lambda v: np.floor((np.unwrap(np.angle(v)) / np.pi - 1) / 2))
    gains = abs(20 * np.log10(abs(at)))
    at = crossings(lambda v: abs(v) > 1)
    phases = 180 - abs(np.degrees(np.angle(at)))
    return min(gains, default=np.inf), min(phases, default=np.inf), poles.max() < 1 + 1e-6
