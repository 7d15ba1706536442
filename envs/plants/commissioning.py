"""Commissions a joint of any robot: the parameters of its drive follow from the model alone.

Windows are angles of the motor shaft, so they scale with the gear, as the encoder does.
"""

import math
from fractions import Fraction
from numbers import Real

import mujoco
import numpy as np

from ...drive.drive import Drive
from ...drive.model.model import load
from ...drive.model.names import hint
from ..engine.checks import flag
from ..engine.machine import Machine
from . import own_units, tuning
from .linear_axis import factor_group
from .motor import MOTOR
from .sizing import Profile, asked
from .tuning import gains

RATED_SPEED = 3000 * 2 * math.pi / 60  # rad/s, usual for servo motors of this size
TRAVEL_TIME = 0.5  # s over the whole range, if the motor is that fast (inferred)
RAMP_TIME = 0.2  # s, from standstill to the highest speed, if the motor can (inferred)
# rad or rad/s at the shaft; linear_axis has 1 mm, 20 µm and 5 mm/s at 60 mm per turn; these are
# wider, because the axes of a robot disturb each other (inferred)
FOLLOWING_ERROR_WINDOW = 0.5
POSITION_WINDOW = 0.005
VELOCITY_WINDOW = 0.5
INCREMENTS = 4  # of the encoder, the smallest position window
UNSIGNED16, INTEGER32 = 0xFFFF, 0x7FFFFFFF


def commission_joint(
    machine: Machine,
    name: str,
    *,
    max_velocity: float | None = None,
    max_acceleration: float | None = None,
    position_unit: float = 1e-6,
    tuned: bool = True,
) -> None:
    """Set units, limits, windows, motor data, homing and gains of the drive `name`.

    The position unit is 1 µrad (hinge) or 1 µm (slide), with velocity and acceleration per s and
    s². The direction is that of the joint, also with a negative gear. The software position limits
    are the range of the joint; an unlimited joint has none. Homing method 37, or 35 if the model
    lacks it, gives the drive the coordinate of the joint when it is homed at the present pose. The
    motor has 400 W, or more if the load of the joint needs it; the gains are for the inertia at the
    present pose. A frequency inverter is left unchanged, because it cannot position.

    Args:
        machine: a machine at rest, with none of its drives in operation.
        name: name of the drive.
        max_velocity: profile velocity (m/s or rad/s); by default 3000 1/min of the motor, or less
            if that crosses the range in under 0.5 s.
        max_acceleration: profile acceleration and deceleration (m/s² or rad/s²); by default that of
            twice the rated torque, or less if that reaches full speed in under 0.2 s.
        position_unit: one position unit of the drive (m or rad).
        tuned: limit gains, profile and following error window to the abilities of mechanics and
            motor; otherwise the gains follow the rule in `tuning`, without further checks.

    Raises:
        ValueError: an unknown drive, an argument that is not above 0, or a value that the drive
            does not accept, with a remedy.
    """
    tuned = flag("tuned", tuned)
    try:
        commission_shaft(
            machine, name, max_velocity=max_velocity, max_acceleration=max_acceleration,
            position_unit=position_unit, tuned=tuned,
            exact=max_velocity is not None or max_acceleration is not None,
        )
    except tuning.Unmovable as error:
        gear = abs(machine.joint(name)[0])
        raise tuning.Unmovable(f"{error}; {_other(name, gear)}") from None


