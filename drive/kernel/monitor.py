"""Monitoring: following error, position and velocity windows, standstill, overspeed.

Windows and times as in CiA 402-2: 6065h/6066h, 6067h/6068h, 606Dh/606Eh, 606Fh/6070h. Times are
whole position cycles; a time of 0 acts at once.
"""

from . import homing
from .cascade import Control, energised
from .faults import Cause, raise_fault
from .jit import block
from .record import FAULT_CAUSES, Axis
from .words import Mode

OVERSPEED = 1.2  # of the maximum motor speed (inferred)


@block
def run(axis: Axis):
    """Compare the demand of this cycle with what the encoder showed at its beginning."""
    _following_error(axis)
    _standstill(axis)
    _set_points(axis)
    if axis.connection_lost and axis.od.abort_connection_option_code == 1:
        raise_fault(axis, Cause.CONNECTION)
    if axis.rpdo_timeout:
        raise_fault(axis, Cause.RPDO_TIMEOUT)
    if axis.rpdo_too_short:
        raise_fault(axis, Cause.RPDO_TOO_SHORT)
    if axis.injected != 0:
        for cause in range(1, FAULT_CAUSES):
            if axis.injected >> cause & 1:
                raise_fault(axis, cause)
    if abs(axis.velocity) > OVERSPEED * axis.max_speed:
        raise_fault(axis, Cause.OVERSPEED)


@block
def _following_error(axis: Axis):
    axis.following_error = axis.position_demand - axis.position
    if not energised(axis) or axis.control != Control.POSITION or homing.pushing(axis):
        axis.following_error_timer = 0
        if energised(axis):
            axis.following_error = 0.0
            axis.following_error_exceeded = 0
        return
    if abs(axis.following_error) > axis.position_error_limit:
        raise_fault(axis, Cause.POSITION_ERROR)
    if abs(axis.following_error) <= axis.following_error_window:
        axis.following_error_timer = 0
        axis.following_error_exceeded = 0
        return
    axis.following_error_timer += 1
    if axis.following_error_timer > axis.following_error_cycles:
        axis.following_error_exceeded = 1
        raise_fault(axis, Cause.FOLLOWING_ERROR)


@block
def _standstill(axis: Axis):
    if abs(axis.velocity) <= axis.velocity_threshold:
        axis.standstill_timer = 0
        axis.standstill = 1
        return
    axis.standstill_timer += 1
    if axis.standstill_timer > axis.velocity_threshold_cycles:
        axis.standstill = 0


@block
def _set_points(axis: Axis):
    """Cyclic set-points that came with process data must not stay away (2019h)."""
    cyclic = (axis.mode >= Mode.CYCLIC_SYNC_POSITION or axis.sync_monitored) and energised(axis)
    axis.silence = axis.silence + 1 if cyclic and axis.synchronised else 0
    allowed = int(axis.od.set_point_loss_limit)
    if allowed > 0 and axis.silence > (allowed + 1) * axis.interpolation_cycles:
        raise_fault(axis, Cause.SET_POINT_LOSS)


@block
def in_window(axis: Axis, deviation, window, cycles):
    """Whether `deviation` has been inside `window` for `cycles` position cycles."""
    axis.window_timer = axis.window_timer + 1 if abs(deviation) <= window else 0
    return axis.window_timer > cycles
