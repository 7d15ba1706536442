"""Mechanical effects of a driven joint, computed at every physics step, between its two halves.

==================  =====================================  ==========================  ==========
effect              law                                    acts through                MJCF name
==================  =====================================  ==========================  ==========
Stribeck friction   Coulomb + (static - Coulomb) ·         limit of `friction`         stribeck
                    exp(-(v / v_s)²), and the brake
cable chain         constant + growth · travel, opposes    limit of `friction`         cable_chain
                    the motion
cogging             amplitude · sin(order · shaft angle)   force                       cogging
torque ripple       share · torque · sin(order · angle)    force                       torque_ripple
backlash            no spring force within ± half the gap  force                       backlash
gear loss           (1 / efficiency - 1) · |spring force|  limit of `friction`         efficiency
load force          constant, in the positive direction    force                       load_force
end stops           ½ m v² at the moment of contact        measured only               (range)
==================  =====================================  ==========================  ==========

The friction law is Armstrong-Hélouvry, Dupont, Canudas de Wit, Automatica 30 (1994), eq. 4, with
exponent 2. The friction of a gear is proportional to its load: a driving motor supplies
1 / efficiency of the load, a driven one 2 - 1 / efficiency, so a gear with an efficiency of 50 % or
less is self-locking (Niemann, Maschinenelemente, worm gears).

Forces are added to ``qfrc_passive``; ``qfrc_applied`` and ``xfrc_applied`` belong to the user. An
effect that is zero costs one comparison. The ``frictionloss`` of a driven joint, or of its guide,
is moved to ``couplings.friction`` when the machine is made, because MuJoCo's own friction would
creep.

In the MJCF an effect is a custom numeric: ``<drive>.`` and a name of the table or of the switches::

    <numeric name="x.stribeck" data="16 0.01"/>       static friction (N), Stribeck velocity (m/s)
    <numeric name="x.cable_chain" data="2 3"/>        N, N per m of travel
    <numeric name="x.cogging" data="0.013 24"/>       Nm at the shaft, periods per revolution
    <numeric name="x.torque_ripple" data="0.01 24"/>  share of the torque, periods per revolution
    <numeric name="x.backlash" data="20e-6"/>         m, the whole gap
    <numeric name="x.efficiency" data="0.9"/>         share, of the gear before the transmission
    <numeric name="x.load_force" data="-3.2"/>        N, such as a spring balancer; signed
    <numeric name="x.switch_period" data="6.283"/>    m or rad, after which switches repeat
    <numeric name="x.switch_offset" data="0 0 1e-4"/> m; negative limit, positive limit, home
    <numeric name="x.switch_scatter" data="20e-6"/>   m, standard deviation, drawn at each release

An elastic transmission is a joint between the motor side and the carriage. The position of the
carriage is then the fixed tendon ``<drive>.guide``, the sum of both joints, to which friction, end
stops and switches belong.
"""

import math

import mujoco
import numpy as np

from ...drive.kernel.jit import block, rare
from ...drive.memory import viewer
from .arrays import reals_at

CARRIAGE, MOTOR = 0, 1  # where friction acts; MOTOR: brake and gear before an elastic transmission
PLACES = 2

