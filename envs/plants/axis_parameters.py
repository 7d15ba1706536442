"""Parameters of a linear axis, and the family: presets by the kind of mechanics.

Values marked `inferred` have the size that catalogues give for axes of this class; they are not
those of a product.
"""

from dataclasses import dataclass, replace

from ...drive.model.names import hint
from ..engine.checks import changed, check_fields, ranged
from .motor import MotorParameters
from .transmission import refuse_without_spring

HEAVIEST = 100.0  # kg, payload


@dataclass(frozen=True)
class Joints:
    """Data of the joints of any robot, drive by drive; all other data is in their drives."""

    ranges: tuple[float, ...]  # half of each (rad or m), pi without limits


@dataclass(frozen=True)
class LinearAxisParameters(MotorParameters):
    """Parameters of one linear axis. Raises ValueError with field, value, range and unit.

    An effect is off if its parameter is 0; `static_friction` also if it equals the Coulomb
    friction. With a `transmission_stiffness` the carriage moves against the motor side: the drive
    measures the motor, while friction, end stops and switches act on the carriage. The `efficiency`
    of the gear is a friction proportional to its load. `transmission_inertia` is that of pulleys,
    coupling and spindle. Orders of 24 belong to the cogging of 12 slots with 8 poles and to the
    ripple of 4 pole pairs. At the `stribeck_velocity` the friction has fallen by 63 % (inferred).
    The switches are shifted to the right by `switch_offset` and scatter with a standard deviation
    of `switch_scatter`.
    """

    payload: float = ranged(5.0, 0.0, HEAVIEST, "kg")  # on the carriage
    carriage_mass: float = ranged(1.5, 1e-3, 100.0, "kg")
    feed_constant: float = ranged(0.06, 1e-5, 1.0, "m per motor revolution")
    rotor_inertia: float | None = ranged(None, 0.0, 1.0, "kg·m²")  # None: of the drive model
    transmission_inertia: float = ranged(0.0, 0.0, 1.0, "kg·m² at the shaft")
    coulomb_friction: float = ranged(12.0, 0.0, 1e5, "N")
    static_friction: float = ranged(0.0, 0.0, 1e5, "N")  # 0, or not below Coulomb's
    stribeck_velocity: float = ranged(0.01, 1e-4, 1.0, "m/s")
    viscous_friction: float = ranged(20.0, 0.0, 1e6, "N·s/m")
    chain_drag: float = ranged(0.0, 0.0, 100.0, "N")  # of a cable chain
    chain_drag_growth: float = ranged(0.0, 0.0, 1000.0, "N per m of travel")  # from the left
    cogging_torque: float = ranged(0.0, 0.0, 10.0, "Nm at the shaft")  # amplitude
    cogging_order: float = ranged(24.0, 0.0, 1000.0, "periods per motor revolution")
    torque_ripple: float = ranged(0.0, 0.0, 0.5, "share of the motor torque")  # amplitude
    ripple_order: float = ranged(24.0, 0.0, 1000.0, "periods per motor revolution")
    max_velocity: float = ranged(1.0, 1e-3, 10.0, "m/s")  # profile velocity
    max_acceleration: float = ranged(10.0, 1e-2, 200.0, "m/s²")  # of the profile
    max_jerk: float = ranged(1000.0, 1.0, 4000.0, "m/s³")  # profile jerk
    stiffness: float = ranged(0.0, 0.0, 1e8, "N/m")  # between carriage and payload; 0: rigid
    structural_damping: float = ranged(0.0, 0.0, 1e5, "N·s/m")  # between carriage and payload
    transmission_stiffness: float = ranged(0.0, 0.0, 1e9, "N/m")  # to the carriage; 0: rigid
    transmission_damping: float = ranged(0.0, 0.0, 1e6, "N·s/m")  # between motor side and carriage
    backlash: float = ranged(0.0, 0.0, 0.01, "m")  # whole gap between motor side and carriage
    efficiency: float = ranged(1.0, 0.1, 1.0, "share")  # of a gear at the motor
    load_encoder: bool = False  # the position is measured at the carriage: dual-loop control
    home_switch: float = ranged(0.2, 0.0, 0.47, "m")  # its left edge; 30 mm long
    switch_offset: float = ranged(0.0, -0.01, 0.01, "m")
    switch_scatter: float = ranged(0.0, 0.0, 0.01, "m")
    inclination: float = ranged(0.0, -90.0, 90.0, "degree")  # 90: vertical, upwards
    brake_torque: float = ranged(0.0, 0.0, 100.0, "Nm")  # at the shaft, holding; 0: none

    def __post_init__(self) -> None:
        check_fields(self)
        if self.static_friction and not 0.0 < self.coulomb_friction <= self.static_friction:
            raise ValueError(
                f"static_friction = {self.static_friction:g} N needs a coulomb_friction above "
                f"0 and not above it, which is {self.coulomb_friction:g} N; 0 is off"
            )
        refuse_without_spring(self, "m", "N/m")


