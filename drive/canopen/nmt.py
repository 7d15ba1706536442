"""NMT: states, commands, and the services of each state (CiA 301, NMT state machine)."""

from enum import IntEnum, IntFlag, auto


class NmtState(IntEnum):
    """NMT states with their values in heartbeat and node guarding."""

    INITIALISING = 0
    STOPPED = 4
    OPERATIONAL = 5
    PRE_OPERATIONAL = 127


class NmtCommand(IntEnum):
    """NMT node control commands."""

    START = 1
    STOP = 2
    ENTER_PRE_OPERATIONAL = 128
    RESET_NODE = 129
    RESET_COMMUNICATION = 130


TARGET = {
    NmtCommand.START: NmtState.OPERATIONAL,
    NmtCommand.STOP: NmtState.STOPPED,
    NmtCommand.ENTER_PRE_OPERATIONAL: NmtState.PRE_OPERATIONAL,
}


class Service(IntFlag):
    """Communication services of a node."""

    LSS = auto()
    NMT = auto()
    ERROR_CONTROL = auto()
    SDO = auto()
    SYNC = auto()
    TIME = auto()
    EMCY = auto()
    PDO = auto()


_ALWAYS = Service.LSS | Service.NMT | Service.ERROR_CONTROL
_CONFIGURABLE = _ALWAYS | Service.SDO | Service.SYNC | Service.TIME | Service.EMCY

# CiA 301, NMT states and communication objects; LSS in every state (inferred)
LIVE = {
    NmtState.INITIALISING: Service.LSS,
    NmtState.STOPPED: _ALWAYS,
    NmtState.PRE_OPERATIONAL: _CONFIGURABLE,
    NmtState.OPERATIONAL: _CONFIGURABLE | Service.PDO,
}
