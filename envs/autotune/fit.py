"""Gains for a measured plant and margins asked for: the fastest loops that keep them.

The velocity loop is a PI controller with an action time of `SHAPES` over its crossover (symmetrical
optimum: 3). The position loop is to keep a phase margin of 60 degrees at least, so that a move does
not overshoot. Of all that keep the margins the stiffest is taken, kp (kv + 1 / Ti): the torque
against a disturbance that lasts as long as the loops are fast.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from .response import Response
from .stand import Gains

SHAPES = (3.0, 5.0, 10.0)  # action time times crossover
SEPARATIONS = (2.0, 2.8, 4.0, 5.6, 8.0, 12.0, 20.0, 40.0)  # crossover over position gain
WITHOUT_OVERSHOOT = 60.0  # degree
STEP = 1.15  # between gains that are tried
LOWEST = 2.0  # Hz, crossover of a rigid plant
HIGHEST = 0.35  # of the position-controller rate, same
EASED = (1.0, 0.75, 0.5)  # of the highest velocity gain, that leave more for the position
RESERVE_GAIN, RESERVE_PHASE = 1.0, 3.0  # dB and degree over what is asked for


@dataclass(frozen=True)
class Asked:
    """Margins of both loops, at least."""

    gain: float = 6.0  # dB
    phase: float = 35.0  # degree

    def kept(self, response: Response) -> bool:
        """Whether a response has them."""
        return all(
            found.stable and found.gain >= self.gain and found.phase >= self.phase
            for found in (response.velocity_margins, response.position_margins)
        )


def fit(response: Response, asked: Asked, ease: float = 1.0) -> Gains | None:
    """Gains that keep the margins with a reserve; None: there are none.

    Args:
        response: of the plant, with a fitted one.
        asked: margins.
        ease: share of the velocity gain that was found to use, 1 for all of it.
    """
    best: tuple[float, Gains] | None = None
    for highest, shape in _velocity(response, asked):
        for share in EASED:
            found = _position(response, highest * share * ease, shape, asked)
            if found and (best is None or _stiffness(found) > best[0]):
                best = _stiffness(found), found
    return best[1] if best else None


def _stiffness(gains: Gains) -> float:
    return gains.velocity_gain * (gains.position_gain + 1 / gains.integral_time)


def _velocity(response: Response, asked: Asked) -> Iterator[tuple[float, float]]:
    """Highest crossover of a rigid plant (rad/s), and shape, of velocity loops with margins."""
    top = 2 * math.pi * HIGHEST / (response.cycle * response.cycles)
    for shape in SHAPES:
        crossover = top
        while crossover > 2 * math.pi * LOWEST:
            found = response.with_gains(_gains(response, crossover, shape, 0.0)).velocity_margins
            if (
                found.stable
                and found.gain >= asked.gain + RESERVE_GAIN
                and found.phase >= asked.phase + RESERVE_PHASE
            ):
                yield crossover, shape
                break
            crossover /= STEP


def _position(
    response: Response, crossover: float, shape: float, asked: Asked
) -> Gains | None:  # fmt: skip
    """The highest position gain that keeps the margins behind a velocity loop."""
    phase = max(asked.phase + RESERVE_PHASE, WITHOUT_OVERSHOOT)
    for separation in SEPARATIONS:
        gains = _gains(response, crossover, shape, crossover / separation)
        behind = response.with_gains(gains)
        found = behind.position_margins
        if found.stable and found.gain >= asked.gain + RESERVE_GAIN and found.phase >= phase:
            inner = behind.velocity_margins
            if inner.gain >= asked.gain and inner.phase >= asked.phase:
                return gains
    return None


def _gains(response: Response, crossover: float, shape: float, position: float) -> Gains:
    assert response.fitted is not None
    return Gains(
        velocity_gain=response.inertia * crossover,
        integral_time=shape / crossover,
        position_gain=position,
    )


def why_not(response: Response, asked: Asked) -> str:
    """What stands in the way of the margins, in words."""
    loops = {"velocity": response.velocity_margins, "position": response.position_margins}
    turning = [name for name, found in loops.items() if not found.stable]
    if turning and all(m.gain >= asked.gain and m.phase >= asked.phase for m in loops.values()):
        return (
            f"the {' and the '.join(turning)} loop as measured goes round -1 (Nyquist), so its "
            "margins are no proof; measure with a larger amplitude"
        )
    assert response.fitted is not None
    delay = response.fitted.delay + 1.5 * response.cycle
    found = ", ".join(map(str, response.fitted.resonances)) or "none"
    poor = float(np.mean(response.coherence < 0.8))
    return (
        f"no gains give {asked.gain:g} dB and {asked.phase:g}°: delay {delay * 1e6:.0f} µs, "
        f"antiresonance/resonance {found}, {poor:.0%} of the frequencies are not coherent; ask for "
        "less, or measure with a larger amplitude"
    )
