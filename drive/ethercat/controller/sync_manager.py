"""Sync managers of a slave controller: mailboxes, three buffers, and the watchdogs they trigger.

Source: ESC data sheet, section I (sync manager, watchdogs). A buffer begins with its first byte and
is handed over with its last one; what lies in a buffer that is not open cannot be touched.
"""

from ...kernel.jit import block
from . import dc
from .bits import get16
from .process_image import NONE_WRITTEN, OUTPUTS
from .record import NEVER, REGISTERS, SYNC_MANAGERS, Event, SyncMode
from .registers import R

FULL = 0x08  # mailbox status of a sync manager (+5 bit 3)
WRITTEN, READ = 0x01, 0x02  # its interrupts (+5 bits 0, 1)
MAILBOX = 0x02  # its control byte: one buffer with handshake


@block
def decode(esc, n):
    """Take over the configuration of sync manager `n`; one that is switched on begins empty."""
    memory = esc.memory
    at = R.SYNC_MANAGER + 8 * n
    enabled = memory[at + 6] & 1 and not memory[at + 7] & 1
    start, length = get16(memory, at), get16(memory, at + 2)
    if not enabled or length == 0:
        if esc.sm_length[n] != 0:
            memory[at + 5] = empty(memory[at + 4])
            memory[R.AL_EVENT + 1 + n // 8] &= 0xFF ^ (1 << n % 8)
        esc.sm_length[n] = 0
        return
    if esc.sm_length[n] != 0:
        return
    control = memory[at + 4]
    esc.sm_start[n] = start
    esc.sm_length[n] = length if start >= REGISTERS and start + length <= len(memory) else 0
    esc.sm_write[n] = control >> 2 & 1
    esc.sm_mailbox[n] = control >> 1 & 1
    esc.sm_watchdog[n] = control >> 6 & 1
    esc.sm_open[n] = 0
    esc.sm_fresh[n] = 0
    memory[at + 5] = empty(control)


@block
def empty(control):
    """Status of a sync manager that begins: its buffer bits are those of three buffers alone."""
    return 0 if control & MAILBOX else NONE_WRITTEN


@block
def decode_all(esc):
    """All of them."""
    esc.sm_count = 0
    for n in range(SYNC_MANAGERS):
        decode(esc, n)
        if esc.sm_length[n] != 0:
            esc.sm_count = n + 1


@block
def allowed(esc, at, n, write):
    """Whether all sync managers that lie in these bytes let EtherCAT pass."""
    for k in range(esc.sm_count):
        length = esc.sm_length[k]
        start = esc.sm_start[k]
        if length == 0 or at >= start + length or at + n <= start:
            continue
        if (esc.sm_write[k] != 0) != write:
            return False
        status = esc.memory[R.SYNC_MANAGER + 8 * k + 5]
        if esc.sm_mailbox[k]:
            if (status & FULL != 0) == write:
                return False
        elif not write and status & NONE_WRITTEN == NONE_WRITTEN:
            return False
        if at > start and not esc.sm_open[k]:
            return False
    return True


@block
def begin(esc, at, n):
    """The first byte of a buffer opens it; a three-buffer one shows its newest inputs."""
    for k in range(esc.sm_count):
        length = esc.sm_length[k]
        start = esc.sm_start[k]
        if length == 0 or not at <= start < at + n:
            continue
        esc.sm_open[k] = 1
        status = R.SYNC_MANAGER + 8 * k + 5
        esc.memory[status] &= 0xFF ^ (READ if esc.sm_write[k] else WRITTEN)
        if not esc.sm_write[k] and not esc.sm_mailbox[k] and esc.sm_fresh[k]:
            esc.sm_fresh[k] = 0
            for b in range(start, start + length):
                esc.memory[b] = esc.local[b]


@block
def finish(esc, at, n, now):
    """The last byte of a buffer hands it over to the other side."""
    for k in range(esc.sm_count):
        length = esc.sm_length[k]
        start = esc.sm_start[k]
        if length == 0 or not at <= start + length - 1 < at + n:
            continue
        esc.sm_open[k] = 0
        status = R.SYNC_MANAGER + 8 * k + 5
        esc.memory[R.AL_EVENT + 1 + k // 8] |= 1 << k % 8
        if esc.sm_mailbox[k]:
            if esc.sm_write[k]:
                esc.memory[status] |= FULL | WRITTEN
                esc.events |= Event.MAILBOX_REQUEST
            else:
                esc.memory[status] = esc.memory[status] & (0xFF ^ FULL) | READ
                esc.events |= Event.MAILBOX_READ
        elif esc.sm_write[k]:
            for b in range(start, start + length):
                esc.local[b] = esc.memory[b]
            esc.sm_fresh[k] = 1
            esc.memory[status] = esc.memory[status] & (0xFF ^ NONE_WRITTEN) | WRITTEN
            if k == OUTPUTS:
                esc.events |= Event.PROCESS_DATA
                if esc.sync_mode < SyncMode.SYNC0 and 0 < now - esc.outputs_at < esc.cycle_ns:
                    esc.cycle_exceeded = min(esc.cycle_exceeded + esc.outputs_on, 0xFFFF)
                esc.outputs_at = now
        else:
            esc.memory[status] |= READ
            if esc.outputs_on == 0 or esc.sm_length[OUTPUTS] == 0:  # else they make the cycle
                esc.events |= Event.PROCESS_DATA
        if esc.sm_watchdog[k] and esc.sm_write[k]:
            trigger_watchdog(esc, now)


@block
def trigger_watchdog(esc, now):
    """Outputs have come: the process-data watchdog runs anew."""
    time = dc.watchdog_time(esc, R.WATCHDOG_TIME)
    esc.memory[R.WATCHDOG_STATUS] = 1
    esc.watchdog_at = now + time if time else NEVER


@block
def bite(esc):
    """The process-data watchdog has expired."""
    memory = esc.memory
    esc.watchdog_at = NEVER
    memory[R.WATCHDOG_STATUS] = 0
    memory[R.AL_EVENT] |= 1 << 6
    if memory[R.WATCHDOG_COUNTER] < 0xFF:
        memory[R.WATCHDOG_COUNTER] += 1
    esc.events |= Event.WATCHDOG


@block
def bite_pdi(esc):
    """The drive's side has been silent for too long."""
    memory = esc.memory
    esc.pdi_watchdog_at = NEVER
    memory[R.DL_STATUS] &= 0xFF ^ 2
    if memory[R.WATCHDOG_COUNTER_PDI] < 0xFF:
        memory[R.WATCHDOG_COUNTER_PDI] += 1
    esc.events |= Event.PDI_WATCHDOG
