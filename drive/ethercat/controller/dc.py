"""Distributed clocks of a slave controller: local time, drift loop, SYNC0 and SYNC1, latch.

Source: ESC data sheet, section I (distributed clocks) and registers 0900h-09CFh. The crystal
deviates by `clock_ppb`; the drift loop adds `drift_ppb` to pull the local time towards the system
time. A proportional and an integral part stand for the speed counter of the hardware (inferred).
The data sheet documents the filter 0934h of the displayed difference, the deviation of the clocks
in 0932h behind the filter 0935h, and the reset by 0930h.
"""

from ...kernel.jit import block
from .bits import get16, get32, get64, put16, put32, put64
from .process_image import OUTPUTS, take_outputs
from .record import NEVER, PORTS, Event, SyncMode
from .registers import R

SECOND = 1_000_000_000  # ns
ITERATIONS = 8  # of `time_of`
CLOCK_64 = 1 << 3  # of 0008h
FAR = 1 << 60  # ns: 36 years; a time further away counts as never
TERA = 1_000_000_000_000
STEEPEST = 500_000  # largest correction of the drift loop (1e-9)
PROPORTIONAL = 50  # correction for a difference of 1 ns (1e-9; inferred)
CYCLIC, SYNC0, SYNC1 = 1, 2, 4  # bits of 0981h


