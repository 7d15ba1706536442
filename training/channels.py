"""What a trace shows of an environment, task by task: quantities with their units.

Each is read from MjData, from the record of the episode, or from those of the drives.
"""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from ..envs.servo_env import METRE
from ..envs.tasks.commissioning import CommissioningEnv
from ..envs.tasks.compliant import CompliantAxisEnv
from ..envs.tasks.contour import CENTRE, GantryContourEnv, point
from ..envs.tasks.gantry_sync import GantrySyncEnv
from ..envs.tasks.homing import HomingEnv
from ..envs.tasks.positioning import LinearAxisEnv
from ..envs.tasks.sway import GantrySwayEnv
from ..envs.tasks.tracking import LinearAxisTrackingEnv

SWITCHED_OFF = 0xFFFFFFFF  # of a window
MM, DEGREE = 1e3, math.degrees(1.0)
Quantity = Callable[[Any], float]  # of an environment, in the unit of its channel


class Channel(NamedTuple):
    """A panel: its label with unit, and what it shows of an environment."""

    label: str
    value: Quantity
    aim: Quantity | None = None  # reference or goal
    window: Quantity | None = None  # half of what is allowed, to both sides of the aim or of 0
    nearest: float = math.inf  # so many windows are shown, what lies beyond is out of the picture
    wide: bool = False  # the window is wide beside the values: linear near 0, logarithmic beyond


def _position(env: Any) -> float:
    """Of what a linear axis moves, with all that is elastic behind it (m)."""
    return float(env.machine.data.qpos.sum())


def _velocity(env: Any) -> float:
    return float(env.machine.data.qvel.sum())


def _goal(env: Any) -> float:
    return MM * float(env.episode.goal)


def _in_mm(quantity: Quantity) -> Quantity:
    return lambda env: MM * quantity(env)


def _reference(env: Any) -> float:
    return float(env.episode._position[env.episode._now])


def _home(env: Any) -> float:
    return float(env.episode._home)


def _tolerance(env: Any) -> float:
    return MM * float(env.tolerance)


def _joint(env: Any, name: str) -> tuple[float, float]:
    """Coordinate and velocity of a joint (m and m/s, or rad and rad/s)."""
    joint = env.machine.data.joint(name)
    return float(joint.qpos[0]), float(joint.qvel[0])


def _hanging(env: Any) -> tuple[float, float]:
    """Position (m) and velocity (m/s) in X of a load on a cable."""
    (bridge, velocity), (angle, rate) = _joint(env, "x"), _joint(env, "sway_x")
    length = env.episode._length
    return bridge + length * math.sin(angle), velocity + length * math.cos(angle) * rate


def _tool(d: int) -> Channel:
    """Position of the tool of a gantry in X or Y, and the point of the path."""
    name = "xy"[d]
    return Channel(
        f"tool in {name.upper()}\n(mm)",
        lambda env: MM * _joint(env, name)[0],
        lambda env: MM * (
            CENTRE[d] + point(env.episode._contour, env.episode._radius, env.episode._way, d)
        ),
    )  # fmt: skip


def _largest(env: Any, values: np.ndarray) -> float:
    """Of the drives the agent commands the one farthest from 0, with its sign."""
    own = values[: len(env.drives)]
    return float(own[np.abs(own).argmax()])


def _window(env: Any) -> float:
    window = int(env.machine.axes["od"]["following_error_window"][0])
    return math.nan if window == SWITCHED_OFF else float(window)


def _torque(env: Any) -> float:
    """Share of the rated torque."""
    return _largest(env, env.machine.axes["torque"] / env.machine.axes["rated_torque"])


def _torque_limit(env: Any) -> float:
    """The one in force, which may be that of the I²t monitoring; share of the rated torque."""
    axes = env.machine.axes
    limit = np.minimum(axes["torque_limit_positive"], axes["torque_ceiling"])
    return _largest(env, limit / axes["rated_torque"])


