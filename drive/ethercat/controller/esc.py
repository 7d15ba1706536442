"""Slave controllers: how they process a frame that passes them. Compiled, without I/O.

Sources: ETG.1000.4 (commands, working counter, FMMU, sync managers) and the ESC data sheet,
sections I and II. The input is a frame and a time (ns), the output the changed frame.
"""

import numpy as np

from ...kernel.jit import block, entry
from ..frame import ROUND
from ..frame import Command as C
from . import dc, sync_manager
from .bits import get16, get16_big, get32, put16
from .eeprom import eeprom_command, eeprom_status, load_configuration
from .process_image import OUTPUTS, take_outputs
from .record import FMMUS, NEVER, REGISTERS, SYNC_MANAGERS, Event, SyncMode
from .registers import EFFECT, READABLE, WRITABLE, Effect, R

NO_REPLY = 1 << 31  # the frame was destroyed


# --------------------------------------------------------------------- FMMU


@block
def decode_fmmus(esc):
    """Decode the active FMMUs; addresses and lengths are in bits."""
    esc.fmmus = 0
    for n in range(FMMUS):
        at = R.FMMU + 16 * n
        length = get16(esc.memory, at + 4)
        if not esc.memory[at + 12] & 1 or length == 0:
            continue
        first, last = esc.memory[at + 6] & 7, esc.memory[at + 7] & 7
        k = esc.fmmus
        esc.fmmu_logical[k] = get32(esc.memory, at) * 8 + first
        esc.fmmu_bits[k] = (length - 1) * 8 + last + 1 - first
        esc.fmmu_physical[k] = get16(esc.memory, at + 8) * 8 + (esc.memory[at + 10] & 7)
        esc.fmmu_type[k] = esc.memory[at + 11] & 3
        if esc.fmmu_bits[k] > 0:
            esc.fmmus = k + 1


