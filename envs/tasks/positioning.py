"""servogym/LinearAxis-v0: bring the carriage of a linear axis to a goal, and hold it there."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from ...drive.kernel.jit import block
from ...drive.kernel.words import Mode
from ...drive.model.model import DriveModel
from ..engine.checks import Options, choice, in_range
from ..environment.servo_env import METRE, ServoEnv
from ..exchange.batch import episode
from ..exchange.faces import clip
from ..exchange.fields import action, observation
from ..plants.axis_parameters import LinearAxisParameters, chosen
from ..view.channels import linear_axis as linear_axis_channels
from .plant import of_datasheet
from .rewards import closeness

STROKE = 0.5  # m
MARGIN = 0.02  # m, distance of starts and goals from the ends
FINE = 20.0  # tolerances, distance that is 1.0 in the fine observation
RESTING = 5e-3  # m/s, below which the carriage counts as settled


@block
def act(episode, action, rpdos):
    """Move the set-point by action × maximum velocity × step time, within the stroke."""
    target = episode._target + action.velocity * episode._way
    episode._target = min(max(target, 0.0), STROKE)
    rpdos[0].target_position = round(episode._target * METRE)


@block
def act_velocity(episode, action, rpdos):
    """Command action × maximum velocity."""
    rpdos[0].target_velocity = round(action.velocity * episode._speed * METRE)


@block
def act_torque(episode, action, rpdos):
    """Command action × maximum torque."""
    rpdos[0].target_torque = round(action.torque * episode._max_torque)


class Command(NamedTuple):
    """The meaning of an action in a mode of the drive."""

    mode: Mode
    object: str  # commanded in the RPDO
    action: np.dtype
    act: Callable[..., None]


VELOCITY = action("velocity")
COMMANDS = {
    "csp": Command(Mode.CYCLIC_SYNC_POSITION, "target_position", VELOCITY, act),
    "csv": Command(Mode.CYCLIC_SYNC_VELOCITY, "target_velocity", VELOCITY, act_velocity),
    "cst": Command(Mode.CYCLIC_SYNC_TORQUE, "target_torque", action("torque"), act_torque),
}


@block
def judge(episode, rpdos, tpdos, observation):
    """Compute observation and reward from the TPDOs."""
    tpdo = tpdos[0]
    position = tpdo.position_actual_value / METRE
    velocity = tpdo.velocity_actual_value / METRE
    distance = episode.goal - position
    observation.distance = clip(distance / STROKE)
    observation.position = clip(2.0 * position / STROKE - 1.0)
    observation.velocity = clip(velocity / episode._speed)
    observation.following_error = clip(tpdo.following_error_actual_value / METRE / episode._window)
    observation.torque = clip(tpdo.torque_actual_value / episode._max_torque)
    lead = episode._target - position if episode._csp else 0.0
    observation.set_point = clip(lead / episode._window)
    observation.distance_fine = clip(distance / (FINE * episode._tolerance))
    off = abs(distance) / episode._tolerance + abs(velocity) / RESTING
    near = closeness(off, STROKE / episode._tolerance)
    settled = abs(distance) <= episode._tolerance and abs(velocity) <= RESTING
    episode.distance = distance
    episode.reward_near = near
    episode.reward_settled = 1.0 if settled else 0.0
    episode.reward = 0.5 * near + 0.5 * episode.reward_settled
    episode.is_success = settled


class LinearAxisEnv(ServoEnv):
    """Bring the carriage of a linear axis to a goal and hold it there.

    The agent is the master of a drive in cyclic synchronous position mode, or in another `mode`. In
    each step it moves the target position 607Ah in the RPDO and observes the TPDOs. Before the
    first step the drive is enabled and referenced. The drive limits its commands as a real drive
    does: too steep a set-point leads to a following error, and the fault ends the episode. With
    torque or velocity the carriage can leave the stroke, beyond which are software limits, limit
    switches and the end stops.

    ## Action space
    `Box(-1, 1, (1,), float32)`; with ``action="pdo"`` ten more: `servogym.envs.exchange.faces`

    | no | name | action | object | scaling |
    |----|------|--------|--------|---------|
    | 0 | velocity | velocity of the set-point | 607Ah | 1 is the maximum velocity 607Fh |
    | 0 | velocity | with ``mode="csv"``: velocity | 60FFh | 1 is the maximum velocity 607Fh |
    | 0 | torque | with ``mode="cst"``: torque | 6071h | 1 is the maximum torque 6072h |

    The target position (1 µm) moves by action × maximum velocity × step time, within the stroke.

    ## Observation space
    `Box(-1, 1, (7,), float32)`, clipped

    | no | name | observation | object | 1.0 is |
    |----|------|-------------|--------|--------|
    | 0 | distance | goal minus position | 6064h position_actual_value | the stroke, 0.5 m |
    | 1 | position | position, -1 and 1 at the ends | 6064h | half the stroke |
    | 2 | velocity | velocity | 606Ch velocity_actual_value | the maximum profile velocity 607Fh |
    | 3 | following_error | following error | 60F4h | its window 6065h |
    | 4 | torque | torque | 6077h torque_actual_value | the maximum torque 6072h |
    | 5 | set_point | set-point minus position; 0 in csv and cst | 607Ah, 6064h | its window 6065h |
    | 6 | distance_fine | goal minus position, fine | 6064h | 20 × `tolerance` |

    ## Reward
    In [0, 1]: half for nearness, half for being settled (closer than `tolerance` and slower than
    5 mm/s). Nearness is 1 at rest at the goal and 0 a stroke away from it, on a logarithmic scale
    of distance / `tolerance` + velocity / 5 mm/s (`servogym.envs.tasks.rewards`). ``info`` has the
    terms and ``cost``, the share of the step at an internal limit.

    ## Episode
    An episode starts at rest at a random position, with a random goal, both from ``np_random``
    unless the reset's options give ``start`` and ``goal`` (m). A fault of the drive terminates
    (``info["fault"]``: code and meaning). Time truncates, after 200 steps (1 s).

    ## Arguments
    Those of `ServoEnv`, and `mode` ("csp", "csv" or "cst"; the drive has to have it), `payload`
    (kg), `tolerance` (m), `following_error_window` (m), `parameters`: `LinearAxisParameters` or the
    name of a preset of `FAMILY` instead of `payload`.

    ## Version history
    * v0: first version
    """

    ID = "servogym/LinearAxis-v0"
    ACTION = VELOCITY
    OBSERVATION = observation(
        "distance", "position", "velocity", "following_error", "torque", "set_point",
        "distance_fine",
    )
    EPISODE = episode(
        ("goal", "f8"),  # m
        ("distance", "f8"),  # goal minus position (m)
        ("reward_near", "f8"),
        ("reward_settled", "f8"),
        ("_csp", "?"),  # there is a set-point
        ("_target", "f8"),  # set-point (m)
        ("_way", "f8"),  # largest travel of the set-point in a step (m)
        ("_speed", "f8"),  # maximum profile velocity (m/s)
        ("_window", "f8"),  # of the following error (m)
        ("_max_torque", "f8"),  # per mille
        ("_tolerance", "f8"),  # m
    )
    judge = staticmethod(judge)

    BOUND = "positioned"
    POLICIES = (
        "trapezoid", "jerk_limited", "s_curve", "ruckig", "ruckig+zv", "ruckig+zvd", "ruckig+ei",
        "ruckig+notch", "tuned_ruckig", "proportional", "pd",
        "informed_ruckig", "bound",
    )
    REFERENCE = "ruckig"
    METRIC = "settling_time"
    CHANNELS = linear_axis_channels("carriage")
    STROKE = (STROKE,)
    # within the tolerance there is no room for exploration noise
    HYPERPARAMETERS = {  # noqa: RUF012
        "PPO": {
            "learning_rate": 5e-4,
            "policy_kwargs": {"log_std_init": -3.0, "net_arch": [64, 64]},
        },
    }

    datasheet: LinearAxisParameters

    def __init__(
        self, drive: str | DriveModel = "generic", *, mode: str = "csp", payload: float = 5.0,
        parameters: LinearAxisParameters | str | None = None, tolerance: float = 50e-6,
        following_error_window: float = 0.02, **arguments: Any
    ):
        choice("mode", mode, COMMANDS)
        self.mode = mode
        own, commanded, self.ACTION, self.act = COMMANDS[mode]
        self.MODES = (own, Mode.HOMING)
        self.RPDO = (commanded,)
        self.datasheet = chosen(parameters, payload)
        self.tolerance = in_range("tolerance", tolerance, 1e-6, 0.1, "m")
        self._window = in_range("following_error_window", following_error_window, 1e-6, 1.0, "m")
        super().__init__(drive, **arguments)

    _make = of_datasheet

    def _begin(self, options: Options) -> None:
        start, goal = self.np_random.uniform(MARGIN, STROKE - MARGIN, 2)
        start = options.number("start", start, 0.0, STROKE, "m")
        goal = options.number("goal", goal, 0.0, STROKE, "m")
        self.place({"x": start})
        episode, x = self.episode, self.drive
        episode.goal = goal
        episode._csp = self.mode == "csp"
        episode._target = x.read("position_actual_value") / METRE
        self.normalise()
        episode._way = episode._speed * self.step_time
        episode._tolerance = self.tolerance

    def settling(self) -> dict[str, float]:
        """Return goal and tolerance of the carriage."""
        return {"goal": float(self.episode.goal), "window": self.tolerance}

    def ghosts(self) -> dict[str, np.ndarray]:
        """Return the carriage at the goal."""
        away = self.episode.goal - self.machine.data.qpos[0]
        return {"carriage": np.array([away, 0.0, 0.0])}
