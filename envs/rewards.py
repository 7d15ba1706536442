"""What several tasks reward the same way."""

import math

from ..drive.jit import block


@block
def closeness(off, far):
    """1 where it is right to 0 where it is off by `far`, logarithmic from 1 on.

    `off` counts in tolerances. Each decade nearer earns about the same, so that there is something
    to gain from any distance.
    """
    return max(1.0 - math.log(1.0 + off) / math.log(1.0 + far), 0.0)
