"""The parameters of a machine: one name, one unit, one range each, set without building it anew.

Randomisation, twins and their fits use these names. `servogym.envs.variation.randomisation` adds
names that count in shares of the nominal value.

A parameter belongs to one drive and its joint. "m" stands for m (slide) or rad (hinge), "N" for N
or Nm. A machine *has* a parameter if it can act there: a stiffness needs the spring, an inclination
needs an axis that travels along X.

| name | unit | meaning |
|------|------|---------|
| payload | kg | mass of the body ``payload`` |
| carriage_mass | kg | mass of the body ``carriage`` |
| inertia | kg·m² | of the body that turns about the joint of the drive |
| rotor_inertia | kg·m² | at the motor shaft, with coupling, pulleys, spindle |
| coulomb_friction | N | dry friction |
| viscous_friction | N·s/m | friction proportional to the speed |
| static_friction | N | at standstill, not below the Coulomb friction |
| stribeck_velocity | m/s | at which the friction has fallen by 63 % |
| inclination | degree | of a linear axis; 90: upwards |
| load_force | N | constant, in the positive direction |
| feed_constant | m | travel per motor revolution |
| load_stiffness, load_damping | N/m, N·s/m | between carriage and payload |
| transmission_stiffness, transmission_damping | N/m, N·s/m | between motor side and carriage |
| backlash | m | whole gap of the transmission |
| efficiency | share | of the gear before the transmission |
| cogging_torque, cogging_order | Nm, periods per revolution | at the shaft |
| torque_ripple, ripple_order | share, periods per revolution | of the motor torque |
| chain_drag, chain_drag_growth | N, N/m | cable chain |
| torque_constant | share | torque of the motor over the torque that the drive assumes |
| velocity_gain | Nm·s/rad | of the velocity controller |
| integral_time | s | of the velocity controller |
| position_gain | 1/s | of the position controller |
| velocity_filter_time | s | of the measured velocity |
| velocity_feed_forward | share | of the demand |
| acceleration_feed_forward | kg·m² | of the demand |
| pid_gain, pid_integral_gain, pid_derivative_gain | Nm/rad, by s | of a PID for the position |
| motor_resistance, supply_voltage | Ohm, V | limit the torque at speed |
| torque_time_constant | s | of the closed current loop |
| delay | position cycles | of an RPDO on its way to all drives |
| encoder_noise | m | standard deviation of the measured position |
"""

import math
from collections.abc import Callable, Iterable, Mapping
from typing import Any, NamedTuple

import mujoco
import numpy as np

from ...drive.drive import Drive
from ...drive.model.names import hint
from .machine import Machine
from .physics import STATE

PAYLOAD, CARRIAGE, LOAD = "payload", "carriage", "load"


class Joint:
    """A drive and its joint, with the parts of the model that parameters change.

    Args:
        machine: the machine of the drive.
        name: name of the drive; by default the first one.
    """

    def __init__(self, machine: Machine, name: str | None = None):
        name = next(iter(machine.drives)) if name is None else name
        self.machine, self.name = machine, name
        self.drive: Drive = machine.drives[name]
        number = self.number = machine.number(name)
        self.coupling: Any = machine.couplings[number]
        self.mechanics: Any = machine.mechanics[number]
        self.unit = machine.joint(name)[1]
        self._inertia: dict[int, np.ndarray] = {}  # original inertia of bodies, per kg

    @property
    def model(self) -> mujoco.MjModel:
        """The MuJoCo model of the machine; a shared one takes over its values first."""
        return self.machine.model

    @property
    def gear(self) -> float:
        """Gear of the drive (rad of motor shaft per m or rad of joint)."""
        return float(self.coupling.gear)

    def set(self, values: Mapping[str, float]) -> None:
        """Set parameters by name, unchecked; positions and speeds of the machine stay."""
        # the static friction is stored as a ratio to the Coulomb friction, which comes first
        for name in sorted(values, key=lambda each: each == "static_friction"):
            PARAMETERS[name].set(self, float(values[name]))
        if any(PARAMETERS[name].derives for name in values):
            model, data = self.model, self.machine.data
            state = np.empty(mujoco.mj_stateSize(model, STATE))
            mujoco.mj_getState(model, data, state, STATE)
            mujoco.mj_setConst(model, data)  # which leaves the data in the reference pose
            mujoco.mj_setState(model, data, state, STATE)
            mujoco.mj_fwdPosition(model, data)

    def body(self, name: str) -> int:
        """Number of a body by its name, -1 if there is none."""
        return int(mujoco.mj_name2id(self.model, mujoco.mjtObj.mjOBJ_BODY, name))

    def mass(self, name: str) -> float:
        """Return the mass of a body (kg), 0 if there is none."""
        body = self.body(name)
        return float(self.model.body_mass[body]) if body >= 0 else 0.0

    def set_mass(self, name: str, mass: float) -> None:
        """Set the mass of a body (kg), and its inertia in proportion."""
        body, model = self.body(name), self.model
        if body not in self._inertia:  # so that rounding does not accumulate
            self._inertia[body] = model.body_inertia[body] / model.body_mass[body]
        model.body_inertia[body] = mass * self._inertia[body]
        model.body_mass[body] = mass

    def spring(self, name: str) -> int:
        """Number of the spring joint of the load or the transmission, -1 if there is none."""
        if name != LOAD:
            return int(self.mechanics.elastic_joint) if self.mechanics.guide >= 0 else -1
        return int(mujoco.mj_name2id(self.model, mujoco.mjtObj.mjOBJ_JOINT, name))

    @property
    def turning(self) -> int:
        """Number of the last body on the joint of a rotary drive, -1 for a slide."""
        joint = self.model.dof_jntid[self.coupling.dof]
        if self.unit != "rad":
            return -1
        body = int(self.model.jnt_bodyid[joint])
        if self.mechanics.guide >= 0:
            return body + 1
        model = self.model  # of the bodies that turn together, the one with the inertia
        fixed = np.flatnonzero(model.body_weldid == model.body_weldid[body])
        return int(fixed[np.argmax(model.body_inertia[fixed, 2])])


