"""Parameters of axes without ends: rotary tables and conveyors, with a family to choose from."""

import math
from dataclasses import dataclass, fields

from ..engine.checks import in_range
from .axis_parameters import RANGES as RANGES_OF_AXES
from .motor import ELECTRICAL

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
