"""The inner loop: drives and physics, compiled, without Python in it.

Every physics tick: each drive whose velocity cycle begins reads its shaft and switches, runs, and
sets the torque of its actuator; then MuJoCo takes one step. When a coordinate is no longer finite
the physics stops, and the drive's encoder fault says so.
"""

import numpy as np

from ..drive.cycle import velocity_cycle
from ..drive.jit import block, entry
from .physics import mj_step

FARTHEST = 1e9  # m or rad; beyond it, or not a number, the physics has failed and stands still
NEGATIVE, POSITIVE, HOME = range(3)  # places in the arrays of a coupling's switches

# How a drive is coupled to the physics. One record a drive.
COUPLING = np.dtype(
    [
        ("qpos", "i8"),  # address of the joint coordinate
        ("dof", "i8"),  # address of the joint's degree of freedom
        ("ctrl", "i8"),  # number of the actuator
        ("velocity_steps", "i8"),  # physics steps per velocity cycle
        ("gear", "f8"),  # rad of motor shaft per m (slide) or rad (hinge) of the joint
        ("friction", "f8"),  # frictionloss of the joint with the brake released (N or Nm)
        ("brake_friction", "f8"),  # added by the engaged brake; 0 = there is none
        ("switch_from", "f8", (3,)),  # (m or rad); from > to: there is no such switch
        ("switch_to", "f8", (3,)),
        ("switch_hysteresis", "f8", (3,)),
        ("switch_active", "u1", (3,)),
    ],
    align=True,
)


@block
def sense(axis, coupling, position):
    """Feed shaft angle and switches of a joint at `position` to the drive."""
    axis.shaft_angle = position * coupling.gear
    for i in range(3):
        slack = coupling.switch_hysteresis[i] if coupling.switch_active[i] else 0.0
        inside = coupling.switch_from[i] - slack <= position <= coupling.switch_to[i] + slack
        coupling.switch_active[i] = 1 if inside else 0
    axis.negative_limit_switch = coupling.switch_active[NEGATIVE]
    axis.positive_limit_switch = coupling.switch_active[POSITIVE]
    axis.home_switch = coupling.switch_active[HOME]


@entry
def run(axes, couplings, model, data, qpos, ctrl, frictionloss, tick, ticks):
    """Advance by `ticks` physics steps, beginning with number `tick`.

    Args:
        axes: AXIS records, shape ``(n_drives,)``.
        couplings: COUPLING records, shape ``(n_drives,)``.
        model, data: addresses of MjModel and MjData.
        qpos, ctrl, frictionloss: views of ``data.qpos``, ``data.ctrl``, ``model.dof_frictionloss``.
    """
    for now in range(tick, tick + ticks):
        sound = True
        for i in range(len(axes)):
            coupling = couplings[i]
            sound = sound and abs(qpos[coupling.qpos]) < FARTHEST
            if now % coupling.velocity_steps == 0:
                axis = axes[i]
                sense(axis, coupling, qpos[coupling.qpos])
                velocity_cycle(axis)
                ctrl[coupling.ctrl] = axis.torque
                if coupling.brake_friction > 0.0:
                    held = 0.0 if axis.brake_released else coupling.brake_friction
                    frictionloss[coupling.dof] = coupling.friction + held
        if sound:
            mj_step(model, data)


@entry
def sense_all(axes, couplings, qpos):
    """Set the switches for the present positions, without history."""
    for i in range(len(axes)):
        couplings[i].switch_active[:] = 0
        sense(axes[i], couplings[i], qpos[couplings[i].qpos])