def _axis(what: str, *more: Channel) -> tuple[Channel, ...]:
    """Of a linear axis that has to reach a goal and stay there."""
    return (
        Channel(f"{what}\n(mm)", _in_mm(_position), _goal),
        Channel(
            f"{what} beyond\nthe goal (mm)",
            lambda env: MM * (_position(env) - env.episode.goal),
            window=_tolerance, nearest=15.0,
        ),
        Channel(f"velocity of the\n{what} (m/s)", _velocity),
        *more,
    )  # fmt: skip


CHANNELS: dict[str, tuple[Channel, ...]] = {
    LinearAxisEnv.ID: _axis("carriage"),
    LinearAxisTrackingEnv.ID: (
        Channel("carriage\n(mm)", _in_mm(_position), _in_mm(_reference)),
        Channel("tracking error\n(µm)", lambda env: METRE * (_reference(env) - _position(env))),
        Channel("velocity\n(m/s)", _velocity),
    ),
    CompliantAxisEnv.ID: _axis(
        "load", Channel("deflection of\nthe load (mm)", lambda env: MM * _joint(env, "load")[0])
    ),
    HomingEnv.ID: (
        Channel("carriage\n(mm)", _in_mm(_position), _in_mm(_home)),
        Channel(
            "beyond the true\nreference (mm)",
            lambda env: MM * (_position(env) - _home(env)),
            window=_tolerance, nearest=30.0,
        ),
        Channel("velocity\n(m/s)", _velocity),
    ),
    CommissioningEnv.ID: (
        Channel("carriage\n(mm)", _in_mm(_position), _goal),
        Channel("milestones\nreached", lambda env: float(env.episode.milestones)),
        Channel("velocity\n(m/s)", _velocity),
    ),
    GantrySyncEnv.ID: (
        Channel("bridge\n(mm)", lambda env: MM * _joint(env, "x")[0], _goal),
        Channel(
            "bridge beyond\nthe goal (mm)",
            lambda env: MM * (_joint(env, "x")[0] - env.episode.goal),
            window=_tolerance, nearest=15.0,
        ),
        Channel(
            "skew of the\nbridge (mm)", lambda env: MM * float(env.episode.skew),
            window=lambda env: MM * env.skew_tolerance,
        ),
        Channel("velocity of the\nbridge (m/s)", lambda env: _joint(env, "x")[1]),
    ),
    GantryContourEnv.ID: (
        _tool(0), _tool(1),
        Channel(
            "outside of the\ncontour (µm)", lambda env: METRE * float(env.episode.contour_error),
            window=lambda env: METRE * env.tolerance,
        ),
        Channel(
            "speed of the\ntool (m/s)",
            lambda env: math.hypot(_joint(env, "x")[1], _joint(env, "y")[1]),
        ),
    ),
    GantrySwayEnv.ID: (
        Channel(
            "load in X\n(mm)", lambda env: MM * _hanging(env)[0],
            lambda env: MM * env.episode.goal_x,
        ),
        Channel(
            "load beyond\nthe goal (mm)",
            lambda env: MM * (_hanging(env)[0] - env.episode.goal_x),
            window=_tolerance, nearest=15.0,
        ),
        Channel("velocity of the\nload (m/s)", lambda env: _hanging(env)[1]),
        Channel("sway in X\n(degrees)", lambda env: DEGREE * _joint(env, "sway_x")[0]),
    ),
}  # fmt: skip


def _drives(following_error: str, torque: str) -> tuple[Channel, ...]:
    """Of the drives, in every task."""
    return (
        Channel(
            following_error,
            lambda env: _largest(env, env.machine.axes["od"]["following_error_actual_value"]),
            window=_window, wide=True,
        ),
        Channel(torque, _torque, window=_torque_limit),
    )  # fmt: skip


ONE_DRIVE = _drives("following error\n(µm)", "torque / rated")
TWO_DRIVES = _drives("larger following\nerror (µm)", "larger torque\n/ rated")


def channels(task: str) -> tuple[Channel, ...]:
    """Of a task by its id: its own, and those of the drives."""
    several = task in (GantrySyncEnv.ID, GantryContourEnv.ID)
    return CHANNELS[task] + (TWO_DRIVES if several else ONE_DRIVE)
