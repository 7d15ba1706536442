"""A linear axis with one drive, commissioned through the objects of the drive."""

import copy
import functools
import math
from contextlib import suppress
from dataclasses import replace
from importlib import resources
from pathlib import Path

import mujoco

from ...drive.drive import Drive
from ...drive.model.model import DriveModel, load
from ..engine.checks import flag
from ..engine.machine import Machine
from ..engine.physics import compiled
from ..engine.rates import physics_step
from . import own_units, tuning, twins
from .axis_parameters import HEAVIEST, LinearAxisParameters, chosen, family
from .motor import MOTOR, motor_and_encoder
from .sizing import Profile, first, largest, least
from .transmission import MOTOR_SIDE_MASS, TooFast, drive_elastically, slow_enough, spring
from .tuning import TooLight, Unmovable, gains

MJCF = Path(str(resources.files("servogym.assets"))) / "mjcf" / "linear_axis.xml"

GRAVITY = 9.81  # m/s²
FINER = (1.25, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0)  # factors that a refusal tries


def linear_axis(
    drive: str | Path | DriveModel = "generic",
    *,
    mechanics: str = "rigid",
    timestep: float | None = None,
    parameters: LinearAxisParameters | None = None,
    parameter_file: str | Path | None = None,
    tuned: bool = True,
    twin: str | Path | None = None,
    **values: float | None,
) -> Machine:
    """Build a `Machine` with one linear axis and the drive ``x``, stroke 0..0.5 m.

    The units of the drive are 1 µm, 1 µm/s and 1 µm/s². Limit switches lie 5 mm and end stops 20 mm
    outside the stroke; homing method 17 puts the zero at its left end.

    Args:
        drive: drive model by name, folder or loaded.
        mechanics: preset of the family: ``rigid``, ``toothed_belt``, ``ball_screw``,
            ``linear_motor``, ``vertical``, ``rack_pinion`` or ``ball_screw_scale``, see
            `axis_parameters`.
        timestep: physics step (s); by default the velocity cycle of the drive, or a fraction of it
            if the mechanics vibrate too fast for that.
        parameters: `LinearAxisParameters`, or its fields as keywords instead of the preset's.
        parameter_file: file in which 1010h stores the parameters of the drive; its values take
            precedence over those of commissioning.
        tuned: limit gains, profile and following error window to the abilities of plant and motor.
            Otherwise the profile is the requested one and the gains follow the rule in `tuning`,
            without further checks, as in the environments of version 0.
        twin: folder of `servogym twin` identified from the log of such an axis; it determines
            plant, drive and gains.

    Raises:
        ValueError: an unknown model or preset, a parameter out of range, a timestep that does not
            fit the cycles of the drive or is too long for the elastic mechanics, or a payload that
            this motor or drive cannot move.
    """
    if twin is not None:
        return twins.machine_of(twin, linear_axis, drive)
    if parameters is None:
        parameters = family(mechanics, **values)
    elif values or mechanics != "rigid":
        given = [*values, *(["mechanics"] if mechanics != "rigid" else [])]
        raise ValueError(f"parameters and {', '.join(given)} are both given: choose one way")
    parameters, tuned = chosen(parameters, 0.0), flag("tuned", tuned)
    model = load(drive)
    try:
        machine = _made(model, parameters, tuned, timestep)
    except Unmovable as error:
        raise ValueError(
            f"payload = {parameters.payload:g} kg: {error}; "
            f"{_would_do(model, parameters, error)}"
        ) from None
    if parameter_file is not None:
        machine.drives["x"].use_parameter_file(parameter_file)
    machine.reset()
    return machine


def _made(
    model: DriveModel, p: LinearAxisParameters, tuned: bool = True, timestep: float | None = None
) -> Machine:
    """Build and commission an axis. Raises Unmovable if motor or drive cannot move it."""
    usual = _timestep(p, model) if timestep is None else timestep
    plant = copy.copy(_plant(p, model.rotor_inertia, physics_step(timestep, usual)))
    machine = Machine(plant, {"x": model})
    commission(machine, "x", p, tuned)
    return machine


