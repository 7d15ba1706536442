"""ESC: one slave controller as one record; a segment is an array of them.

Registers and RAM are bytes in `memory`, little-endian, at the addresses a master uses. Beside them
stands what a master cannot read: the SII image, clocks, decoded sync managers and FMMUs, events for
the drive's services. Reset is an assignment, a snapshot of a whole segment is a copy of the bytes.
"""

from enum import IntEnum

import numpy as np

REGISTERS = 0x1000  # RAM begins here (byte address)
MEMORY = 0x3000  # end of the RAM: 8 KiB, as an ET1100 has
SII_BYTES = 1 << 14  # room for a SII image
SYNC_MANAGERS = 9  # at most; 0004h and 0005h say how many FMMUs and sync managers a slave has
FMMUS = 8
PORTS = 4
ENTRANCES = 2  # ports of the master: the second one is for redundancy
NEVER = np.iinfo(np.int64).max  # a time that does not come (ns)


class Event(IntEnum):
    """Bits: what has happened to a slave controller since its services were served last."""

    AL_CONTROL = 1 << 0  # 0120h has been written; `Pdi.al_control` reads it and opens it again
    MAILBOX_REQUEST = 1 << 1  # SM0 is full
    MAILBOX_READ = 1 << 2  # the master has emptied SM1
    REPEAT = 1 << 3  # the repeat request of SM1 has toggled (080Eh bit 1)
    SYNC_MANAGER = 1 << 4  # a sync manager was configured
    EEPROM = 1 << 5  # a word of the SII was written
    WATCHDOG = 1 << 6  # no outputs within the time of 0420h
    PDI_WATCHDOG = 1 << 7  # the drive's side was silent for the time of 0410h
    FAULT = 1 << 8  # fault or warning of the drive has changed
    SYNC = 1 << 9  # registers of the SYNC unit 0980h-09A7h were written
    PROCESS_DATA = 1 << 10  # outputs or inputs were exchanged; no service is called for it
    SYNC_LOST = 1 << 11  # too many frames came late for SYNC0
    PORTS = 1 << 12  # 0101h was written; the segment looks at its loops again


class SyncMode(IntEnum):
    """When outputs are taken over: 1C32h:01 (ETG.1020)."""

    FREE_RUN = 0x00
    SM_EVENT = 0x01
    SYNC0 = 0x02
    SYNC1 = 0x03


# field, type, meaning
FIELDS = (
    ("memory", ("u1", (MEMORY,)), "0000h-2FFFh as EtherCAT sees them"),
    ("local", ("u1", (MEMORY,)), "buffers of three-buffer sync managers as the drive sees them"),
    ("sii", ("u1", (SII_BYTES,)), "the EEPROM"),
    ("sii_size", "<i4", "bytes of it"),
    ("events", "<u4", "`Event` bits for the services"),
    ("present", "u1", "powered; a slave without power closes the ports of its neighbours"),
    # sync managers, decoded from 0800h on
    ("sm_count", "<i4", "one more than the last that is on"),
    ("sm_start", ("<i4", (SYNC_MANAGERS,)), "first byte"),
    ("sm_length", ("<i4", (SYNC_MANAGERS,)), "bytes; 0 where the sync manager is off"),
    ("sm_write", ("u1", (SYNC_MANAGERS,)), "EtherCAT writes, the drive reads"),
    ("sm_mailbox", ("u1", (SYNC_MANAGERS,)), "one buffer with handshake, not three"),
    ("sm_watchdog", ("u1", (SYNC_MANAGERS,)), "a written buffer triggers the watchdog"),
    ("sm_open", ("u1", (SYNC_MANAGERS,)), "EtherCAT has touched the first byte, not the last"),
    ("scratch", ("u1", (8,)), "a byte on its way through an FMMU of bits"),
    ("sm_fresh", ("u1", (SYNC_MANAGERS,)), "a buffer was finished that nobody has taken"),
    # FMMUs that are active, decoded from 0600h on
    ("fmmus", "<i4", "how many"),
    ("fmmu_logical", ("<i8", (FMMUS,)), "logical start (bit)"),
    ("fmmu_bits", ("<i8", (FMMUS,)), "length (bit)"),
    ("fmmu_physical", ("<i8", (FMMUS,)), "physical start (bit)"),
    ("fmmu_type", ("u1", (FMMUS,)), "bit 0 read, bit 1 write"),
    # EEPROM interface
    ("eeprom_until", "<i8", "it is busy until (ns)"),
    # watchdogs
    ("watchdog_at", "<i8", "the process-data watchdog bites (ns)"),
    ("pdi_watchdog_at", "<i8", "the PDI watchdog bites (ns)"),
    # clock: local time = clock_local + (now - clock_now) * (1e9 + clock_ppb) / 1e9
    ("clock_now", "<i8", "(ns)"),
    ("clock_local", "<i8", "(ns)"),
    ("clock_ppb", "<i8", "deviation of the crystal (1e-9)"),
    ("clock_jitter", "<i8", "of a time stamp, at most (ns)"),
    ("clock_seed", "<i8", "of the jitter"),
    ("drift_ppb", "<i8", "what the drift loop adds to the rate (1e-9)"),
    ("drift_integral", "<i8", "its slow part (1e-12)"),
    ("drift_mean", "<i8", "the slow part behind the filter 0935h (1e-12), shown in 0932h"),
    ("port_time", ("<i8", (ENTRANCES, PORTS)), "when a frame reaches a port (ns); -1 = never"),
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
    ("outputs_on", "u1", "the drive takes outputs over: OPERATIONAL"),
    ("sync_mode", "u1", "`SyncMode`"),
    ("outputs_late", "<i4", "edges of SYNC0 in a row without new outputs"),
    ("sync_errors", "<u2", "1C32h:0B, edges of SYNC0 without new outputs"),
    ("outputs_at", "<i8", "the last whole buffer of outputs came (ns)"),
    ("cycle_ns", "<i8", "1C32h:05, shortest cycle"),
    ("copy_ns", "<i8", "1C32h:06, outputs are ready to be taken over so long after they came"),
    ("cycle_exceeded", "<u2", "1C32h:0C, outputs that came within the cycle of those before"),
    ("shift_short", "<u2", "1C32h:0D, edges of SYNC0 at which outputs were not ready yet"),
    ("late_limit", "<i4", "of outputs_late; more are SYNC_LOST. 0 = no limit"),
    ("seen_fault", "<i8", "fault and warnings as FAULT told them"),
)


def _without_gaps() -> np.dtype:
    """Long numbers first, so that a record has no byte that is in no field."""
    rows = [(name, *((kind,) if isinstance(kind, str) else kind)) for name, kind, _ in FIELDS]
    rows.sort(key=lambda row: -np.dtype(row[1]).itemsize)
    unused = -np.dtype(rows).itemsize % 8
    return np.dtype([*rows, ("unused", "u1", (unused,))], align=True)


ESC = _without_gaps()
