"""Homing: a scripted search as a PLC would make it, and the methods of the drive itself."""

from functools import partial

import numpy as np

from ...envs.servo_env import METRE
from ...envs.tasks.homing import REFERENCES
from .known import Known
from .profiles import of_the_drive
from .script import Script, Steps

RAMP = 0.05  # change of the velocity a step, to be gentle
NEGATIVE, POSITIVE, HOME = range(3)  # places of the switches in an observation
# The legs of a search: velocity, switch, the value it has to take. Fast, back off, slow.
LEGS = {
    "home_switch": (
        (0.6, HOME, True), (-0.2, HOME, False), (0.1, HOME, True), (-0.01, HOME, False),
    ),
    "negative_limit_switch": ((-0.4, NEGATIVE, True), (0.01, NEGATIVE, False)),
}  # fmt: skip
# To the same places, whichever side the start is on: to the home switch negative first, because the
# way beyond it is shorter there.
FASTEST = {"home_switch": 30, "negative_limit_switch": 17, "stop": -17}
SHARE_OF_TOLERANCE = 0.2  # that the slow speed may pass in a cycle in which inputs are sampled


def search(legs) -> Steps:
    """Travel by `legs`, then declare; a positive limit switch turns the first leg round.

    The last leg stops without a ramp.
    """
    velocity, seen = 0.0, (yield np.array([0, 1, -1], np.float32))
    for i, (wanted, switch, value) in enumerate(legs):
        while (seen[switch] > 0.5) != value:
            if i == 0 and seen[POSITIVE] > 0.5:
                wanted = -abs(wanted)
            velocity = min(max(wanted, velocity - RAMP), velocity + RAMP)
            seen = yield np.array([velocity, 1, -1], np.float32)
    yield np.array([0, 1, 1], np.float32)


def to_stop() -> Steps:
    """Push against the end with little torque until it stands, then declare."""
    seen = yield np.array([0, -0.8, -1], np.float32)
    standing = step = 0
    while standing < 20:
        step += 1
        standing = standing + 1 if step > 50 and abs(seen[3]) < 2e-3 and seen[4] < -0.02 else 0
        seen = yield np.array([max(-0.2, -0.01 * step), -0.8, -1], np.float32)
    yield np.array([0, -0.8, 1], np.float32)


def search_policy(known: Known, seed: int = 0) -> Script:
    """The search for the reference of the task."""
    legs = LEGS.get(known.reference)
    return Script(partial(search, legs) if legs else to_stop)


class BuiltIn:
    """A homing method of the drive: it takes the place of the agent for the whole episode.

    Args:
        known: of the environment.
        method: 6098h; if not given the one for the reference of the task, or with `fast` the
            quickest to the same place.
        fast: with the speeds and the acceleration the task allows, instead of those commissioned.
    """

    def __init__(self, known: Known, method: int | None = None, *, fast: bool = False):
        by_default = FASTEST if fast else {name: row[0] for name, row in REFERENCES.items()}
        self.method = by_default[known.reference] if method is None else method
        self.objects = _fast(known) if fast else {}


def _fast(known: Known) -> dict[str, int]:
    """Objects for a homing as fast as an agent may be, the slow part within the tolerance."""
    axis = known.axis
    slow = min(SHARE_OF_TOLERANCE * known.tolerance / known.sampling, axis.speed)
    speeds = {
        "speed_during_search_for_switch": axis.speed,
        "speed_during_search_for_zero": slow,
        "homing_acceleration": of_the_drive(axis).acceleration,
    }
    return {name: round(value * METRE) for name, value in speeds.items()}
