"""What a picture of an episode shows: quantities of an environment over the time, a panel each.

Each is read from MjData, from the record of the episode, or from those of the drives.
"""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from .about import in_unit

SWITCHED_OFF = 0xFFFFFFFF  # of a window
MM, UM = 1e3, 1e6
Quantity = Callable[[Any], float]  # of an environment, in the unit of its channel


class Channel(NamedTuple):
    """A panel: its label with unit, and what it shows of an environment."""

    label: str
    value: Quantity
    aim: Quantity | None = None  # reference or goal
    window: Quantity | None = None  # half of what is allowed, to both sides of the aim or of 0
    nearest: float = math.inf  # so many windows are shown, what lies beyond is out of the picture
    wide: bool = False  # the window is wide beside the values: linear near 0, logarithmic beyond


def joint(env: Any, name: str) -> tuple[float, float]:
    """Coordinate and velocity of a joint (m and m/s, or rad and rad/s)."""
    joint = env.machine.data.joint(name)
    return float(joint.qpos[0]), float(joint.qvel[0])


def position(env: Any) -> float:
    """Position of the load of a linear axis, behind all elasticity (m)."""
    return float(env.machine.data.qpos.sum())


def velocity(env: Any) -> float:
    """Velocity of the load of a linear axis (m/s)."""
    return float(env.machine.data.qvel.sum())


def goal(env: Any) -> float:
    """``goal`` of the episode (mm); not a number where a task has none."""
    return MM * float(getattr(env.episode, "goal", math.nan))


def tolerance(env: Any) -> float:
    """Return the tolerance of the task (mm)."""
    return MM * float(env.tolerance)


def in_mm(quantity: Quantity) -> Quantity:
    """Convert a quantity from m to mm."""
    return lambda env: MM * quantity(env)


def linear_axis(what: str, *more: Channel) -> tuple[Channel, ...]:
    """Channels of a linear axis that has to settle at ``episode.goal`` within ``tolerance``."""
    return (
        Channel(f"{what}\n(mm)", in_mm(position), goal),
        Channel(
            f"{what} beyond\nthe goal (mm)", lambda env: MM * (position(env) - env.episode.goal),
            window=tolerance, nearest=15.0,
        ),
        Channel(f"velocity of the\n{what} (m/s)", velocity),
        *more,
    )


def _driven(env: Any, coordinates: np.ndarray, place: str) -> float:
    return float(coordinates[env.machine.couplings[0][place]])


FIRST_DRIVE = (  # of any machine
    Channel(
        "joint of the\nfirst drive (m)", lambda env: _driven(env, env.machine.data.qpos, "qpos")
    ),
    Channel("its velocity\n(m/s)", lambda env: _driven(env, env.machine.data.qvel, "dof")),
)


def _largest(env: Any, values: np.ndarray) -> float:
    """Return the value farthest from 0 among the agent's drives, with its sign."""
    own = values[: len(env.drives)]
    return float(own[np.abs(own).argmax()])


def _window(env: Any) -> float:
    window = int(env.machine.axes["od"]["following_error_window"][0])
    return math.nan if window == SWITCHED_OFF else UM / env.units * float(window)


def _torque(env: Any) -> float:
    """The peak of the step, share of the rated torque."""
    return _largest(env, env.machine.couplings["torque_peak"] / env.machine.axes["rated_torque"])


def _torque_limit(env: Any) -> float:
    """The one in force, which may be that of the I²t monitoring; share of the rated torque."""
    axes = env.machine.axes
    limit = np.minimum(axes["torque_limit_positive"], axes["torque_ceiling"])
    return _largest(env, limit / axes["rated_torque"])


def drives(several: bool) -> tuple[Channel, ...]:
    """Of the drives an agent commands, in every task; of several the larger value; the peaks of
    each step.
    """
    larger = ("larger following\nerror (µm)", "larger torque\n/ rated")
    following_error, torque = larger if several else ("following error\n(µm)", "torque / rated")
    return (
        Channel(
            following_error,
            lambda env: UM / env.units * _largest(env, env.machine.couplings["error_peak"]),
            window=_window, wide=True,
        ),
        Channel(torque, _torque, window=_torque_limit),
    )


def of(env: Any) -> tuple[Channel, ...]:
    """Return the channels of an environment's task and drives, in the unit of its coordinates."""
    shown = env.CHANNELS + drives(len(env.drives) > 1)
    return tuple(each._replace(label=in_unit(each.label, env.UNIT)) for each in shown)
