"""ESC: one slave controller as one record; a segment is an array of them.

Registers and RAM are bytes in `memory`, little-endian, at the addresses a master uses. Other fields
hold the state that a master cannot read: the SII image, clocks, decoded sync managers and FMMUs,
and events for the drive's services. Reset is an assignment; a snapshot of a segment copies bytes.
"""

from enum import IntEnum

import numpy as np

REGISTERS = 0x1000  # byte address at which the RAM begins
MEMORY = 0x3000  # end of the RAM of 8 KiB, as in an ET1100
SII_BYTES = 1 << 14  # size of the largest SII image
SYNC_MANAGERS = 9  # at most; a slave states its numbers of FMMUs and sync managers in 0004h, 0005h
FMMUS = 8
PORTS = 4
ENTRANCES = 2  # ports of the master; the second one serves redundancy
NEVER = np.iinfo(np.int64).max  # no time (ns)


class Event(IntEnum):
    """Bits: events of a slave controller that its services have not handled yet."""

    AL_CONTROL = 1 << 0  # 0120h was written; locked until `Pdi.al_control` reads it
    MAILBOX_REQUEST = 1 << 1  # SM0 is full
    MAILBOX_READ = 1 << 2  # the master has emptied SM1
    REPEAT = 1 << 3  # the repeat request of SM1 has toggled (080Eh bit 1)
    SYNC_MANAGER = 1 << 4  # a sync manager was configured
    EEPROM = 1 << 5  # a word of the SII was written
    WATCHDOG = 1 << 6  # no outputs within the time of 0420h
    FAULT = 1 << 8  # fault or warning of the drive has changed
    SYNC = 1 << 9  # registers of the SYNC unit 0980h-09A7h were written
    PROCESS_DATA = 1 << 10  # outputs or inputs were exchanged; concerns no service
    SYNC_LOST = 1 << 11  # too many frames were late for SYNC0
    PORTS = 1 << 12  # 0101h was written; the segment updates its loops


class SyncMode(IntEnum):
    """The event at which outputs take effect: 1C32h:01 (ETG.1020)."""

    FREE_RUN = 0x00
    SM_EVENT = 0x01
    SYNC0 = 0x02
    SYNC1 = 0x03


# field, type, meaning
FIELDS = (
    ("memory", ("u1", (MEMORY,)), "0000h-2FFFh on the side of EtherCAT"),
    ("local", ("u1", (MEMORY,)), "buffers of three-buffer sync managers on the side of the drive"),
    ("sii", ("u1", (SII_BYTES,)), "the EEPROM"),
    ("sii_size", "<i4", "length of the EEPROM (byte)"),
    ("events", "<u4", "`Event` bits for the services"),
    ("present", "u1", "powered; a slave without power closes the ports of its neighbours"),
    # sync managers, decoded from 0800h on
    ("sm_count", "<i4", "number of the last enabled sync manager, plus one"),
    ("sm_start", ("<i4", (SYNC_MANAGERS,)), "first byte"),
    ("sm_length", ("<i4", (SYNC_MANAGERS,)), "bytes; 0 if the sync manager is off"),
    ("sm_write", ("u1", (SYNC_MANAGERS,)), "EtherCAT writes, the drive reads"),
    ("sm_mailbox", ("u1", (SYNC_MANAGERS,)), "one buffer with handshake, not three"),
    ("sm_watchdog", ("u1", (SYNC_MANAGERS,)), "a written buffer triggers the watchdog"),
    ("sm_open", ("u1", (SYNC_MANAGERS,)), "EtherCAT has touched the first byte, not the last"),
    ("scratch", ("u1", (8,)), "a byte in transit through an FMMU of bits"),
    ("sm_fresh", ("u1", (SYNC_MANAGERS,)), "a complete buffer that has not been taken"),
    # FMMUs that are active, decoded from 0600h on
    ("fmmus", "<i4", "number of active FMMUs"),
    ("fmmu_logical", ("<i8", (FMMUS,)), "logical start (bit)"),
    ("fmmu_bits", ("<i8", (FMMUS,)), "length (bit)"),
    ("fmmu_physical", ("<i8", (FMMUS,)), "physical start (bit)"),
    ("fmmu_type", ("u1", (FMMUS,)), "bit 0 read, bit 1 write"),
    # EEPROM interface
    ("eeprom_until", "<i8", "end of the busy time (ns)"),
    ("watchdog_at", "<i8", "the process-data watchdog expires (ns)"),
    # clock: local time = clock_local + (now - clock_now) * (1e9 + clock_ppb) / 1e9
    ("clock_now", "<i8", "(ns)"),
    ("clock_local", "<i8", "(ns)"),
    ("clock_ppb", "<i8", "deviation of the crystal (1e-9)"),
    ("drift_ppb", "<i8", "correction of the rate by the drift loop (1e-9)"),
    ("drift_integral", "<i8", "integral part of the correction (1e-12)"),
    ("drift_mean", "<i8", "integral part behind the filter 0935h (1e-12), shown in 0932h"),
    ("port_time", ("<i8", (ENTRANCES, PORTS)), "time until a frame is at a port (ns); -1 = never"),
    ("sync0_at", "<i8", "next edge of SYNC0, system time (ns)"),
    ("sync1_at", "<i8", "next edge of SYNC1, system time (ns)"),
    ("sync0_count", "<i8", "edges since the activation"),
    # process image
    ("axis", "<i8", "address of the AXIS record; 0 = no drive behind it"),
    ("rpdos", "<i8", "address of the RPDOs"),
    ("rpdo_count", "<i4", ""),
    ("rpdo_size", "<i4", "of the image (byte)"),
    ("tpdos", "<i8", "address of the TPDOs"),
    ("tpdo_count", "<i4", ""),
    ("tpdo_size", "<i4", "of the image (byte)"),
    ("inputs_on", "u1", "the drive publishes inputs: SAFE_OPERATIONAL and OPERATIONAL"),
    ("outputs_on", "u1", "the drive accepts outputs: OPERATIONAL"),
    ("sync_mode", "u1", "`SyncMode`"),
    ("outputs_late", "<i4", "edges of SYNC0 in a row without new outputs"),
    ("sync_errors", "<u2", "1C32h:0B, edges of SYNC0 without new outputs"),
    ("outputs_at", "<i8", "arrival of the last complete buffer of outputs (ns)"),
    ("cycle_ns", "<i8", "1C32h:05, shortest cycle"),
    ("copy_ns", "<i8", "1C32h:06, time from the arrival of outputs until they are ready"),
    ("cycle_exceeded", "<u2", "1C32h:0C, outputs that came sooner than the shortest cycle"),
    ("shift_short", "<u2", "1C32h:0D, edges of SYNC0 at which outputs were not ready yet"),
    ("late_limit", "<i4", "outputs_late above this limit is SYNC_LOST; 0 = no limit"),
    ("seen_fault", "<i8", "fault and warnings at the last event FAULT"),
)


def _without_gaps() -> np.dtype:
    """Order the fields by size, so that every byte of a record belongs to a field."""
    rows = [(name, *((kind,) if isinstance(kind, str) else kind)) for name, kind, _ in FIELDS]
    rows.sort(key=lambda row: -np.dtype(row[1]).itemsize)
    unused = -np.dtype(rows).itemsize % 8
    return np.dtype([*rows, ("unused", "u1", (unused,))], align=True)


ESC = _without_gaps()
