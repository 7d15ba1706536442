"""Squares the bridge of a gantry with two drives in X."""

from collections.abc import Callable

from ...drive.kernel.words import Mode
from ...drive.master.master import Master
from ..plants.gantry import Gantry
from .port import MachinePort


def square(
    gantry: Gantry, *, max_twist: float = 0.01, timeout: float = 60.0,
    on_step: Callable[[], None] | None = None,
) -> float:
    """Home ``x1`` and ``x2`` together and bring both to position 0; -> the remaining skew (m).

    Both drives start in the same SYNC at the same speed, so the skew of the bridge stays constant
    until each side has found its own switch. The home offsets 607Ch compensate switches that are
    out of square. A sensor on the bridge is assumed to measure the skew.

    Args:
        gantry: a gantry with two drives in X.
        max_twist: change of the skew (m) at which both drives stop, because a switch was missed.
        timeout: longest duration of the homing (s).
        on_step: called after every cycle.

    Raises:
        ValueError: the gantry has no drives x1 and x2, or `max_twist` is not above 0 m.
        ServoError: Refused if a mode is missing, Interlock if the bridge twists too far, or as
            `Master.home`.
    """
    if not max_twist > 0.0:
        raise ValueError(f"max_twist = {max_twist!r} is out of range: give more than 0 m")
    pair = Master(MachinePort(gantry, on_step), "x1", "x2")
    begin = gantry.skew

    def alarm() -> str:
        twist = abs(gantry.skew - begin)
        return f"the bridge is twisted by {twist * 1e3:.1f} mm" if twist > max_twist else ""

    pair.set_mode(Mode.HOMING)
    pair.enable()
    pair.home(timeout=timeout, alarm=alarm)
    pair.move_to(0.0, timeout=60.0)
    return gantry.skew
