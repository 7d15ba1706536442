"""Filters of the torque command: two notch filters, then a low-pass.

A notch is (s² + 2 d g w s + w²) / (s² + 2 d w s + w²) with the damping d of its poles and the gain
g at its frequency w, discretised by Tustin's method with prewarping at w (Åström, Wittenmark:
Computer-Controlled Systems, 8.3).
"""

import math

from .jit import block
from .record import Axis

NOTCHES = 2


@block
def receive(axis: Axis):
    """Coefficients of the filters from the objects; -> whether any acts."""
    od = axis.od
    time = od.torque_command_filter_time * 1e-6
    axis.command_filter = 1.0 - math.exp(-axis.velocity_period / time) if time > 0.0 else 1.0
    acts = time > 0.0
    for i in range(NOTCHES):
        for k in range(5):
            axis.notch[i, k] = 0.0
        axis.notch[i, 0] = 1.0
        frequency = od.notch_frequency[i] * 0.1
        if 0.0 < frequency < 0.49 / axis.velocity_period:
            _notch(axis, i, 2 * math.pi * frequency)
            acts = True
    return acts


@block
def _notch(axis: Axis, i, w):
    damping = axis.od.notch_damping[i] * 1e-3
    t = math.tan(0.5 * w * axis.velocity_period)
    pole, zero = 2.0 * damping * t, 2.0 * damping * axis.od.notch_depth[i] * 1e-3 * t
    below = 1.0 + pole + t * t
    axis.notch[i, 0] = (1.0 + zero + t * t) / below
    axis.notch[i, 1] = axis.notch[i, 3] = 2.0 * (t * t - 1.0) / below
    axis.notch[i, 2] = (1.0 - zero + t * t) / below
    axis.notch[i, 4] = (1.0 - pole + t * t) / below


@block
def run(axis: Axis, torque):
    """A torque command (Nm) behind the filters."""
    for i in range(NOTCHES):
        out = axis.notch[i, 0] * torque + axis.notch_state[i, 0]
        axis.notch_state[i, 0] = (
            axis.notch[i, 1] * torque - axis.notch[i, 3] * out + axis.notch_state[i, 1]
        )
        axis.notch_state[i, 1] = axis.notch[i, 2] * torque - axis.notch[i, 4] * out
        torque = out
    axis.command_filtered += axis.command_filter * (torque - axis.command_filtered)
    return axis.command_filtered


@block
def clear(axis: Axis):
    """Reset the filters to zero torque."""
    axis.command_filtered = 0.0
    for i in range(NOTCHES):
        axis.notch_state[i, 0] = axis.notch_state[i, 1] = 0.0
