"""The abilities of a motor with its load: torque, speed, and the profile that it can follow.

    torque = (inertia · acceleration + friction + load + viscous · speed) / efficiency

All values are at the shaft. A profile may use `PEAK` of the highest torque; the rest is reserved
for the controller. Travel back and forth at constant speed must not need more than the rated torque
(rms of load and friction).
"""

import math
from bisect import bisect_left
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from ...drive.drive import Drive
from ..engine.machine import Machine

POSES = 17  # positions in the range of a joint at which its load is computed
PEAK = 0.8  # share of the highest torque that a profile may use (inferred)
FAST = 0.9  # share of the highest speed (inferred)
HALF = 0.5  # share of the no-load speed with the most power, at half the stall torque


@dataclass(frozen=True)
class Load:
    """The load of a motor, at its shaft."""

    inertia: float  # kg·m², total
    holding: float  # Nm, gravity and springs, at the worst position
    friction: float  # Nm, dry friction in motion, at the worst position
    breakaway: float  # Nm, dry friction at standstill
    viscous: float  # Nm·s/rad
    loss: float  # friction of a gear over its load; 0: none

    def continuous(self, speed: float = 0.0) -> float:
        """Torque (Nm, rms) of travel back and forth at a constant speed (rad/s)."""
        return math.hypot(self.holding, self.friction + self.viscous * speed) * (1 + self.loss)

    def peak(self, acceleration: float, speed: float) -> float:
        """Torque (Nm) that accelerates (rad/s²) up to a speed (rad/s)."""
        worst = max(self.friction + self.viscous * speed, self.breakaway)
        return (self.holding + worst + self.inertia * acceleration) * (1 + self.loss)

    def acceleration(self, torque: float, speed: float) -> float:
        """Acceleration (rad/s²) by a torque (Nm) at a speed (rad/s), negative for too little."""
        return (torque - self.peak(0.0, speed)) / self.inertia / (1 + self.loss)


def load_of(machine: Machine, name: str, inertia: float) -> Load:
    """Return the load of a drive over the range of its joint, with a given inertia (kg·m²).

    All other joints keep their positions.
    """
    number = machine.number(name)
    coupling, m = machine.couplings[number], machine.mechanics[number]
    gear = abs(float(coupling.gear))
    low, high = machine.range(name)
    travel = high - low if math.isfinite(high - low) and high - low < 1e6 else 0.0
    drag = float(m.chain_drag) + float(m.chain_drag_growth) * travel
    coulomb = float(coupling.friction)
    springs = machine.model.tendon_stiffness.copy()
    machine.model.tendon_stiffness[:] = 0.0  # a beam moves along
    holding = asked(machine, coupling, 0.0) / gear
    machine.model.tendon_stiffness[:] = springs
    cogging = float(m.cogging_torque)
    return Load(
        inertia=inertia, holding=holding, friction=(coulomb + drag) / gear + cogging,
        breakaway=(coulomb * max(float(m.static_ratio), 1.0) + drag) / gear + cogging,
        viscous=float(machine.model.dof_damping[coupling.dof]) / gear**2, loss=float(m.gear_loss),
    )


def asked(machine: Machine, coupling, speed: float) -> float:
    """Largest force (N or Nm at the joint) against gravity, springs and damping.

    It is taken over the range of the joint, at rest and at `speed` (m/s or rad/s); the other joints
    keep their positions.
    """
    model, data = machine.model, mujoco.MjData(machine.model)
    data.qpos[:] = machine.data.qpos
    joint = model.dof_jntid[coupling.dof]
    here = data.qpos[coupling.qpos]
    low, high = model.jnt_range[joint] if model.jnt_limited[joint] else (here, here)
    if not model.jnt_limited[joint] and model.jnt_type[joint] == int(mujoco.mjtJoint.mjJNT_HINGE):
        high = here + 2 * math.pi
    force = 0.0
    for position in np.linspace(low, high, POSES):
        data.qpos[coupling.qpos] = position
        mujoco.mj_fwdPosition(model, data)
        for velocity in (0.0, -speed, speed):
            data.qvel[coupling.dof] = velocity
            mujoco.mj_fwdVelocity(model, data)
            wanted = data.qfrc_bias[coupling.dof] - data.qfrc_passive[coupling.dof]
            force = max(force, abs(float(wanted)))
    return force


