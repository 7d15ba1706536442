"""Logarithmic scales of the distance to a goal, for rewards and observations."""

import math

from ...drive.kernel.jit import block


@block
def closeness(off, far):
    """Return 1 for a deviation `off` of 0, falling logarithmically to 0 at `far`.

    Both count in tolerances. Each decade closer gains about the same, so that progress pays at any
    distance.
    """
    return max(1.0 - math.log(1.0 + off) / math.log(1.0 + far), 0.0)


@block
def decades(off, far):
    """Return `off` on a signed logarithmic scale, ±1 at ±`far`, nearly linear below 1."""
    share = math.log(1.0 + abs(off)) / math.log(1.0 + far)
    return math.copysign(min(share, 1.0), off)
