"""The registers of a slave controller as one table.

Sources: ETG.1000.4 (data link layer registers) and the ESC data sheet of the ET1100, section II
(register description; the last column names its group). A byte without a row is reserved: it is
neither read nor written, and a datagram that addresses only such bytes does not count.
"""

from enum import IntEnum
from typing import NamedTuple

import numpy as np

from .record import FMMUS, REGISTERS, SYNC_MANAGERS


class R(IntEnum):
    """Addresses of the registers that the code names."""

    TYPE = 0x0000
    FMMUS_SUPPORTED = 0x0004
    SYNC_MANAGERS_SUPPORTED = 0x0005
    FEATURES = 0x0008
    STATION_ADDRESS = 0x0010
    STATION_ALIAS = 0x0012
    LOOP_CONTROL = 0x0101
    ALIAS_ENABLE = 0x0103
    DL_STATUS = 0x0110
    AL_CONTROL = 0x0120
    AL_STATUS = 0x0130
    AL_STATUS_CODE = 0x0134
    PDI_CONTROL = 0x0140
    ECAT_EVENT_MASK = 0x0200
    ECAT_EVENT = 0x0210
    AL_EVENT = 0x0220
    RX_ERRORS = 0x0300
    PROCESSING_ERRORS = 0x030C
    PDI_ERRORS = 0x030D
    LOST_LINKS = 0x0310
    WATCHDOG_DIVIDER = 0x0400
    WATCHDOG_TIME = 0x0420
    WATCHDOG_STATUS = 0x0440
    WATCHDOG_COUNTER = 0x0442
    EEPROM_CONFIGURATION = 0x0500
    EEPROM_CONTROL = 0x0502
    EEPROM_ADDRESS = 0x0504
    EEPROM_DATA = 0x0508
    FMMU = 0x0600
    SYNC_MANAGER = 0x0800
    RECEIVE_TIME = 0x0900
    SYSTEM_TIME = 0x0910
    RECEIVE_TIME_UNIT = 0x0918
    SYSTEM_TIME_OFFSET = 0x0920
    SYSTEM_TIME_DELAY = 0x0928
    SYSTEM_TIME_DIFFERENCE = 0x092C
    SPEED_COUNTER_START = 0x0930
    SPEED_COUNTER_DIFFERENCE = 0x0932
    DIFFERENCE_FILTER = 0x0934
    SPEED_FILTER = 0x0935
    ACTIVATION = 0x0981
    PULSE_LENGTH = 0x0982
    ACTIVATION_STATUS = 0x0984
    SYNC0_STATUS = 0x098E
    SYNC1_STATUS = 0x098F
    START_TIME = 0x0990
    NEXT_SYNC1 = 0x0998
    SYNC0_CYCLE = 0x09A0
    SYNC1_CYCLE = 0x09A4
    LATCH_CONTROL = 0x09A8
    LATCH_STATUS = 0x09AE
    LATCH_TIME = 0x09B0


# bytes of a sync manager
MAILBOX = 0x02  # control (+4): one buffer with handshake
FULL = 0x08  # status (+5) of a mailbox
WRITTEN, READ = 0x01, 0x02  # status (+5): interrupts
REPEAT = 0x02  # activation (+6) and PDI control (+7): repeat request and its acknowledge


class Effect(IntEnum):
    """Effect of a write from EtherCAT beyond the register's value."""

    NONE = 0
    AL_CONTROL = 1
    EEPROM = 2
    SYNC_MANAGER = 3
    FMMU = 4
    CLEAR_RX_ERRORS = 5
    CLEAR_PROCESSING_ERRORS = 6
    CLEAR_PDI_ERRORS = 7
    CLEAR_LOST_LINKS = 8
    CLEAR_WATCHDOG_COUNTERS = 9
    WATCHDOG = 10
    RECEIVE_TIME = 11
    SYSTEM_TIME = 12
    RESET_DRIFT = 13
    SYNC = 14
    PORTS = 15
    EEPROM_ACCESS = 16
    OFFSET = 17


class Register(NamedTuple):
    """One row; `writable` masks the bits of each byte that EtherCAT may write."""

    address: int
    length: int
    name: str
    reset: int
    writable: int
    effect: Effect
    group: str


E = Effect
ALL = 0xFF
_FMMU_ROW = bytes([255] * 4 + [255, 255, 7, 7, 255, 255, 7, 3, 1])  # writable bits of 13 bytes
_SM_ROW = bytes([255] * 4 + [0x7F, 0, 0xC3, 0])

