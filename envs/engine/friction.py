"""Dry friction of driven joints: the force that stops them within the physics step, clipped.

Between the two halves of a step MuJoCo knows the acceleration the joints would have without
friction. What would leave a joint at rest at the end of the step is then one division::

    force = clip(-(velocity + timestep · acceleration) / (timestep · compliance), ±limit)

so a joint that is pulled with less than the limit does not move at all, and the force never does
work on it. `compliance` is J M⁻¹ Jᵀ, what a force of 1 N accelerates, J the direction of the
friction: of the driven joint, or of the guide of an elastic transmission. Joints that the mass
matrix couples take each other's forces into account: one sweep of projected Gauss-Seidel a step,
begun with the forces of the last one (as in Catto, Iterative Dynamics with Temporal Coherence,
2005). What end stops, contacts and equalities add is known only after the step; that of the step
before stands for it.

The limit is Coulomb's, Stribeck's, or the holding brake's: `mechanics.run` sets it. The force goes
into ``qfrc_passive``. Beside MuJoCo's own friction constraint it costs a third and does not creep.
"""

from ...drive.kernel.jit import block
from .arrays import couplings_at, reals_at, velocities
from .mechanics import CARRIAGE, MOTOR, PLACES, mechanics_at
from .physics import mj_fwd_acceleration, mj_fwd_actuation, mj_solve_m


@block
def limited(joints):
    """Whether there is any friction in this step."""
    for i in range(len(joints)):
        if joints[i].friction_limit[CARRIAGE] > 0.0 or joints[i].friction_limit[MOTOR] > 0.0:
            return True
    return False


@block
def _along(vector, place, coupling, m):
    """What a vector over the degrees of freedom is in the direction of a friction."""
    value = vector[coupling.dof]
    if place == CARRIAGE and m.guide >= 0:
        value += vector[m.elastic_dof]
    return value


@block
def response(world, i, place):
    """Accelerations that a friction of 1 N gives to all degrees of freedom."""
    return reals_at(world, world.responses + (PLACES * i + place) * world.response_row, world.nv)


@block
def stick(world):
    """Add the friction of all driven joints to the passive forces, between the halves of a step."""
    mj_fwd_actuation(world.mj_model, world.mj_data)
    mj_fwd_acceleration(world.mj_model, world.mj_data)
    joints = mechanics_at(world.mechanics, world.drives)
    for i in range(len(joints)):
        for place in range(PLACES):
            if joints[i].friction_limit[place] > 0.0:
                row = (PLACES * i + place) * world.response_row
                solution, right = world.responses + row, world.directions + row
                mj_solve_m(world.mj_model, world.mj_data, solution, right, 1)
    grip(world)


@block
def grip(world):
    """The part of `stick` that needs nothing of MuJoCo but its arrays."""
    couplings = couplings_at(world.couplings, world.drives)
    joints = mechanics_at(world.mechanics, world.drives)
    qvel = velocities(world)
    acceleration = reals_at(world, world.smooth_acceleration, world.nv)
    for i in range(len(joints)):
        for place in range(PLACES):
            if joints[i].friction_limit[place] > 0.0:
                answer = response(world, i, place)
                for k in range(world.nv):
                    acceleration[k] += answer[k] * joints[i].friction_force[place]
    for i in range(len(joints)):
        for place in range(PLACES):
            if joints[i].friction_limit[place] > 0.0:
                _grip(world, couplings[i], joints[i], i, place, qvel, acceleration)
            else:
                joints[i].friction_force[place] = 0.0


@block
def _grip(world, coupling, m, i, place, qvel, acceleration):
    answer = response(world, i, place)
    after = _along(acceleration, place, coupling, m) + m.constraint[place]
    speed = _along(qvel, place, coupling, m) + world.timestep * after
    before, limit = m.friction_force[place], m.friction_limit[place]
    stopping = before - speed / (world.timestep * _along(answer, place, coupling, m))
    force = min(max(stopping, -limit), limit)
    for k in range(world.nv):
        acceleration[k] += answer[k] * (force - before)
    passive = reals_at(world, world.passive, world.nv)
    passive[coupling.dof] += force
    if place == CARRIAGE and m.guide >= 0:
        passive[m.elastic_dof] += force
    m.friction_force[place] = force


@block
def remember(world, couplings, joints):
    """Note what constraints have added to the acceleration of this step, for the next one."""
    smooth = reals_at(world, world.smooth_acceleration, world.nv)
    final = reals_at(world, world.acceleration, world.nv)
    for i in range(len(joints)):
        for place in range(PLACES):
            whole = _along(final, place, couplings[i], joints[i])
            joints[i].constraint[place] = whole - _along(smooth, place, couplings[i], joints[i])
