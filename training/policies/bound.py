"""Bounds: no controller can be better in an episode, even with all drawn parameters given.

| task | quantity | what it follows from | |
|------|----------|----------------------|-|
| LinearAxis, Compliant | settling time | all torques within the limits, lag of the current loop, \
set-points at their top speed with the axis within the window of the following error | proven |
| RotaryAxis | settling time | the same; set-points at their top speed if its gear is not linear \
| proven |
| GantrySway | settling time | the same, of the pendulum for small angles | inferred |
| Robot | settling time, return | set-points of each joint within their speed and acceleration \
| proven |
| GantrySync, Commissioning | settling time | set-points at their top speed | proven |
| Homing | settling time | all torques, and the top speed with `OVER` of overshoot | inferred |
| LinearAxisTracking | rms error | all torques, where the reference turns sharpest | proven |
| GantryContour | return | full feed and no error | proven |

A proven bound holds for the physics as it is simulated, step by step, up to rounding:
`bounds.times` and `bounds.errors` give a certificate for each episode that does not depend on a
solver. It covers motions whose following error stays within its window (the drive faults after
10 ms outside it) and that meet no end stop. A bound need not be attainable: nothing is known about
the range between it and the best motion that was played.
"""

import math
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from ...drive.kernel.words import Mode
from ...envs.engine import probe
from ...envs.engine.tick import NEGATIVE
from ...envs.environment.servo_env import METRE, ServoEnv
from .bounds.errors import SIDE, least_squares
from .bounds.plant import LOAD, NotLinear, Plant, plant
from .bounds.times import Question, least_ticks, scipy

TAIL, SWINGING = 0.03, 0.2  # s that the load has to stay in the window; with a load on a spring
PERIOD = 2.0 * math.pi * math.sqrt(0.4 / 9.81)  # s, of the longest pendulum
HORIZON = 0.3  # s, the first one tried
OVER = 1.05  # of the top speed, the overshoot of a velocity loop (inferred)
NOISE = 6.0  # standard deviations of the encoder's noise that the following error may contain
CSP = int(Mode.CYCLIC_SYNC_POSITION)


class Bound:
    """The limit of what is possible in an episode that has begun; it is not a controller.

    Raises:
        ImportError: scipy is missing.
        ValueError: no bound is known for the task, or only for linear mechanics.
    """

    def __init__(self, env: ServoEnv, seed: int = 0):
        scipy()
        if env.BOUND not in BOUNDS:
            raise ValueError(f"policy 'bound': no bound is known for {env.ID}")
        self._env, self._of = env, BOUNDS[env.BOUND]
        if env.BOUND in LINEAR:
            try:
                plant(env, 1)
            except NotLinear as error:
                raise ValueError(f"policy 'bound': {error}") from None

    def values(self) -> dict[str, float]:
        """The best possible value of each metric."""
        return self._of(self._env)


def _least(make: Callable[[int], Plant], asked: Question, delay: int) -> float:
    """Return the least time until a load has settled (s), over the shortest sufficient horizon."""
    steps = min(round(HORIZON / make(1).timestep), asked.last)
    while True:
        whole = make(steps)
        found = least_ticks(whole, asked._replace(last=steps))
        if steps == asked.last or found + 2 * asked.ticks < steps - asked.tail:
            return (found + delay) * whole.timestep
        steps = min(2 * steps, asked.last)


def _ticks(env: Any, seconds: float) -> int:
    return round(seconds / float(env.machine.model.opt.timestep))


def _delay(env: Any, d: int = 0) -> int:
    """Return the physics steps until the first command arrives, before which nothing moves.

    With encoder noise the loops move the axis meanwhile, so the delay counts as 0.
    """
    return 0 if env.machine.couplings[d]["noise"] > 0.0 else int(env.machine.world["delay"][0])


def _ahead(env: Any, d: int = 0) -> float:
    """The distance by which an axis can lead its set-point (m or rad)."""
    window = float(env.machine.axes[d]["od"]["following_error_window"]) + 2.0  # of rounding
    return window / env.units + NOISE * float(env.machine.couplings[d]["noise"])


