"""Axes without ends: a rotary table and a conveyor. Their position repeats after a range, 607Bh.

Both consist of a motor, a gear and a rotating load: the table itself, or the roller that drives a
belt. Values marked `inferred` have the size that catalogues give; they are not those of a product.
"""

from dataclasses import replace
from importlib import resources
from pathlib import Path

import mujoco

from ...drive.model.model import DriveModel, load
from ...drive.model.names import hint
from ..engine.checks import changed, flag
from ..engine.machine import Machine
from ..engine.physics import compiled
from ..engine.rates import physics_step
from . import own_units, twins
from .commissioning import commission_shaft
from .linear_axis import FINER
from .motor import motor_and_encoder
from .rotary_parameters import ROTARY_FAMILY, RotaryParameters
from .sizing import first, largest
from .transmission import MOTOR_SIDE_MASS, drive_elastically, slow_enough
from .tuning import Unmovable, gains, inertias, movable, turned

MJCF = Path(str(resources.files("servogym.assets"))) / "mjcf" / "rotary_axis.xml"
TABLE_MASS = 10.0  # kg; only its inertia counts
HOME_SWITCH = (0.25, 0.3, 0.0005)  # from, to, hysteresis, as shares of the period


def rotary_axis(
    drive: str | Path | DriveModel = "generic",
    *,
    mechanics: str = "rotary_table",
    timestep: float | None = None,
    parameters: RotaryParameters | None = None,
    tuned: bool = True,
    twin: str | Path | None = None,
    **values: float | None,
) -> Machine:
    """Build a `Machine` with one axis without ends and the drive ``x``.

    The position unit is 0.001 degree for a table and 1 µm for a conveyor. Positions repeat after a
    turn of the table or a pitch of the conveyor (607Bh, if the model has it). A home switch occurs
    once in that range, at a quarter of it; homing method 23 puts the zero at its left edge.

    Args:
        drive: drive model by name, folder or loaded.
        mechanics: preset: ``rotary_table`` or ``conveyor``.
        timestep: physics step (s); by default the velocity cycle of the drive.
        parameters: `RotaryParameters`, or its fields as keywords instead of the preset's.
        tuned: as for `linear_axis`.
        twin: folder of `servogym twin` identified from the log of such an axis; it determines
            plant, drive and gains.

    Raises:
        ValueError: an unknown model or preset, a parameter out of range, a timestep that does not
            fit the cycles of the drive or is too long for the elastic mechanics, or an inertia that
            this motor or drive cannot move.
    """
    if twin is not None:
        return twins.machine_of(twin, rotary_axis, drive)
    if mechanics not in ROTARY_FAMILY:
        raise ValueError(
            f"mechanics = {mechanics!r} is unknown: {hint(str(mechanics), ROTARY_FAMILY)}"
        )
    if parameters is None:
        parameters = changed(ROTARY_FAMILY[mechanics], values, f"a {mechanics}")
    elif values:
        raise ValueError(f"parameters and {', '.join(values)} are both given: choose one way")
    model, tuned = load(drive), flag("tuned", tuned)
    try:
        machine = _made(model, parameters, tuned, timestep)
    except Unmovable as error:
        raise ValueError(
            f"inertia = {parameters.inertia:g} kg·m²: {error}; {_would_do(model, parameters)}"
        ) from None
    machine.reset()
    return machine


def _made(
    model: DriveModel, p: RotaryParameters, tuned: bool = True, timestep: float | None = None
) -> Machine:
    """Build and commission an axis. Raises Unmovable if motor or drive cannot move it."""
    timestep = physics_step(timestep, model.cycle_time["velocity"])
    machine = Machine(_plant(p, model, timestep), {"x": model})
    _commission(machine, p, tuned)
    return machine


def _would_do(drive: DriveModel, p: RotaryParameters) -> str:
    """Say which inertia, and which gear ratio, this motor can move."""

    def moves(**changed: float) -> bool:
        other = replace(p, **changed)  # type: ignore[arg-type]
        return movable(lambda: _made(drive, other))

    carried = largest(lambda inertia: moves(inertia=inertia), p.inertia)
    higher = first(FINER, lambda factor: moves(gear_ratio=p.gear_ratio * factor))
    said = f"it takes {carried:.3g} kg·m²"
    if higher is None:
        return said
    return f"{said}; with a gear_ratio of {p.gear_ratio * higher:.4g} it takes this one"


def _plant(p: RotaryParameters, drive: DriveModel, timestep: float) -> mujoco.MjModel:
    spec = mujoco.MjSpec.from_file(str(MJCF))
    spec.option.timestep = timestep
    joint, table = spec.joint("x"), spec.body("table")
    rotor = drive.rotor_inertia if p.rotor_inertia is None else p.rotor_inertia
    joint.armature = rotor * p.gear_ratio**2
    joint.frictionloss = p.coulomb_friction
    joint.damping[0] = p.viscous_friction
    spec.actuator("x").gear[0] = p.gear_ratio
    table.mass, table.inertia = TABLE_MASS, [0.6 * p.inertia, 0.6 * p.inertia, p.inertia]
    spec.numeric("x.switch_period").data = [p.period]
    spec.numeric("x.home_switch").data = [share * p.period for share in HOME_SWITCH]
    for name, value in {"backlash": p.backlash, "efficiency": p.efficiency}.items():
        spec.add_numeric(name=f"x.{name}", size=1, data=[value])
    if p.transmission_stiffness > 0.0:
        drive_elastically(spec, "table", p.transmission_stiffness, p.transmission_damping)
        motor = joint.armature + MOTOR_SIDE_MASS * 1e-4
        slow_enough(
            "transmission_stiffness", p.transmission_stiffness, motor, p.inertia, timestep,
            ("Nm/rad", "kg·m²"),
        )
    return compiled(spec)


def _commission(machine: Machine, p: RotaryParameters, tuned: bool) -> None:
    x = machine.drives["x"]
    if not x.model.positions:  # an inverter has its own parameters for motor and ramps
        if tuned:
            turned(machine, "x")
        return
    own_units.motor_and_factors(x, motor_and_encoder(p, x))
    commission_shaft(
        machine, "x", max_velocity=p.max_velocity, max_acceleration=p.max_acceleration,
        position_unit=p.unit, tuned=tuned,
    )
    own_units.commission(
        x,
        {
            "min_position_range_limit": 0,
            "max_position_range_limit": round(p.period / p.unit),
            "homing_method": 23,
            "home_offset": 0,
        },
        abs(machine.joint("x")[0]) * p.unit,
    )
    if not tuned:
        x.commission(gains(x, *inertias(machine, "x")))