class Parameter(NamedTuple):
    """A row of the table: its unit and range, how it is read and set, and which joints have it."""

    unit: str
    low: float
    high: float
    get: Callable[[Joint], float]
    set: Callable[[Joint, float], None]
    there: Callable[[Joint], bool] = lambda joint: True
    derives: bool = False  # MuJoCo derives other values of the model from it


def _at(
    place: Callable[[Joint], tuple[Any, Any]], factor: Callable[[Joint], float] = lambda joint: 1.0
) -> tuple[Callable, Callable]:
    """Accessors of a number, ``place(joint) = (array, index)``, in units of `factor`."""

    def get(joint: Joint) -> float:
        array, index = place(joint)
        return float(array[index]) / factor(joint)

    def assign(joint: Joint, value: float) -> None:
        array, index = place(joint)
        array[index] = value * factor(joint)

    return get, assign


def _field(name: str) -> tuple[Callable, Callable]:
    """Accessors of a field of MECHANICS."""
    return _at(lambda joint: (joint.mechanics, name))


def _body(name: str) -> tuple[Callable, Callable, Callable]:
    return (
        lambda joint: joint.mass(name),
        lambda joint, value: joint.set_mass(name, value),
        lambda joint: joint.mass(name) > 0.0,
    )


def _spring(name: str, damping: bool) -> tuple[Callable, Callable, Callable]:
    def place(joint: Joint) -> tuple[np.ndarray, int]:
        number, model = joint.spring(name), joint.model
        if damping:
            return model.dof_damping, int(model.jnt_dofadr[number])
        return model.jnt_stiffness, number

    get, put = _at(place)

    def there(joint: Joint) -> bool:
        return joint.spring(name) >= 0

    return lambda joint: get(joint) if there(joint) else 0.0, put, there


# as the motor feels it
_rotor, _set_rotor = _at(
    lambda joint: (joint.model.dof_armature, joint.coupling.dof), lambda joint: joint.gear**2
)


def _static(joint: Joint) -> float:
    return float(joint.mechanics.static_ratio) * float(joint.coupling.friction)


def _set_static(joint: Joint, value: float) -> None:
    coulomb = float(joint.coupling.friction)
    joint.mechanics.static_ratio = max(value / coulomb, 1.0) if coulomb > 0.0 else 1.0


def _feed(joint: Joint) -> float:
    return 2 * math.pi / abs(joint.gear)


def _set_feed(joint: Joint, value: float) -> None:
    rotor, sign = _rotor(joint), math.copysign(1.0, joint.gear)
    joint.coupling.gear = sign * 2 * math.pi / value
    joint.model.actuator_gear[joint.coupling.ctrl, 0] = joint.coupling.gear
    _set_rotor(joint, rotor)


def _inclination(joint: Joint) -> float:
    x, _, z = joint.model.opt.gravity
    return math.degrees(math.atan2(-x, -z))


