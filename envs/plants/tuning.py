"""Tunes an axis while it is commissioned: gains for its plant, profile and windows for its motor.

A rigid inertia gets the symmetrical optimum for speed and a safe ratio for position. The delays of
the velocity loop add up to T = 1.5 velocity cycles (sampling and hold) + the torque time constant +
the velocity filter. Symmetrical optimum with a = 3 (Leonhard, Control of Electrical Drives, speed
control): crossover w = 1 / (a T), integral action time a / w. The position loop stays a factor 4
below the crossover of the speed loop. Behind a spring the load is no longer felt above the
resonance: there the loop closes around the motor side alone and must cross below 1 / T, which
leaves a gain margin of pi / 2.

If a load much heavier than the motor side makes these gains too slow, if the margins are too small
or the gains are out of the drive's ranges, the gains are instead the stiffest ones in these ranges
that keep the margins (`loops`) with the plant of the model (`shaft`).
"""

import math
from collections.abc import Callable, Sequence

import mujoco
import numpy as np

from ...drive.drive import Drive
from ...drive.kernel.cascade import Structure
from ..engine.machine import Machine
from .loops import (
    ANY,
    LOWEST,
    OBJECTS,
    RESERVE_GAIN,
    RESERVE_PHASE,
    Gains,
    LoopPlant,
    RequiredMargins,
    fastest,
    fastest_pid,
    gains_of,
    in_units,
    measurable,
    ranges,
)
from .shaft import plant_at_shaft
from .sizing import PEAK, Load, Motor, Profile, load_of, motor_of, possible

A = 3.0  # larger is softer and better damped
SEPARATION = 4.0  # velocity crossover over position gain
# share of the window by which friction may deflect the axis with gains of the rule; beyond it the
# end of a move takes a tenth longer than with the stiffest gains (measured on 162 axes)
SOFT = 0.12
UNKNOWN = 0.25  # share of the acceleration torque that the feed-forward may miss
RESERVE = 4.0  # ratio of the window to the expected following error
REST = 400.0  # ms times the position gain (1/s): a soft loop crosses its window before it rests
SHORTEST = 5  # ms
SPRUNG = 0.9  # share of the inertia on the motor side below which there is a spring
UNSIGNED32 = 2**32
ASKED = RequiredMargins()


class Unmovable(ValueError):
    """A motor or a drive cannot move what it is to move."""


class TooLight(Unmovable):
    """A motor with a fixed slip line oscillates with so little inertia."""


def inertia_at_shaft(model: mujoco.MjModel, data: mujoco.MjData, dof: int, gear: float) -> float:
    """Inertia at the motor shaft (kg·m²): the joint's diagonal of the mass matrix / gear²."""
    mass = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, mass)
    return float(mass[dof, dof]) / gear**2


def inertias(machine: Machine, name: str) -> tuple[float, float]:
    """Inertia at the motor shaft of a drive (kg·m²), and the part of it before any spring.

    A sudden torque only accelerates that part.
    """
    model, data, coupling = machine.model, machine.data, machine.coupling(name)
    mass = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, mass)
    motor_side = 1.0 / float(np.linalg.inv(mass)[coupling.dof, coupling.dof]) / coupling.gear**2
    return inertia_at_shaft(model, data, coupling.dof, coupling.gear), motor_side


def movable(make: Callable[[], object]) -> bool:
    """Whether a machine can be commissioned: its motor and its drive can move the load."""
    try:
        make()
    except Unmovable:
        return False
    return True


def rule(drive: Drive, inertia: float, motor_side: float | None = None) -> Gains:
    """Return the gains of the symmetrical optimum for `inertia` (kg·m² at the shaft).

    `motor_side` (kg·m²) is the part of it before any spring, by default all of it.
    """
    filter_time = float(drive.axis.od.velocity_filter_time) * 1e-6
    delay = (
        1.5 * drive.model.cycle_time["velocity"] + drive.model.torque_time_constant + filter_time
    )
    crossover = min(1.0 / A, (motor_side or inertia) / inertia) / delay
    return Gains(inertia * crossover, A / crossover, crossover / SEPARATION)


