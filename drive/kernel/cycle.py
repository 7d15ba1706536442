"""One control cycle: the block diagram of a servo drive, in the order the signals take.

Every velocity cycle: sample feedback, [position cycle], velocity controller, torque.
Every position cycle: power models, device control, brake, mode of operation, position controller,
monitoring, publish.
"""

from . import (
    brake,
    cascade,
    dc_link,
    device_control,
    encoder,
    factors,
    faults,
    homing,
    modes,
    monitor,
    sync,
    thermal,
)
from .jit import block, entry
from .record import Axis
from .words import Mode


@block
def velocity_cycle(axis: Axis):
    """One velocity-controller cycle: `shaft_angle` and switches in, `torque` out."""
    if axis.velocity_cycle == 0 and axis.parameters_changed:
        factors.receive(axis)
    encoder.sample(axis)
    if axis.velocity_cycle == 0:
        position_cycle(axis)
    cascade.velocity_loop(axis)
    axis.velocity_cycle += 1
    if axis.velocity_cycle == axis.velocity_cycles:
        axis.velocity_cycle = 0


@block
def position_cycle(axis: Axis):
    """One position-controller cycle on the latest sample."""
    if axis.set_position_wanted:
        factors.set_position(axis)
    sync.run(axis)
    thermal.run(axis)
    dc_link.run(axis)
    device_control.run(axis)
    brake.run(axis)
    faults.expire_warnings(axis)
    axis.faults_present = 0
    modes.demand(axis)
    if homing.pushing(axis):
        axis.torque_ceiling = min(axis.torque_ceiling, axis.homing_torque)
    if axis.mode != Mode.PROFILE_TORQUE:
        axis.torque_ceiling = min(axis.torque_ceiling, axis.current_limit)
    cascade.position_loop(axis)
    monitor.run(axis)
    modes.status(axis)
    factors.publish(axis)
    axis.cycle_count += 1


@entry
def run(axes, index, angle, speed):
    """One position cycle of ``axes[index]`` on a shaft at `angle` (rad) moving at `speed` (rad/s).

    The shaft keeps its speed within the cycle. Returns the torque (Nm) of the last velocity cycle.
    """
    axis = axes[index]
    for _ in range(axis.velocity_cycles):
        axis.shaft_angle = axis.load_angle = angle
        velocity_cycle(axis)
        angle += speed * axis.velocity_period
    return axis.torque
