"""servogym/LinearAxisTracking-v0: follow a trajectory with unknown friction and payload."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from ...drive.kernel.jit import block
from ...drive.kernel.words import Mode
from ...drive.model.model import DriveModel
from ..engine.checks import Options, choice, in_range
from ..engine.probe import elastic
from ..engine.tick import coordinates, speeds
from ..environment.servo_env import METRE, ServoEnv
from ..exchange.batch import episode
from ..exchange.faces import clip, world_of
from ..exchange.fields import action, observation
from ..plants.axis_parameters import LinearAxisParameters, chosen
from ..view.about import Metric
from ..view.channels import MM, UM, Channel, in_mm, position, velocity
from .plant import of_datasheet
from .positioning import MARGIN, STROKE
from .references import REFERENCES, Limits, make_reference

STEPS = 400
PREVIEW = 4  # points of the reference ahead
STRIDE = 2  # steps between these points
SAMPLES = STEPS + 1 + PREVIEW * STRIDE
CLOSE = 10e-6  # m, tracking error at which the reward for closeness has fallen to one half
SMOOTH = 0.05  # share of the maximum torque, change per step that halves the smoothness
RANDOMISE = {"payload": (1.0, 10.0), "friction": (0.5, 2.0)}
CSP = int(Mode.CYCLIC_SYNC_POSITION)
STATE_MASK, OPERATION_ENABLED = 0x6F, 0x27


@block
def act(episode, action, rpdos):
    """Command the next point of the reference, corrected, and the torque feed-forward."""
    if episode._running and episode._now < STEPS:
        episode._now += 1
    target = episode._position[episode._now] + action.correction * episode._correction
    rpdos[0].target_position = round(min(max(target, 0.0), STROKE) * METRE)
    rpdos[0].torque_offset = round(action.torque * episode._max_torque)


@block
def judge(episode, rpdos, tpdos, observation):
    """Compute observation and reward from the TPDOs."""
    rpdo, tpdo = rpdos[0], tpdos[0]
    now = episode._now
    reference = episode._position[now]
    position = tpdo.position_actual_value / METRE
    torque = tpdo.torque_actual_value / episode._max_torque
    error = reference - position
    observation.error = clip(error / episode._correction)
    observation.reference = clip(2.0 * reference / STROKE - 1.0)
    observation.reference_velocity = clip(episode._velocity[now] / episode._speed)
    observation.reference_acceleration = clip(
        episode._acceleration[now] / episode._max_acceleration
    )
    observation.velocity = clip(tpdo.velocity_actual_value / METRE / episode._speed)
    observation.following_error = clip(tpdo.following_error_actual_value / METRE / episode._window)
    observation.torque = clip(torque)
    for i in range(PREVIEW):
        ahead = (i + 1) * STRIDE
        way = episode._position[now + ahead] - reference
        observation.preview[i] = clip(way / (ahead * episode._way))
    enabled = tpdo.statusword & STATE_MASK == OPERATION_ENABLED
    was_running = episode._running
    episode._running = enabled and rpdo.modes_of_operation == CSP
    away = abs(error) / CLOSE
    world = world_of(episode)
    qpos, qvel = coordinates(world), speeds(world)
    behind = reference + episode._rest
    for i in range(len(episode._places)):
        if episode._places[i] >= 0:  # at the time of the sampled position, one cycle ago
            behind -= qpos[episode._places[i]] - qvel[episode._places[i]] * episode._age
    change = (torque - episode._torque) / SMOOTH
    episode.error = error
    episode.reward_close = 1.0 / (1.0 + away) if episode._running else 0.0
    episode.reward_smooth = 1.0 / (1.0 + change * change) if episode._running else 0.0
    episode.reward = 0.8 * episode.reward_close + 0.2 * episode.reward_smooth
    if was_running:
        episode._squares += error * error
        episode._load_squares += behind * behind
        episode._count += 1
        episode.rms_error = (episode._squares / episode._count) ** 0.5
        episode.rms_load_error = (episode._load_squares / episode._count) ** 0.5
    episode._torque = torque
    episode.is_success = episode._count > 0 and episode.rms_error <= episode._tolerance


def _reference(env: Any) -> float:
    """Return the present point of the reference (m)."""
    return float(env.episode._position[env.episode._now])


class LinearAxisTrackingEnv(ServoEnv):
    """Follow a reference trajectory on a linear axis with unknown friction and payload.

    The drive follows the reference in cyclic synchronous position mode with its own cascade, tuned
    for the nominal payload; with actions of 0 it does nothing else. The agent corrects the target
    position and adds torque. Before the first step the drive is enabled and referenced.

    ## Action space
    `Box(-1, 1, (2,), float32)`; with ``action="pdo"`` ten more: `servogym.envs.exchange.faces`

    | no | name | action | object | scaling |
    |----|------|--------|--------|---------|
    | 0 | correction | correction of the set-point | 607Ah | 1 is `correction`, 1 mm |
    | 1 | torque | torque feed-forward | 60B2h torque_offset | 1 is the maximum torque 6072h |

    The target position (1 µm) is the point of the reference at the end of the step, plus the
    correction, within the stroke.

    ## Observation space
    `Box(-1, 1, (11,), float32)`, clipped

    | no | name | observation | object | 1.0 is |
    |----|------|-------------|--------|--------|
    | 0 | error | tracking error: reference minus position | 6064h | `correction` |
    | 1 | reference | reference, -1 and 1 at the ends of the stroke | | half the stroke |
    | 2 | reference_velocity | velocity of the reference | | the maximum profile velocity 607Fh |
    | 3 | reference_acceleration | its acceleration | | the profile acceleration 6083h |
    | 4 | velocity | velocity | 606Ch velocity_actual_value | the maximum profile velocity 607Fh |
    | 5 | following_error | following error | 60F4h | its window 6065h |
    | 6 | torque | torque | 6077h torque_actual_value | the maximum torque 6072h |
    | 7–10 | preview[:] | travel of the reference in the next 2, 4, 6, 8 steps | | \
