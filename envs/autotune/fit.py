"""Gains for required margins, by `plants.loops.fastest` with a measured plant."""

from collections.abc import Mapping

import numpy as np

from ..plants import loops
from ..plants.loops import LOWEST, Gains
from .response import Response


class Requirements(loops.RequiredMargins):
    """The smallest permitted margins of both loops, with a check of a measured response."""

    def kept(self, response: Response) -> bool:
        """Return whether a measured response has these margins."""
        velocity, position = response.velocity_margins, response.position_margins
        return position.measured and all(
            found.stable and found.sure >= self.gain and found.phase >= self.phase
            for found in (velocity, position)
        )


def fit(
    response: Response, asked: loops.RequiredMargins, ease: float = 1.0,
    allowed: Mapping[str, tuple[float, float]] = loops.ANY,
) -> Gains | None:
    """Return gains that keep the margins with a reserve; None without any.

    Args:
        response: a measured response with a fitted plant.
        asked: required margins.
        ease: share of the highest velocity gain that is used.
        allowed: gains that the drive accepts, as `plants.loops.ranges` returns them.
    """
    plants = [each.wide_plant for each in (response, *(other for _, other in response.also))]
    pid = response.gains.pid is not None
    return (loops.fastest_pid if pid else loops.fastest)(plants, asked, allowed, ease)


def why_not(response: Response, asked: Requirements) -> str:
    """Explain why the margins are not reached."""
    loops = {"velocity": response.velocity_margins, "position": response.position_margins}
    if not loops["position"].measured:
        return f"the position loop crosses over below {LOWEST:g} Hz, where nothing is measured"
    unstable = [name for name, found in loops.items() if not found.stable]
    if unstable and all(m.sure >= asked.gain and m.phase >= asked.phase for m in loops.values()):
        return (
            f"the {' and the '.join(unstable)} loop as measured goes round -1 (Nyquist), so its "
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
