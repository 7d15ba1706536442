"""The EEPROM interface of a slave controller, registers 0500h-050Fh (ESC data sheet, section II).

A command takes no time, because the drive emulates its EEPROM; `eeprom_until` keeps it busy.
"""

from ...kernel.jit import block
from .bits import get16, get32, put16
from .record import Event
from .registers import R

READ, WRITE, RELOAD = 1, 2, 4  # commands, 0502h bits 10-8
IP_CORE = 0x04  # 0000h: an IP core, whose PDI (0140h) is fixed by its design, not by the EEPROM
EIGHT_BYTES = 1 << 6  # 0502h: a read gives 8 bytes, not 4
# 0503h, the upper byte of 0502h
COMMAND_BITS, CHECKSUM_ERROR, NOT_LOADED, COMMAND_ERROR, ENABLE_ERROR, BUSY = 7, 8, 16, 32, 64, 128
CHECKED = 14  # bytes of the configuration area before its checksum


@block
def checksum(sii):
    """CRC-8 of the first 14 bytes: polynomial x^8 + x^2 + x + 1, initial value FFh (ETG.2010)."""
    crc = 0xFF
    for b in range(CHECKED):
        crc ^= sii[b]
        for _ in range(8):
            crc = (crc << 1 ^ 0x07) & 0xFF if crc & 0x80 else crc << 1
    return crc


@block
def load_configuration(esc):
    """Load words 0-4 of the SII into their registers if the checksum is right."""
    memory, sii = esc.memory, esc.sii
    if checksum(sii) != sii[CHECKED]:
        memory[R.EEPROM_CONTROL + 1] |= CHECKSUM_ERROR
        memory[R.DL_STATUS] &= 0xFE
        return
    memory[R.EEPROM_CONTROL + 1] &= 0xFF ^ (CHECKSUM_ERROR | NOT_LOADED)
    memory[R.DL_STATUS] |= 1
    if memory[R.TYPE] != IP_CORE:
        put16(memory, R.PDI_CONTROL, get16(sii, 0))
    put16(memory, 0x0150, get16(sii, 2))
    put16(memory, R.PULSE_LENGTH, get16(sii, 4))
    put16(memory, 0x0152, get16(sii, 6))
    put16(memory, R.STATION_ALIAS, get16(sii, 8))


@block
def eeprom_status(esc, now):
    """Refresh the busy bit."""
    memory = esc.memory
    memory[R.EEPROM_CONTROL + 1] &= 0xFF ^ BUSY
    if now < esc.eeprom_until:
        memory[R.EEPROM_CONTROL + 1] |= BUSY


@block
def eeprom_command(esc, now):
    """Execute the command in 0502h; it clears the errors of the previous one."""
    memory = esc.memory
    status = R.EEPROM_CONTROL + 1
    command = memory[status] & COMMAND_BITS
    memory[status] &= CHECKSUM_ERROR | NOT_LOADED
    at = 2 * get32(memory, R.EEPROM_ADDRESS)
    if command == READ:
        n = 8 if memory[R.EEPROM_CONTROL] & EIGHT_BYTES else 4
        if at + 2 > esc.sii_size:
            memory[status] |= COMMAND_ERROR
            return
        for b in range(n):
            inside = at + b < esc.sii_size
            memory[R.EEPROM_DATA + b] = esc.sii[at + b] if inside else 0xFF
    elif command == WRITE:
        if not memory[R.EEPROM_CONTROL] & 1:
            memory[status] |= ENABLE_ERROR
            return
        if at + 2 > esc.sii_size:
            memory[status] |= COMMAND_ERROR
            return
        esc.sii[at] = memory[R.EEPROM_DATA]
        esc.sii[at + 1] = memory[R.EEPROM_DATA + 1]
        esc.events |= Event.EEPROM
    elif command == RELOAD:
        load_configuration(esc)
    elif command != 0:
        memory[status] |= COMMAND_ERROR
