"""A linear axis with one drive, commissioned as a user would: through its objects."""

import math
from importlib import resources
from pathlib import Path

import mujoco

from ..drive.drive import Drive
from ..drive.model import DriveModel, load
from .axis_parameters import LinearAxisParameters, family
from .machine import Machine
from .tuning import gains, inertia_at_shaft, inertia_of_motor_side

MJCF = Path(str(resources.files("servogym.assets"))) / "mjcf" / "linear_axis.xml"

# a 400 W servo motor: mA, mNm, per mille
MOTOR = {
    "motor_rated_current": 2500,
    "motor_rated_torque": 1270,
    "max_current": 3000,
    "max_torque": 3000,
}
GRAVITY = 9.81  # m/s²
MOTOR_SIDE_MASS = 1e-3  # kg; MuJoCo wants some for a moving body, the inertia is the armature
FASTEST = 1.5  # rad of a vibration in one physics step; from 2 on the integrator diverges


def linear_axis(
    drive: str | Path | DriveModel = "generic",
    *,
    mechanics: str = "rigid",
    timestep: float | None = None,
    parameters: LinearAxisParameters | None = None,
    **values: float | None,
) -> Machine:
    """A `Machine` with one linear axis, its drive called ``x``, stroke 0..0.5 m.

    Position unit 1 µm, velocity unit 1 µm/s, acceleration unit 1 µm/s². Limit switches lie 5 mm,
    end stops 20 mm outside the stroke; homing method 17 puts the zero at its left end.

    Args:
        drive: drive model by name, folder or loaded.
        mechanics: preset of the family: ``rigid``, ``toothed_belt``, ``ball_screw``,
            ``linear_motor`` or ``vertical``, see `axis_parameters`.
        timestep: physics step (s); the velocity cycle of the drive if not given.
        parameters: `LinearAxisParameters`, or its fields as keywords instead of the preset's.

    Raises:
        ValueError: unknown model or preset, a parameter out of range, a timestep that the rates
            do not allow or that is too long for the elastic mechanics.
    """
    if parameters is None:
        parameters = family(mechanics, **values)
    elif values or mechanics != "rigid":
        given = [*values, *(["mechanics"] if mechanics != "rigid" else [])]
        raise ValueError(f"parameters and {', '.join(given)} are both given: choose one way")
    drive_model = load(drive)
    if timestep is None:
        timestep = drive_model.cycle_time["velocity"]
    if not (isinstance(timestep, int | float) and 0.0 < timestep <= 0.01):
        raise ValueError(f"timestep = {timestep!r} is out of range 0..0.01 s")
    machine = Machine(_plant(parameters, drive_model, timestep), {"x": drive_model})
    commission(machine, "x", parameters)
    machine.reset()
    return machine


def _plant(p: LinearAxisParameters, drive_model: DriveModel, timestep: float) -> mujoco.MjModel:
    spec = mujoco.MjSpec.from_file(str(MJCF))
    gear = 2 * math.pi / p.feed_constant
    spec.option.timestep = timestep
    joint = spec.joint("x")
    rotor = drive_model.rotor_inertia if p.rotor_inertia is None else p.rotor_inertia
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
        "switch_offset": [p.switch_offset] * 3,
        "switch_scatter": [p.switch_scatter],
    }.items():
        if values:
            spec.add_numeric(name=f"x.{name}", size=len(values), data=values)
    carried = p.carriage_mass + p.payload
    if p.stiffness > 0.0 and p.payload > 0.0:
        _spring(spec, "payload", "load", p.stiffness, p.structural_damping)
        rest = joint.armature + p.carriage_mass
        if p.transmission_stiffness > 0.0:
            rest = p.carriage_mass
        _slow_enough("stiffness", p.stiffness, rest, p.payload, timestep)
    if p.transmission_stiffness > 0.0:
        _drive_elastically(spec, p)
        motor = joint.armature + MOTOR_SIDE_MASS
        _slow_enough("transmission_stiffness", p.transmission_stiffness, motor, carried, timestep)
    return spec.compile()


def _spring(spec: mujoco.MjSpec, body: str, name: str, stiffness: float, damping: float) -> None:
    """Put a body on a spring along the axis: the joint `name`."""
    joint = spec.body(body).add_joint(name=name, type=mujoco.mjtJoint.mjJNT_SLIDE, axis=[1, 0, 0])
    joint.stiffness[0] = stiffness
    joint.damping[0] = damping


def _drive_elastically(spec: mujoco.MjSpec, p: LinearAxisParameters) -> None:
    """A spring, the joint ``carriage``, between the motor side and the carriage.

    Friction and end stops go from the motor's joint to the carriage, which is the tendon
    ``x.guide``, the sum of the joints. The viscous friction stays: both move at nearly one speed.
    """
    _spring(spec, "carriage", "carriage", p.transmission_stiffness, p.transmission_damping)
    motor_side, motor = spec.body("motor_side"), spec.joint("x")
    motor_side.mass = MOTOR_SIDE_MASS
    motor_side.inertia = [MOTOR_SIDE_MASS * 1e-4] * 3
    motor_side.explicitinertial = True
    guide = spec.add_tendon(
        name="x.guide",
        limited=True,
        range=motor.range,
        frictionloss=motor.frictionloss,
        solref_limit=motor.solref_limit,
        solimp_limit=motor.solimp_limit,
    )
    guide.wrap_joint("x", 1.0)
    guide.wrap_joint("carriage", 1.0)
    motor.limited = False
    motor.frictionloss = 0.0


def _slow_enough(name: str, stiffness: float, a: float, b: float, timestep: float) -> None:
    """Refuse a spring between two masses (kg) that vibrates too fast for the physics step."""
    rate = math.sqrt(stiffness * (1.0 / a + 1.0 / b))
    if rate * timestep > FASTEST:
        raise ValueError(
            f"{name} = {stiffness:g} N/m between {a:.3g} kg and {b:.3g} kg resonates at "
            f"{rate / (2 * math.pi):.0f} Hz, too fast for a timestep of {timestep * 1e6:g} µs: at "
            f"most {FASTEST / rate * 1e6:.0f} µs, as a whole fraction of the velocity cycle, or a "
            "softer spring"
        )


def commission(machine: Machine, name: str, p: LinearAxisParameters) -> None:
    """Parameters of a drive for such an axis: motor, units, limits, windows, homing, gains."""
    x = machine.drives[name]
    if x.model.quirk("inverter"):
        return  # its motor and its ramps are parameters of its own
    micro = 1e6  # drive units per m
    parameters = {
        **MOTOR,
        **factor_group(x, p.feed_constant * micro),
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
        "position_control_v_max": 2 * p.max_velocity * micro,
        "limit_switch_deceleration": 2 * p.max_acceleration * micro,
    }
    x.commission(parameters)
    coupling = machine.couplings[list(machine.drives).index(name)]
    place = machine.model, machine.data, coupling.dof, coupling.gear
    tune(x, inertia_at_shaft(*place), inertia_of_motor_side(*place))


def factor_group(drive: Drive, units: float, turns: int = 1) -> dict[str, float]:
    """`units` position units in so many motor revolutions, and units/s, units/s².

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


def tune(drive: Drive, inertia: float, motor_side: float | None = None) -> None:
    """Set the gains for `inertia` (kg·m² at the shaft), `motor_side` of it before any spring."""
    drive.commission(gains(drive, inertia, motor_side))