@dataclass(frozen=True)
class Motor:
    """The data of a motor, from the objects of its drive."""

    rated: float  # Nm
    highest: float  # Nm
    limit: float  # rad/s, 6080h
    stall: float = math.inf  # Nm, torque by the voltage at standstill
    no_load: float = math.inf  # rad/s, at which the voltage drives no torque

    @property
    def speed(self) -> float:
        """Highest speed (rad/s) with rated torque, or with the most power if that is lower."""
        share = max(1.0 - self.rated / self.stall, HALF)
        return self.limit if math.isinf(self.no_load) else min(self.limit, share * self.no_load)

    def torque(self, speed: float) -> float:
        """Highest torque (Nm) at a speed (rad/s)."""
        if math.isinf(self.no_load):
            return self.highest
        return min(self.highest, max(self.stall * (1 - speed / self.no_load), 0.0))

    def __str__(self) -> str:
        speed = self.speed * 30 / math.pi
        return f"{self.rated:.3g} Nm, {self.torque(0.0):.3g} Nm at most, {speed:.0f} 1/min"


def motor_of(drive: Drive) -> Motor:
    """The motor of a commissioned drive."""
    od = drive.axis.od
    rated = max(int(od.motor_rated_torque), 1) * 1e-3
    ceiling = min(int(od.max_torque), int(od.max_current),
                  int(od.positive_torque_limit), int(od.negative_torque_limit))
    limit = float(od.max_motor_speed) * 2 * math.pi / 60
    constant = float(od.motor_torque_constant) * 1e-6
    back = float(od.motor_voltage_constant) * 1e-6 or constant
    resistance, voltage = float(od.motor_resistance) * 1e-6, float(od.supply_voltage) * 1e-3
    if not (constant > 0.0 and resistance > 0.0):
        return Motor(rated, rated * ceiling * 1e-3, limit)
    # the resistance of the supply counts as one of the winding
    stall = constant * voltage / (resistance + float(od.supply_resistance) * 1e-6)
    return Motor(rated, rated * ceiling * 1e-3, limit, stall, voltage / back)


@dataclass(frozen=True)
class Profile:
    """Speeds (rad/s) and accelerations (rad/s²) of an axis, at the shaft."""

    velocity: float
    acceleration: float
    stop: float  # quick stop
    homing_speed: float
    homing_acceleration: float


def largest(takes: Callable[[float], bool], refused: float) -> float:
    """Return the largest payload (or inertia) below a refused one that is accepted; 0: none."""
    low, high = 0.0, refused
    while high - low > 0.02 * high:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if takes(middle) else (low, middle)
    return float(f"{low:.2g}") if takes(float(f"{low:.2g}")) else low


def least(takes: Callable[[float], bool], refused: float, highest: float) -> float:
    """Return the smallest payload above a refused one that is accepted; infinite: none."""
    if not takes(highest):
        return math.inf
    low, high = refused, highest
    while high - low > 0.02 * high:
        middle = 0.5 * (low + high)
        low, high = (low, middle) if takes(middle) else (middle, high)
    return float(f"{high:.3g}") if takes(float(f"{high:.3g}")) else high


def first(ascending: Sequence[float], takes: Callable[[float], bool]) -> float | None:
    """Return the smallest factor that is accepted, as all above it are; None: no factor is."""
    place = bisect_left(ascending, True, key=takes)
    return ascending[place] if place < len(ascending) else None


def possible(load: Load, motor: Motor, wanted: Profile) -> Profile:
    """Limit a profile to the motor; the stopping distance behind a homing switch stays.

    The acceleration is 0 if the motor cannot break away.
    """
    velocity = min(wanted.velocity, FAST * motor.speed)
    highest = max(load.acceleration(PEAK * motor.torque(velocity), velocity), 0.0)
    acceleration = min(wanted.acceleration, highest)
    stop = load.acceleration(0.5 * (1 + PEAK) * motor.torque(velocity), 0.0)
    homing = min(wanted.homing_acceleration, 0.5 * highest)
    slower = math.sqrt(homing / wanted.homing_acceleration)
    return Profile(
        velocity, acceleration, max(min(wanted.stop, stop), acceleration),
        min(slower * wanted.homing_speed, velocity), homing,
    )