def _set_points(env: Any, d: int = 0) -> dict[str, float]:
    """The top speed of the set-points, and the distance by which an axis can lead them."""
    return {"speed": float(env.episode._way) / env.step_time, "ahead": _ahead(env, d)}


def _farthest(most: float, ramp: float, left: float, steps: int) -> np.ndarray:
    """Return how far a set-point can be from its start after 0, 1, 2 … `steps` steps.

    Each step is as large as it may be such that the set-point can still stop within `left`. No
    other sequence of steps is ahead of this one at any time.

    Args:
        most: the largest step (m or rad).
        ramp: by how much a step can differ from the one before (m or rad).
        left: where the set-point has to stop at the latest (m or rad), may be infinite.
        steps: how many.
    """
    terms = np.arange(math.ceil(most / ramp)) + 1.0  # of the steps until it stands
    spared = 0.5 * ramp * (terms - 1.0)
    places, step = np.zeros(steps + 1), 0.0
    for n in range(steps):
        stopping = float(np.min((left - places[n]) / terms + spared))
        step = max(min(step + ramp, most, stopping), 0.0)
        places[n + 1] = places[n] + step
    return places


def _arrival(way: float, near: float, most: float, ramp: float, steps: int) -> int:
    """Return the number of steps before a set-point is within `near` of its goal and stays there.

    An episode counts as settled from the last step at which it was not.

    Args:
        way: from the start to the goal (m or rad).
        near: the tolerance, and how far the axis can be ahead of its set-point (m or rad).
        most: the largest step of the set-point (m or rad).
        ramp: by how much a step can differ from the one before (m or rad).
        steps: of an episode.
    """
    there = _farthest(most, ramp, way + near, steps) >= way - near
    return max(int(np.argmax(there)) - 1, 0) if there.any() else steps


def _positioned(env: Any) -> dict[str, float]:
    """Bound a load behind one axis, at physics steps."""
    aim = env.settling()
    swings = bool(probe.elastic(env.machine))
    limits = _set_points(env) if int(env.MODES[0]) == CSP else {}
    asked = Question(
        aim["goal"], aim["window"], 1, _ticks(env, env.STEPS * env.step_time),
        _ticks(env, SWINGING if swings else TAIL), **limits,
    )
    return {"settling_time": _least(partial(plant, env), asked, _delay(env))}


def _swayed(env: Any) -> dict[str, float]:
    """Bound a pendulum behind each axis, at the agent's steps, for small angles."""
    episode, seconds = env.episode, []
    for d in range(len(env.drives)):
        arm = {int(episode._sway_at[d]): float(episode._length)}
        every = _ticks(env, env.step_time)
        asked = Question(
            float(episode._goal[d]), env.tolerance, every, every * env.STEPS,
            _ticks(env, PERIOD), resting=env.resting, **_set_points(env, d),
        )
        seconds.append(_least(partial(plant, env, d=d, arm=arm), asked, _delay(env, d)))
    return {"settling_time": max(seconds)}


def _squared(env: Any) -> dict[str, float]:
    """Bound the middle of the bridge, which moves with the mean of the two set-points."""
    here = float(env.machine.data.qpos[int(env.episode._bridge_at)])
    way = abs(float(env.episode.goal) - here)
    near = env.tolerance + sum(_ahead(env, d) for d in range(2)) / 2.0
    most = float(env.episode._way)
    return {"settling_time": _arrival(way, near, most, most, env.STEPS) * env.step_time}


def _turned(env: Any) -> dict[str, float]:
    """Bound the position that the drive measures, at the agent's steps, the shorter way round.

    A gear with backlash or losses is not linear; there the bound follows from set-points alone.
    """
    episode, every = env.episode, _ticks(env, env.step_time)
    here, period = float(episode._target), float(episode._period)
    way = float(episode.goal) - here
    way -= period * math.floor(way / period + 0.5)
    near, most = env.tolerance + _ahead(env), float(episode._way)
    seconds = _arrival(abs(way), near, most, most, env.STEPS) * env.step_time
    make = partial(plant, env, arm=None if env.datasheet.load_encoder else {})
    try:
        begin = float(make(1).free[0, LOAD])
    except NotLinear:
        return {"settling_time": seconds}
    within = env.tolerance + 2.0 / env.units  # of rounding
    asked = [
        Question(
            begin + goal, within, every, every * env.STEPS, _ticks(env, TAIL), **_set_points(env)
        )
        for goal in (way, way - math.copysign(period, way))
    ]
    least = min(_least(make, each, _delay(env)) for each in asked)
    return {"settling_time": max(seconds, least)}


