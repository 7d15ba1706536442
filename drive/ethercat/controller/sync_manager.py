"""Sync managers of a slave controller: mailboxes, three buffers, and the watchdogs they trigger.

Source: ESC data sheet, section I (sync manager, watchdogs). Access to the first byte opens a
buffer, access to the last one hands it over; other bytes are accessible only while it is open.
"""

from ...kernel.jit import block
from . import dc
from .bits import get16
from .process_image import NONE_WRITTEN, OUTPUTS
from .record import NEVER, REGISTERS, SYNC_MANAGERS, Event, SyncMode
from .registers import FULL, MAILBOX, READ, WRITTEN, R


@block
def decode(esc, n):
    """Decode the configuration of sync manager `n`; its buffer is empty when it is enabled."""
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
    """Status of an empty sync manager; only three-buffer mode has the buffer bits."""
    return 0 if control & MAILBOX else NONE_WRITTEN


@block
def decode_all(esc):
    """Decode the configuration of all sync managers."""
    esc.sm_count = 0
    for n in range(SYNC_MANAGERS):
        decode(esc, n)
        if esc.sm_length[n] != 0:
            esc.sm_count = n + 1


@block
def allowed(esc, at, n, write):
    """Whether all sync managers within these bytes permit the access by EtherCAT."""
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
    """Open the buffers whose first byte is accessed; three buffers show the newest inputs."""
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
    """Hand over the buffers whose last byte is accessed."""
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
            if esc.outputs_on == 0 or esc.sm_length[OUTPUTS] == 0:  # else outputs count the cycles
                esc.events |= Event.PROCESS_DATA
        if esc.sm_watchdog[k] and esc.sm_write[k]:
            trigger_watchdog(esc, now)


@block
def trigger_watchdog(esc, now):
    """Restart the process-data watchdog when outputs have arrived."""
    time = dc.watchdog_time(esc, R.WATCHDOG_TIME)
    esc.memory[R.WATCHDOG_STATUS] = 1
    esc.watchdog_at = now + time if time else NEVER


@block
def expire_watchdog(esc):
    """Let the process-data watchdog expire."""
    memory = esc.memory
    esc.watchdog_at = NEVER
    memory[R.WATCHDOG_STATUS] = 0
    memory[R.AL_EVENT] |= 1 << 6
    if memory[R.WATCHDOG_COUNTER] < 0xFF:
        memory[R.WATCHDOG_COUNTER] += 1
    esc.events |= Event.WATCHDOG
