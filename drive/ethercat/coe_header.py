"""The two bytes before each CoE service: number and service (ETG.1000.6, table 27)."""

import struct
from enum import IntEnum


class Service(IntEnum):
    """Service of a CoE telegram: ETG.1000.6, table 27."""

    EMERGENCY = 1
    SDO_REQUEST = 2
    SDO_RESPONSE = 3
    TPDO = 4
    RPDO = 5
    TPDO_REQUEST = 6
    RPDO_REQUEST = 7
    SDO_INFORMATION = 8


def header(service: Service) -> bytes:
    """The two bytes before a service."""
    return struct.pack("<H", service << 12)
