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
    limits,
    modes,
    monitor,
    outputs,
    sync,
    thermal,
)
from .factors.units import FRACTION_LIMIT
from .jit import block, entry
from .record import FAULT_CAUSES, IP_RECORDS, SEGMENTS, SET_POINTS, Axis
from .words import Mode, State

LAST_STATE = len(State) - 1
LAST_ERROR = len(homing.CAUSE) - 1
MOST_CYCLES = 1 << 16  # velocity cycles in a position cycle


@block
def velocity_cycle(axis: Axis):
    """One velocity-controller cycle: `shaft_angle` and switches in, `torque` out."""
    if axis.velocity_cycle == 0:
        _bring_in(axis)
        if axis.parameters_changed:
            factors.receive(axis)
    encoder.sample(axis)
    if axis.velocity_cycle == 0:
        position_cycle(axis)
    cascade.velocity_loop(axis)
    axis.velocity_cycle += 1
    if not 0 < axis.velocity_cycle < axis.velocity_cycles:
        axis.velocity_cycle = 0


@block
def _bring_in(axis: Axis):
    """Limit indices and divisors to their ranges, as a program may have written the record."""
    axis.state = min(max(axis.state, 0), LAST_STATE)
    axis.fault_raised = min(max(axis.fault_raised, 0), FAULT_CAUSES - 1)
    axis.homing_leg = min(max(axis.homing_leg, 0), homing.LAST_LEG)
    axis.homing_error = min(max(axis.homing_error, 0), LAST_ERROR)
    axis.segments = min(max(axis.segments, 0), SEGMENTS)
    axis.segment = min(max(axis.segment, 0), axis.segments)
    axis.set_points = min(max(axis.set_points, 0), SET_POINTS)
    axis.ip_first = min(max(axis.ip_first, 0), IP_RECORDS - 1)
    axis.ip_records = min(max(axis.ip_records, 0), IP_RECORDS)
    axis.interpolation_cycles = max(axis.interpolation_cycles, 1)
    axis.position_numerator = min(max(axis.position_numerator, 1), FRACTION_LIMIT)
    axis.position_denominator = min(max(axis.position_denominator, 1), FRACTION_LIMIT)


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
    limits.by_source(axis)
    modes.demand(axis)
    if homing.pushing(axis):
        axis.torque_ceiling = min(axis.torque_ceiling, axis.homing_torque)
    if axis.mode != Mode.PROFILE_TORQUE:
        axis.torque_ceiling = min(axis.torque_ceiling, axis.current_limit)
    cascade.position_loop(axis)
    monitor.run(axis)
    modes.status(axis)
    outputs.run(axis)
    factors.publish(axis)
    axis.cycle_count += 1


@entry
def run(axes, index, angle, speed):
    """One position cycle of ``axes[index]`` on a shaft at `angle` (rad) moving at `speed` (rad/s).

    The shaft keeps its speed within the cycle. Returns the torque (Nm) of the last velocity cycle.
    """
    axis = axes[index]
    for _ in range(min(axis.velocity_cycles, MOST_CYCLES)):
        axis.shaft_angle = axis.load_angle = angle
        velocity_cycle(axis)
        angle += speed * axis.velocity_period
    return axis.torque
