"""Parameters of axes without ends: rotary tables and conveyors, with a family to choose from."""

import math
from dataclasses import dataclass

from ..engine.checks import check_fields, ranged
from .motor import MotorParameters
from .transmission import refuse_without_spring

MILLIDEGREE = math.radians(1e-3)
MICROMETRE = 1e-6


@dataclass(frozen=True)
class RotaryParameters(MotorParameters):
    """Parameters of one axis without ends, at the table or roller unless marked otherwise.

    The `efficiency` of the gear is a friction proportional to its load. The `circumference` is the
    travel of the belt per revolution of its roller; after the `pitch` the position of a conveyor
    repeats.

    Raises ValueError with field, value, range and unit.
    """

    inertia: float = ranged(0.5, 1e-6, 1e4, "kg·m²")  # of the load, rotating or carried
    gear_ratio: float = ranged(50.0, 0.1, 1e4, "motor revolutions per revolution")
    circumference: float = ranged(0.0, 0.0, 10.0, "m per revolution, 0 for a table")
    pitch: float = ranged(0.0, 0.0, 10.0, "m, 0 for the circumference")  # of a conveyor
    rotor_inertia: float | None = ranged(None, 0.0, 1.0, "kg·m²")  # None: of the drive model
    coulomb_friction: float = ranged(5.0, 0.0, 1e4, "Nm")
    viscous_friction: float = ranged(2.0, 0.0, 1e4, "Nm·s/rad")
    efficiency: float = ranged(1.0, 0.1, 1.0, "share")  # of the gear
    transmission_stiffness: float = ranged(0.0, 0.0, 1e8, "Nm/rad")  # torsion of the gear; 0: rigid
    transmission_damping: float = ranged(0.0, 0.0, 1e6, "Nm·s/rad")
    backlash: float = ranged(0.0, 0.0, 0.1, "rad")  # whole gap
    load_encoder: bool = False  # the position is measured at the table: dual-loop control
    max_velocity: float = ranged(3.0, 1e-3, 1e3, "rad/s")  # profile velocity
    max_acceleration: float = ranged(20.0, 1e-2, 1e5, "rad/s²")  # of the profile

    def __post_init__(self) -> None:
        check_fields(self)
        refuse_without_spring(self, "rad", "Nm/rad")
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
        """Angle after which positions and switches repeat (rad)."""
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