def _set_inclination(joint: Joint, value: float) -> None:
    slope = math.radians(value)
    size = float(np.linalg.norm(joint.model.opt.gravity))
    joint.model.opt.gravity[:] = [-size * math.sin(slope), 0.0, -size * math.cos(slope)]


def _along_x(joint: Joint) -> bool:
    model = joint.model
    axis = model.jnt_axis[model.dof_jntid[joint.coupling.dof]]
    return joint.unit == "m" and len(joint.machine.drives) == 1 and abs(float(axis[0])) > 0.999


def _efficiency(joint: Joint) -> float:
    return 1.0 / (1.0 + float(joint.mechanics.gear_loss))


def _set_efficiency(joint: Joint, value: float) -> None:
    joint.mechanics.gear_loss = 1.0 / value - 1.0


def _object(name: str, unit: float | str) -> tuple[Callable, Callable, Callable]:
    """Accessors of a variable of the drive; `unit`: its unit in SI, or the field that holds it."""

    def scale(joint: Joint) -> float:
        return float(joint.drive.axis[unit]) if isinstance(unit, str) else unit

    def get(joint: Joint) -> float:
        return float(getattr(joint.drive.axis.od, name)) * scale(joint)

    def assign(joint: Joint, value: float) -> None:
        joint.drive.commission({name: value / scale(joint)})

    return get, assign, lambda joint: joint.drive.model.positions


def _lag(joint: Joint) -> float:
    return float(joint.drive.axis.torque_time_constant)


def _set_lag(joint: Joint, value: float) -> None:
    joint.drive.axis.torque_time_constant = value
    joint.drive.axis.parameters_changed = 1


def _delay(joint: Joint) -> float:
    return float(joint.machine.world["delay"][0]) / joint.machine.physics_steps


def _set_delay(joint: Joint, value: float) -> None:
    joint.machine.world["delay"] = round(value * joint.machine.physics_steps)


def _noise(joint: Joint) -> float:
    return float(joint.coupling.noise)


def _set_noise(joint: Joint, value: float) -> None:
    joint.coupling.noise = value
    if joint.coupling.noise_state == 0:  # its generator would stay at 0
        joint.coupling.noise_state = joint.number + 1


def _elastic(joint: Joint) -> bool:
    return bool(joint.mechanics.guide >= 0)


