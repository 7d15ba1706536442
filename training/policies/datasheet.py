"""The prior knowledge of a policy: constants of its task and data sheet of the machine.

Nothing here comes from the physics or from an episode. What was drawn at random is not known.
"""

import math
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from ...drive.drive import Drive
from ...envs.environment.servo_env import METRE, ServoEnv
from ...envs.exchange import fields
from ...envs.plants.axis_parameters import Joints, LinearAxisParameters
from ...envs.plants.gantry import FEED_CONSTANT, PAIR, GantryParameters
from ...envs.plants.linear_axis import GRAVITY
from ...envs.plants.rotary_parameters import RotaryParameters
from ...envs.variation.randomisation import PAYLOAD
from ...envs.view.about import Sensor


class Bounds(NamedTuple):
    """Limits of a profile."""

    velocity: float  # m/s
    acceleration: float  # m/s²
    jerk: float  # m/s³


class Vibration(NamedTuple):
    """Nominal vibration of the load behind an axis at rest."""

    frequency: float  # undamped (rad/s)
    ratio: float  # damping ratio


@dataclass(frozen=True)
class Axis:
    """Data sheet of one axis: moved mass, force, commands and observations."""

    carriage: float  # kg, without payload
    rotor: float  # of motor and transmission, as a mass at the carriage (kg)
    coulomb_friction: float  # N
    viscous_friction: float  # N·s/m
    lost: float  # to friction and weight at most, with the heaviest payload (N)
    force: float  # that the maximum torque 6072h makes at the carriage (N)
    stroke: float  # m
    speed: float  # of the set-point for an action of 1 (m/s)
    fastest: float  # maximum profile velocity 607Fh, 1 in an observation (m/s)
    profile: Bounds  # commissioned for profile position mode
    lag: float  # of the position behind a set-point that moves, by the gains commissioned (s)
    payload: float = 0.0  # nominal (kg)
    heaviest: float = 0.0  # payload declared (kg)
    weight: float = 0.0  # along the axis, with the nominal payload (N)
    offset: float = 0.0  # that action 1 adds at 1, where there is one (N)
    vibration: Vibration | None = None
    sensor: Sensor | None = None  # None: nothing is seen of the load

    def mass(self, payload: float) -> float:
        """The mass that a force at the carriage accelerates, including the motor (kg)."""
        return self.carriage + payload + self.rotor


@dataclass(frozen=True)
class Datasheet:
    """Data sheet of one environment: what a controller may know before an episode."""

    task: str  # its id
    action_record: np.dtype  # the names of an action
    observation_record: np.dtype  # and of an observation
    step_time: float  # s
    steps: int  # of an episode
    tolerance: float  # m; 0 where the task has none
    sampling: float  # cycle in which the drive samples its inputs (s)
    axes: tuple[Axis, ...]  # that the agent moves; none where there is no data sheet
    sensor: str = ""  # argument of the environment that gives a sensor of the load
    reference: str = ""  # that a homing looks for
    homing_method: int | None = None  # of the drive, that looks for the same
    hold: tuple[tuple[str, float], ...] = ()  # actions that hold still where that is not 0
    constants: tuple[tuple[str, float], ...] = ()  # of the task, and its arguments

    def constant(self, name: str) -> float:
        """Return a constant of the task's class or an argument. Raises KeyError otherwise."""
        return dict(self.constants)[name]

    @property
    def actions(self) -> int:
        """Components of an action."""
        return fields.width(self.action_record)

    def action(self, **values: Any) -> np.ndarray:
        """Build an action from named components, float32; components not given are 0."""
        action, slots = np.zeros(self.actions, np.float32), fields.slots(self.action_record)
        for name, value in values.items():
            action[slots[name]] = value
        return action

    def named(self, observation: np.ndarray) -> Any:
        """Return an observation by the names of its components, the latest of a history."""
        return fields.named(self.observation_record, observation)

    def seen(self, observation: np.ndarray) -> Any:
        """Return `named`. Deprecated since 0.2, to be removed in 0.3."""
        warnings.warn("use datasheet.named(observation)", DeprecationWarning, stacklevel=2)
        return self.named(observation)

    def named_by_axis(self, observation: np.ndarray) -> Any:
        """Return `named` axis by axis: the record's ``axes`` or ``sides``, or one record of all."""
        seen = self.named(observation)
        for name in ("axes", "sides"):
            if name in (self.observation_record.names or ()):
                return getattr(seen, name)
        return [seen]

    @property
    def axis(self) -> Axis:
        """Return the first axis. Raises ValueError if there is none."""
        if not self.axes:
            raise ValueError(
                f"{self.task} has no data sheet of its axes, which its baselines need, that of "
                "REFERENCE too: give the task `datasheet` and `STROKE`"
            )
        return self.axes[0]


UNTOLD: Mapping[str, float] = MappingProxyType({})
# Fields of a data sheet that hold what a knob of the randomisation turns: as it is, or as a share.
VALUES = ("payload", "cable_length")
SHARES = {
    "friction": ("coulomb_friction", "static_friction", "viscous_friction"),
    "stiffness": ("stiffness", "transmission_stiffness"),
    "structural_damping": ("structural_damping", "transmission_damping"),
}