def _timestep(p: LinearAxisParameters, drive: DriveModel) -> float:
    """The velocity cycle (s), or a fraction that is short enough for the vibrations of the axis."""
    cycle = drive.cycle_time["velocity"]
    for part in (1, 2, 4):
        with suppress(TooFast):
            _plant(p, drive.rotor_inertia, cycle / part)
            return cycle / part
    return cycle  # with which `_plant` reports the vibration


@functools.lru_cache(maxsize=16)  # the machines of a vector or a benchmark are the same
def _plant(p: LinearAxisParameters, rotor: float, timestep: float) -> mujoco.MjModel:
    """Compile the model for these parameters and a motor with the inertia `rotor` (kg·m²)."""
    spec = mujoco.MjSpec.from_file(str(MJCF))
    gear = 2 * math.pi / p.feed_constant
    spec.option.timestep = timestep
    joint = spec.joint("x")
    rotor = rotor if p.rotor_inertia is None else p.rotor_inertia
    joint.armature = (rotor + p.transmission_inertia) * gear**2
    joint.frictionloss = p.coulomb_friction
    joint.damping[0] = p.viscous_friction
    spec.actuator("x").gear[0] = gear
    slope = math.radians(p.inclination)
    spec.option.gravity = [-GRAVITY * math.sin(slope), 0.0, -GRAVITY * math.cos(slope)]
    spec.geom("carriage").mass = p.carriage_mass
    payload = spec.geom("payload")
    payload.mass = p.payload
    payload.size = [0.02 + 0.01 * min(p.payload, 5.0) ** (1 / 3)] * 3
    payload.pos[2] = 0.014 + payload.size[2]
    for name, values in {
        "brake_torque": [p.brake_torque] if p.brake_torque > 0.0 else [],
        "stribeck": [p.static_friction, p.stribeck_velocity] if p.static_friction > 0.0 else [],
        "cable_chain": [p.chain_drag, p.chain_drag_growth],
        "cogging": [p.cogging_torque, p.cogging_order],
        "torque_ripple": [p.torque_ripple, p.ripple_order],
        "backlash": [p.backlash],
        "efficiency": [p.efficiency],
        "switch_offset": [p.switch_offset] * 3,
        "switch_scatter": [p.switch_scatter],
    }.items():
        if values:
            spec.add_numeric(name=f"x.{name}", size=len(values), data=values)
    _mount_home_switch(spec, p.home_switch)
    carried = p.carriage_mass + p.payload
    if p.stiffness > 0.0 and p.payload > 0.0:
        spring(spec, "payload", "load", p.stiffness, p.structural_damping)
        rest = joint.armature + p.carriage_mass
        if p.transmission_stiffness > 0.0:
            rest = p.carriage_mass
        slow_enough("stiffness", p.stiffness, rest, p.payload, timestep)
    if p.transmission_stiffness > 0.0:
        drive_elastically(spec, "carriage", p.transmission_stiffness, p.transmission_damping)
        motor = joint.armature + MOTOR_SIDE_MASS
        slow_enough("transmission_stiffness", p.transmission_stiffness, motor, carried, timestep)
    return compiled(spec)


def _mount_home_switch(spec: mujoco.MjSpec, place: float) -> None:
    numeric, box = spec.numeric("x.home_switch"), spec.geom("home_switch")
    low, high, hysteresis = numeric.data
    numeric.data = [place, place + high - low, hysteresis]
    box.pos[0] += place - low


