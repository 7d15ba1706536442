"""Stops, which the option codes 605Ah-605Eh select, with real ramps.

A stop replaces the demand of the mode until device control or the end of a halt removes it.
Sources: CiA 402-2, quick stop, shutdown, disable operation, halt and fault reaction option codes.
Current limit and voltage limit differ in a real drive by what bounds the braking torque; without a
model of the DC link both brake at the torque limit (inferred).
"""

from enum import IntEnum

from .cascade import Control
from .jit import block, rare
from .ramps import (
    DOWN,
    NO_JERK_LIMIT,
    QUICK_STOP,
    advance,
    close_position_loop,
    plan_velocity,
    profile_jerk,
    rest,
    vl_rate,
)
from .record import Axis
from .words import Mode


class Stop(IntEnum):
    """How the axis is brought to rest."""

    NONE = 0  # the drive function is disabled, the motor coasts
    SLOW_DOWN_RAMP = 1  # deceleration of the mode
    QUICK_STOP_RAMP = 2  # 6085h
    CURRENT_LIMIT = 3
    VOLTAGE_LIMIT = 4


# option code -> (stop, the state is kept afterwards). 605Bh and 605Ch use codes 0-1, 605Dh 1-4,
# 605Eh 0-4, 605Ah 0-8.
OPTION_STOP = (0, 1, 2, 3, 4, 1, 2, 3, 4)
OPTION_STAYS = (0, 0, 0, 0, 0, 1, 1, 1, 1)
LAST_OPTION = 8

PATIENCE = 1.0  # s after the demand has stopped; then the stop counts as finished (inferred)


@rare
def begin(axis: Axis, stop):
    """Start to stop the axis from its present demand."""
    axis.stop = stop
    axis.stop_cycles = 0
    if stop == Stop.NONE:
        return
    close_position_loop(axis)
    if stop >= Stop.CURRENT_LIMIT:
        rest(axis)
        axis.control = Control.VELOCITY
        return
    plan(axis, stop)


@block
def plan(axis: Axis, stop):
    """Plan the ramp to standstill of a kind of stop."""
    rate = axis.deceleration
    jerk = profile_jerk(axis)
    if stop >= Stop.QUICK_STOP_RAMP:
        rate = axis.quick_stop_deceleration
        if axis.mode == Mode.VELOCITY:
            rate = vl_rate(axis, QUICK_STOP, axis.velocity_demand)
        jerk = NO_JERK_LIMIT
    elif axis.mode == Mode.HOMING:
        rate = axis.homing_acceleration
    elif axis.mode == Mode.VELOCITY:
        rate = vl_rate(axis, DOWN, axis.velocity_demand)
        jerk = NO_JERK_LIMIT
    plan_velocity(axis, 0.0, rate, rate, jerk)


@block
def option(code):
    """An option code as an index of the tables, limited to their range.

    Objects refuse other values, but a program may write them to the record.
    """
    return min(max(int(code), 0), LAST_OPTION)


@block
def limit_switch_rate(axis: Axis):
    """Deceleration at a limit switch (rad/s²): an object of some models, or the quick stop's."""
    if axis.limit_deceleration > 0.0:
        return axis.limit_deceleration
    return axis.quick_stop_deceleration


@block
def at_limit_switch(axis: Axis):
    """Brake a move at a limit switch, with its own deceleration or the stop of 2017h."""
    if axis.limit_deceleration > 0.0:
        rate = axis.limit_deceleration
        plan_velocity(axis, 0.0, rate, rate, NO_JERK_LIMIT)
    else:
        plan(axis, OPTION_STOP[option(axis.od.limit_switch_reaction)])


@block
def demand(axis: Axis):
    """Demand of the stop in force; at the end the position is held."""
    axis.stop_cycles += 1
    if axis.control == Control.VELOCITY:
        rest(axis)
        axis.control = Control.VELOCITY if abs(axis.velocity) > axis.velocity_threshold else 0
        return
    advance(axis)


@block
def finished(axis: Axis):
    """Whether demand and axis stand still, or with `stop_by_demand` the demand has run down."""
    if axis.stop_by_demand:
        return _run_down(axis)
    if not axis.profile_done:
        return False
    if abs(axis.velocity) <= axis.velocity_threshold and axis.control == Control.POSITION:
        return True
    return axis.stop_cycles * axis.position_period > _patience(axis)


@block
def _run_down(axis: Axis):
    """Whether the demand is below `stop_velocity` for a time, or DC braking has ended."""
    time = axis.stop_cycles * axis.position_period
    if axis.stop == Stop.CURRENT_LIMIT:
        return time >= axis.dc_brake_time
    slow = abs(axis.velocity_demand) <= axis.stop_velocity
    axis.hold_cycles = axis.hold_cycles + 1 if slow else 0
    return axis.hold_cycles * axis.position_period > axis.stop_hold_time


@block
def _patience(axis: Axis):
    """Longest time a stop may take (s): the ramp from full speed, and PATIENCE."""
    slowest = min(axis.deceleration, axis.quick_stop_deceleration)
    return axis.max_speed / slowest + PATIENCE
