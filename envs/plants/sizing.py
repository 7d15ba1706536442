"""What a motor can do with what it moves: torque, speed, and the profile it can follow.

    torque = (inertia · acceleration + friction + load + viscous · speed) / efficiency

all at the shaft. A profile may ask for `PEAK` of the highest torque, the rest is the controller's;
what travel to and fro at a constant speed needs, rms of load and friction, must not be more than
the rated torque.
"""

import math
from bisect import bisect_left
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from ...drive.drive import Drive
from ..engine.machine import Machine

POSES = 17  # places on the joint's range where its load is looked at
PEAK = 0.8  # share of the highest torque that a profile may ask for (inferred)
FAST = 0.9  # share of the highest speed (inferred)
HALF = 0.5  # of the no-load speed, where a winding gives the most power, at half the stall torque


@dataclass(frozen=True)
class Load:
    """What stands against a motor, at its shaft."""

    inertia: float  # kg·m², all of it
    holding: float  # Nm, gravity and springs, at the worst place
    friction: float  # Nm, dry, in motion, at the worst place
    breakaway: float  # Nm, the same at standstill
    viscous: float  # Nm·s/rad
    loss: float  # of a gear, over what it carries; 0: none

    def continuous(self, speed: float = 0.0) -> float:
        """Torque (Nm, rms) of travel to and fro at a constant speed (rad/s)."""
        return math.hypot(self.holding, self.friction + self.viscous * speed) * (1 + self.loss)

    def peak(self, acceleration: float, speed: float) -> float:
        """Torque (Nm) that accelerates (rad/s²) up to a speed (rad/s)."""
        worst = max(self.friction + self.viscous * speed, self.breakaway)
        return (self.holding + worst + self.inertia * acceleration) * (1 + self.loss)

    def acceleration(self, torque: float, speed: float) -> float:
        """What a torque (Nm) accelerates with (rad/s²); negative: it is too little."""
        return (torque - self.peak(0.0, speed)) / self.inertia / (1 + self.loss)


def load_of(machine: Machine, name: str, inertia: float) -> Load:
    """The load of a drive whose inertia is known, over the range of its joint.

    All other joints stay as they are.
    """
    number = machine.number(name)
    coupling, m = machine.couplings[number], machine.mechanics[number]
    gear = abs(float(coupling.gear))
    low, high = machine.range(name)
    travel = high - low if math.isfinite(high - low) and high - low < 1e6 else 0.0
    drag = float(m.chain_drag) + float(m.chain_drag_growth) * travel
    coulomb = float(coupling.friction)
    springs = machine.model.tendon_stiffness.copy()
    machine.model.tendon_stiffness[:] = 0.0  # a beam comes along
    holding = asked(machine, coupling, 0.0) / gear
    machine.model.tendon_stiffness[:] = springs
    cogging = float(m.cogging_torque)
    return Load(
        inertia=inertia, holding=holding, friction=(coulomb + drag) / gear + cogging,
        breakaway=(coulomb * max(float(m.static_ratio), 1.0) + drag) / gear + cogging,
        viscous=float(machine.model.dof_damping[coupling.dof]) / gear**2, loss=float(m.gear_loss),
    )


def asked(machine: Machine, coupling, speed: float) -> float:
    """Largest force (N or Nm at the joint) that gravity, springs and damping ask for.

    Over the range of the joint, all others as they are; at rest and at `speed` (m/s or rad/s).
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
    """What a motor gives, from the objects of its drive."""

    rated: float  # Nm
    highest: float  # Nm
    limit: float  # rad/s, 6080h
    stall: float = math.inf  # Nm that the voltage drives at standstill
    no_load: float = math.inf  # rad/s at which the voltage drives none

    @property
    def speed(self) -> float:
        """Highest speed (rad/s) that has rated torque, or the most power if that is less."""
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
    # what the supply loses in its own resistance counts as one of the winding
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
    """The largest payload (or inertia) below a refused one that is taken; 0: none."""
    low, high = 0.0, refused
    while high - low > 0.02 * high:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if takes(middle) else (low, middle)
    return float(f"{low:.2g}") if takes(float(f"{low:.2g}")) else low


def least(takes: Callable[[float], bool], refused: float, highest: float) -> float:
    """The smallest payload above a refused one that is taken; infinite: none up to `highest`."""
    if not takes(highest):
        return math.inf
    low, high = refused, highest
    while high - low > 0.02 * high:
        middle = 0.5 * (low + high)
        low, high = (low, middle) if takes(middle) else (middle, high)
    return float(f"{high:.3g}") if takes(float(f"{high:.3g}")) else high


def first(ascending: Sequence[float], takes: Callable[[float], bool]) -> float | None:
    """The smallest of some factors that is taken, as all above it are; None: there is none."""
    place = bisect_left(ascending, True, key=takes)
    return ascending[place] if place < len(ascending) else None


def possible(load: Load, motor: Motor, wanted: Profile) -> Profile:
    """A profile as far as the motor follows it; homing stops behind a switch as soon as wanted.

    The acceleration is 0 where it cannot break away.
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
