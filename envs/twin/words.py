"""Describes the parameters that a fit cannot determine, and the moves that would."""

import numpy as np

from .candidates import LAG
from .fit import GOOD, Fitted

WIDE = 0.15  # half an interval over the value, above which a parameter is poorly known
TIED = 0.97  # correlation above which two estimates can no longer be separated
GAINS = "read the gains from the drive (--read-gains)"
RING = "let it ring out: add a short, sharp move and a rest of half a second"
MOVES = {  # advice that separates two parameters, and the kind of moves (`plan.KINDS`) for it
    frozenset(("payload", "coulomb_friction")): (
        "two accelerations separate them; add a move at half the acceleration", "acceleration"),
    frozenset(("payload", "velocity_gain")): (
        f"{GAINS}, or add a move at the torque limit", "acceleration"),
    frozenset(("coulomb_friction", "viscous_friction")): (
        "two speeds separate them; add moves at a third of the speed", "speed"),
    frozenset(("coulomb_friction", "load_force")): (
        "both directions separate them; add the same moves back", "speed"),
    frozenset(("payload", "load_stiffness")): (
        "a sweep over the resonance separates them; add a sine of the set-point that rises from "
        "5 to 100 Hz", "sweep"),
    frozenset(("load_stiffness", "load_damping")): (RING, "ring"),
    frozenset(("transmission_stiffness", "transmission_damping")): (RING, "ring"),
    frozenset(("velocity_gain", "position_gain")): (GAINS, ""),
    frozenset(("velocity_gain", "integral_time")): (GAINS, ""),
}
ALONE = {
    "payload": ("add moves with more acceleration", "acceleration"),
    "inertia": ("add moves with more acceleration", "acceleration"),
    "coulomb_friction": ("add slow moves in both directions", "slow"),
    "viscous_friction": (
        "add long moves at the highest speed and at a third of it", "speed"),
    "load_force": ("add the same moves in both directions", "slow"),
    "load_stiffness": ("add short, sharp moves, or a sweep over the resonance", "sweep"),
    "load_damping": ("add short, sharp moves with a rest behind each", "ring"),
    "transmission_stiffness": ("add short, sharp moves, or a sweep over the resonance", "sweep"),
    "transmission_damping": ("add short, sharp moves with a rest behind each", "ring"),
    "backlash": ("add short, slow moves in both directions", "slow"),
}
OTHERS = ("record moves that differ more in speed and acceleration", "acceleration")
ALWAYS = (
    "The torque is the one that the drive reports: masses, frictions and stiffnesses are as "
    "accurate as its torque constant. A second log with a known added payload would determine it."
)
COARSE = (
    "With so few increments a turn, inertia, friction and gains compensate one another: the "
    "motion is right, but single parameters may be half as large again, so no intervals are given."
)
MISSED = (
    ". In profile position a write of the profile that the logger has missed does the same: look "
    "at the pictures for single motions that are off, and record again"
)
SWINGING = 0.2  # torque at rest of the highest one, above which the axis does not stand still


def doubts(fitted: Fitted) -> list[str]:
    """Sentences about parameters that this log does not determine; none if it determines all."""
    if fitted.increment:
        return [COARSE, *_limit_cycle(fitted)]
    return [text for text, _ in _open(fitted)]


def missing(fitted: Fitted) -> tuple[str, ...]:
    """Kinds of moves (`plan.KINDS`) that would determine the open parameters, each once."""
    return tuple(dict.fromkeys(kind for _, kind in _open(fitted) if kind))


def _open(fitted: Fitted) -> list[tuple[str, str]]:
    """Sentences about open parameters, each with the kind of moves that it requires."""
    said: list[tuple[str, str]] = []
    estimate = fitted.estimate
    names = [free.name for free in estimate.free]
    correlation = estimate.correlation()
    friction = max(fitted.values.get("coulomb_friction", 0.0), 1e-9)
    poor = set()
    for name in names:
        if name == LAG:
            continue
        low, high = estimate.interval(name)
        scale = friction if name == "load_force" else max(abs(fitted.values[name]), 1e-12)
        if (high - low) / 2 > WIDE * scale:
            poor.add(name)
    paired: set[str] = set()
    for i, first in enumerate(names):
        for k in range(i):
            pair = frozenset((first, names[k]))
            if abs(correlation[i, k]) > TIED and LAG not in pair and pair & poor:
                advice, kind = MOVES.get(pair, OTHERS)
                text = f"{names[k]} and {first} are hard to separate with this log: {advice}."
                said.append((text, kind))
                paired |= pair
    for name in names:
        if name in poor and name not in paired:
            low, high = estimate.interval(name)
            advice, kind = ALONE.get(name, (GAINS, ""))
            said.append((f"{name} is uncertain ({low:.3g} to {high:.3g}): {advice}.", kind))
    return said


def _limit_cycle(fitted: Fitted) -> list[str]:
    """A sentence about an axis that oscillates between increments when it should be at rest."""
    measured, twin = [], []
    for experiment, run in zip(fitted.whole, fitted.simulated, strict=True):
        measured.append(experiment.torque[~experiment.moving])
        twin.append(run.torque[0][~experiment.moving])
    there, here = (float(np.std(np.concatenate(each))) for each in (measured, twin))
    highest = max(float(np.abs(each.torque).max()) for each in fitted.whole)
    if there < SWINGING * highest:
        return []
    return [
        "At rest the axis oscillates between increments of its encoder: its torque is "
        f"{there:.3g} Nm rms, that of the twin {here:.3g}. The instants at which it passes an edge "
        "cannot be predicted, so torque at rest is not compared."
    ]


def verdict(fitted: Fitted) -> str:
    """The verdict in a sentence."""
    scale, unit = (1e6, "µm") if fitted.unit == "m" else (1e6, "µrad")
    figures = f"held-out position error {scale * fitted.held_position:.3g} {unit} rms, " + (
        f"{fitted.held_position / fitted.increment:.2f} increments of the encoder"
        if fitted.increment
        else f"{fitted.ratio:.2f} times what the encoder's noise alone would leave "
        f"({scale * fitted.floor_position:.3g} {unit})"
    )
    if fitted.fitted_ratio > max(fitted.ratio, GOOD):
        figures += f"; in the fitted part {fitted.fitted_ratio:.2f} times"
    if not fitted.complete:
        return f"interrupted: the best so far, without intervals; {figures}"
    if fitted.verdict == "good":
        return f"good: trust it; {figures}"
    if fitted.verdict == "fair":
        return f"fair: trust the motion, use the parameters with care; {figures}"
    return (
        f"refused: do not trust it; {figures}. The family {fitted.family.name} does not describe "
        "this axis, or the drive model, its gains or its units differ: try --mechanics auto, "
        "--read-gains" + (MISSED if any(each.events for each in fitted.whole) else "")
    )