def commission_shaft(
    machine: Machine, name: str, *, max_velocity: float | None, max_acceleration: float | None,
    position_unit: float, tuned: bool, exact: bool = False,
) -> None:
    """Commission a drive as `commission_joint` does, without its advice for robots in errors.

    A speed or ramp beyond the range of the drive is refused if `exact`, otherwise limited.
    """
    if not isinstance(machine, Machine):
        raise ValueError(f"machine = {machine!r}: give a Machine, such as one of Machine.from_mjcf")
    if name not in machine.drives:
        raise ValueError(f"name: there is no drive {name!r}: {hint(str(name), machine.drives)}")
    drive = machine.drives[name]
    if not drive.model.positions:
        return
    coupling = machine.coupling(name)
    gear = abs(float(coupling.gear))
    given = {"max_velocity": max_velocity, "max_acceleration": max_acceleration}
    for argument, value in {**given, "position_unit": position_unit}.items():
        if value is not None and not (isinstance(value, Real) and 0.0 < value < math.inf):
            raise ValueError(f"{argument} = {value!r} must be a finite number above 0")
    speed = _speed(machine, coupling) if max_velocity is None else max_velocity * gear
    torque = (asked(machine, coupling, speed / gear) + float(coupling.friction)) / gear
    inertia = _inertia(machine, coupling)
    rated = max(MOTOR["motor_rated_torque"] * 1e-3, 2 * torque)
    if max_acceleration is None:
        acceleration = min(speed / RAMP_TIME, (2 * rated - torque) / inertia)
    else:
        acceleration = max_acceleration * gear
        rated = max(rated, (torque + inertia * acceleration) / 2)
    try:
        per_unit = gear * position_unit  # rad of the shaft
        own_units.motor_and_factors(drive, _motor(drive, rated) | _units(drive, per_unit))
        profile = _profile(speed / per_unit, acceleration / per_unit)
        own_units.commission(
            drive,
            {"polarity": 0xC0 if coupling.gear < 0 else 0}
            | profile
            | _windows(drive, per_unit)
            | _places(machine, drive, coupling, position_unit),
            per_unit,
            exact=profile if exact else (),
        )
        if tuned:
            wanted = Profile(speed, acceleration, 2 * acceleration, 0.1 * speed, 0.1 * acceleration)
            behind = _behind_springs(machine, coupling)
            tuned_values = tuning.tuned(
                machine, name, inertia=inertia + behind, motor_side=inertia, wanted=wanted,
                per_unit=per_unit, window=FOLLOWING_ERROR_WINDOW,
            )
            own_units.commission(drive, tuned_values, per_unit, exact=gains(drive, inertia))
        else:
            drive.commission(gains(drive, inertia))
    except tuning.Unmovable:
        raise
    except (ValueError, OverflowError) as error:
        raise ValueError(
            f"drive {name!r} ({drive.model.name}) cannot take a value: {error}; inertia at the "
            f"shaft {inertia:.3g} kg·m², {speed:.4g} rad/s, position_unit {position_unit:g}: "
            f"{_other(name, gear)}, another position_unit, or smaller limits"
        ) from None


def _other(name: str, gear: float) -> str:
    return (
        f"choose another gear than {gear:g} (gears[{name!r}] of Machine.from_mjcf adds the "
        "rotor's inertia too)"
    )


def _units(drive: Drive, angle: float) -> dict[str, float]:
    """Factors for units of `angle` (rad of the shaft), as a fraction of a revolution."""
    turn = 2 * math.pi / angle
    # both parts have to stay below 2^31 together with the increments of the encoder
    units = Fraction(turn).limit_denominator(max(1, min(1000, int(2**31 / turn) - 1)))
    return factor_group(drive, units.numerator, units.denominator)


def _speed(machine: Machine, coupling) -> float:
    """Speed of the shaft (rad/s) that suits motor and range."""
    joint = machine.model.dof_jntid[coupling.dof]
    if not machine.model.jnt_limited[joint]:
        return RATED_SPEED
    low, high = machine.model.jnt_range[joint]
    return min(RATED_SPEED, abs(float(coupling.gear)) * float(high - low) / TRAVEL_TIME)


def _inertia(machine: Machine, coupling) -> float:
    """Inertia at the shaft (kg·m²) with the other drives held and joints without a drive free."""
    model = machine.model
    mass = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, machine.data, mass)
    driven = {int(other.dof) for other in machine.couplings}
    free = [int(coupling.dof), *(dof for dof in range(model.nv) if dof not in driven)]
    mobility = np.linalg.inv(mass[np.ix_(free, free)])
    return float(1.0 / mobility[0, 0] / coupling.gear**2)


