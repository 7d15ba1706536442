"""Couples a drive with a joint: the actuator between them, its switches and its brake."""

from typing import Any

import mujoco

from ...drive.drive import Drive
from .mechanics import numeric
from .mjcf import GEAR_RANGE, actuator_of
from .rates import whole_ratio

SWITCHES = ("negative_limit_switch", "positive_limit_switch", "home_switch")


def unit(model: mujoco.MjModel, joint: int) -> str:
    """Unit of the position of a joint: "m" for a slide, "rad" for a hinge."""
    return "m" if model.jnt_type[joint] == int(mujoco.mjtJoint.mjJNT_SLIDE) else "rad"


def couple(model: mujoco.MjModel, name: str, drive: Drive, coupling: Any) -> None:
    """Fill the COUPLING record of the drive on actuator `name` of the model.

    The control range of the actuator and the friction of the joint are removed from the model,
    because the loop applies them.

    Raises:
        ValueError: the actuator is not a plain motor on a slide or hinge, or the velocity cycle is
            not a whole multiple of the physics step.
    """
    number = actuator_of(model, name)
    joint = model.actuator_trnid[number, 0]
    on_joint = model.actuator_trntype[number] == int(mujoco.mjtTrn.mjTRN_JOINT)
    sliding = (int(mujoco.mjtJoint.mjJNT_SLIDE), int(mujoco.mjtJoint.mjJNT_HINGE))
    if not on_joint or model.jnt_type[joint] not in sliding:
        raise ValueError(
            f"actuator {name!r} does not act on a slide or hinge joint: "
            f'a drive needs <motor name="{name}" joint="..." gear="..."/>'
        )
    gear = float(model.actuator_gear[number, 0])
    low, high = GEAR_RANGE
    if not low <= abs(gear) <= high:
        raise ValueError(
            f"actuator {name!r}: gear = {gear} rad/{unit(model, joint)} is out of range "
            f"{low:g}..{high:g}; it is the motor's angle per unit of joint travel"
        )
    plain = (
        model.actuator_gaintype[number] == int(mujoco.mjtGain.mjGAIN_FIXED)
        and model.actuator_gainprm[number, 0] == 1.0
        and model.actuator_biastype[number] == int(mujoco.mjtBias.mjBIAS_NONE)
        and model.actuator_dyntype[number] == int(mujoco.mjtDyn.mjDYN_NONE)
    )
    if not plain:
        raise ValueError(
            f"actuator {name!r} is not a plain motor (gain 1, no bias, no dynamics): "
            "the drive is the controller, so use <motor> with the mechanics as its gear"
        )
    model.actuator_ctrllimited[number] = 0
    coupling.qpos = model.jnt_qposadr[joint]
    coupling.dof = model.jnt_dofadr[joint]
    coupling.ctrl = number
    coupling.gear = gear
    coupling.friction = model.dof_frictionloss[coupling.dof]
    model.dof_frictionloss[coupling.dof] = 0.0
    velocity_cycle = drive.model.cycle_time["velocity"]
    coupling.velocity_steps = whole_ratio(
        velocity_cycle, model.opt.timestep, f"velocity cycle of drive {name!r}", "physics step"
    )
    for i, switch in enumerate(SWITCHES):
        span = numeric(model, f"{name}.{switch}", 3)
        coupling.switch_from[i], coupling.switch_to[i] = span[:2] if span else (1.0, -1.0)
        coupling.switch_hysteresis[i] = span[2] if span else 0.0
    brake = numeric(model, f"{name}.brake_torque", 1)
    if brake:
        coupling.brake_friction = brake[0] * abs(gear)
        drive.commission({"brake_fitted": 1})