# The mechanics of one driven joint. "m" stands for m (slide) or rad (hinge), "N" for N or Nm.
MECHANICS = np.dtype(
    [
        ("guide", "i8"),  # number of the tendon that is the carriage; -1: the joint itself is
        ("elastic_joint", "i8"),  # number, coordinate and degree of freedom of the transmission
        ("elastic_qpos", "i8"),
        ("elastic_dof", "i8"),
        ("inertia_at", "i8"),  # place of the joint's own inertia in MjData.M
        ("low", "f8"),  # end stops (m), infinite where there is none
        ("high", "f8"),
        ("static_ratio", "f8"),  # static over Coulomb friction; 1 = no Stribeck effect
        ("stribeck_velocity", "f8"),  # (m/s)
        ("chain_drag", "f8"),  # cable chain, constant part (N)
        ("chain_drag_growth", "f8"),  # and with the travel from the lower end stop (N/m)
        ("cogging_torque", "f8"),  # amplitude at the shaft (Nm)
        ("cogging_order", "f8"),  # periods per motor revolution
        ("torque_ripple", "f8"),  # amplitude as a share of the motor torque
        ("ripple_order", "f8"),  # periods per motor revolution
        ("backlash", "f8"),  # whole gap of the transmission (m)
        ("load_force", "f8"),  # constant force on the carriage (N)
        ("gear_loss", "f8"),  # friction of the gear over its load; 0: none
        ("switch_period", "f8"),  # after which the switches of an endless axis repeat (m); 0: never
        ("friction_limit", "f8", (2,)),  # of this step (N), where it acts
        ("friction_force", "f8", (2,)),  # of the last step (N)
        ("constraint", "f8", (2,)),  # acceleration added there by constraints (m/s²)
        ("switch_offset", "f8", (3,)),  # displacement of each switch (m)
        ("switch_scatter", "f8"),  # standard deviation of the switching point (m)
        ("switch_shift", "f8", (3,)),  # its present value for each switch (m)
        ("switch_seed", "u8"),  # seed of its random numbers after a reset; not 0
        ("noise_state", "u8"),
        ("stop", "i8"),  # -1, 1: touches the lower, the upper end stop
        ("impacts", "i8"),  # since the reset
        ("impact_last", "f8"),  # kinetic energy at contact (J)
        ("impact_largest", "f8"),
        ("impact_sum", "f8"),
    ],
    align=True,
)

mechanics_at = viewer(MECHANICS)

MEMORY = (  # fields that a reset sets to 0
    "friction_limit", "friction_force", "constraint",
    "stop", "impacts", "impact_last", "impact_largest", "impact_sum",
)

# MJCF name after "<drive>.": the fields its numbers fill, the largest number, units
NUMERICS = {
    "stribeck": (("static_ratio", "stribeck_velocity"), (1e5, 1e3), "N (static), m/s"),
    "cable_chain": (("chain_drag", "chain_drag_growth"), (1e5, 1e6), "N, N/m"),
    "cogging": (("cogging_torque", "cogging_order"), (1e4, 1e4), "Nm, 1/revolution"),
    "torque_ripple": (("torque_ripple", "ripple_order"), (1.0, 1e4), "share, 1/revolution"),
    "backlash": (("backlash",), (0.1,), "m"),
    "switch_scatter": (("switch_scatter",), (0.1,), "m"),
    "efficiency": (("gear_loss",), (1.0,), "share"),
    "switch_period": (("switch_period",), (1e6,), "m or rad"),
}


@block
def run(world, axis, coupling, m, qpos, qvel):
    """Set the friction limits and add the other forces of a driven joint for this step."""
    position, velocity = qpos[coupling.qpos], qvel[coupling.dof]
    if m.cogging_torque != 0.0 or m.torque_ripple != 0.0:
        angle = position * coupling.gear
        torque = m.cogging_torque * math.sin(m.cogging_order * angle)
        torque += m.torque_ripple * axis.torque * math.sin(m.ripple_order * angle)
        reals_at(world, world.passive, world.nv)[coupling.dof] += torque * coupling.gear
    if m.load_force != 0.0:
        reals_at(world, world.passive, world.nv)[coupling.dof] += m.load_force
        if m.guide >= 0:
            reals_at(world, world.passive, world.nv)[m.elastic_dof] += m.load_force
    held = 0.0 if axis.brake_released else coupling.brake_friction
    if m.guide >= 0:
        if m.backlash > 0.0:
            _backlash(world, m, qpos[m.elastic_qpos], qvel[m.elastic_dof])
        if m.gear_loss > 0.0:
            held += m.gear_loss * abs(_carried(world, m, qpos[m.elastic_qpos], qvel[m.elastic_dof]))
        position += qpos[m.elastic_qpos]
        velocity += qvel[m.elastic_dof]
    limit = coupling.friction
    if m.static_ratio > 1.0:
        slip = velocity / m.stribeck_velocity
        limit *= 1.0 + (m.static_ratio - 1.0) * math.exp(-slip * slip)
    limit += m.chain_drag
    if m.chain_drag_growth > 0.0:
        limit += m.chain_drag_growth * max(position - m.low, 0.0)
    elastic = m.guide >= 0
    m.friction_limit[CARRIAGE] = limit if elastic else limit + held
    m.friction_limit[MOTOR] = held if elastic else 0.0


