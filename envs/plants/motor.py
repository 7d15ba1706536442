"""The motor of an axis: its rated data, and its winding and thermal model."""

from dataclasses import dataclass
from typing import Any

from ...drive.drive import Drive
from ..engine.checks import ranged

# a 400 W servo motor: mA, mNm, per mille
MOTOR = {
    "motor_rated_current": 2500,
    "motor_rated_torque": 1270,
    "max_current": 3000,
    "max_torque": 3000,
}
WINDING_LOSS = 45.0  # W, its copper loss at rated torque (inferred)
ELECTRICAL_TIME = 4e-3  # s, inductance over resistance, usual for servo motors (inferred)
# parameter of a plant: field of the drive, and its number of units per SI unit
ELECTRICAL = {
    "dc_link_voltage": ("supply_voltage", 1e3),
    "motor_torque_constant": ("motor_torque_constant", 1e6),
    "motor_voltage_constant": ("motor_voltage_constant", 1e6),
    "motor_resistance": ("motor_resistance", 1e6),
    "motor_inductance": ("motor_inductance", 1e9),
    "supply_resistance": ("supply_resistance", 1e6),
}
THERMAL = {
    "motor_winding_loss": 1e3, "motor_thermal_resistance": 1e3, "motor_thermal_time": 1,
    "motor_temperature_limit": 10,
}
LINK = {"undervoltage": 200, "chopper_voltage": 390, "overvoltage": 430}  # V, of one of 325 V


@dataclass(frozen=True)
class MotorParameters:
    """Parameters of the motor of any axis; None stands for the value of the drive model.

    A motor is modelled as a DC motor on the DC link, which sags with the resistance of its supply,
    and as one thermal mass. Without a voltage constant, the torque constant is used (both in SI).
    The inductance over the resistance is the electrical time constant. With a resistance of 0, the
    voltage does not limit the torque. A temperature above the limit is a fault; a limit of 0
    disables it.
    """

    speed_torque_curve: bool = False  # values not given below follow from rated data (inferred)
    dc_link_voltage: float | None = ranged(None, 1.0, 2000.0, "V")
    motor_torque_constant: float | None = ranged(None, 1e-6, 4000.0, "Nm/A")
    motor_voltage_constant: float | None = ranged(None, 1e-6, 4000.0, "V·s/rad")
    motor_resistance: float | None = ranged(None, 0.0, 4000.0, "Ohm")  # 0: limits no torque
    motor_inductance: float | None = ranged(None, 0.0, 4.0, "H")
    supply_resistance: float | None = ranged(None, 0.0, 4000.0, "Ohm")  # before the DC link
    motor_winding_loss: float | None = ranged(None, 0.0, 1e5, "W")  # copper loss at rated torque
    motor_thermal_resistance: float | None = ranged(None, 0.0, 1e3, "K/W")  # winding to ambient
    motor_thermal_time: float | None = ranged(None, 1.0, 65535.0, "s")
    motor_temperature_limit: float | None = ranged(None, 0.0, 300.0, "degC")


def rated_winding(rated_torque: float, rated_current: float, loss: float) -> dict[str, float]:
    """Torque constant (Nm/A), resistance (Ohm) and inductance (H) from rated data (inferred).

    Args:
        rated_torque: Nm.
        rated_current: A, of the equivalent DC motor.
        loss: W, copper loss at rated torque.
    """
    resistance = loss / rated_current**2
    return {
        "motor_torque_constant": rated_torque / rated_current,
        "motor_resistance": resistance,
        "motor_inductance": ELECTRICAL_TIME * resistance,
    }


def motor_and_encoder(p: Any, drive: Drive) -> dict[str, float]:
    """Fields of the drive for the winding, the thermal model and the position source, if given."""
    given = {name: getattr(p, name) for name in (*ELECTRICAL, *THERMAL)}
    if p.speed_torque_curve:
        od = drive.axis.od
        loss = given["motor_winding_loss"]
        inferred = rated_winding(
            float(od.motor_rated_torque) * 1e-3, float(od.motor_rated_current) * 1e-3,
            loss or float(od.motor_winding_loss) * 1e-3 or WINDING_LOSS,
        )
        given |= {name: value for name, value in inferred.items() if given[name] is None}
    values: dict[str, float] = {}
    for name, value in given.items():
        if value is not None:
            field, scale = ELECTRICAL.get(name, (name, 0.0))
            values[field] = value * (scale or THERMAL[name])
    if (voltage := given["dc_link_voltage"]) is not None:
        values |= _link(voltage)
    return values | ({"position_source": 1} if p.load_encoder else {})


def _link(voltage: float) -> dict[str, float]:
    """Limits of a DC link (mV) at another voltage (V), in proportion to those at 325 V."""
    return {name: limit * voltage / 325.0 * 1e3 for name, limit in LINK.items()}
