"""Who commands drives: one master for every bus, written against objects and statuswords alone.

A `Port` moves the objects and lets time pass: in memory `servogym.envs.masters.port.MachinePort`,
on CANopen `servogym.drive.canopen.remote.CanOpenPort`. The room stands below the buses, so that
their ports can use its errors, and knows none of them.
"""

from .errors import (
    BusError,
    DriveFault,
    HomingFailed,
    Interlock,
    NoPower,
    Refused,
    ServoError,
    Timeout,
)
from .master import Master
from .port import Port, Units

__all__ = [
    "BusError", "DriveFault", "HomingFailed", "Interlock", "Master", "NoPower", "Port", "Refused",
    "ServoError", "Timeout", "Units",
]  # fmt: skip