@block
def _logical(esc, address, frame, at, n, sent, reads, writes, now, unit, entrance):
    """Pass LRD, LWR or LRW through the FMMUs of these logical bytes; -> read, written."""
    first, end = address * 8, (address + n) * 8
    was_read, was_written = False, False
    for k in range(esc.fmmus):
        low = max(first, esc.fmmu_logical[k])
        high = min(end, esc.fmmu_logical[k] + esc.fmmu_bits[k])
        if low >= high:
            continue
        physical = esc.fmmu_physical[k] + low - esc.fmmu_logical[k]
        kind = esc.fmmu_type[k]
        whole = low % 8 == 0 and high % 8 == 0 and physical % 8 == 0
        place = (low - first) // 8
        if whole:
            count = (high - low) // 8
            if reads and kind & 1 and read(esc, physical // 8, frame, at + place, count, False,
                                           now, unit):
                was_read = True
            if writes and kind & 2 and write(esc, physical // 8, sent, place, count,
                                             now, unit, entrance):
                was_written = True
        else:
            for bit in range(high - low):
                here = low - first + bit
                there = physical + bit
                mask = 1 << here % 8
                if reads and kind & 1 and read(esc, there // 8, esc.scratch, 0, 1, False,
                                               now, unit):
                    was_read = True
                    frame[at + here // 8] &= 0xFF ^ mask
                    if esc.scratch[0] >> there % 8 & 1:
                        frame[at + here // 8] |= mask
                if writes and kind & 2 and there // 8 < len(esc.memory):
                    esc.scratch[0] = esc.memory[there // 8] & (0xFF ^ 1 << there % 8)
                    if sent[here // 8] & mask:
                        esc.scratch[0] |= 1 << there % 8
                    if write(esc, there // 8, esc.scratch, 0, 1, now, unit, entrance):
                        was_written = True
    return was_read, was_written


# ---------------------------------------------------------- read and write


@block
def read(esc, address, data, at, n, mix, now, unit):
    """Read `n` bytes; `mix` ORs them into the data (BRD). -> whether any byte could be read."""
    memory = esc.memory
    if n == 0 or address + n > len(memory):
        return False
    if address >= REGISTERS:
        if not sync_manager.allowed(esc, address, n, False):
            return False
        sync_manager.begin(esc, address, n)
    else:
        if address + n > REGISTERS:
            return False
        found = False
        for b in range(address, address + n):
            found = found or (READABLE[b] != 0 and _built(memory, b))
        if not found:
            return False
        _refresh(esc, address, n, now, unit)
    for b in range(n):
        if mix:
            data[at + b] |= memory[address + b]
        else:
            data[at + b] = memory[address + b]
    if address >= REGISTERS:
        sync_manager.finish(esc, address, n, now)
    elif address < R.ECAT_EVENT + 2 or address >= R.LATCH_TIME:
        _was_read(esc, address, n)
    return True


@block
def _built(memory, at):
    """Whether this slave has the FMMU or sync manager of this register (0004h, 0005h)."""
    if R.FMMU <= at < R.SYNC_MANAGER:
        return (at - R.FMMU) // 16 < memory[R.FMMUS_SUPPORTED]
    if R.SYNC_MANAGER <= at < R.SYNC_MANAGER + 8 * SYNC_MANAGERS:
        return (at - R.SYNC_MANAGER) // 8 < memory[R.SYNC_MANAGERS_SUPPORTED]
    return True


@block
def _meets(address, n, register, length):
    return address < register + length and address + n > register


@block
def _refresh(esc, address, n, now, unit):
    """Update registers whose values are computed on reading."""
    if _meets(address, n, R.EEPROM_CONTROL, 2):
        eeprom_status(esc, now)
    edges = _meets(address, n, R.AL_EVENT, 1) or _meets(address, n, R.SYNC0_STATUS, 0x12)
    if edges and not dc.synchronised(esc):
        dc.skip(esc, unit)
    if _meets(address, n, R.SYSTEM_TIME, 8):
        dc.put_time(esc, R.SYSTEM_TIME, dc.system_time(esc, unit))


@block
def _was_read(esc, address, n):
    """Clear the events 0210h of AL status, DL status and latch after reading."""
    memory = esc.memory
    if _meets(address, n, R.AL_STATUS, 2):
        memory[R.ECAT_EVENT] &= 0xFF ^ 1 << 3
    if _meets(address, n, R.DL_STATUS, 2):
        memory[R.ECAT_EVENT] &= 0xFF ^ 1 << 2
    for k in range(4):
        if _meets(address, n, R.LATCH_TIME + 8 * k, 8):
            memory[R.LATCH_STATUS + k // 2] &= 0xFF ^ 1 << k % 2
            memory[R.ECAT_EVENT] &= 0xFE


@block
def write(esc, address, data, at, n, now, unit, entrance):
    """Write `n` bytes of `data` from `at` on; -> whether any byte could be written."""
    memory = esc.memory
    if n == 0 or address + n > len(memory):
        return False
    if address >= REGISTERS:
        if not sync_manager.allowed(esc, address, n, True):
            return False
        sync_manager.begin(esc, address, n)
        for b in range(n):
            memory[address + b] = data[at + b]
        sync_manager.finish(esc, address, n, now)
        return True
    if address + n > REGISTERS or _locked(esc, address, n, now):
        return False
    effects, found = 0, False
    for b in range(n):
        here = address + b
        mask = WRITABLE[here]
        if (mask == 0 and EFFECT[here] == 0) or not _built(memory, here):
            continue
        found = True
        if R.SYNC_MANAGER <= here < R.SYNC_MANAGER + 8 * SYNC_MANAGERS:
            active = memory[(here & ~7) + 6] & 1
            if here & 7 < 5 and active:
                continue
            if here & 7 == 6 and (memory[here] ^ data[at + b]) & 2:
                esc.events |= Event.REPEAT
        memory[here] = memory[here] & (0xFF ^ mask) | data[at + b] & mask
        effects |= 1 << np.int64(EFFECT[here])
    if effects > 1:
        _effects(esc, effects, address, data, at, n, now, unit, entrance)
    return found


@block
def _locked(esc, address, n, now):
    """Whether EtherCAT may not write now: AL Control is unread, or the EEPROM busy or the PDI's."""
    if _meets(address, n, R.AL_CONTROL, 2) and esc.memory[R.AL_EVENT] & 1:
        return True
    if _meets(address, n, R.EEPROM_CONTROL, 14):
        return now < esc.eeprom_until or esc.memory[R.EEPROM_CONFIGURATION] & 1 != 0
    return False


@block
def _clear(memory, at, n):
    for b in range(at, at + n):
        memory[b] = 0


@block
def _effects(esc, effects, address, data, at, n, now, unit, entrance):
    memory = esc.memory
    if effects >> Effect.AL_CONTROL & 1:
        memory[R.AL_EVENT] |= 1
        esc.events |= Event.AL_CONTROL
    if effects >> Effect.SYNC_MANAGER & 1:
        memory[R.AL_EVENT] |= 1 << 4
        esc.events |= Event.SYNC_MANAGER
        sync_manager.decode_all(esc)
    if effects >> Effect.FMMU & 1:
        decode_fmmus(esc)
    if effects >> Effect.EEPROM & 1:
        eeprom_command(esc, now)
    if effects >> Effect.EEPROM_ACCESS & 1:
        memory[R.EEPROM_CONFIGURATION + 1] = memory[R.EEPROM_CONFIGURATION] & 1
    if effects >> Effect.CLEAR_RX_ERRORS & 1:
        _clear(memory, R.RX_ERRORS, 12)
    if effects >> Effect.CLEAR_PROCESSING_ERRORS & 1:
        _clear(memory, R.PROCESSING_ERRORS, 1)
    if effects >> Effect.CLEAR_PDI_ERRORS & 1:
        _clear(memory, R.PDI_ERRORS, 1)
    if effects >> Effect.CLEAR_LOST_LINKS & 1:
        _clear(memory, R.LOST_LINKS, 4)
    if effects >> Effect.CLEAR_WATCHDOG_COUNTERS & 1:
        _clear(memory, R.WATCHDOG_COUNTER, 2)
    if effects >> Effect.WATCHDOG & 1 and esc.watchdog_at != NEVER:
        sync_manager.trigger_watchdog(esc, now)
    if effects >> Effect.RECEIVE_TIME & 1:
        dc.receive_times(esc, now, unit, entrance)
    if effects >> Effect.SYSTEM_TIME & 1 and address <= R.SYSTEM_TIME and address + n >= 0x0914:
        place = at + R.SYSTEM_TIME - address
        wide = address + n >= 0x0918 and dc.wide(esc)
        dc.steer(esc, unit, dc.get64(data, place) if wide else get32(data, place), wide)
    if effects >> Effect.OFFSET & 1:
        dc.skip(esc, now)  # the time jumps; the edges in between do not occur
    if effects >> Effect.RESET_DRIFT & 1:
        dc.reset_drift(esc, now)
    if effects >> Effect.SYNC & 1:
        dc.activate(esc, now)
    if effects >> Effect.PORTS & 1:
        esc.events |= Event.PORTS


# ------------------------------------------------------------------- frames


@block
def _begin(frame, length):
    """Offset of the EtherCAT header, -1 if none. Clears a UDP checksum, as data will change."""
    at = 12
    if length < 16:
        return -1
    kind = get16_big(frame, at)
    if kind == 0x8100 and length >= 20:
        at += 4
        kind = get16_big(frame, at)
    if kind == 0x88A4:
        return at + 2
    if kind == 0x0800 and length > at + 30 and frame[at + 2] >> 4 == 4 and frame[at + 11] == 17:
        udp = at + 2 + 4 * (frame[at + 2] & 0x0F)
        if length >= udp + 10 and get16_big(frame, udp + 2) == 0x88A4:
            frame[udp + 6] = 0
            frame[udp + 7] = 0
            return udp + 8
    return -1


@block
def _sound(frame, begin, length):
    """Whether the datagrams fit their frame and the stated lengths."""
    header = get16(frame, begin)
    at = begin + 2
    end = at + (header & 0x07FF)
    if header >> 12 != 1 or end > length:
        return False
    while True:
        if at + 12 > end:
            return False
        size = get16(frame, at + 6)
        at += 12 + (size & 0x07FF)
        if at > end:
            return False
        if not size & 0x8000:
            return True


@block
def _process(esc, frame, begin, sent, now, unit, entrance):
    """Process all datagrams of a valid frame in one slave; -> whether it forwards the frame.

    A slave whose port 0 is closed marks circulating frames and destroys them when they return.
    """
    memory = esc.memory
    memory[R.EEPROM_CONTROL] &= 0xFE  # write enable holds for one frame
    loose = memory[R.DL_STATUS + 1] & 1
    at = begin + 2
    while True:
        command = frame[at]
        size = get16(frame, at + 6)
        if loose:
            if size & ROUND:
                return False
            put16(frame, at + 6, size | ROUND)
        n = size & 0x07FF
        if 0 < command <= C.FRMW:
            _datagram(esc, command, frame, at, n, sent, now, unit, entrance)
            events = get16(memory, R.ECAT_EVENT) & get16(memory, R.ECAT_EVENT_MASK)
            if events:
                put16(frame, at + 8, get16(frame, at + 8) | events)
        if not size & 0x8000:
            return True
        at += 12 + n


@block
def _datagram(esc, command, frame, at, n, sent, now, unit, entrance):
    memory = esc.memory
    adp, ado = get16(frame, at + 2), get16(frame, at + 4)
    data = at + 10
    reads, writes, addressed = False, False, True
    broadcast = C.BRD <= command <= C.BRW
    if command <= C.APRW or command == C.ARMW:
        addressed = adp == 0
    elif command <= C.FPRW or command == C.FRMW:
        addressed = adp == get16(memory, R.STATION_ADDRESS)
        if not addressed and memory[R.ALIAS_ENABLE] & 1:
            addressed = adp == get16(memory, R.STATION_ALIAS)
    if command <= C.APRW or command == C.ARMW or broadcast:
        put16(frame, at + 2, adp + 1)
    if command == C.ARMW or command == C.FRMW:
        reads, writes = addressed, not addressed
        addressed = True
    else:
        kind = (command - 1) % 3  # read, write, both: commands come in groups of three
        reads, writes = kind != 1, kind != 0
    if not addressed:
        return
    if writes:
        for b in range(n):
            sent[b] = frame[data + b]
    counted = 0
    if C.LRD <= command <= C.LRW:
        was_read, was_written = _logical(
            esc, ado << 16 | adp, frame, data, n, sent, reads, writes, now, unit, entrance
        )
    else:
        was_read = reads and read(esc, ado, frame, data, n, broadcast, now, unit)
        was_written = writes and write(esc, ado, sent, 0, n, now, unit, entrance)
    if was_read:
        counted = 1
    if was_written:
        counted += 2 if reads else 1
    if counted:
        put16(frame, data + n, get16(frame, data + n) + counted)


@entry
def exchange(escs, slaves, times, entrance, frame, length, sent, now):
    """Let a frame pass slave controllers; it is changed in place.

    Args:
        escs: ESC records of the segment.
        slaves: indices of the slaves in the order of processing.
        times: time from `now` to the processing in each of them (ns).
        entrance: port of the master at which the frame enters, 0 or 1.
        frame: Ethernet frame without its check sequence, u1.
        length: length of the frame (bytes).
        sent: buffer for the data of one datagram, u1 (2,048).
        now: time at which the frame enters the segment (ns).

    Returns:
        `Event` bits of all slaves together; `NO_REPLY` if the frame was destroyed.
    """
    begin = _begin(frame, length)
    if begin < 0 or len(slaves) == 0:
        return NO_REPLY if begin < 0 else 0
    if not _sound(frame, begin, length):
        first = escs[slaves[0]]
        if first.memory[R.PROCESSING_ERRORS] < 0xFF:
            first.memory[R.PROCESSING_ERRORS] += 1
        return NO_REPLY
    events = 0
    for k in range(len(slaves)):
        esc = escs[slaves[k]]
        if not _process(esc, frame, begin, sent, now, now + times[k], entrance):
            return events | NO_REPLY
        if esc.sm_fresh[OUTPUTS] and esc.sync_mode < SyncMode.SYNC0:
            take_outputs(esc)
        events |= esc.events
    frame[6] |= 2  # a slave marks the source address (data sheet, section I)
    return events


@entry
def poll(escs, now):
    """Process edges of SYNC0 and watchdogs up to `now` (ns), in order; -> `Event` bits."""
    events = 0
    for i in range(len(escs)):
        esc = escs[i]
        if not dc.synchronised(esc):
            dc.skip(esc, now)
        while esc.sync0_at != NEVER and dc.synchronised(esc):
            due = dc.time_of(esc, esc.sync0_at)
            if due > now:
                break
            if esc.watchdog_at <= due:
                sync_manager.expire_watchdog(esc)
            dc.edge(esc, due)
        if esc.watchdog_at <= now:
            sync_manager.expire_watchdog(esc)
        events |= esc.events
    return events


@entry
def next_time(escs):
    """The next time at which `poll` has something to do (ns)."""
    soonest = NEVER
    for i in range(len(escs)):
        esc = escs[i]
        soonest = min(soonest, esc.watchdog_at)
        if esc.sync0_at != NEVER and dc.synchronised(esc):
            soonest = min(soonest, dc.time_of(esc, esc.sync0_at))
    return soonest


@entry
def synchronised(escs, index):
    """Whether the drive of one slave runs at the edges of SYNC0."""
    return dc.synchronised(escs[index])


@entry
def latch(escs, index, now, unit, rising):
    """Process an edge at a latch input of one slave."""
    dc.latch_input(escs[index], now, unit, rising)


@entry
def configure(escs, index):
    """Decode the registers of one slave after the drive's side has written them."""
    sync_manager.decode_all(escs[index])
    decode_fmmus(escs[index])


@entry
def power_on(escs, index):
    """Load the configuration area of the SII of one slave."""
    load_configuration(escs[index])


@entry
def take_process_data(escs, slaves):
    """Mark the slaves that exchanged process data since the last call (u1); -> their number."""
    count = 0
    for i in range(len(escs)):
        touched = escs[i].events & Event.PROCESS_DATA
        slaves[i] = 1 if touched else 0
        if touched:
            count += 1
            escs[i].events &= 0xFFFFFFFF ^ Event.PROCESS_DATA
    return count
