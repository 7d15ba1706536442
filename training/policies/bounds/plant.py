"""The linear plant of a drawn episode: how torques and disturbances move it.

The plant is derived from the physics model itself, as the simulator integrates it, by differences
over one step, which for a linear model are exact up to rounding. What is not linear counts as a
disturbance that may take any value up to its largest, to the controller's advantage: dry friction
with stiction and cable chain, cogging, torque ripple. The current loop is the lag in the drive's
record. A gear that loses a share of what it carries, or has backlash, has no such largest value,
and `NotLinear` is raised.
"""

import copy
from typing import Any, NamedTuple

import mujoco
import numpy as np

from ....envs.engine import probe
from ....envs.environment.servo_env import ServoEnv

HELD = 1e12  # kg, the inertia of an axis that does not move
DISPLACED = 1e-4  # the displacement of a coordinate (m, rad) or speed in a difference


class NotLinear(ValueError):
    """No bounded disturbance represents a part of the mechanics."""


class Response(NamedTuple):
    """Outputs 0, 1, 2 … physics steps after an input of one unit that lasts one of its cycles.

    The input may take any value from `low` to `high` in each cycle.
    """

    impulse: np.ndarray  # shape (steps + 1, outputs)
    cycle: int  # physics steps
    low: float
    high: float

    def rows(self, ticks: np.ndarray, output: int) -> np.ndarray:
        """Return what each cycle of the input adds to an output after `ticks`, (rows, cycles)."""
        cycles = np.arange(-(-int(ticks.max()) // self.cycle))
        since = ticks[:, None] - self.cycle * cycles[None, :]
        return np.where(since > 0, self.impulse[np.maximum(since, 0), output], 0.0)

    def least(self, weights: np.ndarray) -> float:
        """Return the least value of ``weights @ input``; weights have the shape ``(cycles,)``."""
        return float(np.minimum(weights * self.low, weights * self.high).sum())


class Plant(NamedTuple):
    """One axis of an episode that has begun.

    Outputs: positions of the motor side and of the load, in the coordinate of the driven joint (m
    or rad), and the velocity of the load.
    """

    free: np.ndarray  # outputs if no torque is commanded any more, (steps + 1, 3)
    begun: np.ndarray  # what the weight adds to them, from rest at 0, (steps + 1, 3)
    states: np.ndarray  # outputs for each unit state at the beginning, (steps + 1, 3, states)
    held: np.ndarray  # outputs for 1 Nm in the motor at the beginning, (steps + 1, 3)
    inputs: tuple[Response, ...]  # the commanded torque (Nm) first, then disturbances (N or Nm)
    timestep: float  # s


MOTOR, LOAD, SPEED = range(3)


def plant(env: ServoEnv, steps: int, d: int = 0, arm: dict[int, float] | None = None) -> Plant:
    """Return the plant of an episode that has begun.

    Args:
        env: the environment, not stepped yet.
        steps: number of physics steps.
        d: number of the drive.
        arm: coordinates that add to the motor's position to give that of the load, with m per unit
            of each; by default the elastic coordinates behind the drive.

    Raises:
        NotLinear: the mechanics have backlash or a gear with losses.
    """
    machine = env.machine
    coupling, mechanics, axis = machine.couplings[d], machine.mechanics[d], machine.axes[d]
    if mechanics["backlash"] > 0.0 or mechanics["gear_loss"] > 0.0:
        raise NotLinear(
            f"no bound is known for {env.ID} with backlash or a gear that loses a share of what it "
            "carries: it is known for linear mechanics"
        )
    model, here = machine.model, machine.data
    if len(machine.couplings) > 1:  # the other axes are held by their drives and brakes
        model = copy.copy(model)
        model.dof_armature[machine.couplings["dof"][np.arange(len(machine.couplings)) != d]] = HELD
    data = mujoco.MjData(model)
    nq = model.nq
    qpos, qvel = np.array(here.qpos), np.array(here.qvel)
    motor, control, gear = int(coupling["qpos"]), int(coupling["ctrl"]), float(coupling["gear"])
    driven, elastic = int(coupling["dof"]), int(mechanics["elastic_dof"])

    def step(place: np.ndarray, speed: np.ndarray, torque: float = 0.0, force: Any = 0.0) -> Any:
        data.qpos[:], data.qvel[:], data.ctrl[:] = place, speed, 0.0
        data.ctrl[control] = torque
        data.qfrc_applied[:] = force
        data.qacc_warmstart[:] = 0.0
        mujoco.mj_step(model, data)
        return np.concatenate([data.qpos - qpos, data.qvel])

    constant = step(qpos, np.zeros_like(qvel))
    a = np.zeros((2 * nq, 2 * nq))
    for k in range(nq):
        shift = np.zeros(nq)
        shift[k] = DISPLACED
        a[:, k] = (step(qpos + shift, 0.0 * qvel) - constant) / DISPLACED
        a[:, nq + k] = (step(qpos, shift) - constant) / DISPLACED
    by_torque = step(qpos, 0.0 * qvel, 1.0) - constant
    on_motor, on_carriage = np.zeros(nq), np.zeros(nq)
    on_motor[driven] = on_carriage[driven] = 1.0
    if mechanics["guide"] >= 0:
        on_carriage[elastic] = 1.0

    def by_force(direction: np.ndarray) -> np.ndarray:
        return step(qpos, 0.0 * qvel, 0.0, direction) - constant

    outputs = np.zeros((3, 2 * nq))
    outputs[:, motor] = 1.0, 1.0, 0.0
    springs = {q: 1.0 for q in probe.elastic(machine)} if arm is None else arm
    for q, length in springs.items():
        outputs[LOAD, q] = length
    outputs[SPEED, nq:] = outputs[LOAD, :nq]
    filtered, cycle = float(axis["torque_filter"]), int(coupling["velocity_steps"])
    start = np.concatenate([np.zeros(nq), qvel])
    offset = outputs[:, motor] * qpos[motor] + sum(
        (outputs[:, q] * qpos[q] for q in springs), start=np.zeros(3)
    )
    rest, still = 0.0 * start, np.zeros((steps, 2 * nq))
    fading = (1.0 - filtered) ** (np.arange(steps) // cycle)
    held = _run(a, outputs, rest, steps, (1.0 - filtered) * fading[:, None] * by_torque)
    pulse = _run(a, outputs, rest, steps, filtered * fading[:, None] * by_torque)
    pushed = constant + mechanics["load_force"] * by_force(on_carriage)
    begun = _run(a, outputs, rest, steps, still + pushed)
    free = offset + _run(a, outputs, start, steps, still) + begun + float(axis["torque"]) * held
    states = np.stack([_run(a, outputs, one, steps, still) for one in np.eye(2 * nq)], axis=2)
    ceiling = float(axis["torque_ceiling"])
    high = min(float(axis["torque_limit_positive"]), ceiling)
    low = -min(float(axis["torque_limit_negative"]), ceiling)
    found = [Response(pulse, cycle, low, high)]
    rough = float(mechanics["cogging_torque"] + mechanics["torque_ripple"] * max(high, -low)) * gear
    rubbing = float(coupling["friction"] * max(mechanics["static_ratio"], 1.0))
    rubbing += float(mechanics["chain_drag"])
    if mechanics["chain_drag_growth"] > 0.0:
        rubbing += float(mechanics["chain_drag_growth"] * (mechanics["high"] - mechanics["low"]))
    if mechanics["guide"] < 0:
        rough, rubbing = 0.0, rough + rubbing  # both act on the one joint
    for direction, most in ((on_carriage, rubbing), (on_motor, rough)):
        if most > 0.0:
            once = np.zeros((steps, 2 * nq))
            once[0] = by_force(direction)
            impulse = _run(a, outputs, rest, steps, once)
            found.append(Response(impulse, 1, -most, most))
    timestep = float(model.opt.timestep)
    return Plant(free, begun, states, held, tuple(found), timestep)


def _run(a: np.ndarray, outputs: np.ndarray, x: np.ndarray, steps: int, added: Any) -> np.ndarray:
    """Return the outputs of ``x ← a x + added`` at the beginning and after each step."""
    seen = np.empty((steps + 1, len(x)))
    seen[0] = x
    for k in range(steps):
        seen[k + 1] = x = a @ x + added[k]
    return seen @ outputs.T