# 16 mm belt, both spans in parallel, at the middle of the stroke: Gates, Synchroflex: specific
# stiffness of AT5 with steel tension members about 1e5 N per unit strain and spans of 0.5 m:
# 4e5 N/m (inferred). Damping ratio 2 %, pulleys 0.1e-4 kg·m², repeatability of a proximity switch
# 20 µm (inferred).
TOOTHED_BELT = LinearAxisParameters(
    transmission_inertia=0.1e-4,
    transmission_stiffness=4e5,
    transmission_damping=25.0,
    static_friction=16.0,
    chain_drag=2.0,
    chain_drag_growth=3.0,
    cogging_torque=0.013,  # 1 % of the rated torque, a usual limit for servo motors (inferred)
    switch_scatter=20e-6,
)
# 16 x 10 mm ball screw, 0.65 m long: E A / L = 2.1e11 · 1.5e-4 / 0.65 = 48 N/µm, in series with
# nut and bearings of about 80 N/µm: 30 N/µm. The home switch is mounted half a pitch beside the
# index pulses, as the limit switches are. Rolled, ISO 3408 T7, without preload: axial play
# 20 µm. Inertia of the steel spindle: pi/32 · 7850 · 0.65 · 0.016⁴ = 0.33e-4 kg·m² (inferred).
BALL_SCREW = LinearAxisParameters(
    feed_constant=0.01,
    transmission_inertia=0.33e-4,
    transmission_stiffness=3e7,
    transmission_damping=450.0,
    backlash=20e-6,
    home_switch=0.205,
    coulomb_friction=40.0,
    static_friction=50.0,
    viscous_friction=150.0,
    chain_drag=2.0,
    chain_drag_growth=3.0,
    cogging_torque=0.013,
    switch_scatter=20e-6,
    max_velocity=0.4,
    max_acceleration=5.0,
)
# Iron core, pole pair 30 mm: a "revolution" of the drive is a pole pair. The moving coil rides on
# the carriage. Cogging 1.5 N amplitude per 100 N of rated force, twice a pole pair (inferred).
LINEAR_MOTOR = LinearAxisParameters(
    feed_constant=0.03,
    carriage_mass=3.5,
    rotor_inertia=0.0,
    coulomb_friction=8.0,
    static_friction=10.0,
    viscous_friction=10.0,
    chain_drag=3.0,
    chain_drag_growth=4.0,
    cogging_torque=0.02,
    cogging_order=2.0,
    torque_ripple=0.01,
    ripple_order=6.0,
    max_velocity=2.0,
    max_acceleration=20.0,
    switch_scatter=20e-6,
)
# The load hangs on one flank of the screw. A brake of 1.3 Nm is usual for a motor of 400 W.
VERTICAL = replace(BALL_SCREW, inclination=90.0, brake_torque=1.3, chain_drag_growth=8.0)
# Rack of 5 mm metric pitch, pinion of 25 teeth, planetary gear 5:1: 25 mm a motor revolution.
# Torsion of the gear 5 Nm/arcmin over the radius of 20 mm is 4e7 N/m, in series with the teeth
# about 2e7; backlash of 3 arcmin, 17 µm, and of the teeth; efficiency of one planetary stage.
# Motor: winding of class F, shut down at 140 °C. There is an index pulse at 200 mm, so the home
# switch is half a turn beside it (inferred).
RACK_PINION = LinearAxisParameters(
    feed_constant=0.025,
    transmission_inertia=0.3e-4,
    transmission_stiffness=2e7,
    transmission_damping=450.0,
    backlash=40e-6,
    efficiency=0.95,
    home_switch=0.2125,
    coulomb_friction=30.0,
    static_friction=36.0,
    viscous_friction=60.0,
    chain_drag=2.0,
    chain_drag_growth=3.0,
    cogging_torque=0.013,
    switch_scatter=20e-6,
    max_acceleration=8.0,
    motor_winding_loss=60.0,
    motor_thermal_resistance=1.5,
    motor_thermal_time=1200.0,
    motor_temperature_limit=140.0,
)
# A scale at the carriage compensates the compliance of the spindle, but not backlash: the nut is
# preloaded and has more friction (inferred).
SCALE = replace(
    BALL_SCREW, load_encoder=True, backlash=0.0, coulomb_friction=55, static_friction=65
)

FAMILY = {
    "rigid": LinearAxisParameters(),
    "toothed_belt": TOOTHED_BELT,
    "ball_screw": BALL_SCREW,
    "linear_motor": LINEAR_MOTOR,
    "vertical": VERTICAL,
    "rack_pinion": RACK_PINION,
    "ball_screw_scale": SCALE,
}


def family(mechanics: str, **values: float | None) -> LinearAxisParameters:
    """Return the preset `mechanics` of the family with `values` instead of its own.

    Raises:
        ValueError: an unknown name, or a parameter out of range.
    """
    if mechanics not in FAMILY:
        raise ValueError(f"mechanics = {mechanics!r} is unknown: {hint(str(mechanics), FAMILY)}")
    return changed(FAMILY[mechanics], values, "a linear axis")


def chosen(parameters: LinearAxisParameters | str | None, payload: float) -> LinearAxisParameters:
    """Return parameters, given directly or by the name of a preset; None: rigid with `payload`."""
    if parameters is None:
        return LinearAxisParameters(payload=payload)
    if isinstance(parameters, str):
        return family(parameters)
    if not isinstance(parameters, LinearAxisParameters):
        raise ValueError(
            f"parameters = {parameters!r}: give LinearAxisParameters(...), or the name of a "
            f"preset: {', '.join(FAMILY)}"
        )
    return parameters
