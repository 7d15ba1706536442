"""A Luenberger observer of the speed, for encoders of few increments a revolution.

It estimates position, speed and load torque of an inertia that the drive accelerates, and corrects
them by the encoder, which counts as the middle of an increment. All three poles lie at the
bandwidth (Ellis: Observers in Control Systems, 4.5; the load as in 7.3).
"""

import math

from .jit import block
from .record import Axis


@block
def receive(axis: Axis):
    """Gains from bandwidth and inertia; -> whether it is on."""
    od = axis.od
    inertia = od.observer_inertia * 1e-12
    axis.observer_inertia = inertia if inertia > 0.0 else axis.inertia_feed_forward
    on = od.observer_bandwidth > 0 and axis.observer_inertia > 0.0
    # three equal poles of the error at p = exp(-w T), in a predictor and corrector of period T
    period = axis.velocity_period
    p = math.exp(-2 * math.pi * od.observer_bandwidth * 0.1 * period)
    axis.observer_gain[0] = 1.0 - p * p * p if on else 0.0
    axis.observer_gain[1] = 1.5 * (1.0 - p) * (1.0 - p) * (1.0 + p) / period
    axis.observer_gain[2] = (1.0 - p) * (1.0 - p) * (1.0 - p) / (period * period)
    if on:
        axis.velocity_filter = 0.0  # the speed is the observer's
    else:
        axis.observed[0] = math.nan
    return on


@block
def run(axis: Axis):
    """One velocity cycle: predict with the torque of the last one, correct by the encoder."""
    if axis.observer_gain[0] == 0.0:
        return
    seen = (axis.motor_counts + 0.5) * axis.rad_per_increment
    period = axis.velocity_period
    # it starts at power-on, and again half a turn off or with nan
    if axis.cycle_count <= 1 or not abs(axis.observed[0] - seen) < math.pi:
        axis.observed[0], axis.observed[1], axis.observed[2] = seen, 0.0, 0.0
    acceleration = axis.torque / axis.observer_inertia + axis.observed[2]
    position = axis.observed[0] + period * (axis.observed[1] + 0.5 * period * acceleration)
    speed = axis.observed[1] + period * acceleration
    error = seen - position
    axis.observed[0] = position + axis.observer_gain[0] * error
    axis.observed[1] = speed + axis.observer_gain[1] * error
    axis.observed[2] += axis.observer_gain[2] * error
    axis.velocity = axis.observed[1]