def _told(parameters: Any, truth: Mapping[str, float]) -> Any:
    """The data sheet of the machine as it was drawn."""
    values = {name: truth[name] for name in VALUES if name in truth and hasattr(parameters, name)}
    for knob, names in SHARES.items():
        for name in names:
            if knob in truth and hasattr(parameters, name):
                values[name] = truth[knob] * getattr(parameters, name)
    return replace(parameters, **values)


def datasheet(env: ServoEnv, truth: Mapping[str, float] = UNTOLD) -> Datasheet:
    """The data sheet of `env`, independent of the parameters drawn for its present episode.

    Args:
        env: the environment.
        truth: what was drawn of the machine, for an informed law; a policy is not told.
    """
    task = vars(env)
    parameters, reference = env.datasheet, task.get("reference")
    if parameters is not None and truth:
        parameters = _told(parameters, truth)
    axes: tuple[Axis, ...] = ()
    if isinstance(parameters, LinearAxisParameters):
        axes = (_linear(env, parameters, truth),)
    elif isinstance(parameters, RotaryParameters):
        axes = (_rotary(env, parameters, truth),)
    elif isinstance(parameters, GantryParameters):
        axes = tuple(_of_gantry(env, parameters, truth, d) for d in range(len(env.drives)))
    elif isinstance(parameters, Joints):
        axes = tuple(_joint(env, d, half) for d, half in enumerate(parameters.ranges))
    return Datasheet(
        task=env.ID,
        action_record=env.action_record,
        observation_record=env.observation_record,
        step_time=env.step_time,
        steps=env.STEPS,
        tolerance=task.get("tolerance", 0.0),
        sampling=env.drive.model.cycle_time["velocity"],
        axes=axes,
        sensor=env.SENSOR,
        reference=reference if isinstance(reference, str) else "",
        homing_method=env.homing_method,
        hold=tuple(env.HOLD.items()),
        constants=tuple(
            (name, float(value))
            for name, value in {**_of_class(type(env)), **task}.items()
            if not name.startswith("_") and type(value) in (int, float)
        ),
    )


def _of_class(task: type[ServoEnv]) -> dict[str, Any]:
    """Read a value from the class of a task or from its bases."""
    own = [each for each in task.__mro__ if issubclass(each, ServoEnv) and each is not ServoEnv]
    return {name: value for each in reversed(own) for name, value in vars(each).items()}


def _linear(env: ServoEnv, p: LinearAxisParameters, truth: Mapping[str, float]) -> Axis:
    task, drive, heaviest = vars(env), env.drive, _heaviest(env, p.payload, truth)
    gear = 2 * math.pi / p.feed_constant
    rotor = drive.model.rotor_inertia if p.rotor_inertia is None else p.rotor_inertia
    fastest = _object(drive, "max_profile_velocity") / METRE
    slope = math.radians(p.inclination)
    lost = (p.carriage_mass + heaviest) * GRAVITY * abs(math.sin(slope))
    lost += max(p.coulomb_friction, p.static_friction)
    lost += p.chain_drag + p.chain_drag_growth * _stroke(env, 0)
    lost += p.viscous_friction * fastest
    force = _torque(drive) * gear
    return Axis(
        carriage=p.carriage_mass,
        rotor=(rotor + p.transmission_inertia) * gear**2,
        payload=p.payload,
        heaviest=heaviest,
        coulomb_friction=p.coulomb_friction,
        viscous_friction=p.viscous_friction,
        weight=(p.carriage_mass + p.payload) * GRAVITY * math.sin(slope),
        lost=lost,
        force=force,
        offset=force * task.get("torque_range", 1.0),
        stroke=_stroke(env, 0),
        speed=task.get("max_velocity", fastest),
        fastest=fastest,
        profile=Bounds(p.max_velocity, p.max_acceleration, p.max_jerk),
        vibration=_spring(p),
        lag=_lag(env, 0, truth),
        sensor=env.sensor(),
    )


def _rotary(env: ServoEnv, p: RotaryParameters, truth: Mapping[str, float]) -> Axis:
    """An endless axis: rad for m, Nm for N, kg·m² for kg; half its range is the largest way."""
    drive, units = env.drive, env.units
    fastest = _object(drive, "max_profile_velocity") / units
    rotor = drive.model.rotor_inertia if p.rotor_inertia is None else p.rotor_inertia
    return Axis(
        carriage=p.inertia,
        rotor=rotor * p.gear_ratio**2,
        coulomb_friction=p.coulomb_friction,
        viscous_friction=p.viscous_friction,
        lost=p.coulomb_friction + p.viscous_friction * fastest,
        force=_torque(drive) * p.gear_ratio * p.efficiency,
        stroke=p.period / 2,
        speed=fastest,
        fastest=fastest,
        profile=Bounds(p.max_velocity, p.max_acceleration, math.inf),
        lag=_lag(env, 0, truth),
    )


