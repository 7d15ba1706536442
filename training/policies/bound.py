"""Bounds: no controller can be better in an episode, even with all drawn parameters given.

| task | quantity | what it follows from | |
|------|----------|----------------------|-|
| LinearAxis, Compliant | settling time | all torques within the limits, lag of the current loop, \
set-points at their top speed with the axis within the window of the following error | proven |
| GantrySway | settling time | the same, of the pendulum for small angles | inferred |
| GantrySync, Commissioning | settling time | set-points at their top speed | proven |
| Homing | settling time | all torques, and the top speed with `OVER` of overshoot | inferred |
| LinearAxisTracking | rms error | all torques, where the reference turns sharpest | proven |
| GantryContour | return | full feed and no error | proven |

"Proven" is for the physics as it is simulated, step by step, up to rounding: `bounds.times` and
`bounds.errors` give a certificate for each episode that does not depend on a solver. It holds for
motions whose following error stays within its window (beyond it for 10 ms the drive faults) and
that meet no end stop. A bound is not a promise: what lies between it and the best motion that was
played is not known.
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
from .bounds.plant import NotLinear, Plant, plant
from .bounds.times import Question, least_ticks, scipy

TAIL, SWINGING = 0.03, 0.2  # s, in the window that is looked at; where a load is on a spring
PERIOD = 2.0 * math.pi * math.sqrt(0.4 / 9.81)  # s, of the longest pendulum
HORIZON = 0.3  # s, that is tried first
OVER = 1.05  # of the top speed, that a velocity loop overshoots (inferred)
NOISE = 6.0  # standard deviations of the encoder's noise, that the following error may show
CSP = int(Mode.CYCLIC_SYNC_POSITION)


class Bound:
    """The limit of what is possible in an episode that has begun; it is not a controller.

    Raises:
        ImportError: scipy is missing.
        ValueError: nothing is known to bound the task, or its mechanics are not linear.
    """

    def __init__(self, env: ServoEnv, seed: int = 0):
        scipy()
        if env.BOUND not in BOUNDS:
            raise ValueError(f"policy 'bound': no bound is known for {env.ID}")
        self._env, self._of = env, BOUNDS[env.BOUND]
        try:
            plant(env, 1)
        except NotLinear as error:
            raise ValueError(f"policy 'bound': {error}") from None

    def values(self) -> dict[str, float]:
        """The best possible value of each metric."""
        return self._of(self._env)


def _least(make: Callable[[int], Plant], asked: Question, delay: int) -> float:
    """The time until a load has settled (s), over the shortest sufficient horizon."""
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
    """Physics steps before the first command arrives; without noise nothing moves until then."""
    return 0 if env.machine.couplings[d]["noise"] > 0.0 else int(env.machine.world["delay"][0])


def _set_points(env: Any, d: int = 0) -> dict[str, float]:
    """The top speed of the set-points, and the distance by which an axis can lead them."""
    coupling, od = env.machine.couplings[d], env.machine.axes[d]["od"]
    units = env.units
    ahead = float(od["following_error_window"]) + 2.0  # of rounding
    return {
        "speed": float(env.episode._way) / env.step_time,
        "ahead": ahead / units + NOISE * float(coupling["noise"]),
    }


def _positioned(env: Any) -> dict[str, float]:
    """A load behind one axis, physics step by physics step."""
    aim = env.settling()
    swings = bool(probe.elastic(env.machine))
    limits = _set_points(env) if int(env.MODES[0]) == CSP else {}
    asked = Question(
        aim["goal"], aim["window"], 1, _ticks(env, env.STEPS * env.step_time),
        _ticks(env, SWINGING if swings else TAIL), **limits,
    )
    return {"settling_time": _least(partial(plant, env), asked, _delay(env))}


def _swayed(env: Any) -> dict[str, float]:
    """A pendulum behind each axis, agent step by agent step, for small angles."""
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
    """The middle of the bridge, which the two set-points bring there."""
    limits = [_set_points(env, d) for d in range(2)]
    here = float(env.machine.data.qpos[int(env.episode._bridge_at)])
    way = abs(float(env.episode.goal) - here) - env.tolerance
    way -= sum(limit["ahead"] for limit in limits) / 2.0
    step = limits[0]["speed"] * env.step_time
    return {"settling_time": max(math.ceil(way / step) - 1, 0) * env.step_time}


def _homed(env: Any) -> dict[str, float]:
    """To the true reference, where it is taken a step before the episode ends."""
    episode = env.episode
    asked = Question(
        float(episode._home), env.tolerance, 1, _ticks(env, env.STEPS * env.step_time), 1,
        speed=OVER * float(episode._max_velocity), ahead=env.tolerance,
    )
    seconds = _least(partial(plant, env), asked, _delay(env))
    return {"settling_time": max(seconds - env.step_time, 0.0)}


def _commissioned(env: Any) -> dict[str, float]:
    """Wait for the cause to clear, search the switch, and move to the goal by profile.

    Ramps count once each; states, edges and the end of the homing take no time.
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
    """The load along the reference, at the end of each step of the agent."""
    episode, every = env.episode, _ticks(env, env.step_time)
    reference = np.array(episode._position[: env.STEPS + 1])
    whole = plant(env, (2 * SIDE + 1) * every)
    squares = least_squares(whole, reference, every, float(episode._age))
    return {"load_error": 1e6 * math.sqrt(squares / env.STEPS)}


def _contoured(env: Any) -> dict[str, float]:
    """No known effect keeps the tool from following the contour at full feed."""
    return {"episode_return": float(env.STEPS), "contour_error": 0.0}


BOUNDS: dict[str, Callable[[Any], dict[str, float]]] = {  # by `Task.BOUND`
    "positioned": _positioned,
    "tracked": _tracked,
    "swayed": _swayed,
    "squared": _squared,
    "contoured": _contoured,
    "homed": _homed,
    "commissioned": _commissioned,
}
INFERRED = ("swayed", "homed")  # the others are proven