REGISTERS_TABLE = (
    Register(0x0000, 1, "type", 0x11, 0, E.NONE, "ESC information"),
    Register(0x0001, 1, "revision", 0x00, 0, E.NONE, "ESC information"),
    Register(0x0002, 2, "build", 0x0003, 0, E.NONE, "ESC information"),
    Register(0x0004, 1, "FMMUs supported", FMMUS, 0, E.NONE, "ESC information"),
    Register(0x0005, 1, "sync managers supported", 8, 0, E.NONE, "ESC information"),
    Register(0x0006, 1, "RAM size (KiB)", 8, 0, E.NONE, "ESC information"),
    Register(0x0007, 1, "port descriptor", 0x0F, 0, E.NONE, "ESC information"),
    Register(0x0008, 2, "features supported", 0x00FC, 0, E.NONE, "ESC information"),
    Register(0x0010, 2, "configured station address", 0, ALL, E.NONE, "station address"),
    Register(0x0012, 2, "configured station alias", 0, 0, E.NONE, "station address"),
    Register(0x0020, 1, "write register enable", 0, 0x01, E.NONE, "write protection"),
    Register(0x0021, 1, "write register protection", 0, 0x01, E.NONE, "write protection"),
    Register(0x0030, 1, "ESC write enable", 0, 0x01, E.NONE, "write protection"),
    Register(0x0031, 1, "ESC write protection", 0, 0x01, E.NONE, "write protection"),
    Register(0x0040, 1, "ESC reset ECAT", 0, ALL, E.NONE, "data link layer"),
    Register(0x0100, 1, "DL control: forwarding", 0x01, 0x03, E.NONE, "data link layer"),
    Register(0x0101, 1, "DL control: loops of the ports", 0x00, ALL, E.PORTS, "data link layer"),
    Register(0x0102, 1, "DL control: RX FIFO", 0x07, 0x0F, E.NONE, "data link layer"),
    Register(0x0103, 1, "DL control: station alias", 0x00, 0x01, E.NONE, "data link layer"),
    Register(0x0108, 2, "physical read/write offset", 0, ALL, E.NONE, "data link layer"),
    Register(0x0110, 2, "DL status", 0x0002, 0, E.NONE, "data link layer"),
    Register(0x0120, 2, "AL control", 0x0001, ALL, E.AL_CONTROL, "application layer"),
    Register(0x0130, 2, "AL status", 0x0001, 0, E.NONE, "application layer"),
    Register(0x0134, 2, "AL status code", 0, 0, E.NONE, "application layer"),
    Register(0x0138, 1, "RUN LED override", 0, 0x1F, E.NONE, "application layer"),
    Register(0x0139, 1, "ERR LED override", 0, 0x1F, E.NONE, "application layer"),
    Register(0x0140, 2, "PDI control", 0, 0, E.NONE, "PDI"),
    Register(0x014E, 2, "PDI information", 0, 0, E.NONE, "PDI"),
    Register(0x0150, 4, "PDI configuration", 0, 0, E.NONE, "PDI"),
    Register(0x0200, 2, "ECAT event mask", 0, ALL, E.NONE, "interrupts"),
    Register(0x0204, 4, "AL event mask", 0x00FFFF0F, 0, E.NONE, "interrupts"),
    Register(0x0210, 2, "ECAT event request", 0, 0, E.NONE, "interrupts"),
    Register(0x0220, 4, "AL event request", 0, 0, E.NONE, "interrupts"),
    Register(0x0300, 8, "RX error counters", 0, 0, E.CLEAR_RX_ERRORS, "error counters"),
    Register(0x0308, 4, "forwarded RX errors", 0, 0, E.CLEAR_RX_ERRORS, "error counters"),
    Register(0x030C, 1, "ECAT processing unit errors", 0, 0, E.CLEAR_PROCESSING_ERRORS,
             "error counters"),
    Register(0x030D, 1, "PDI errors", 0, 0, E.CLEAR_PDI_ERRORS, "error counters"),
    Register(0x0310, 4, "lost links", 0, 0, E.CLEAR_LOST_LINKS, "error counters"),
    Register(0x0400, 2, "watchdog divider", 0x09C2, ALL, E.WATCHDOG, "watchdogs"),
    Register(0x0410, 2, "watchdog time PDI", 0x03E8, ALL, E.WATCHDOG, "watchdogs"),
    Register(0x0420, 2, "watchdog time process data", 0x03E8, ALL, E.WATCHDOG, "watchdogs"),
    Register(0x0440, 2, "watchdog status process data", 0x0001, 0, E.NONE, "watchdogs"),
    Register(0x0442, 2, "watchdog counters", 0, 0, E.CLEAR_WATCHDOG_COUNTERS, "watchdogs"),
    Register(0x0500, 1, "EEPROM configuration", 0, 0x03, E.EEPROM_ACCESS, "SII EEPROM interface"),
    Register(0x0501, 1, "EEPROM PDI access state", 0, 0, E.NONE, "SII EEPROM interface"),
    Register(0x0502, 1, "EEPROM control: write enable", 0xC0, 0x01, E.EEPROM,
             "SII EEPROM interface"),
    Register(0x0503, 1, "EEPROM command and status", 0x00, 0x07, E.EEPROM, "SII EEPROM interface"),
    Register(0x0504, 4, "EEPROM address", 0, ALL, E.NONE, "SII EEPROM interface"),
    Register(0x0508, 8, "EEPROM data", 0, ALL, E.NONE, "SII EEPROM interface"),
    *(Register(0x0600 + 16 * n + b, 1, f"FMMU {n}, byte {b}", 0,
               _FMMU_ROW[b] if b < len(_FMMU_ROW) else 0, E.FMMU, "FMMU")
      for n in range(FMMUS) for b in range(16)),
    *(Register(0x0800 + 8 * n + b, 1, f"sync manager {n}, byte {b}", 0, _SM_ROW[b],
               E.SYNC_MANAGER if _SM_ROW[b] else E.NONE, "sync managers")
      for n in range(SYNC_MANAGERS) for b in range(8)),
    Register(0x0900, 4, "receive time port 0", 0, 0, E.RECEIVE_TIME, "distributed clocks"),
    Register(0x0904, 12, "receive times ports 1-3", 0, 0, E.NONE, "distributed clocks"),
    Register(0x0910, 8, "system time", 0, 0, E.SYSTEM_TIME, "distributed clocks"),
    Register(0x0918, 8, "receive time of the processing unit", 0, 0, E.NONE, "distributed clocks"),
    Register(0x0920, 8, "system time offset", 0, ALL, E.OFFSET, "distributed clocks"),
    Register(0x0928, 4, "system time delay", 0, ALL, E.NONE, "distributed clocks"),
    Register(0x092C, 4, "system time difference", 0, 0, E.NONE, "distributed clocks"),
    Register(0x0930, 2, "speed counter start", 0x1000, ALL, E.RESET_DRIFT, "distributed clocks"),
    Register(0x0932, 2, "speed counter difference", 0, 0, E.NONE, "distributed clocks"),
    Register(0x0934, 1, "filter depth of the difference", 4, 0x0F, E.RESET_DRIFT,
             "distributed clocks"),
    Register(0x0935, 1, "filter depth of the speed counter", 12, 0x0F, E.RESET_DRIFT,
             "distributed clocks"),
    Register(0x0980, 1, "cyclic unit control", 0, 0x31, E.SYNC, "distributed clocks, SYNC"),
    Register(0x0981, 1, "activation", 0, ALL, E.SYNC, "distributed clocks, SYNC"),
    Register(0x0982, 2, "pulse length of SYNC (10 ns)", 0, 0, E.NONE, "distributed clocks, SYNC"),
    Register(0x0984, 1, "activation status", 0, 0, E.NONE, "distributed clocks, SYNC"),
    Register(0x098E, 2, "SYNC0 and SYNC1 status", 0, 0, E.NONE, "distributed clocks, SYNC"),
    Register(0x0990, 8, "start time, next SYNC0", 0, ALL, E.NONE, "distributed clocks, SYNC"),
    Register(0x0998, 8, "next SYNC1", 0, 0, E.NONE, "distributed clocks, SYNC"),
    Register(0x09A0, 4, "SYNC0 cycle", 0, ALL, E.SYNC, "distributed clocks, SYNC"),
    Register(0x09A4, 4, "SYNC1 cycle", 0, ALL, E.SYNC, "distributed clocks, SYNC"),
    Register(0x09A8, 2, "latch control", 0, 0x03, E.NONE, "distributed clocks, latch"),
    Register(0x09AE, 2, "latch status", 0, 0, E.NONE, "distributed clocks, latch"),
    Register(0x09B0, 32, "latch times: 0 rising, 0 falling, 1 rising, 1 falling", 0, 0, E.NONE,
             "distributed clocks, latch"),
    Register(0x0E00, 8, "product id", 0, 0, E.NONE, "ESC specific"),
    Register(0x0F80, 128, "user RAM", 0, ALL, E.NONE, "ESC specific"),
)


def _columns() -> tuple[np.ndarray, ...]:
    reset, writable, effect, readable = (np.zeros(REGISTERS, np.uint8) for _ in range(4))
    for row in REGISTERS_TABLE:
        here = slice(row.address, row.address + row.length)
        reset[here] = list(row.reset.to_bytes(row.length, "little"))
        writable[here] = row.writable
        effect[here] = row.effect
        readable[here] = 1
    return reset, writable, effect, readable


# by byte: value after power-on, bits that EtherCAT may write, `Effect`, whether it has a row
RESET, WRITABLE, EFFECT, READABLE = _columns()
