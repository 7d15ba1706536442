"""Channels of a picture of an episode: quantities of an environment over time, one panel each.

They are read from MjData, from the record of the episode, or from those of the drives.
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
    """A panel: its label with unit, and the quantity of an environment that it shows."""

    label: str
    value: Quantity
    aim: Quantity | None = None  # reference or goal
    window: Quantity | None = None  # permitted deviation to both sides of the aim, or of 0
    nearest: float = math.inf  # number of windows that the panel shows
    wide: bool = False  # a window much wider than the values: linear near 0, logarithmic beyond


def joint(env: Any, name: str) -> tuple[float, float]:
    """Return coordinate and velocity of a joint (m and m/s, or rad and rad/s)."""
    joint = env.machine.data.joint(name)
    return float(joint.qpos[0]), float(joint.qvel[0])


def position(env: Any) -> float:
    """Return the position of the load of a linear axis, behind all elasticity (m)."""
    return float(env.machine.data.qpos.sum())


def velocity(env: Any) -> float:
    """Return the velocity of the load of a linear axis (m/s)."""
    return float(env.machine.data.qvel.sum())


def goal(env: Any) -> float:
    """Return ``goal`` of the episode (mm); NaN if the task has none."""
    return MM * float(getattr(env.episode, "goal", math.nan))


def tolerance(env: Any) -> float:
    """Return the tolerance of the task (mm)."""
    return MM * float(env.tolerance)


def in_mm(quantity: Quantity) -> Quantity:
    """Convert a quantity from m to mm."""
    return lambda env: MM * quantity(env)


def linear_axis(what: str, *more: Channel) -> tuple[Channel, ...]:
    """Return channels of a linear axis that settles at ``episode.goal`` within ``tolerance``."""
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
    """Return channels of the drives that an agent commands: the peaks of each step.

    Of several drives the larger value is shown.
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