def commission(machine: Machine, name: str, p: LinearAxisParameters, tuned: bool = True) -> None:
    """Set the parameters of a drive for a linear axis, from its motor to its gains.

    Raises Unmovable if motor or drive cannot move it.
    """
    x = machine.drives[name]
    if not x.model.positions:  # an inverter has its own parameters for motor and ramps
        if tuned:
            tuning.turned(machine, name)
        return
    micro = 1e6  # drive units per m
    coupling = machine.coupling(name)
    per_unit = abs(float(coupling.gear)) / micro  # rad of the shaft
    own_units.motor_and_factors(x, MOTOR | factor_group(x, p.feed_constant * micro))
    parameters = {
        "min_position_limit": 0,
        "max_position_limit": 0.5 * micro,
        "following_error_window": 1_000,
        "following_error_time_out": 10,
        "position_window": 20,
        "position_window_time": 5,
        "velocity_window": 5_000,
        "velocity_window_time": 5,
        "velocity_threshold": 5_000,
        "max_profile_velocity": 2 * p.max_velocity * micro,
        "profile_velocity": p.max_velocity * micro,
        "profile_acceleration": p.max_acceleration * micro,
        "profile_deceleration": p.max_acceleration * micro,
        "quick_stop_deceleration": 2 * p.max_acceleration * micro,
        "profile_jerk_1": p.max_jerk * micro,
        "homing_method": 17,
        "speed_during_search_for_switch": 0.1 * micro,
        "speed_during_search_for_zero": 0.01 * micro,
        "homing_acceleration": 1.0 * micro,
        "home_offset": 5_000,
    }
    own_units.commission(x, parameters, per_unit)
    own_units.commission(x, motor_and_encoder(p, x), per_unit)
    inertia, motor_side = tuning.inertias(machine, name)
    if not tuned:
        x.commission(gains(x, inertia, motor_side))
        return
    gear = abs(float(coupling.gear))
    wanted = Profile(
        velocity=p.max_velocity * gear, acceleration=p.max_acceleration * gear,
        stop=2 * p.max_acceleration * gear, homing_speed=0.1 * gear, homing_acceleration=gear,
    )
    tuned_values = tuning.tuned(
        machine, name, inertia=inertia, motor_side=motor_side, wanted=wanted,
        per_unit=per_unit, window=1e-3 * gear,
    )
    own_units.commission(x, tuned_values, per_unit)


def _would_do(model: DriveModel, p: LinearAxisParameters, refusal: Unmovable) -> str:
    """Say which payload, and which feed constant, this motor can move."""

    def moves(**changed: float) -> bool:
        other = replace(p, **changed)  # type: ignore[arg-type]
        return tuning.movable(lambda: _made(model, other))

    if isinstance(refusal, TooLight):
        mass = least(lambda payload: moves(payload=payload), p.payload, HEAVIEST)
        return f"it takes {mass:.3g} kg and more" if mass < math.inf else "it takes no payload"
    mass = largest(lambda payload: moves(payload=payload), p.payload)
    finer = first(FINER, lambda factor: moves(feed_constant=p.feed_constant / factor))
    said = f"it takes {mass:.3g} kg" if mass > 0.0 else "it takes no payload"
    if finer is None:
        return said
    return f"{said}; with a feed_constant of {p.feed_constant / finer:.2g} m it takes this one"


def factor_group(drive: Drive, units: float, turns: int = 1) -> dict[str, float]:
    """Factors for `units` position units in `turns` motor revolutions, with units/s and units/s².

    The older factor group counts 65536 increments a turn, turns per 4096 min, and turns per minute
    in 256 s (DSP 402 V2, 6093h, 6094h, 6097h).
    """
    if not drive.model.quirk("older_factor_group"):
        return {"feed": units, "feed_shaft_revolutions": turns}
    return {
        "position_factor_divisor": units,
        "position_factor_numerator": turns * 65536,
        "velocity_encoder_factor_divisor": units,
        "velocity_encoder_factor_numerator": turns * 60 * 4096,
        "acceleration_factor_divisor": units,
        "acceleration_factor_numerator": turns * 60 * 256,
    }
