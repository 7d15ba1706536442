"""servogym/RotaryAxis-v0: turn a table, or move a conveyor, to a periodic position."""

import math
from typing import Any

import numpy as np

from ...drive.kernel.jit import block
from ...drive.model.model import DriveModel
from ..engine.checks import Options, in_range
from ..engine.machine import Machine
from ..environment.servo_env import ServoEnv
from ..exchange.batch import episode
from ..exchange.faces import clip
from ..exchange.fields import action, observation
from ..plants.rotary_parameters import ROTARY_FAMILY, RotaryParameters
from ..view.channels import Channel
from .plant import of_datasheet
from .rewards import closeness

FINE = 20.0  # tolerances, distance that is 1.0 in the fine observation
RESTING = 0.02  # rad/s, below which the axis counts as settled
MARK = 0.19  # m, radius of the mark on the table


@block
def nearest(way, period):
    """Return the shortest travel that ends at the same place."""
    return way - period * math.floor(way / period + 0.5)


@block
def act(episode, action, rpdos):
    """Move the set-point by action × maximum velocity × step time, in the range of 607Bh."""
    episode._target += action.velocity * episode._way
    target = episode._target - episode._period * math.floor(episode._target / episode._period)
    rpdos[0].target_position = round(target * episode._units) % episode._range


@block
def judge(episode, rpdos, tpdos, observation):
    """Compute observation and reward from the received TPDOs."""
    tpdo = tpdos[0]
    period = episode._period
    position = tpdo.position_actual_value / episode._units
    velocity = tpdo.velocity_actual_value / episode._units
    distance = nearest(episode.goal - position, period)
    observation.distance = clip(2.0 * distance / period)
    observation.cosine = clip(math.cos(2.0 * math.pi * position / period))
    observation.sine = clip(math.sin(2.0 * math.pi * position / period))
    observation.velocity = clip(velocity / episode._speed)
    observation.following_error = clip(
        tpdo.following_error_actual_value / episode._units / episode._window
    )
    observation.torque = clip(tpdo.torque_actual_value / episode._max_torque)
    observation.set_point = clip(nearest(episode._target - position, period) / episode._window)
    observation.distance_fine = clip(distance / (FINE * episode._tolerance))
    off = abs(distance) / episode._tolerance + abs(velocity) / RESTING
    settled = abs(distance) <= episode._tolerance and abs(velocity) <= RESTING
    episode.distance = distance
    episode.reward_near = closeness(off, period / episode._tolerance)
    episode.reward_settled = 1.0 if settled else 0.0
    episode.reward = 0.5 * episode.reward_near + 0.5 * episode.reward_settled
    episode.is_success = settled


def _degrees(env: Any) -> float:
    """Return the angle of the table or roller within its repeating range (degree)."""
    return math.degrees(float(env.machine.data.qpos.sum()) % float(env.episode._period))