def _joint(env: ServoEnv, d: int, half: float) -> Axis:
    """Return the data of a joint of a user's robot, known from its drive alone: rad or m."""
    drive = env.drives[d]
    speed, rate = (_object(drive, f"profile_{of}") / METRE for of in ("velocity", "acceleration"))
    profile = Bounds(speed, rate, math.inf)
    unknown = math.nan
    return Axis(
        carriage=unknown, rotor=unknown, payload=unknown, heaviest=unknown,
        coulomb_friction=unknown, viscous_friction=unknown, weight=unknown, lost=unknown,
        force=unknown, stroke=half, speed=profile.velocity,
        fastest=_object(drive, "max_profile_velocity") / METRE, profile=profile, lag=_lag(env, d),
    )


def _spring(p: LinearAxisParameters) -> Vibration | None:
    if p.stiffness > 0.0 and p.payload > 0.0:
        stiffness, damping, mass = p.stiffness, p.structural_damping, p.payload
    elif p.transmission_stiffness > 0.0:
        stiffness, damping = p.transmission_stiffness, p.transmission_damping
        mass = p.payload + p.carriage_mass
    else:
        return None
    return Vibration(math.sqrt(stiffness / mass), damping / (2.0 * math.sqrt(stiffness * mass)))


def _of_gantry(env: ServoEnv, p: GantryParameters, truth: Mapping[str, float], d: int) -> Axis:
    """Axis X or Y, which carries everything attached to it."""
    task, drive, heaviest = vars(env), env.drives[d], _heaviest(env, p.payload, truth)
    gear = 2 * math.pi / FEED_CONSTANT
    fastest = _object(drive, "max_profile_velocity") / METRE
    speed = task.get("speed", fastest)
    vibration = None
    if p.cable_length > 0.0:
        natural = math.sqrt(GRAVITY / p.cable_length)
        inertia = p.payload * p.cable_length**2
        vibration = Vibration(natural, p.sway_damping / (2.0 * inertia * natural))
    acceleration = _object(drive, "profile_acceleration") / METRE
    jerk = _object(drive, "profile_jerk_1") / METRE
    return Axis(
        carriage=_moved(env.machine.model, env.DRIVES[d]),
        rotor=drive.model.rotor_inertia * gear**2,
        payload=p.payload,
        heaviest=heaviest,
        coulomb_friction=p.coulomb_friction,
        viscous_friction=p.viscous_friction,
        lost=p.coulomb_friction + p.viscous_friction * speed,
        force=_torque(drive) * gear,
        stroke=_stroke(env, d),
        speed=speed,
        fastest=fastest,
        profile=Bounds(min(p.max_velocity, speed), acceleration, jerk),
        vibration=vibration,
        lag=_lag(env, d, truth),
        sensor=env.sensor(),
    )


def _moved(model: Any, joint: str) -> float:
    """Return the mass behind a drive without payload (kg); one of a pair moves half the bridge."""
    return _carried(model, joint) + (0.5 * _carried(model, "x") if joint in PAIR else 0.0)


def _carried(model: Any, joint: str) -> float:
    """Mass of the body of a joint and of all behind it but the payload, which is drawn (kg)."""
    carried, mass = {int(model.joint(joint).bodyid[0])}, 0.0
    for body in range(model.nbody):  # parents come first
        if body in carried or int(model.body_parentid[body]) in carried:
            carried.add(body)
            mass += 0.0 if model.body(body).name == PAYLOAD else float(model.body_mass[body])
    return mass


def _stroke(env: ServoEnv, d: int) -> float:
    if d >= len(env.STROKE):
        raise ValueError(f"task {type(env).__name__} lacks STROKE: give it that of each axis (m)")
    return env.STROKE[d]


def _heaviest(env: ServoEnv, payload: float, truth: Mapping[str, float]) -> float:
    """Payload declared (kg); the one there is, if it is known."""
    return payload if truth else env.randomisation.ranges.get("payload", (payload, payload))[1]


def _torque(drive: Drive) -> float:
    """Maximum torque 6072h (Nm)."""
    rated = _object(drive, "motor_rated_torque") * 1e-3
    return _object(drive, "max_torque") * 1e-3 * rated


def _lag(env: ServoEnv, d: int, truth: Mapping[str, float] = UNTOLD) -> float:
    """Return the lag of the position loop due to velocity that is not fed forward (s).

    With the gain the drive was built with: what it has now was drawn for an episode.
    """
    axis = env.drives[d].axis
    built = env.randomisation.gains[d].get("position_control_gain", 0)
    gain = truth.get("gains", 1.0) * built * float(axis.position_gain_unit)
    od = axis.od
    return (1.0 - 1e-3 * float(od.velocity_feed_forward)) / gain if gain > 0.0 else 0.0


def _object(drive: Drive, name: str) -> int:
    """Read an object; 0 if a drive without set-point modes does not have it."""
    return drive.read(name) if name in drive.objects.names else 0
