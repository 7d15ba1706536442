"""Homing: a scripted search as a PLC would make it, and the methods of the drive itself."""

from collections.abc import Callable, Mapping
from functools import partial

from ...envs.environment.servo_env import METRE
from .datasheet import Datasheet
from .numbers import Range, Tunable
from .profiles import of_the_drive
from .script import Script, Steps

NEGATIVE, POSITIVE, HOME = "negative_limit_switch", "positive_limit_switch", "home_switch"
# Shares of the top speed; `ramp` limits the change in a step. The ranges are those of the tuner.
SPEEDS = {
    "fast": Range(0.2, 1.0, 0.6), "back": Range(0.02, 1.0, 0.2), "again": Range(0.01, 1.0, 0.1),
    "slow": Range(0.002, 0.1, 0.01), "ramp": Range(0.02, 1.0, 0.05),
}
# The legs of a search: direction, speed, and the switch with the value that ends the leg.
LEGS = {
    "home_switch": (
        (1, "fast", HOME, True), (-1, "back", HOME, False), (1, "again", HOME, True),
        (-1, "slow", HOME, False),
    ),
    "negative_limit_switch": ((-1, "fast", NEGATIVE, True), (1, "slow", NEGATIVE, False)),
}
TO_LIMIT = 2.0 / 3.0  # of the fast speed, towards a limit switch
# The quickest methods to the same homes from either side of the start. To the home switch it is the
# one in the negative direction, because the way beyond the switch is shorter there.
FASTEST = {"home_switch": 30, "negative_limit_switch": 17, "stop": -17}
SHARE_OF_TOLERANCE = 0.2  # the most that the slow speed covers between two samples of the inputs


def search(datasheet: Datasheet, legs, speeds: Mapping[str, float]) -> Steps:
    """Travel along `legs`, then declare home; a positive limit switch reverses the first leg.

    The last leg stops without a ramp.
    """
    ramp = speeds["ramp"]
    velocity, seen = 0.0, datasheet.named((yield datasheet.action(torque_limit=1, reference=-1)))
    for i, (direction, speed, switch, value) in enumerate(legs):
        wanted = direction * speeds[speed] * (TO_LIMIT if switch == NEGATIVE and i == 0 else 1.0)
        while (seen[switch] > 0.5) != value:
            if i == 0 and seen[POSITIVE] > 0.5:
                wanted = -abs(wanted)
            velocity = min(max(wanted, velocity - ramp), velocity + ramp)
            action = datasheet.action(velocity=velocity, torque_limit=1, reference=-1)
            seen = datasheet.named((yield action))
    yield datasheet.action(torque_limit=1, reference=1)


def to_stop(datasheet: Datasheet) -> Steps:
    """Push against the end stop with little torque until the axis stands, then declare home."""
    seen = datasheet.named((yield datasheet.action(torque_limit=-0.8, reference=-1)))
    standing = step = 0
    while standing < 20:
        step += 1
        pushing = step > 50 and abs(seen.velocity) < 2e-3 and seen.torque < -0.02
        standing = standing + 1 if pushing else 0
        velocity = max(-0.2, -0.01 * step)
        seen = datasheet.named(
            (yield datasheet.action(velocity=velocity, torque_limit=-0.8, reference=-1))
        )
    yield datasheet.action(torque_limit=-0.8, reference=1)


def search_policy(datasheet: Datasheet, seed: int = 0) -> Script:
    """Return the search for the reference of the task."""
    return Script(_searched(datasheet, {name: one.untuned for name, one in SPEEDS.items()}))


def _searched(datasheet: Datasheet, speeds: Mapping[str, float]) -> Callable[[], Steps]:
    """Return a script that searches for the reference of the task at given speeds."""
    legs = LEGS.get(datasheet.reference)
    return partial(search, datasheet, legs, speeds) if legs else partial(to_stop, datasheet)


class TunedSearch(Script, Tunable):
    """The search at the speeds of the tuner."""

    NAME, RANGES = "tuned_search", SPEEDS

    def __init__(self, datasheet: Datasheet, seed: int = 0):
        super().__init__(_searched(datasheet, self.numbers(datasheet.task)))


class BuiltIn:
    """A homing method of the drive, which replaces the agent for the whole episode.

    Args:
        datasheet: of the environment.
        method: 6098h; by default that of the task's reference, or with `fast` the quickest method
            with the same home.
        fast: use the speeds and the acceleration that the task permits, not those commissioned.
    """

    def __init__(self, datasheet: Datasheet, method: int | None = None, *, fast: bool = False):
        by_default = FASTEST[datasheet.reference] if fast else datasheet.homing_method
        self.method = by_default if method is None else method
        self.objects = _fast(datasheet) if fast else {}


def _fast(datasheet: Datasheet) -> dict[str, int]:
    """Return objects for a homing at an agent's top speed, with a slow part that is accurate."""
    axis = datasheet.axis
    slow = min(SHARE_OF_TOLERANCE * datasheet.tolerance / datasheet.sampling, axis.speed)
    speeds = {
        "speed_during_search_for_switch": axis.speed,
        "speed_during_search_for_zero": slow,
        "homing_acceleration": of_the_drive(axis).acceleration,
    }
    return {name: round(value * METRE) for name, value in speeds.items()}