PARAMETERS: dict[str, Parameter] = {
    "payload": Parameter("kg", 1e-3, 1e4, *_body(PAYLOAD), True),
    "carriage_mass": Parameter("kg", 1e-3, 1e4, *_body(CARRIAGE), True),
    "inertia": Parameter(
        "kg·m²", 1e-9, 1e6, *_at(lambda joint: (joint.model.body_inertia, (joint.turning, 2))),
        lambda joint: joint.turning >= 0, True,
    ),
    "rotor_inertia": Parameter("kg·m²", 0.0, 10.0, _rotor, _set_rotor, derives=True),
    "coulomb_friction": Parameter("N", 0.0, 1e5, *_at(lambda joint: (joint.coupling, "friction"))),
    "viscous_friction": Parameter(
        "N·s/m", 0.0, 1e6, *_at(lambda joint: (joint.model.dof_damping, joint.coupling.dof)),
    ),
    "static_friction": Parameter("N", 0.0, 1e5, _static, _set_static),
    "stribeck_velocity": Parameter("m/s", 1e-5, 10.0, *_field("stribeck_velocity")),
    "inclination": Parameter("degree", -90.0, 90.0, _inclination, _set_inclination, _along_x),
    "load_force": Parameter("N", -1e5, 1e5, *_field("load_force")),
    "feed_constant": Parameter("m", 1e-5, 100.0, _feed, _set_feed, derives=True),
    "load_stiffness": Parameter("N/m", 1.0, 1e9, *_spring(LOAD, False)),
    "load_damping": Parameter("N·s/m", 0.0, 1e6, *_spring(LOAD, True)),
    "transmission_stiffness": Parameter("N/m", 1.0, 1e10, *_spring("", False)),
    "transmission_damping": Parameter("N·s/m", 0.0, 1e7, *_spring("", True)),
    "backlash": Parameter("m", 0.0, 0.1, *_field("backlash"), _elastic),
    "efficiency": Parameter("share", 0.1, 1.0, _efficiency, _set_efficiency, _elastic),
    "cogging_torque": Parameter("Nm", 0.0, 100.0, *_field("cogging_torque")),
    "cogging_order": Parameter("periods per revolution", 0.0, 1e4, *_field("cogging_order")),
    "torque_ripple": Parameter("share", 0.0, 0.5, *_field("torque_ripple")),
    "ripple_order": Parameter("periods per revolution", 0.0, 1e4, *_field("ripple_order")),
    "chain_drag": Parameter("N", 0.0, 1e4, *_field("chain_drag")),
    "chain_drag_growth": Parameter("N/m", 0.0, 1e5, *_field("chain_drag_growth")),
    "torque_constant": Parameter(
        "share", 0.1, 10.0,
        *_at(lambda joint: (joint.model.actuator_gainprm, (joint.coupling.ctrl, 0))),
    ),
    "velocity_gain": Parameter(
        "Nm·s/rad", 0.0, 1e6, *_object("velocity_control_gain", "velocity_gain_unit")
    ),
    "integral_time": Parameter("s", 0.0, 60.0, *_object("velocity_control_time", 1e-6)),
    "position_gain": Parameter(
        "1/s", 0.0, 1e5, *_object("position_control_gain", "position_gain_unit")
    ),
    "velocity_filter_time": Parameter("s", 0.0, 0.06, *_object("velocity_filter_time", 1e-6)),
    "velocity_feed_forward": Parameter("share", 0.0, 2.0, *_object("velocity_feed_forward", 1e-3)),
    "acceleration_feed_forward": Parameter(
        "kg·m²", 0.0, 4.0, *_object("acceleration_feed_forward", 1e-9)
    ),
    "pid_gain": Parameter("Nm/rad", 0.0, 4e3, *_object("pid_gain", 1e-6)),
    "pid_integral_gain": Parameter("Nm/(rad·s)", 0.0, 4e6, *_object("pid_integral_gain", 1e-3)),
    "pid_derivative_gain": Parameter("Nm·s/rad", 0.0, 4e3, *_object("pid_derivative_gain", 1e-6)),
    "motor_resistance": Parameter("Ohm", 0.0, 4e3, *_object("motor_resistance", 1e-6)),
    "supply_voltage": Parameter("V", 1.0, 2e3, *_object("supply_voltage", 1e-3)),
    "torque_time_constant": Parameter("s", 0.0, 0.1, _lag, _set_lag),
    "delay": Parameter("position cycles", 0.0, 1000.0, _delay, _set_delay),
    "encoder_noise": Parameter("m", 0.0, 1e-2, _noise, _set_noise),
}


def known(joint: Joint, name: str) -> Parameter:
    """The row of a parameter. Raises ValueError for a name that the machine does not have."""
    if name not in PARAMETERS:
        raise ValueError(f"there is no parameter {name!r}: {hint(name, PARAMETERS)}")
    row = PARAMETERS[name]
    if not row.there(joint):
        there = [each for each, other in PARAMETERS.items() if other.there(joint)]
        raise ValueError(
            f"parameter {name!r} cannot act in this machine: {hint(name, there)}; "
            "elasticities are built in, see LinearAxisParameters"
        )
    return row


def unit(joint: Joint, name: str) -> str:
    """Return the unit of a parameter for its joint: on a hinge rad for m, and Nm for N."""
    text = PARAMETERS[name].unit
    if joint.unit == "m" or name in ("payload", "carriage_mass"):
        return text
    return {
        "N": "Nm", "N·s/m": "Nm·s/rad", "m/s": "rad/s", "m": "rad", "N/m": "Nm/rad",
    }.get(text, text)


def get(machine: Machine, names: Iterable[str], drive: str | None = None) -> dict[str, float]:
    """Values of parameters by name. Raises ValueError for a name the machine does not have."""
    joint = Joint(machine, drive)
    return {name: known(joint, name).get(joint) for name in names}


def apply(machine: Machine, values: Mapping[str, float], drive: str | None = None) -> None:
    """Set parameters of a drive and its joint by name; the machine has to be at rest.

    Args:
        machine: the machine of the drive.
        values: values by the names of the table, in its units.
        drive: name of the drive; by default the first one.

    Raises:
        ValueError: a name the machine does not have, or a value out of range; nothing is changed.
    """
    joint = Joint(machine, drive)
    rows = {name: known(joint, name) for name in values}
    for name, value in values.items():
        low, high = rows[name].low, rows[name].high
        if not low <= value <= high:
            raise ValueError(
                f"{name} = {value!r} is out of range {low:g}..{high:g} {unit(joint, name)}"
            )
    joint.set(values)
