"""Interpolated position: data records 60C1h from a buffer, one a period 60C2h (CiA 402-2, ip).

Every latched process image, and every change of 60C1h:01, puts a record into the buffer 60C4h while
60C4h:06 gives access. With enable_ip_mode (controlword bit 4) the drive takes one record a period
and moves linearly to it. A FIFO refuses records when it is full, a ring overwrites the oldest. When
the buffer runs empty the drive holds the last position. Sub mode -2 (60C0h, as Festo CMMP-AS and
Metronix ARS 2000 have it) is linear interpolation without a buffer: the newest record acts at once.
"""

from .. import sync
from ..cascade import energised
from ..jit import block, rare
from ..ramps import close_position_loop
from ..record import IP_RECORDS, Axis
from ..words import Controlword, Latched
from . import csp

RING = 1
UNBUFFERED = -2


@rare
def start(axis: Axis):
    """Hold the position; the buffer keeps its records."""
    close_position_loop(axis)
    csp.hold(axis)
    axis.ip_active = 0


@block
def receive(axis: Axis):
    """Put a new data record into the buffer."""
    od = axis.od
    unbuffered = od.interpolation_sub_mode_select == UNBUFFERED
    size = 1 if unbuffered else min(int(od.interpolation_actual_buffer_size), IP_RECORDS)
    if not od.interpolation_buffer_clear:
        axis.ip_records = 0
    elif axis.sync == Latched.CYCLIC or axis.ip_data != axis.last_ip_data:
        if unbuffered:
            axis.ip_records = 0
        if axis.ip_records >= size and od.interpolation_buffer_organization == RING:
            _take(axis)
        if axis.ip_records < size:
            relative = axis.interpolation_target if od.interpolation_data_relative else 0.0
            place = (axis.ip_first + axis.ip_records) % IP_RECORDS
            axis.ip_buffer[place] = relative + axis.ip_data
            axis.ip_records += 1
    od.interpolation_buffer_position = axis.ip_records


@block
def _take(axis: Axis):
    first = axis.ip_first
    axis.ip_first = (first + 1) % IP_RECORDS
    axis.ip_records -= 1
    return axis.ip_buffer[first]


@block
def demand(axis: Axis):
    """Interpolate one position cycle further; at the end of a period take the next record."""
    asked = int(axis.od.controlword) & Controlword.NEW_SET_POINT != 0
    enabled = asked and sync.locked(axis)
    sync.wait(axis, asked and not enabled)
    if not enabled and axis.ip_active:
        csp.hold(axis)
    axis.ip_active = enabled
    at_once = axis.od.interpolation_sub_mode_select == UNBUFFERED
    ready = at_once or axis.interpolation_cycle >= axis.interpolation_cycles
    if enabled and ready and axis.ip_records > 0:
        csp.aim(axis, _take(axis), at_once and axis.sync == Latched.CYCLIC)
    csp.travel(axis, 0.0)


@block
def status(axis: Axis):
    """target_reached: nothing is left to do; ip_mode_active."""
    resting = axis.ip_records == 0 and axis.interpolation_cycle >= axis.interpolation_cycles
    axis.mode_bit10 = axis.standstill if axis.halted else energised(axis) and resting
    axis.mode_bit12 = energised(axis) and axis.ip_active