def gains(drive: Drive, inertia: float, motor_side: float | None = None) -> dict[str, int]:
    """Return objects 60F9h, 60FBh and 2010h for `inertia` by `rule`, in drive units."""
    axis, found = drive.axis, rule(drive, inertia, motor_side)
    return {
        "velocity_control_gain": round(found.velocity_gain / axis.velocity_gain_unit),
        "velocity_control_time": round(found.integral_time * 1e6),
        "position_control_gain": round(found.position_gain / axis.position_gain_unit),
        "acceleration_feed_forward": round(inertia * 1e9),
    }


def fitting(
    plants: Sequence[LoopPlant], drive: Drive, by_rule: Gains, stiffness: float
) -> Gains | None:
    """Return gains of a drive for a plant: those of the rule if they suffice.

    Args:
        plants: plants of `shaft.plant_at_shaft`, in all situations.
        drive: the drive whose ranges apply, as far as `bode` can measure the loops.
        by_rule: gains of `rule`.
        stiffness: stiffness that the gains of the rule need (Nm/rad).

    Returns:
        The gains, or None if no gains in the ranges keep the margins.
    """
    allowed = measurable(ranges(drive))
    taken = all(
        low <= value <= high
        for (low, high), value in (
            (allowed["velocity_gain"], by_rule.velocity_gain),
            (allowed["integral_time"], by_rule.integral_time),
            (allowed["position_gain"], by_rule.position_gain),
        )
    )
    pid = drive.axis.od.control_structure == Structure.PID
    if taken and not pid and by_rule.stiffness >= stiffness:
        found = [margin for plant in plants for margin in plant.margins(by_rule)]
        if all(
            stable and gain >= ASKED.gain + RESERVE_GAIN and phase >= ASKED.phase + RESERVE_PHASE
            for gain, phase, stable in found
        ):
            return by_rule
    return (fastest_pid if pid else fastest)(plants, ASKED, allowed)


def tuned(
    machine: Machine, name: str, *, inertia: float, motor_side: float, wanted: Profile,
    per_unit: float, window: float,
) -> dict[str, float]:
    """Return the objects of a tuned drive: gains, profile and following error window.

    Args:
        machine: a machine at rest; units and motor of the drive are set.
        name: name of the drive.
        inertia: inertia at the shaft (kg·m²).
        motor_side: the part of it before any spring (kg·m²).
        wanted: the requested profile.
        per_unit: one position unit at the shaft (rad).
        window: smallest following error window (rad at the shaft).

    Raises:
        Unmovable: this motor or this drive cannot move the load.
    """
    drive = machine.drives[name]
    motor, load = motor_of(drive), load_of(machine, name, inertia)
    _bears(drive, motor, load)
    can = possible(load, motor, wanted)
    if can.acceleration <= 0.0:
        raise Unmovable(_too_weak(drive, motor, load))
    # torque that friction and a wrong inertia leave to the controller
    left = load.breakaway + load.friction + UNKNOWN * inertia * can.acceleration
    settings = _inertia_settings(drive, inertia, motor_side)
    drive.commission(settings)
    pushes = (1.0, -1.0) if load.loss > 0.0 else (1.0,)
    plants = [plant_at_shaft(machine, name, pushes=each) for each in pushes]
    found = fitting(plants, drive, rule(drive, inertia, motor_side), left / (SOFT * window))
    if found is None:
        raise Unmovable(
            f"drive {name!r} ({drive.model.name}) has no gains that keep {ASKED.gain:g} dB and "
            f"{ASKED.phase:g}° with {inertia:.3g} kg·m² at its shaft: {_missing(plants, drive)}"
        )
    window = max(window, RESERVE * left / found.stiffness)
    return {
        **in_units(drive, found),
        **settings,
        "max_profile_velocity": 2 * can.velocity / per_unit,
        "profile_velocity": can.velocity / per_unit,
        "profile_acceleration": can.acceleration / per_unit,
        "profile_deceleration": can.acceleration / per_unit,
        "quick_stop_deceleration": can.stop / per_unit,
        "speed_during_search_for_switch": max(can.homing_speed / per_unit, 1),
        "homing_acceleration": max(can.homing_acceleration / per_unit, 1),
        "following_error_window": window / per_unit,
        "position_window_time": max(SHORTEST, round(REST / found.position_gain)),
    }


