"""SYNC of the bus in the drive's time grid, which interpolated position of some models needs.

Sources: Festo CMMP-AS 7.4.3, Metronix ARS 2000 8.4.3.2: 6061h shows -1 until the drive has
synchronised, and again when SYNC leaves its grid. How many SYNCs it takes, and how far from the
period 60C2h they may come, is inferred.
"""

from .cascade import energised
from .faults import Cause, raise_fault
from .jit import block
from .record import Axis
from .words import Mode

LOCK = 3  # SYNCs in the grid, one after the other (inferred)
TOLERANCE = 1  # position cycle (inferred)
PATIENCE = 100  # periods for the first lock, with enable_ip_mode (inferred)


@block
def run(axis: Axis):
    """Measure the time between two SYNCs, once a position cycle."""
    was_locked = locked(axis)
    axis.sync_gap += 1
    if axis.sync_pulse:
        early_or_late = abs(axis.sync_gap - axis.interpolation_cycles) > TOLERANCE
        axis.sync_good = 0 if early_or_late else min(axis.sync_good + 1, LOCK)
        axis.sync_gap = 0
        axis.sync_pulse = 0
    elif axis.sync_gap > axis.interpolation_cycles + TOLERANCE:
        axis.sync_good = 0
    in_use = axis.mode == Mode.INTERPOLATED_POSITION and axis.ip_active and energised(axis)
    if was_locked and in_use and not locked(axis):
        raise_fault(axis, Cause.SYNC_LOST)


@block
def wait(axis: Axis, waiting):
    """Raise the fault of a drive that is `waiting` for SYNC for too long (Festo B.3, 34-0)."""
    axis.sync_wait = axis.sync_wait + 1 if waiting else 0
    if axis.sync_wait > PATIENCE * axis.interpolation_cycles:
        raise_fault(axis, Cause.NO_SYNC)


@block
def locked(axis: Axis):
    """Whether interpolated position may run."""
    return not axis.ip_needs_sync or axis.sync_good >= LOCK