@block
def watch(world, coupling, m, qpos, qvel):
    """Measure the impact if the joint, or its carriage, met an end stop in this step."""
    position, velocity = qpos[coupling.qpos], qvel[coupling.dof]
    if m.guide >= 0:
        position += qpos[m.elastic_qpos]
        velocity += qvel[m.elastic_dof]
    stop = -1 if position < m.low else 1 if position > m.high else 0
    if stop != m.stop:
        m.stop = stop
        if stop != 0:
            inertia = reals_at(world, world.inertia, m.inertia_at + 1)[m.inertia_at]
            _impact(m, 0.5 * inertia * velocity * velocity)


@block
def _backlash(world, m, deflection, velocity):
    """Cancel the force of spring and damper of the transmission within the gap."""
    half = 0.5 * m.backlash
    stiffness = reals_at(world, world.stiffness, m.elastic_joint + 1)[m.elastic_joint]
    force = stiffness * min(max(deflection, -half), half)
    if -half < deflection < half:
        force += reals_at(world, world.damping, m.elastic_dof + 1)[m.elastic_dof] * velocity
    reals_at(world, world.passive, world.nv)[m.elastic_dof] += force


@block
def _carried(world, m, deflection, velocity):
    """Force in spring and damper of the transmission."""
    gap = min(max(deflection, -0.5 * m.backlash), 0.5 * m.backlash)
    stiffness = reals_at(world, world.stiffness, m.elastic_joint + 1)[m.elastic_joint]
    force = stiffness * (deflection - gap)
    if deflection != gap or m.backlash == 0.0:
        force += reals_at(world, world.damping, m.elastic_dof + 1)[m.elastic_dof] * velocity
    return force


@rare
def _impact(m, energy):
    m.impacts += 1
    m.impact_last = energy
    m.impact_sum += energy
    m.impact_largest = max(m.impact_largest, energy)


@block
def carriage(m, coupling, qpos):
    """Position of the carriage, where the switches are (m or rad)."""
    position = qpos[coupling.qpos]
    return position + qpos[m.elastic_qpos] if m.guide >= 0 else position


def numeric(model: mujoco.MjModel, name: str, size: int) -> list[float]:
    """Data of a custom numeric, empty without one. Raises ValueError for wrong data."""
    number = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_NUMERIC, name)
    if number < 0:
        return []
    start = model.numeric_adr[number]
    data = model.numeric_data[start : start + model.numeric_size[number]].tolist()
    if len(data) != size or not all(map(math.isfinite, data)):
        raise ValueError(f"numeric {name!r} needs {size} finite numbers, it has {data}")
    return data


def directions(model: mujoco.MjModel, couplings, joints) -> np.ndarray:
    """Directions of the frictions over the degrees of freedom, shape ``(2 n_drives, nv)``."""
    rows = np.zeros((len(joints), PLACES, model.nv))
    for row, coupling, m in zip(rows, couplings, joints, strict=True):
        row[:, coupling.dof] = 1.0
        if m.guide >= 0:
            row[CARRIAGE, m.elastic_dof] = 1.0
    return rows.reshape(-1, model.nv)


