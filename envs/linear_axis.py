"""A linear axis with one drive, commissioned as a user would: through its objects."""

import math
from dataclasses import dataclass, fields
from importlib import resources
from pathlib import Path

import mujoco

from ..drive.drive import Drive
from ..drive.model import DriveModel, load
from .machine import Machine
from .tuning import gains, inertia_at_shaft

MJCF = Path(str(resources.files("servogym.assets"))) / "mjcf" / "linear_axis.xml"

# a 400 W servo motor: mA, mNm, per mille
MOTOR = {
    "motor_rated_current": 2500,
    "motor_rated_torque": 1270,
    "max_current": 3000,
    "max_torque": 3000,
}
GRAVITY = 9.81  # m/s²
# lowest, highest, unit
RANGES = {
    "payload": (0.0, 100.0, "kg"),
    "feed_constant": (1e-3, 1.0, "m per motor revolution"),
    "coulomb_friction": (0.0, 200.0, "N"),
    "viscous_friction": (0.0, 2000.0, "N·s/m"),
    "max_velocity": (1e-3, 10.0, "m/s"),
    "max_acceleration": (1e-2, 200.0, "m/s²"),
    "max_jerk": (1.0, 4000.0, "m/s³"),
    "stiffness": (0.0, 1e8, "N/m"),
    "structural_damping": (0.0, 1e5, "N·s/m"),
    "inclination": (-90.0, 90.0, "degree"),
    "brake_torque": (0.0, 100.0, "Nm"),
}


@dataclass(frozen=True)
class LinearAxisParameters:
    """What can be chosen about the axis. Raises ValueError naming field, value, range and unit."""

    payload: float = 5.0  # kg, on a carriage of 1.5 kg
    feed_constant: float = 0.06  # m per motor revolution
    coulomb_friction: float = 12.0  # N
    viscous_friction: float = 20.0  # N·s/m
    max_velocity: float = 1.0  # m/s, profile velocity
    max_acceleration: float = 10.0  # m/s², profile acceleration and deceleration
    max_jerk: float = 1000.0  # m/s³, profile jerk
    stiffness: float = 0.0  # N/m, between carriage and payload; 0: rigid
    structural_damping: float = 0.0  # N·s/m, between carriage and payload
    inclination: float = 0.0  # degree; 90: vertical, the positive direction is upwards
    brake_torque: float = 0.0  # Nm at the shaft, of the holding brake; 0: there is none

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            low, high, unit = RANGES[field.name]
            try:
                inside = low <= float(value) <= high
            except (TypeError, ValueError):
                inside = False
            if not inside:
                raise ValueError(
                    f"{field.name} = {value!r} is out of range {low:g}..{high:g} {unit}"
                )


def linear_axis(
    drive: str | Path | DriveModel = "generic",
    *,
    timestep: float | None = None,
    parameters: LinearAxisParameters | None = None,
    **values: float,
) -> Machine:
    """A `Machine` with one linear axis, its drive called ``x``, stroke 0..0.5 m.

    Position unit 1 µm, velocity unit 1 µm/s, acceleration unit 1 µm/s². Limit switches lie 5 mm,
    end stops 20 mm outside the stroke; homing method 17 puts the zero at its left end.

    Args:
        drive: drive model by name, folder or loaded.
        timestep: physics step (s); the velocity cycle of the drive if not given.
        parameters: `LinearAxisParameters`, or its fields as keywords.

    Raises:
        ValueError: unknown model, a parameter out of range, a timestep the rates do not allow.
    """
    if parameters is None:
        parameters = LinearAxisParameters(**values)
    elif values:
        raise ValueError(f"parameters and {', '.join(values)} are both given: choose one way")
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
    joint.armature = drive_model.rotor_inertia * gear**2
    joint.frictionloss = p.coulomb_friction
    joint.damping[0] = p.viscous_friction
    spec.actuator("x").gear[0] = gear
    slope = math.radians(p.inclination)
    spec.option.gravity = [-GRAVITY * math.sin(slope), 0.0, -GRAVITY * math.cos(slope)]
    if p.brake_torque > 0.0:
        spec.add_numeric(name="x.brake_torque", size=1, data=[p.brake_torque])
    payload = spec.geom("payload")
    payload.mass = p.payload
    payload.size = [0.02 + 0.01 * min(p.payload, 5.0) ** (1 / 3)] * 3
    payload.pos[2] = 0.014 + payload.size[2]
    if p.stiffness > 0.0 and p.payload > 0.0:
        _mount_elastically(spec, p)
    return spec.compile()


def _mount_elastically(spec: mujoco.MjSpec, p: LinearAxisParameters) -> None:
    """Put the payload on a spring along the axis: the joint ``load``, a two-mass system."""
    body = spec.body("payload")
    joint = body.add_joint(name="load", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=[1, 0, 0])
    joint.stiffness[0] = p.stiffness
    joint.damping[0] = p.structural_damping


def commission(machine: Machine, name: str, p: LinearAxisParameters) -> None:
    """Parameters of a drive for such an axis: motor, units, limits, windows, homing, gains."""
    x = machine.drives[name]
    if x.model.quirk("inverter"):
        return  # its motor and its ramps are parameters of its own
    micro = 1e6  # drive units per m
    parameters = {
        **MOTOR,
        **_units(x, p.feed_constant * micro),
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
    inertia = inertia_at_shaft(machine.model, machine.data, coupling.dof, coupling.gear)
    tune(x, inertia)


def _units(drive: Drive, turn: float) -> dict[str, float]:
    """Factor group for `turn` position units a motor revolution, and units/s, units/s².

    The older one counts 65536 increments a turn, turns per 4096 min, and turns per minute in 256 s.
    """
    if not drive.model.quirk("older_factor_group"):
        return {"feed": turn, "feed_shaft_revolutions": 1}
    return {
        "position_factor_divisor": turn,
        "position_factor_numerator": 65536,
        "velocity_encoder_factor_divisor": turn,
        "velocity_encoder_factor_numerator": 60 * 4096,
        "acceleration_factor_divisor": turn,
        "acceleration_factor_numerator": 60 * 256,
    }


def tune(drive: Drive, inertia: float) -> None:
    """Set the gains for `inertia` (kg·m² at the shaft)."""
    drive.commission(gains(drive, inertia))
