"""Digital outputs by their functions (2420h), and what 60FEh switches directly.

Sources: Metronix ARS 2000 6.13.2.3, 6.13.2.4; Festo CMMP-AS 5.13. An output that 60FEh switches has
the function OFF or ON from then on, by SDO and by PDO. Functions for which the drive has no object
(remaining distance 4, comparison speed 6) or no hardware (15) are never on.
"""

from . import homing
from .faults import Cause
from .jit import block
from .record import Axis
from .statusword import POWERED, manufacturer_status
from .words import ManufacturerStatus

OFF, ON = 0, 12  # functions
NATIVE, FIRST_NATIVE = 3, 25  # DOUT1-DOUT3, bit of the first
OUTPUTS, FIRST_MORE = NATIVE + 8, 16  # those of a module behind them, bit of its first


@block
def run(axis: Axis):
    """Set `outputs` for this position cycle, in the bits of 60FEh."""
    if not axis.output_functions:
        return
    od = axis.od
    command, mask = int(od.digital_outputs[0]), int(od.digital_outputs[1])
    told = command == axis.outputs_told[0] and mask == axis.outputs_told[1]
    active = _active(axis)
    outputs = 0 if axis.brake_released else 1
    for i in range(OUTPUTS):
        bit = FIRST_NATIVE + i if i < NATIVE else FIRST_MORE + i - NATIVE
        if not told and mask >> bit & 1:
            _assign(axis, i, ON if command >> bit & 1 else OFF)
        if active >> _function(axis, i) & 1:
            outputs |= 1 << bit
    axis.outputs_told[0], axis.outputs_told[1] = command, mask
    axis.outputs = outputs


@block
def _function(axis: Axis, i):
    if i < NATIVE:
        return min(int(axis.od.output_function[i]), 62)
    i -= NATIVE
    return min(int(axis.od.output_function_more[i // 4]) >> 8 * (i % 4) & 0xFF, 62)


@block
def _assign(axis: Axis, i, function):
    if i < NATIVE:
        axis.od.output_function[i] = function
        return
    i -= NATIVE
    shift = 8 * (i % 4)
    others = int(axis.od.output_function_more[i // 4]) & ~(0xFF << shift)
    axis.od.output_function_more[i // 4] = others | function << shift


@block
def _active(axis: Axis):
    """The active functions as bits; those above 16 are Festo's."""
    shown = axis.warnings | axis.faults
    ready = manufacturer_status(axis) & ManufacturerStatus.READY_FOR_ENABLE
    return (
        1 << ON
        | (1 << 1 if axis.profile_done else 0)
        | (1 << 2 if axis.mode_bit10 else 0)
        | (1 << 5 if homing.busy(axis) else 0)
        | (1 << 7 if shown >> Cause.I2T & 1 else 0)
        | (1 << 8 if axis.following_error_exceeded else 0)
        | (1 << 9 if shown >> Cause.UNDERVOLTAGE & 1 else 0)
        | (1 << 10 if axis.brake_released else 0)
        | (1 << 11 if POWERED[axis.state] else 0)
        | (1 << 13 if axis.faults else 0)
        | (1 << 14 if axis.blocked else 0)
        | (1 << 16 if axis.homed else 0)
        | (1 << 17 if ready else 0)
        | (1 << 36 if axis.sto_input else 0)
        | (1 << 39 if axis.standstill else 0)
        | (1 << 42 if not axis.sto_input else 0)
        | (1 << 43 if not axis.sto_input else 0)
        | (1 << 44 if axis.mode_bit10 else 0)
    )
