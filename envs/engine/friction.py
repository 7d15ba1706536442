"""Dry friction of driven joints: the force that stops them within the physics step, clipped.

Between the two halves of a step MuJoCo knows the acceleration that the joints would have without
friction. The force that leaves a joint at rest at the end of the step then takes one division::

    force = clip(-(velocity + timestep · acceleration) / (timestep · compliance), ±limit)

A joint that is pulled with less than the limit therefore does not move at all, and the friction
never drives it. `compliance` is J M⁻¹ Jᵀ, the acceleration by a force of 1 N; J is the direction of
the friction, that of the driven joint or of the guide of an elastic transmission. For joints that
the mass matrix couples, each step makes one sweep of projected Gauss-Seidel, which begins with the
forces of the step before (as in Catto, Iterative Dynamics with Temporal Coherence, 2005). The
forces of end stops, contacts and equalities are known only after the step; those of the step before
are used instead.

The limit is Coulomb's, Stribeck's, or the holding brake's: `mechanics.run` sets it. The force goes
into ``qfrc_passive``. It costs a third of MuJoCo's own friction constraint and does not creep.
"""

from ...drive.kernel.jit import block
from .arrays import couplings_at, reals_at, velocities
from .mechanics import CARRIAGE, MOTOR, PLACES, mechanics_at
from .physics import mj_fwd_acceleration, mj_fwd_actuation, mj_solve_m


@block
def limited(joints):
    """Whether a joint has friction in this step."""
    for i in range(len(joints)):
        if joints[i].friction_limit[CARRIAGE] > 0.0 or joints[i].friction_limit[MOTOR] > 0.0:
            return True
    return False


@block
def _along(vector, place, coupling, m):
    """Component of a vector over the degrees of freedom in the direction of a friction."""
    value = vector[coupling.dof]
    if place == CARRIAGE and m.guide >= 0:
        value += vector[m.elastic_dof]
    return value


@block
def response(world, i, place):
    """Accelerations of all degrees of freedom by a friction force of 1 N."""
    return reals_at(world, world.responses + (PLACES * i + place) * world.response_row, world.nv)


@block
def stick(world):
    """Add the friction of all driven joints to the passive forces, between the two half-steps."""
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
    """The part of `stick` that only needs arrays: the forces that hold the joints."""
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
    """Record the acceleration that constraints added in this step, for the next one."""
    smooth = reals_at(world, world.smooth_acceleration, world.nv)
    final = reals_at(world, world.acceleration, world.nv)
    for i in range(len(joints)):
        for place in range(PLACES):
            whole = _along(final, place, couplings[i], joints[i])
            joints[i].constraint[place] = whole - _along(smooth, place, couplings[i], joints[i])
