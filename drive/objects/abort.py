"""SDO abort codes of CiA 301, and the exception that carries one to Python code."""

from enum import IntEnum


class Abort(IntEnum):
    """CiA 301, SDO abort transfer."""

    NONE = 0
    STORED = 1  # not a code of CiA 301: the side effect has done all there was to do
    TOGGLE_BIT = 0x05030000
    TIME_OUT = 0x05040000
    COMMAND_SPECIFIER = 0x05040001
    BLOCK_SIZE = 0x05040002
    SEQUENCE_NUMBER = 0x05040003
    CRC = 0x05040004
    MEMORY = 0x05040005
    UNSUPPORTED_ACCESS = 0x06010000
    WRITE_ONLY = 0x06010001
    READ_ONLY = 0x06010002
    NO_OBJECT = 0x06020000
    NOT_MAPPABLE = 0x06040041
    PDO_LENGTH = 0x06040042
    PARAMETER_INCOMPATIBLE = 0x06040043
    INTERNAL_INCOMPATIBLE = 0x06040047
    HARDWARE = 0x06060000
    LENGTH = 0x06070010
    LENGTH_TOO_HIGH = 0x06070012
    LENGTH_TOO_LOW = 0x06070013
    NO_SUBINDEX = 0x06090011
    INVALID_VALUE = 0x06090030
    VALUE_TOO_HIGH = 0x06090031
    VALUE_TOO_LOW = 0x06090032
    MAXIMUM_BELOW_MINIMUM = 0x06090036
    GENERAL = 0x08000000
    NOT_TRANSFERABLE = 0x08000020
    LOCAL_CONTROL = 0x08000021
    DEVICE_STATE = 0x08000022
    NO_DATA = 0x08000024


TEXT = {
    Abort.TOGGLE_BIT: "toggle bit not alternated",
    Abort.TIME_OUT: "SDO protocol timed out",
    Abort.COMMAND_SPECIFIER: "command specifier not valid or unknown",
    Abort.BLOCK_SIZE: "invalid block size",
    Abort.SEQUENCE_NUMBER: "invalid sequence number",
    Abort.CRC: "CRC error",
    Abort.MEMORY: "out of memory",
    Abort.UNSUPPORTED_ACCESS: "unsupported access to an object",
    Abort.WRITE_ONLY: "attempt to read a write-only object",
    Abort.READ_ONLY: "attempt to write a read-only object",
    Abort.NO_OBJECT: "object does not exist in the object dictionary",
    Abort.NOT_MAPPABLE: "object cannot be mapped to the PDO",
    Abort.PDO_LENGTH: "mapped objects would exceed the PDO length",
    Abort.PARAMETER_INCOMPATIBLE: "general parameter incompatibility",
    Abort.INTERNAL_INCOMPATIBLE: "general internal incompatibility",
    Abort.HARDWARE: "access failed due to a hardware error",
    Abort.LENGTH: "data type or length does not match",
    Abort.LENGTH_TOO_HIGH: "length of the parameter too high",
    Abort.LENGTH_TOO_LOW: "length of the parameter too low",
    Abort.NO_SUBINDEX: "sub-index does not exist",
    Abort.INVALID_VALUE: "invalid value for the parameter",
    Abort.VALUE_TOO_HIGH: "value of the parameter too high",
    Abort.VALUE_TOO_LOW: "value of the parameter too low",
    Abort.MAXIMUM_BELOW_MINIMUM: "maximum is less than minimum",
    Abort.GENERAL: "general error",
    Abort.NOT_TRANSFERABLE: "data cannot be transferred or stored",
    Abort.LOCAL_CONTROL: "data cannot be transferred because of local control",
    Abort.DEVICE_STATE: "data cannot be transferred in the present device state",
    Abort.NO_DATA: "no data available",
}


class SdoAbort(Exception):
    """An object access the drive refused; `code` is what it would answer on the bus."""

    def __init__(self, code: int, index: int, subindex: int, hint: str = ""):
        text = TEXT.get(code, "unknown abort code")  # type: ignore[call-overload]
        where = f"{index:04X}h:{subindex:02X}h"
        super().__init__(f"{where}: {text} ({code:08X}h){'; ' + hint if hint else ''}")
        self.code = Abort(code) if code in TEXT else code  # a drive may have codes of its own
        self.index = index
        self.subindex = subindex

    def __reduce__(self):
        return SdoAbort, (int(self.code), self.index, self.subindex)
