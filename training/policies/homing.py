"""Homing: a scripted search as a PLC would make it, and the methods of the drive itself."""

from functools import partial

import numpy as np

from ...envs.tasks.homing import REFERENCES
from .known import Known
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
        method: 6098h; the one for the reference of the task if not given.
    """

    def __init__(self, known: Known, method: int | None = None):
        self.method = REFERENCES[known.reference][0] if method is None else method
