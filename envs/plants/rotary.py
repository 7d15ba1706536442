"""Axes without ends: a rotary table, a conveyor. Their position repeats after a range, 607Bh.

Both are a motor, a gear and something that turns: the table itself, or the roller that drives a
belt. Values marked `inferred` are of the size catalogues give, not of one product.
"""

import math
from dataclasses import dataclass, fields, replace
from importlib import resources
from pathlib import Path

import mujoco

from ...drive.model.model import DriveModel, load
from ...drive.model.near import near
from ..engine.checks import in_range
from ..engine.machine import Machine
from ..engine.physics import compiled
from .axis_parameters import RANGES as RANGES_OF_AXES
from .commissioning import commission_joint
from .linear_axis import tune
from .motor import ELECTRICAL, motor_and_encoder
from .sizing import largest
from .transmission import MOTOR_SIDE_MASS, drive_elastically, slow_enough
from .tuning import Unmovable, inertia_at_shaft, inertia_of_motor_side

MJCF = Path(str(resources.files("servogym.assets"))) / "mjcf" / "rotary_axis.xml"
TABLE_MASS = 10.0  # kg; only its inertia counts
HOME_SWITCH = (0.25, 0.3, 0.0005)  # from, to, hysteresis, as shares of the period
MILLIDEGREE = math.radians(1e-3)
MICROMETRE = 1e-6
# lowest, highest, unit
RANGES = {
    "inertia": (1e-6, 1e4, "kg·m²"),
    "gear_ratio": (0.1, 1e4, "motor revolutions per revolution"),
    "circumference": (0.0, 10.0, "m per revolution, 0 for a table"),
    "pitch": (0.0, 10.0, "m, 0 for the circumference"),
    "rotor_inertia": (0.0, 1.0, "kg·m²"),
    "coulomb_friction": (0.0, 1e4, "Nm"),
    "viscous_friction": (0.0, 1e4, "Nm·s/rad"),
    "efficiency": (0.1, 1.0, "share"),
    "transmission_stiffness": (0.0, 1e8, "Nm/rad"),
    "transmission_damping": (0.0, 1e6, "Nm·s/rad"),
    "backlash": (0.0, 0.1, "rad"),
    "max_velocity": (1e-3, 1e3, "rad/s"),
    "max_acceleration": (1e-2, 1e5, "rad/s²"),
    **{name: RANGES_OF_AXES[name] for name in ELECTRICAL},
    "motor_winding_loss": (0.0, 1e5, "W"),
    "motor_thermal_resistance": (0.0, 1e3, "K/W"),
    "motor_thermal_time": (1.0, 65535.0, "s"),
    "motor_temperature_limit": (0.0, 300.0, "degC"),
}


@dataclass(frozen=True)
class RotaryParameters:
    """One axis without ends; all at the table or roller, unless it says motor.

    Raises ValueError naming field, value, range and unit.
    """

    inertia: float = 0.5  # kg·m², of all that turns or is carried
    gear_ratio: float = 50.0  # motor revolutions per revolution
    circumference: float = 0.0  # m the belt moves per revolution of its roller; 0: a table
    pitch: float = 0.0  # m after which the position of a conveyor repeats; 0: the circumference
    rotor_inertia: float | None = None  # kg·m²; None: of the drive model's motor
    coulomb_friction: float = 5.0  # Nm
    viscous_friction: float = 2.0  # Nm·s/rad
    efficiency: float = 1.0  # of the gear; friction in proportion to what it carries
    transmission_stiffness: float = 0.0  # Nm/rad, torsion of the gear; 0: rigid
    transmission_damping: float = 0.0  # Nm·s/rad
    backlash: float = 0.0  # rad, whole gap
    load_encoder: bool = False  # the position is measured at the table: dual-loop control
    max_velocity: float = 3.0  # rad/s, profile velocity
    max_acceleration: float = 20.0  # rad/s², profile acceleration and deceleration
    # the motor as a DC motor on the DC link, as `LinearAxisParameters` has it
    speed_torque_curve: bool = False
    dc_link_voltage: float | None = None  # V; None: of the drive model
    motor_torque_constant: float | None = None  # Nm/A
    motor_voltage_constant: float | None = None  # V·s/rad
    motor_resistance: float | None = None  # Ohm
    motor_inductance: float | None = None  # H
    supply_resistance: float | None = None  # Ohm
    motor_winding_loss: float | None = None  # W at rated torque; None: of the drive model
    motor_thermal_resistance: float | None = None  # K/W
    motor_thermal_time: float | None = None  # s
    motor_temperature_limit: float | None = None  # degC, a fault above it; 0: none

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if field.name in RANGES and value is not None:
                in_range(field.name, value, *RANGES[field.name])
            elif field.name not in RANGES and not isinstance(value, bool):
                raise ValueError(f"{field.name} = {value!r}: use True or False")
        elastic = {"backlash": self.backlash > 0.0, "efficiency": self.efficiency < 1.0}
        for name, wanted in elastic.items():
            if wanted and self.transmission_stiffness == 0.0:
                raise ValueError(
                    f"{name} = {getattr(self, name):g} needs a transmission_stiffness above 0 "
                    "Nm/rad: it acts at the spring between motor and load"
                )
        if self.pitch > 0.0 and self.circumference == 0.0:
            raise ValueError(
                f"pitch = {self.pitch:g} m needs a circumference: a table repeats after a turn"
            )

    @property
    def unit(self) -> float:
        """One position unit (rad): 0.001 degree of a table, 1 µm of a belt."""
        if self.circumference == 0.0:
            return MILLIDEGREE
        return MICROMETRE * 2 * math.pi / self.circumference

    @property
    def period(self) -> float:
        """After which positions and switches repeat (rad)."""
        if self.pitch == 0.0:
            return 2 * math.pi
        return 2 * math.pi * self.pitch / self.circumference


