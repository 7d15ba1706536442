"""Logarithmic scales of the distance to a goal: what it earns, and how it is seen."""

import math

from ...drive.kernel.jit import block


@block
def closeness(off, far):
    """1 where it is right to 0 where it is off by `far`, logarithmic from 1 on.

    `off` counts in tolerances. Each decade nearer earns about the same, so that there is something
    to gain from any distance.
    """
    return max(1.0 - math.log(1.0 + off) / math.log(1.0 + far), 0.0)


@block
def decades(off, far):
    """`off` with its sign on a logarithmic scale, -1 to 1 at `far`; about linear below 1."""
    share = math.log(1.0 + abs(off)) / math.log(1.0 + far)
    return math.copysign(min(share, 1.0), off)
