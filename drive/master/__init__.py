"""The master: it commands drives on any bus through objects and statuswords alone.

A `Port` transfers the objects and lets time pass: `servogym.envs.masters.port.MachinePort` in
memory, `servogym.drive.canopen.remote.CanOpenPort` on CANopen. This package depends on no bus, so
that the ports of all buses can raise its errors.
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
]