# Worm gear 50:1 of a dividing table: efficiency 65 % (Niemann: 60..75 % at this ratio), torsion
# 3 Nm/arcsec: 6e5 is for large tables, 5e4 Nm/rad for one of 0.5 m; backlash 1 arcmin (inferred).
# Winding of class F, shut down at 140 °C.
ROTARY_TABLE = RotaryParameters(
    efficiency=0.65,
    transmission_stiffness=5e4,
    transmission_damping=10.0,
    backlash=math.radians(1 / 60),
    motor_winding_loss=60.0,
    motor_thermal_resistance=1.5,
    motor_thermal_time=1200.0,
    motor_temperature_limit=140.0,
)
# Belt on a roller of 0.4 m circumference behind a planetary gear 8:1; 8 kg of belt and goods are
# 8 · (0.4 / 2 pi)² kg·m². A cleat, and its switch, each 0.25 m (inferred).
CONVEYOR = RotaryParameters(
    inertia=0.035,
    gear_ratio=8.0,
    circumference=0.4,
    pitch=0.25,
    coulomb_friction=1.5,
    viscous_friction=0.2,
    max_velocity=12.0,
    max_acceleration=60.0,
)
ROTARY_FAMILY = {"rotary_table": ROTARY_TABLE, "conveyor": CONVEYOR}


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
    """A `Machine` with one axis without ends, its drive called ``x``.

    Position unit 0.001 degree of a table, 1 µm of a conveyor; positions repeat after a turn of the
    table or a pitch of the conveyor (607Bh, where the model has it). A home switch comes once in
    that range, a quarter of it from its beginning; homing method 23 puts the zero at its left edge.

    Args:
        drive: drive model by name, folder or loaded.
        mechanics: preset: ``rotary_table`` or ``conveyor``.
        timestep: physics step (s); the velocity cycle of the drive if not given.
        parameters: `RotaryParameters`, or its fields as keywords instead of the preset's.
        tuned: as `linear_axis` has it.
        twin: folder of `servogym twin` that was found from the log of such an axis; its plant,
            drive and gains, and nothing else beside.

    Raises:
        ValueError: unknown model or preset, a parameter out of range, a timestep that the rates
            do not allow or that is too long for the elastic mechanics.
    """
    if twin is not None:
        from . import twins  # which makes such axes

        found = twins.read(twin)
        if found.builder != "rotary_axis":
            raise ValueError(f"twin = {str(twin)!r} is a {found.builder}, no rotary_axis")
        return found.machine(None if drive == "generic" else drive)
    if mechanics not in ROTARY_FAMILY:
        raise ValueError(
            f"mechanics = {mechanics!r} is unknown: {near(str(mechanics), ROTARY_FAMILY)}"
        )
    if parameters is None:
        parameters = replace(ROTARY_FAMILY[mechanics], **values)  # type: ignore[arg-type]
    elif values:
        raise ValueError(f"parameters and {', '.join(values)} are both given: choose one way")
    model = load(drive)
    timestep = model.cycle_time["velocity"] if timestep is None else timestep
    if not (isinstance(timestep, int | float) and 0.0 < timestep <= 0.01):
        raise ValueError(f"timestep = {timestep!r} is out of range 0..0.01 s")
    machine = Machine(_plant(parameters, model, timestep), {"x": model})
    try:
        _commission(machine, parameters, tuned)
    except Unmovable as error:
        carried = largest(lambda i: _takes(model, parameters, i), parameters.inertia)
        raise ValueError(
            f"inertia = {parameters.inertia:g} kg·m²: {error}; it takes {carried:.3g} kg·m²"
        ) from None
    machine.reset()
    return machine


def _takes(drive: DriveModel, p: RotaryParameters, inertia: float) -> bool:
    """Whether motor and drive move a table or roller with this inertia (kg·m²)."""
    machine = Machine(_plant(replace(p, inertia=inertia), drive, drive.cycle_time["velocity"]),
                      {"x": drive})  # fmt: skip
    try:
        _commission(machine, replace(p, inertia=inertia), True)
    except Unmovable:
        return False
    return True


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
        )  # fmt: skip
    return compiled(spec)


def _commission(machine: Machine, p: RotaryParameters, tuned: bool) -> None:
    x = machine.drives["x"]
    if x.model.quirk("inverter"):
        return  # its motor and its ramps are parameters of its own
    x.commission(motor_and_encoder(p, x))
    commission_joint(
        machine, "x", max_velocity=p.max_velocity, max_acceleration=p.max_acceleration,
        position_unit=p.unit, tuned=tuned,
    )  # fmt: skip
    x.commission(
        {
            "min_position_range_limit": 0,
            "max_position_range_limit": round(p.period / p.unit),
            "homing_method": 23,
            "home_offset": 0,
        }
    )
    if tuned:
        return
    coupling = machine.couplings[0]
    place = machine.model, machine.data, int(coupling.dof), float(coupling.gear)
    tune(x, inertia_at_shaft(*place), inertia_of_motor_side(*place))
