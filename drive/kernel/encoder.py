"""The feedback: a quantised incremental encoder with an index pulse, and the axis switches.

It is sampled once a velocity cycle; the drive's own values (`counts`, `position`, `velocity`) never
use the true `shaft_angle` again. The encoder counts from its position at power-on, so an axis
has no reference until it is homed; its index pulse lies at every whole revolution of the shaft.
With `position_source` 1 positions, index and latches are those of a second encoder at the load, of
the same resolution, and only the speed is the motor's: dual-loop control.
"""

import math
from enum import IntEnum

from . import probe
from .faults import Cause, raise_fault
from .jit import block, rare
from .record import Axis


class Switch(IntEnum):
    """Bits of `AXIS.switches`, in the places digital inputs 60FDh give them (CiA 402-2)."""

    NEGATIVE_LIMIT = 0x1
    POSITIVE_LIMIT = 0x2
    HOME = 0x4


class Event(IntEnum):
    """What the position latch can wait for."""

    NONE = 0
    NEGATIVE_LIMIT_ON = 1
    NEGATIVE_LIMIT_OFF = 2
    POSITIVE_LIMIT_ON = 3
    POSITIVE_LIMIT_OFF = 4
    HOME_ON = 5
    HOME_OFF = 6
    INDEX = 7
    STOP = 8  # a mechanical stop; found by torque, not latched by the encoder


FARTHEST = 2.0**53  # increments a float64 angle still resolves one by one


@block
def sample(axis: Axis):
    """Read shaft angle and switches; latch positions at the awaited events."""
    exact = axis.shaft_angle / axis.rad_per_increment
    motor_counts = 0
    if abs(exact) < FARTHEST:
        motor_counts = int(math.floor(exact))
        if axis.od.position_source:
            exact = axis.load_angle / axis.rad_per_increment
    if not abs(exact) < FARTHEST or axis.injected >> Cause.ENCODER_LOSS & 1:  # also not a number
        raise_fault(axis, Cause.ENCODER_LOSS)
        return
    counts = int(math.floor(exact))
    switches = (
        axis.negative_limit_switch * Switch.NEGATIVE_LIMIT
        + axis.positive_limit_switch * Switch.POSITIVE_LIMIT
        + axis.home_switch * Switch.HOME
    ) ^ axis.switch_inversion
    if axis.od.limit_switch_selector:
        switches = switches & Switch.HOME | (switches & 1) << 1 | (switches & 2) >> 1
    if not axis.sampled:
        axis.sampled = 1
        axis.counts = counts
        axis.motor_counts = motor_counts
        axis.zero_counts = counts
        axis.switches = switches
        axis.probe_inputs = probe.read(axis)
    before, switches_before = axis.counts, axis.switches
    axis.counts = counts
    axis.switches = switches
    axis.position = (counts - axis.zero_counts) * axis.rad_per_increment
    moved = (motor_counts - axis.motor_counts) * axis.rad_per_increment
    axis.motor_counts = motor_counts
    axis.shaft_work += axis.torque * moved
    velocity = moved / axis.velocity_period
    axis.velocity += axis.velocity_filter * (velocity - axis.velocity)
    probe_inputs = probe.read(axis)
    waiting = 0 < axis.latch_event < Event.STOP and not axis.latched
    if waiting or probe.command(axis) != 0:
        index_counts, index_passed = _index(axis, before, counts)
        if waiting and axis.latch_event == Event.INDEX:
            axis.latched = index_passed
            axis.latch_counts = index_counts
        elif waiting:
            _latch_switch(axis, switches_before, switches, counts)
        probe.sample(axis, probe_inputs, index_counts, index_passed)
    axis.probe_inputs = probe_inputs


@rare
def _latch_switch(axis: Axis, before, now, counts):
    bit = 1 << ((axis.latch_event - 1) >> 1)
    wanted = bit if axis.latch_event & 1 else 0  # odd events wait for ON
    if (before ^ now) & bit and now & bit == wanted:
        axis.latched = 1
        axis.latch_counts = counts


@rare
def _index(axis: Axis, before, counts):
    """The last index pulse at or below the farther of two counts, and whether it was passed."""
    od = axis.od
    a, b = int(od.position_encoder_resolution[0]), int(od.position_encoder_resolution[1])
    revolution = max(a // max(b, 1), 1)
    last = max(before, counts) // revolution
    passed = last != min(before, counts) // revolution and not axis.index_missing
    return last * revolution, passed


@block
def set_zero(axis: Axis, zero_counts):
    """Move the axis zero to an encoder count; every position of the cycle moves with it."""
    shift = (zero_counts - axis.zero_counts) * axis.rad_per_increment
    axis.zero_counts = zero_counts
    axis.position -= shift
    axis.position_demand -= shift
    axis.segment_position -= shift
    axis.profile_position -= shift
    axis.interpolation_start -= shift
    axis.interpolation_target -= shift
    axis.interpolation_wanted -= shift
    axis.target -= shift
    axis.target_wanted -= shift
