"""The holding brake: released with the enabled operation, engaged before the power goes off.

The delays follow Festo CMMP-AS, 6510h:18 brake_delay_time. After enabling, set-points wait until
the brake is released; before an orderly power-off the motor holds the axis until the brake is
engaged. If the power goes off at once (disable voltage, severe faults, STO), the brake engages
after its own delay. While the motor is off, 60FEh bit 0 with its mask engages (1) or releases (0)
it.
"""

from .cascade import energised
from .jit import block
from .record import Axis


@block
def run(axis: Axis):
    """Command the brake for this position cycle; the plant reads `brake_released`."""
    od = axis.od
    release = 1
    if od.brake_fitted:
        release = 1 if energised(axis) and not axis.brake_gripping else 0
        if not energised(axis) and od.digital_outputs[1] & 1:
            release = 0 if od.digital_outputs[0] & 1 else 1
    if release != axis.brake_released:
        axis.brake_released = release
        axis.brake_timer = 0
    axis.brake_timer += 1


@block
def waits(axis: Axis):
    """Whether set-points still wait for the brake to be released."""
    if not axis.od.brake_fitted:
        return False
    return not axis.brake_released or axis.brake_timer <= axis.brake_release_cycles


@block
def gripped(axis: Axis):
    """Engage the brake; True once it holds and the power stage may go off."""
    if not axis.od.brake_fitted:
        return True
    axis.brake_gripping = 1
    return not axis.brake_released and axis.brake_timer > axis.brake_engage_cycles
