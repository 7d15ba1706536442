"""Elastic transmissions: a spring between the motor side of an axis and what it moves."""

import math
from typing import Any

import mujoco

MOTOR_SIDE_MASS = 1e-3  # kg; MuJoCo needs a mass, the inertia is that of the armature
FASTEST = 1.5  # rad of a vibration per physics step; from 2 on the integrator diverges


def spring(spec: mujoco.MjSpec, body: str, name: str, stiffness: float, damping: float) -> None:
    """Put a body on a spring joint `name` along the joint ``x``."""
    driven = spec.joint("x")
    joint = spec.body(body).add_joint(name=name, type=driven.type, axis=driven.axis)
    joint.stiffness[0] = stiffness
    joint.damping[0] = damping


def drive_elastically(spec: mujoco.MjSpec, body: str, stiffness: float, damping: float) -> None:
    """Put a spring between the motor side and `body`, as a joint of the same name.

    Friction and end stops move from the joint of the motor to the tendon ``x.guide``, the sum of
    both joints. The viscous friction stays, because both sides move at nearly the same speed.
    """
    spring(spec, body, body, stiffness, damping)
    motor_side, motor = spec.body("motor_side"), spec.joint("x")
    motor_side.mass = MOTOR_SIDE_MASS
    motor_side.inertia = [MOTOR_SIDE_MASS * 1e-4] * 3
    motor_side.explicitinertial = True
    guide = spec.add_tendon(
        name="x.guide", limited=bool(motor.range[0] < motor.range[1]), range=motor.range,
        frictionloss=motor.frictionloss, solref_limit=motor.solref_limit,
        solimp_limit=motor.solimp_limit,
    )
    guide.wrap_joint("x", 1.0)
    guide.wrap_joint(body, 1.0)
    motor.limited = False
    motor.frictionloss = 0.0


def refuse_without_spring(parameters: Any, length: str, stiffness: str) -> None:
    """Raise ValueError for backlash or losses of a rigid transmission, with units of both."""
    given = []
    if parameters.backlash > 0.0:
        given.append(f"backlash = {parameters.backlash:g} {length}")
    if parameters.efficiency < 1.0:
        given.append(f"efficiency = {parameters.efficiency:g}")
    if given and parameters.transmission_stiffness == 0.0:
        raise ValueError(
            f"{given[0]} needs a transmission_stiffness above 0 {stiffness}: it acts at the spring "
            "between motor and load"
        )


class TooFast(ValueError):
    """A vibration is too fast for the physics step."""


def slow_enough(
    name: str, stiffness: float, a: float, b: float, timestep: float,
    units: tuple[str, str] = ("N/m", "kg"),
) -> None:
    """Refuse a spring between two masses or inertias that vibrates too fast for the physics step.

    Args:
        name: name of the parameter.
        stiffness: stiffness of the spring, in the first of `units`.
        a: mass or inertia on one side, in the second of `units`.
        b: mass or inertia on the other side.
        timestep: physics step (s).
        units: units of the stiffness, and of the masses or inertias.

    Raises:
        TooFast: with the parameter, the resonance and the required timestep.
    """
    rate = math.sqrt(stiffness * (1.0 / a + 1.0 / b))
    if rate * timestep > FASTEST:
        of_spring, of_mass = units
        raise TooFast(
            f"{name} = {stiffness:g} {of_spring} between {a:.3g} {of_mass} and {b:.3g} {of_mass} "
            f"resonates at {rate / (2 * math.pi):.0f} Hz, too fast for a timestep of "
            f"{timestep * 1e6:g} µs: at most {FASTEST / rate * 1e6:.0f} µs, as a whole fraction of "
            "the velocity cycle, or a softer spring"
        )