def fit(model: mujoco.MjModel, name: str, coupling, m) -> None:
    """Fill the MECHANICS record `m` of drive `name` from its model, and its friction.

    Raises:
        ValueError: a number out of range, a guide that is not the sum of two joints, or an effect
            that needs an elastic transmission without one.
    """
    dof = int(coupling.dof)
    joint = model.dof_jntid[dof]
    m.guide = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_TENDON, f"{name}.guide")
    m.inertia_at = model.M_rowadr[dof] + model.M_rownnz[dof] - 1
    m.static_ratio, m.stribeck_velocity, m.switch_seed = 1.0, 1.0, 1
    limited, span = model.jnt_limited[joint], model.jnt_range[joint]
    if m.guide >= 0:
        elastic = _other_joint(model, name, int(m.guide), joint)
        m.elastic_joint = elastic
        m.elastic_qpos, m.elastic_dof = model.jnt_qposadr[elastic], model.jnt_dofadr[elastic]
        limited, span = model.tendon_limited[m.guide], model.tendon_range[m.guide]
        coupling.friction = model.tendon_frictionloss[m.guide]
        model.tendon_frictionloss[m.guide] = 0.0
    m.low, m.high = span if limited else (-math.inf, math.inf)
    for effect, (names, highest, unit) in NUMERICS.items():
        for field, value, high in zip(
            names, numeric(model, f"{name}.{effect}", len(names)), highest, strict=False
        ):
            if not 0.0 <= value <= high:
                raise ValueError(
                    f"numeric '{name}.{effect}': {value:g} is out of range 0..{high:g} ({unit})"
                )
            m[field] = value
    m.switch_offset[:] = numeric(model, f"{name}.switch_offset", 3) or 0.0
    m.load_force = (numeric(model, f"{name}.load_force", 1) or [0.0])[0]
    if numeric(model, f"{name}.stribeck", 2):
        _stribeck(name, coupling, m)
    if numeric(model, f"{name}.efficiency", 1):
        _gear(name, m)
    if m.chain_drag_growth > 0.0 and not limited:
        raise ValueError(
            f"numeric '{name}.cable_chain': a drag growing with the travel needs the joint's "
            "range, the travel counts from its lower end"
        )
    if m.backlash > 0.0 and m.guide < 0:
        raise ValueError(
            f"numeric '{name}.backlash' needs an elastic transmission: a spring joint behind the "
            f"driven one, and the fixed tendon '{name}.guide', the sum of both"
        )


def _stribeck(name: str, coupling, m) -> None:
    """Convert the static friction (N) to a ratio, so that it follows the Coulomb friction."""
    static, coulomb = float(m.static_ratio), float(coupling.friction)
    if static < coulomb or coulomb <= 0.0 or m.stribeck_velocity <= 0.0:
        raise ValueError(
            f"numeric '{name}.stribeck': static friction {static:g} N must not be below the "
            f"Coulomb friction {coulomb:g} N of the joint, which must be above 0, as must the "
            f"Stribeck velocity {m.stribeck_velocity:g} m/s"
        )
    m.static_ratio = static / coulomb


def _gear(name: str, m) -> None:
    """Convert the efficiency (share) to the loss over the load."""
    efficiency = float(m.gear_loss)
    if efficiency <= 0.0 or (efficiency < 1.0 and m.guide < 0):
        raise ValueError(
            f"numeric '{name}.efficiency' = {efficiency:g} must be above 0, and below 1 it needs "
            f"an elastic transmission (the fixed tendon '{name}.guide'): its spring is what the "
            "gear carries"
        )
    m.gear_loss = 1.0 / efficiency - 1.0


def _other_joint(model: mujoco.MjModel, name: str, tendon: int, joint: int) -> int:
    """The joint of the elastic transmission, which the guide adds to the driven joint."""
    first = model.tendon_adr[tendon]
    wraps = range(first, first + model.tendon_num[tendon])
    parts = {int(model.wrap_objid[i]): float(model.wrap_prm[i]) for i in wraps}
    kinds = {int(model.wrap_type[i]) for i in wraps}
    others = [part for part in parts if part != joint]
    plain = kinds == {int(mujoco.mjtWrap.mjWRAP_JOINT)} and set(parts.values()) == {1.0}
    if not plain or joint not in parts or len(others) != 1:
        raise ValueError(
            f"tendon '{name}.guide' must be fixed, the sum of the driven joint and the spring "
            "joint behind it, both with coef 1"
        )
    return others[0]