def _reached(env: Any) -> dict[str, float]:
    """Bound the joint that is last at its goal, by speed and acceleration of its set-point."""
    episode, steps = env.episode, env.STEPS
    settled, away = 0, np.zeros(steps)  # of the joint farthest from its goal, after each step
    for d in np.flatnonzero(episode._sought).tolist():
        way, ahead = abs(float(episode._goal[d] - episode._target[d])), _ahead(env, d)
        limits = float(episode._way[d]), float(episode._ramp[d])
        settled = max(settled, _arrival(way, env.tolerance + ahead, *limits, steps))
        away = np.maximum(away, way - ahead - _farthest(*limits, math.inf, steps)[1:])
    return {
        "settling_time": settled * env.step_time,
        "episode_return": float(env.highest_reward(away).sum()),
    }


def _homed(env: Any) -> dict[str, float]:
    """Bound the way to the true home, which is declared a step before the episode ends."""
    episode = env.episode
    asked = Question(
        float(episode._home), env.tolerance, 1, _ticks(env, env.STEPS * env.step_time), 1,
        speed=OVER * float(episode._max_velocity), ahead=env.tolerance,
    )
    seconds = _least(partial(plant, env), asked, _delay(env))
    return {"settling_time": max(seconds - env.step_time, 0.0)}


def _commissioned(env: Any) -> dict[str, float]:
    """Bound the wait for the cause to clear, the search for the switch and the move to the goal.

    Of each motion one ramp counts; states, edges and the end of the homing take no time.
    """
    drive, episode, coupling = env.drive, env.episode, env.machine.couplings[0]
    ahead = float(env.machine.axes[0]["od"]["following_error_window"]) / METRE
    edge = float(coupling["switch_to"][NEGATIVE])
    here = float(env.machine.data.qpos[int(coupling["qpos"])])
    seconds = episode.outage * env.step_time - env.step_time
    for way, speed, rate in (
        (here - edge, "speed_during_search_for_switch", "homing_acceleration"),
        (float(episode.goal) - env.tolerance, "profile_velocity", "profile_acceleration"),
    ):
        top, ramp = drive.read(speed) / METRE, drive.read(rate) / METRE
        seconds += max(way - ahead, 0.0) / top + 0.5 * top / ramp
    return {"settling_time": max(float(seconds), 0.0)}


def _tracked(env: Any) -> dict[str, float]:
    """Bound the error of the load along the reference, at the end of each step of the agent."""
    episode, every = env.episode, _ticks(env, env.step_time)
    reference = np.array(episode._position[: env.STEPS + 1])
    whole = plant(env, (2 * SIDE + 1) * every)
    squares = least_squares(whole, reference, every, float(episode._age))
    return {"load_error": 1e6 * math.sqrt(squares / env.STEPS)}


def _contoured(env: Any) -> dict[str, float]:
    """Bound the contour by full feed without error: no known effect excludes it."""
    return {"episode_return": float(env.STEPS), "contour_error": 0.0}


BOUNDS: dict[str, Callable[[Any], dict[str, float]]] = {  # by `Task.BOUND`
    "positioned": _positioned,
    "turned": _turned,
    "reached": _reached,
    "tracked": _tracked,
    "swayed": _swayed,
    "squared": _squared,
    "contoured": _contoured,
    "homed": _homed,
    "commissioned": _commissioned,
}
LINEAR = ("positioned", "tracked", "swayed", "homed")  # need linear mechanics
INFERRED = ("swayed", "homed")  # the others are proven
