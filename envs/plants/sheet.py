"""The sizing of an axis on one sheet: the abilities of its motor, and the margins of its loops."""

import math
from dataclasses import dataclass

import numpy as np

from ..engine.machine import Machine
from .gantry import PAIR
from .loops import Gains, Margin, gains_of
from .shaft import plant_at_shaft
from .sizing import FAST, PEAK, Load, Motor, load_of, motor_of


@dataclass(frozen=True)
class Sizing:
    """Sizing of one commissioned drive, in units at the joint unless stated otherwise."""

    drive: str
    model: str
    unit: str  # of the joint
    gear: float  # rad of the motor per m or rad
    motor: Motor
    load: Load
    inertia_ratio: float  # inertia of the load over that of the motor, infinite if that is 0
    velocity: float  # m/s or rad/s, of the profile
    acceleration: float  # m/s² or rad/s²
    highest_velocity: float  # that this motor allows
    highest_acceleration: float
    resonances: tuple[tuple[float, float], ...]  # antiresonance and resonance (Hz)
    gains: Gains
    crossover: float  # Hz, of the velocity loop
    velocity_margins: Margin
    position_margins: Margin

    @property
    def peak_share(self) -> float:
        """Share of the peak torque at the profile velocity that the profile acceleration needs."""
        speed, rate = self.velocity * self.gear, self.acceleration * self.gear
        return self.load.peak(rate, speed) / self.motor.torque(speed)

    @property
    def continuous_share(self) -> float:
        """Share of the rated torque at the profile velocity."""
        return self.load.continuous(self.velocity * self.gear) / self.motor.rated

    @property
    def row(self) -> dict[str, str]:
        """Figures as texts, for a table."""
        vibrates = ", ".join(f"{a:.3g}/{r:.3g}" for a, r in self.resonances)
        ratio = f"{self.inertia_ratio:.3g}" if math.isfinite(self.inertia_ratio) else "-"
        return {
            "inertia ratio": ratio,
            "peak torque": f"{self.peak_share:.0%}",
            "continuous torque": f"{self.continuous_share:.0%}",
            "resonance (Hz)": vibrates or "-",
            "crossover (Hz)": f"{self.crossover:.3g}",
            "velocity loop": _margin(self.velocity_margins),
            "position loop": _margin(self.position_margins),
            f"profile ({self.unit}/s, {self.unit}/s²)":
                f"{self.velocity:.3g}, {self.acceleration:.3g}",
            "this motor allows": f"{self.highest_velocity:.3g}, {self.highest_acceleration:.3g}",
        }

    def __str__(self) -> str:
        lines = [f"drive {self.drive} ({self.model}): {self.motor}; {self.gains}"]
        return "\n".join([*lines, *(f"{name:28}{value}" for name, value in self.row.items())])


def _margin(of: Margin) -> str:
    gain, phase, stable = of
    return f"{gain:.1f} dB, {phase:.0f}°" if stable else "unstable"


def size(machine: Machine, name: str | None = None) -> Sizing:
    """Return the sizing of one drive at the present position of its machine.

    A machine that has not run yet makes one step.

    Args:
        machine: a commissioned machine.
        name: name of the drive; by default the first one.

    Raises:
        ValueError: no such drive, or one without a position controller.
    """
    name = next(iter(machine.drives)) if name is None else name
    if name not in machine.drives:
        raise ValueError(f"there is no drive {name!r}: {', '.join(machine.drives)}")
    drive = machine.drives[name]
    if not drive.model.positions:
        raise ValueError(
            f"drive {name!r} ({drive.model.name}) is an inverter without a position controller: "
            "choose a servo drive, see `servogym drives`"
        )
    beam = PAIR if name in PAIR and all(x in machine.drives for x in PAIR) else (name,)
    plant = plant_at_shaft(machine, dict.fromkeys(beam, 1.0))
    gear, unit = machine.joint(name)
    gear = abs(gear)
    inertia = plant_at_shaft(machine, dict.fromkeys(beam, 1.0), pushes=0.0).inertia
    motor, load, gains = motor_of(drive), load_of(machine, name, inertia), gains_of(drive)
    dof = int(machine.coupling(name).dof)
    own = float(machine.model.dof_armature[dof]) / gear**2
    if not drive.axis.cycle_count:
        machine.step()  # after which the units of the drive are valid
    speed, rate = float(drive.axis.profile_speed), float(drive.axis.acceleration)
    velocity, position = plant.margins(gains)
    return Sizing(
        drive=name, model=drive.model.name, unit=unit, gear=gear, motor=motor, load=load,
        inertia_ratio=(inertia - own) / own if own > 0.0 else np.inf,
        velocity=speed / gear, acceleration=rate / gear, highest_velocity=FAST * motor.speed / gear,
        highest_acceleration=load.acceleration(PEAK * motor.torque(speed), speed) / gear,
        resonances=plant.resonances, gains=gains, crossover=plant.crossover(gains),
        velocity_margins=velocity, position_margins=position,
    )