def _inertia_settings(drive: Drive, inertia: float, motor_side: float) -> dict[str, float]:
    """Objects that describe the load to a drive: they change its loops.

    An observer of a motor before a spring needs the inertia of the motor side alone.
    """
    settings: dict[str, float] = {"acceleration_feed_forward": round(inertia * 1e9)}
    if drive.axis.od.observer_bandwidth > 0:
        behind = motor_side < SPRUNG * inertia and motor_side * 1e12 < UNSIGNED32
        settings["observer_inertia"] = round(motor_side * 1e12) if behind else 0
    return settings


def turned(machine: Machine, name: str) -> None:
    """Check that a frequency inverter can turn its load, with the fixed slip line of its motor.

    Raises:
        Unmovable: the load exceeds the rated torque, or (`TooLight`) makes the motor oscillate.
    """
    drive, plant = machine.drives[name], plant_at_shaft(machine, name)
    _bears(drive, motor_of(drive), load_of(machine, name, plant.inertia))
    slip = gains_of(drive)
    (gain, _, stable), _ = plant.margins(slip)
    if not stable or gain < RESERVE_GAIN:
        raise TooLight(
            f"the asynchronous motor of drive {name!r} ({drive.model.name}), "
            f"{slip.velocity_gain:.3g} Nm a rad/s of slip, oscillates with "
            f"{plant.inertia:.3g} kg·m² at its shaft: a rotor_inertia of "
            f"{drive.model.rotor_inertia:.3g} kg·m², that of such a motor, or a lower gear ratio "
            "would do"
        )


def _missing(plants: Sequence[LoopPlant], drive: Drive) -> str:
    """Explain why no gains of the drive suffice: the objects out of range, and a remedy."""
    needed, light = fastest(plants, ASKED, ANY), False
    out: list[str] = []
    for name, (of, per) in OBJECTS.items() if needed else ():
        (low, high), value, unit = ranges(drive)[of], getattr(needed, of), per(drive.axis)
        if not low <= value <= high:
            limits = f"{low * unit:g}..{high * unit:g}"
            light = not out and of == "velocity_gain" and value < low
            out.append(f"{name} = {value * unit:.3g} is out of range {limits}")
    if needed and needed.position_gain < 2 * math.pi * LOWEST:
        crossover = needed.position_gain / (2 * math.pi)
        out.append(f"the position loop would cross over at {crossover:.2g} Hz, too slow to measure")
    would = "a lower gear ratio" if light else "a stiffer transmission or a higher gear ratio"
    return ", ".join([*out, f"{would} would do"])


def _too_weak(drive: Drive, motor: Motor, load: Load) -> str:
    """Explain that the voltage drives less torque than the load needs to break away."""
    needed, ratio = load.peak(0.0, 0.0), load.peak(0.0, 0.0) / (PEAK * motor.torque(0.0))
    return (
        f"the DC link of drive {drive.model.name!r} drives {motor.torque(0.0):.3g} Nm at most "
        f"through the winding, and this load needs {needed:.3g} Nm to break away: a higher "
        "dc_link_voltage, less motor_resistance or supply_resistance, or a gear ratio "
        f"{max(math.ceil(10 * ratio) / 10, 1.1):g} times as high would do"
    )


def _bears(drive: Drive, motor: Motor, load: Load) -> None:
    """Refuse a load that permanently needs more than the rated torque."""
    needed = load.continuous()
    if needed > motor.rated:
        raise Unmovable(
            f"the motor of drive {drive.model.name!r}, rated {motor.rated:.3g} Nm, would have to "
            f"give {needed:.3g} Nm all the time to move this load: one rated {needed:.3g} Nm or "
            f"a gear ratio {math.ceil(10 * needed / motor.rated) / 10:g} times as high would do"
        )