@block
def _scaled(span, ppb):
    """Scale `span` (ns) by `ppb` without overflow."""
    if ppb == 0:
        return 0
    return (span // SECOND) * ppb + (span % SECOND) * ppb // SECOND


@block
def local_time(esc, now):
    """The local clock (ns)."""
    span = now - esc.clock_now
    return esc.clock_local + span + _scaled(span, esc.clock_ppb + esc.drift_ppb)


@block
def system_time(esc, now):
    """The slave's copy of the system time (ns)."""
    return local_time(esc, now) + get64(esc.memory, R.SYSTEM_TIME_OFFSET)


@block
def wide(esc):
    """Whether the clock has 64 bits, not 32 (0008h bit 3)."""
    return esc.memory[R.FEATURES] & CLOCK_64 != 0


@block
def put_time(esc, at, time):
    """Write a time to its registers; the upper half is 0 if the clock has 32 bits."""
    put64(esc.memory, at, time if wide(esc) else time & 0xFFFFFFFF)


@block
def time_of(esc, system):
    """The time (ns) at which the slave's copy of the system time reaches `system`."""
    local = system - get64(esc.memory, R.SYSTEM_TIME_OFFSET)
    if not -FAR < local - esc.clock_local < FAR:
        return NEVER
    now = esc.clock_now + local - esc.clock_local
    for _ in range(ITERATIONS):  # the error shrinks by the deviation of the rate each time
        error = local_time(esc, now) - local
        if error == 0:
            break
        now -= error
    for _ in range(2):  # rounding: find the first moment that shows this time
        if local_time(esc, now - 1) >= local:
            now -= 1
        elif local_time(esc, now) < local:
            now += 1
    return now


@block
def synchronised(esc):
    """Whether the drive runs at the edges of SYNC0; otherwise the controller only counts them."""
    return (
        esc.sync_mode == SyncMode.SYNC0
        and esc.inputs_on != 0
        and esc.memory[R.ACTIVATION] & CYCLIC != 0
    )


@block
def receive_times(esc, now, unit, entrance):
    """Write of 0900h: latch the times at which the frame reaches ports and processing unit."""
    for port in range(PORTS):
        at = esc.port_time[entrance, port]
        if at >= 0:
            put32(esc.memory, R.RECEIVE_TIME + 4 * port, local_time(esc, now + at))
    put_time(esc, R.RECEIVE_TIME_UNIT, local_time(esc, unit))


@block
def steer(esc, now, received, wide):
    """Write of 0910h: compare with the local copy of the system time and correct the rate.

    `received` is the reference clock's time (ns), or its lower 32 bits if not `wide`.
    """
    own = system_time(esc, now)
    difference = own - received - get32(esc.memory, R.SYSTEM_TIME_DELAY)
    if not wide:
        difference = (difference + (1 << 31)) % (1 << 32) - (1 << 31)
    depth = esc.memory[R.DIFFERENCE_FILTER] & 0x0F
    shown = get32(esc.memory, R.SYSTEM_TIME_DIFFERENCE)
    mean = -(shown & 0x7FFFFFFF) if shown >> 31 else shown & 0x7FFFFFFF
    if shown == 0 or depth == 0:
        mean = difference
    else:
        mean += _rounded(difference - mean, depth)
    mean = min(max(mean, -0x7FFFFFFF), 0x7FFFFFFF)
    put32(esc.memory, R.SYSTEM_TIME_DIFFERENCE, mean if mean >= 0 else -mean | 1 << 31)
    span = max(now - esc.clock_now, 1)
    error = min(max(difference, -STEEPEST), STEEPEST)
    gain = min(PROPORTIONAL, SECOND // 2 // span)
    if abs(error * gain) < STEEPEST:
        growth = error * min(span // 1000, 10_000) * (PROPORTIONAL * PROPORTIONAL // 4) // 1000
        most = STEEPEST * 1000
        esc.drift_integral = min(max(esc.drift_integral - growth, -most), most)
    esc.clock_local = local_time(esc, now)
    esc.clock_now = now
    correction = esc.drift_integral // 1000 - error * gain
    esc.drift_ppb = min(max(correction, -STEEPEST), STEEPEST)
    depth = esc.memory[R.SPEED_FILTER] & 0x0F
    esc.drift_mean += _rounded(esc.drift_integral - esc.drift_mean, depth)
    put16(esc.memory, R.SPEED_COUNTER_DIFFERENCE, _speed_difference(esc))


@block
def _speed_difference(esc):
    """0932h: with S = 0930h and D = this, the clock periods deviate by 5 D / ((S + 2)² - D²).

    Positive where the local clock is slower than the reference (inferred).
    """
    start = get16(esc.memory, R.SPEED_COUNTER_START) & 0x7FFF
    most = max(start - 0x7F, 0)
    difference = 0
    for _ in range(4):
        square = (start + 2) * (start + 2) - difference * difference
        difference = (esc.drift_mean * square + 5 * TERA // 2) // (5 * TERA)
        difference = min(max(difference, -most), most)
    return difference


@block
def _rounded(value, depth):
    """Divide `value` by 2 ** depth; the result is 0 only if `value` is 0."""
    step = value >> depth if value >= 0 else -(-value >> depth)
    if step == 0 and value != 0:
        return 1 if value > 0 else -1
    return step


@block
def reset_drift(esc, now):
    """Write of 0930h, 0934h or 0935h: reset the filters (data sheet, 0930h)."""
    esc.clock_local = local_time(esc, now)
    esc.clock_now = now
    esc.drift_ppb = 0
    esc.drift_integral = 0
    esc.drift_mean = 0
    put16(esc.memory, R.SPEED_COUNTER_DIFFERENCE, 0)
    put32(esc.memory, R.SYSTEM_TIME_DIFFERENCE, 0)


@block
def activate(esc, now):
    """Write of the SYNC registers: start or stop the edges.

    If the start time has passed, edges start a whole number of cycles after it; the hardware would
    wait until its 64 bits overflow (inferred: a master on a loaded computer may be late).
    """
    memory = esc.memory
    active = memory[R.ACTIVATION]
    cycle = get32(memory, R.SYNC0_CYCLE)
    esc.events |= Event.SYNC
    if not (active & CYCLIC and active & (SYNC0 | SYNC1)):
        esc.sync0_at, esc.sync1_at = NEVER, NEVER
        memory[R.ACTIVATION_STATUS] = 0
        return
    if esc.sync0_at != NEVER:
        return
    start = get64(memory, R.START_TIME)
    own = system_time(esc, now)
    if not wide(esc):  # the nearest time with these lower 32 bits
        start = own + (start - own + (1 << 31)) % (1 << 32) - (1 << 31)
    if start <= own:
        late = own - start
        start = start + (late // cycle + 1) * cycle if cycle and 0 <= late < FAR else own + 1
    esc.sync0_at = start
    esc.sync1_at = start + get32(memory, R.SYNC1_CYCLE) if active & SYNC1 else NEVER
    esc.sync0_count = 0
    esc.outputs_late = 0
    memory[R.ACTIVATION_STATUS] = (active >> 1) & 3
    put_time(esc, R.START_TIME, start)


@block
def _signal(esc):
    """Show an edge in the registers."""
    memory = esc.memory
    memory[R.AL_EVENT] |= 1 << 2
    memory[R.SYNC0_STATUS] = 1
    if esc.sync1_at != NEVER:
        memory[R.AL_EVENT] |= 1 << 3
        memory[R.SYNC1_STATUS] = 1


@block
def edge(esc, now):
    """Process an edge of SYNC0: outputs that have arrived take effect, missing ones count as late.

    Outputs that arrived less than the copy time ago wait for the next edge (ETG.1020, 1C32h).
    """
    _signal(esc)
    if esc.sync_mode == SyncMode.SYNC0:
        if esc.sm_fresh[OUTPUTS]:
            esc.outputs_late = 0
            if now - esc.outputs_at >= esc.copy_ns:
                take_outputs(esc)
            else:
                esc.shift_short = min(esc.shift_short + 1, 0xFFFF)
        elif esc.outputs_on:
            esc.outputs_late += 1
            esc.sync_errors = min(esc.sync_errors + 1, 0xFFFF)
            if esc.late_limit and esc.outputs_late == esc.late_limit + 1:
                esc.events |= Event.SYNC_LOST
    _next(esc, 1)


@block
def _next(esc, edges):
    """Advance by a number of edges."""
    esc.sync0_count += edges
    cycle = get32(esc.memory, R.SYNC0_CYCLE)
    if cycle == 0:
        esc.sync0_at = NEVER
        return
    esc.sync0_at += edges * cycle
    put_time(esc, R.START_TIME, esc.sync0_at)
    if esc.sync1_at != NEVER:
        esc.sync1_at += edges * cycle
        put_time(esc, R.NEXT_SYNC1, esc.sync1_at)


@block
def skip(esc, now):
    """Pass the edges of SYNC0 up to `now` at once, for a drive that does not run at them."""
    if esc.sync0_at == NEVER:
        return
    late = system_time(esc, now) - esc.sync0_at
    if late < 0:
        return
    cycle = get32(esc.memory, R.SYNC0_CYCLE)
    _signal(esc)
    _next(esc, late // cycle + 1 if cycle else 1)


@block
def latch_input(esc, now, unit, rising):
    """Process an edge at the latch input `unit`: latch the system time as set in 09A8h."""
    memory = esc.memory
    single = memory[R.LATCH_CONTROL + unit] >> (0 if rising else 1) & 1
    bit = 1 if rising else 2
    if single and memory[R.LATCH_STATUS + unit] & bit:
        return
    memory[R.LATCH_STATUS + unit] |= bit
    at = R.LATCH_TIME + 16 * unit + (0 if rising else 8)
    put_time(esc, at, system_time(esc, now))
    memory[R.AL_EVENT] |= 1 << 1
    memory[R.ECAT_EVENT] |= 1


@block
def watchdog_time(esc, register):
    """Time of a watchdog (ns) in units of (0400h + 2) x 40 ns; 0 means off."""
    return get16(esc.memory, register) * (get16(esc.memory, R.WATCHDOG_DIVIDER) + 2) * 40