def _behind_springs(machine: Machine, coupling) -> float:
    """Inertia at the shaft (kg·m²) of the bodies behind springs; 0 without springs."""
    model = machine.model
    if not model.jnt_stiffness.any():
        return 0.0
    still = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, machine.data, still)
    driven = {int(other.dof) for other in machine.couplings}
    sprung = [float(model.jnt_stiffness[model.dof_jntid[dof]]) > 0.0 for dof in range(model.nv)]
    loose = [dof for dof in range(model.nv) if dof not in driven and not sprung[dof]]
    free = [int(coupling.dof), *loose]
    whole = 1.0 / np.linalg.inv(still[np.ix_(free, free)])[0, 0] / coupling.gear**2
    return max(float(whole) - _inertia(machine, coupling), 0.0)


def _motor(drive: Drive, rated_torque: float) -> dict[str, float]:
    """Return `MOTOR` with another rated torque (Nm) and the same torque constant.

    The capacitor and the brake resistor of the DC link scale with the motor.
    """
    scale = rated_torque * 1e3 / MOTOR["motor_rated_torque"]
    values: dict[str, float] = {**MOTOR}
    for name in ("motor_rated_current", "motor_rated_torque"):
        values[name] = math.ceil(MOTOR[name] * scale)
    for name, factor in (("link_capacitance", scale), ("chopper_resistance", 1 / scale)):
        row = drive.model.names.get(name) or load("generic").names[name]
        default = drive.model.fixed.get(name, row.default)
        values[name] = math.ceil(float(default) * factor)
    return values


def _profile(velocity: float, acceleration: float) -> dict[str, float]:
    """Speeds and ramps (drive units): limits at twice the profile, homing at a tenth."""
    return {
        "max_profile_velocity": 2 * velocity,
        "profile_velocity": velocity,
        "profile_acceleration": acceleration,
        "profile_deceleration": acceleration,
        "quick_stop_deceleration": 2 * acceleration,
        "speed_during_search_for_switch": max(0.1 * velocity, 1),
        "speed_during_search_for_zero": max(0.01 * velocity, 1),
        "homing_acceleration": max(0.1 * acceleration, 1),
    }


def _windows(drive: Drive, per_unit: float) -> dict[str, float]:
    """Windows (drive units); `per_unit` is rad of the shaft."""
    increments, turns = drive.axis.od.position_encoder_resolution.tolist()
    window = max(POSITION_WINDOW, INCREMENTS * 2 * math.pi * turns / increments)
    velocity = min(max(VELOCITY_WINDOW / per_unit, 1), UNSIGNED16)
    return {
        "following_error_window": max(FOLLOWING_ERROR_WINDOW / per_unit, 1),
        "following_error_time_out": 10,
        "position_window": max(window / per_unit, 1),
        "position_window_time": 5,
        "velocity_window": velocity,
        "velocity_window_time": 5,
        "velocity_threshold": velocity,
    }


def _places(machine: Machine, drive: Drive, coupling, position_unit: float) -> dict[str, float]:
    """Software limits and homing at the present position (drive units)."""
    model = machine.model
    joint = model.dof_jntid[coupling.dof]
    low, high = model.jnt_range[joint] if model.jnt_limited[joint] else (0.0, 0.0)  # equal: none
    here = float(machine.data.qpos[coupling.qpos])
    name = model.joint(joint).name
    if low < high and not low - 1e-6 <= here <= high + 1e-6:
        raise ValueError(
            f"joint {name!r} stands at {here:g}, out of its range {low:g}..{high:g}: "
            "choose a pose with machine.reset(positions=...) first"
        )
    for place in (low, high, here):
        if abs(place) / position_unit > INTEGER32:
            raise ValueError(
                f"joint {name!r} at {place:g}: in units of {position_unit:g} this exceeds an "
                "INTEGER32: choose a larger position_unit"
            )
    return {
        "min_position_limit": low / position_unit,
        "max_position_limit": high / position_unit,
        "homing_method": drive.model.homes_here,
        "home_offset": -here / position_unit,
    }