607Fh times that time |

    ## Reward
    In [0, 1]: ``0.8 / (1 + |tracking error| / 10 µm)`` for closeness, and for smoothness
    ``0.2 / (1 + (change of the torque in the step / 5 % of 6072h)²)``. The terms are in ``info``,
    with the tracking error ``error`` (m) at the drive's encoder, its root mean square so far
    ``rms_error`` (m), that of the load itself ``rms_load_error`` (m, the true position behind all
    elasticity at the time of sampling), ``is_success`` while `rms_error` is within `tolerance`, and
    ``cost``, the share of the step at an internal limit.

    ## Episode
    An episode starts at rest at a random position. The reference is one of
    `servogym.envs.tasks.references`, within the stroke and the profile velocity, acceleration and
    jerk of the axis, and ends after 400 steps. While the drive is not enabled in its mode, the
    reference waits and there is no reward. The reset's options may give ``start`` (m),
    ``reference`` (name) and ``way_points`` (m). A fault of the drive terminates (``info["fault"]``:
    code and meaning). Time truncates, after 400 steps (2 s).

    ## Arguments
    Those of `ServoEnv`, where `randomise` is payload 1..10 kg and friction 0.5..2 of the nominal by
    default, and `reference` (name; by default drawn for each episode), `correction` (m), `payload`
    (kg, nominal), `tolerance` (m, of the root mean square), `following_error_window` (m) and
    `parameters`, `LinearAxisParameters` or the name of a preset of `FAMILY` instead of `payload`.

    ## Version history
    * v0: first version
    """

    ID = "servogym/LinearAxisTracking-v0"
    STEPS = STEPS
    RPDO = ("target_position", "torque_offset")
    ACTION = action("correction", "torque")
    OBSERVATION = observation(
        "error", "reference", "reference_velocity", "reference_acceleration", "velocity",
        "following_error", "torque", ("preview", PREVIEW),
    )
    EPISODE = episode(
        ("error", "f8"),  # reference minus position (m)
        ("rms_error", "f8"),  # m
        ("rms_load_error", "f8"),  # m
        ("reward_close", "f8"),
        ("reward_smooth", "f8"),
        ("_position", "f8", (SAMPLES,)),  # of the reference at each step (m)
        ("_velocity", "f8", (SAMPLES,)),  # m/s
        ("_acceleration", "f8", (SAMPLES,)),  # m/s²
        ("_now", "i8"),  # sample of the reference
        ("_running", "?"),  # the drive is enabled, so the reference advances
        ("_squares", "f8"),  # sum of error² (m²) over `_count` steps
        ("_load_squares", "f8"),  # the same of the load
        ("_count", "i8"),
        ("_places", "i8", (3,)),  # in MjData.qpos; their sum is the load's position; -1: none
        ("_age", "f8"),  # of a position when it is reported (s)
        ("_rest", "f8"),  # position of the load at the start minus that of the drive (m)
        ("_torque", "f8"),  # one step ago, as a share of the maximum
        ("_correction", "f8"),  # m
        ("_speed", "f8"),  # maximum profile velocity (m/s)
        ("_way", "f8"),  # travel at that velocity in a step (m)
        ("_max_acceleration", "f8"),  # of the profile (m/s²)
        ("_window", "f8"),  # of the following error (m)
        ("_max_torque", "f8"),  # per mille
        ("_tolerance", "f8"),  # m
    )
    act = staticmethod(act)
    judge = staticmethod(judge)

    BOUND = "tracked"
    POLICIES = (
        "feed_forward", "disturbance_observer", "adaptive_feed_forward", "leading_feed_forward",
        "basis_feed_forward", "iterative_learning", "informed_adaptive_feed_forward",
        "bound",
    )
    REFERENCE = "feed_forward"
    METRIC = "load_error"
    METRICS = {  # noqa: RUF012
        "load_error": Metric(
            "rms tracking error at the load (µm)", "low", "reference minus place of the load"
        ),
    }
    DONE = ("", "")  # episodes always run to the end
    CHANNELS = (
        Channel("carriage\n(mm)", in_mm(position), lambda env: MM * _reference(env)),
        Channel("tracking error\n(µm)", lambda env: UM * float(env.episode.error)),
        Channel("velocity\n(m/s)", velocity),
    )
    STROKE = (STROKE,)
    # the actions are small corrections of a drive that follows well by itself
    HYPERPARAMETERS = {  # noqa: RUF012
        "PPO": {"gamma": 0.9, "policy_kwargs": {"log_std_init": -3.0, "net_arch": [64, 64]}},
    }

    datasheet: LinearAxisParameters

    def __init__(
        self, drive: str | DriveModel = "generic", *, reference: str | None = None,
        correction: float = 1e-3, payload: float = 5.0,
        parameters: LinearAxisParameters | str | None = None, tolerance: float = 20e-6,
        following_error_window: float = 5e-3,
        randomise: Mapping[str, float | tuple[float, ...]] | None = None, **arguments: Any
    ):
        self.reference = None if reference is None else choice("reference", reference, REFERENCES)
        self.correction = in_range("correction", correction, 1e-6, 0.1, "m")
        self.datasheet = chosen(parameters, payload)
        self.tolerance = in_range("tolerance", tolerance, 1e-6, 0.1, "m")
        self._window = in_range("following_error_window", following_error_window, 1e-6, 1.0, "m")
        ranges = RANDOMISE if randomise is None else randomise
        super().__init__(drive, randomise=ranges, **arguments)
        self._times = np.arange(STEPS + 1) * self.step_time

    _make = of_datasheet

    def _begin(self, options: Options) -> None:
        start = self.np_random.uniform(MARGIN, STROKE - MARGIN)
        start = options.number("start", start, 0.0, STROKE, "m")
        self.place({"x": start})
        episode, x, p = self.episode, self.drive, self.datasheet
        limits = Limits(0.0, STROKE, p.max_velocity, p.max_acceleration, p.max_jerk)
        points = options.get("way_points")
        if points is not None:
            points = [
                in_range("options['way_points']", point, 0.0, STROKE, "m")
                for point in np.atleast_1d(points)
            ]
        kind = choice("options['reference']", options.get("reference") or self._kind(), REFERENCES)
        here = x.read("position_actual_value") / METRE
        made = make_reference(kind, self.np_random, limits, here, self._times, points)
        episode._position[:STEPS] = made.position[:STEPS]
        episode._position[STEPS:] = made.position[STEPS]
        episode._velocity[: STEPS + 1] = made.velocity
        episode._acceleration[: STEPS + 1] = made.acceleration
        episode._correction = self.correction
        self.normalise()
        episode._way = episode._speed * self.step_time
        episode._max_acceleration = p.max_acceleration
        episode._tolerance = self.tolerance
        episode._age = self.machine.cycle_time
        places = [int(self.machine.couplings[0].qpos), *elastic(self.machine)]
        episode._places = ([*places, -1, -1])[:3]
        episode._rest = sum(self.machine.data.qpos[place] for place in places) - here

    def _kind(self) -> str:
        if self.reference is not None:
            return self.reference
        return list(REFERENCES)[self.np_random.integers(len(REFERENCES))]

    def figures(self) -> dict[str, float]:
        """Return tracking errors; a reference has no goal to settle at."""
        return {
            "tracking_error": UM * self.episode.rms_error,
            "load_error": UM * self.episode.rms_load_error,
            "settling_time": math.nan,
        }

    def ghosts(self) -> dict[str, np.ndarray]:
        """Return the carriage at the present point of the reference."""
        away = self.episode._position[self.episode._now] - self.machine.data.qpos[0]
        return {"carriage": np.array([away, 0.0, 0.0])}