class RotaryAxisEnv(ServoEnv):
    """Turn an axis without ends to a goal, the shorter way round, and hold it there.

    The axis is a rotary table or the roller of a conveyor. Its position repeats after a turn of the
    table or a pitch of the conveyor (607Bh), and so do commands and observations. Angles are those
    of the table or roller in rad; the drive counts 0.001 degree of a table, 1 µm of a belt. The
    agent is the master of a drive in cyclic synchronous position mode. Before the first step the
    drive is enabled and referenced. Too steep a set-point leads to a following error, and the fault
    ends the episode.

    ## Action space
    `Box(-1, 1, (1,), float32)`; with ``action="pdo"`` ten more: `servogym.envs.exchange.faces`

    | no | name | action | object | scaling |
    |----|------|--------|--------|---------|
    | 0 | velocity | velocity of the set-point | 607Ah | 1 is the maximum velocity 607Fh |

    The target position moves by action × maximum velocity × step time and wraps at 607Bh.

    ## Observation space
    `Box(-1, 1, (8,), float32)`, clipped

    | no | name | observation | object | 1.0 is |
    |----|------|-------------|--------|--------|
    | 0 | distance | goal minus position, the shorter way | 6064h position_actual_value | half the range 607Bh |
    | 1 | cosine | cosine of the position, a range 607Bh being a turn | 6064h | 1 |
    | 2 | sine | sine of the position | 6064h | 1 |
    | 3 | velocity | velocity | 606Ch velocity_actual_value | the maximum profile velocity 607Fh |
    | 4 | following_error | following error | 60F4h | its window 6065h |
    | 5 | torque | torque | 6077h torque_actual_value | the maximum torque 6072h |
    | 6 | set_point | set-point minus position | 607Ah, 6064h | its window 6065h |
    | 7 | distance_fine | goal minus position, fine | 6064h | 20 × `tolerance` |

    ## Reward
    In [0, 1]: half for nearness, half for being settled (closer than `tolerance` and slower than
    0.02 rad/s). Nearness is 1 at rest at the goal and 0 a range away from it, on a logarithmic
    scale of distance / `tolerance` + velocity / 0.02 rad/s (`servogym.envs.tasks.rewards`).
    ``info`` has the terms and ``cost``, the share of the step at an internal limit.

    ## Episode
    An episode starts at rest at a random angle, with a random goal, both from ``np_random`` unless
    the reset's options give ``start`` and ``goal`` (rad, within the range). A fault of the drive
    terminates (``info["fault"]``: code and meaning). Time truncates, after 400 steps (2 s).

    ## Arguments
    Those of `ServoEnv`, and `mechanics` ("rotary_table" or "conveyor"), `tolerance` (rad),
    `following_error_window` (rad), `parameters`: `RotaryParameters` instead of the preset. The
    drive needs 607Bh.

    ## Version history
    * v0: first version
    """  # noqa: E501

    ID = "servogym/RotaryAxis-v0"
    STEPS = 400
    RPDO = ("target_position",)
    ACTION = action("velocity")
    OBSERVATION = observation(
        "distance", "cosine", "sine", "velocity", "following_error", "torque", "set_point",
        "distance_fine",
    )
    EPISODE = episode(
        ("goal", "f8"),  # rad
        ("distance", "f8"),  # goal minus position, the shorter way (rad)
        ("reward_near", "f8"),
        ("reward_settled", "f8"),
        ("_target", "f8"),  # set-point, without wrapping (rad)
        ("_way", "f8"),  # largest travel of the set-point in a step (rad)
        ("_speed", "f8"),  # maximum profile velocity (rad/s)
        ("_window", "f8"),  # of the following error (rad)
        ("_max_torque", "f8"),  # per mille
        ("_tolerance", "f8"),  # rad
        ("_period", "f8"),  # after which positions repeat (rad)
        ("_units", "f8"),  # position units per rad
        ("_range", "i8"),  # position units of 607Bh
    )
    act = staticmethod(act)
    judge = staticmethod(judge)

    BOUND = "turned"
    POLICIES = (
        "trapezoid", "ruckig", "proportional", "tuned_proportional", "informed_ruckig", "bound",
    )
    REFERENCE = "ruckig"
    UNIT = "rad"
    METRIC = "settling_time"
    CHANNELS = (
        Channel("table\n(degree)", _degrees, lambda env: math.degrees(env.episode.goal)),
        Channel(
            "table beyond\nthe goal (degree)", lambda env: -math.degrees(env.episode.distance),
            window=lambda env: math.degrees(env.tolerance), nearest=15.0,
        ),
        Channel("velocity of the\ntable (rad/s)", lambda env: float(env.machine.data.qvel.sum())),
    )

    datasheet: RotaryParameters

    def __init__(
        self, drive: str | DriveModel = "generic", *, mechanics: str = "rotary_table",
        parameters: RotaryParameters | None = None, tolerance: float = 5e-4,
        following_error_window: float = 0.05, **arguments: Any
    ):
        if mechanics not in ROTARY_FAMILY:
            raise ValueError(f"mechanics = {mechanics!r}, use one of {', '.join(ROTARY_FAMILY)}")
        self.datasheet = parameters or ROTARY_FAMILY[mechanics]
        self.units = 1.0 / self.datasheet.unit
        self.tolerance = in_range("tolerance", tolerance, 1e-6, 0.5, "rad")
        window = in_range("following_error_window", following_error_window, 1e-6, 10.0, "rad")
        self._window = round(window * self.units) / self.units
        super().__init__(drive, **arguments)

    def _make(self, model: DriveModel) -> Machine:
        if "max_position_range_limit" not in model.names:
            raise ValueError(f"drive {model.name!r} has no object 607Bh, which this task needs")
        return of_datasheet(self, model)

    def _begin(self, options: Options) -> None:
        period = self.datasheet.period
        start, goal = self.np_random.uniform(0.0, period, 2)
        start = options.number("start", start, 0.0, period, "rad")
        goal = options.number("goal", goal, 0.0, period, "rad")
        self.place({"x": start})
        episode = self.episode
        episode.goal, episode._period, episode._units = goal, period, self.units
        episode._range = round(period * self.units)
        episode._target = self.drive.read("position_actual_value") / self.units
        self.normalise()
        episode._way = episode._speed * self.step_time
        episode._tolerance = self.tolerance

    def ghosts(self) -> dict[str, np.ndarray]:
        """Return the mark of the table at the goal."""
        angle = float(self.machine.data.qpos.sum())
        goal = angle + float(self.episode.distance)
        way = np.array([math.cos(goal) - math.cos(angle), math.sin(goal) - math.sin(angle), 0.0])
        return {"mark": MARK * way}
