"""servogym/GantryContour-v0: follow a circle or a square with X and Y, closely and fast."""

import math
from typing import Any

import numpy as np

from ...drive.kernel.jit import block
from ...drive.model.model import DriveModel
from ..engine.checks import Options, choice, in_range
from ..engine.machine import Machine
from ..engine.tick import coordinates
from ..environment.servo_env import METRE, ServoEnv
from ..exchange.batch import episode
from ..exchange.faces import clip, world_of
from ..exchange.fields import action, observation
from ..plants.gantry import AXES, GantryParameters
from ..view.about import Metric
from ..view.channels import MM, UM, Channel, joint
from .plant import of_datasheet

CONTOURS = ("circle", "square")
CIRCLE = CONTOURS.index("circle")
CENTRE = (0.4, 0.25)  # m, in X and Y
CLOSE = 20e-6  # m, contour error at which the reward for closeness has fallen to one half
SLOWEST = 0.2  # feed override
PROGRESS = 0.8  # share of the travel at full feed that success requires
CORNER = 2e-3  # m, distance in X and Y that counts as at the corner
AHEAD = (1.0, 2.0, 4.0, 8.0)  # steps at full feed to the points of the preview
AXIS = observation("distance", "velocity", "following_error", "torque", "correction")


@block
def length(contour, radius):
    """Return the length of one lap (m)."""
    return 2.0 * math.pi * radius if contour == CIRCLE else 8.0 * radius


@block
def point(contour, radius, way, axis):
    """Return X or Y (m) from the centre, after `way` (m) anticlockwise from the right."""
    if contour == CIRCLE:
        angle = way / radius
        return radius * (math.cos(angle) if axis == 0 else math.sin(angle))
    # over eight radii: Y rises for two, stays, falls, stays; X is Y two radii ahead
    done = (way / radius + (3.0 if axis == 0 else 1.0)) % 8.0
    if done < 2.0:
        return radius * (done - 1.0)
    if done < 4.0:
        return radius
    return radius * (5.0 - done) if done < 6.0 else -radius


@block
def deviation(contour, radius, x, y):
    """Return the perpendicular distance (m) of a place to the contour, positive outside."""
    if contour == CIRCLE:
        return math.hypot(x, y) - radius
    over_x, over_y = abs(x) - radius, abs(y) - radius
    if over_x > 0.0 and over_y > 0.0:
        return math.hypot(over_x, over_y)
    return max(over_x, over_y)


@block
def act(episode, action, rpdos):
    """Advance along the path by the override; command its point plus the corrections."""
    episode._override = SLOWEST + (1.0 - SLOWEST) * 0.5 * (action.override + 1.0)
    episode._way += episode._override * episode._step
    for d in range(2):
        episode._correction[d] = action.correction[d]
        target = CENTRE[d] + point(episode._contour, episode._radius, episode._way, d)
        target += action.correction[d] * episode._range
        rpdos[d].target_position = round(target * METRE)


@block
def judge(episode, rpdos, tpdos, observation):
    """Observe the path and the TPDOs; reward the position of the tool."""
    contour, radius = episode._contour, episode._radius
    for d in range(2):
        here = point(contour, radius, episode._way, d)
        for k in range(len(AHEAD)):
            ahead = AHEAD[k] * episode._step
            there = point(contour, radius, episode._way + ahead, d)
            observation.path[k, d] = clip((there - here) / ahead)
        axis = observation.axes[d]
        position = tpdos[d].position_actual_value / METRE
        axis.distance = clip((CENTRE[d] + here - position) / episode._window)
        axis.velocity = clip(tpdos[d].velocity_actual_value / METRE / episode._speed)
        axis.following_error = clip(tpdos[d].following_error_actual_value / METRE / episode._window)
        axis.torque = clip(tpdos[d].torque_actual_value / episode._max_torque)
        axis.correction = episode._correction[d]
    qpos = coordinates(world_of(episode))
    x, y = qpos[episode._x_at] - CENTRE[0], qpos[episode._y_at] - CENTRE[1]
    error = deviation(contour, radius, x, y)
    away = error / CLOSE
    episode.contour_error = error
    episode.worst = max(episode.worst, abs(error))
    if episode._way > episode._begin:  # it has begun
        episode._steps += 1.0
        episode._sum += abs(error)
        episode.mean_error = episode._sum / episode._steps
        episode.progress = (episode._way - episode._begin) / (episode._step * episode._steps)
    if contour != CIRCLE and min(abs(x), abs(y)) >= radius - CORNER:
        episode.worst_corner = max(episode.worst_corner, abs(error))
    episode.laps = (episode._way - episode._begin) / length(contour, radius)
    episode.reward_close = 1.0 / (1.0 + away * away)
    episode.reward_progress = episode._override
    episode.reward = 0.6 * episode.reward_close + 0.4 * episode.reward_progress
    episode.is_success = (
        episode.laps >= 1.0 and episode.progress >= PROGRESS and episode.worst <= episode._tolerance
    )


def _tool(d: int) -> Channel:
    """Return the channel of the tool in X or Y, with the point of the path."""
    name = "xy"[d]
    return Channel(
        f"tool in {name.upper()}\n(mm)",
        lambda env: MM * joint(env, name)[0],
        lambda env: (
            MM * (CENTRE[d] + point(env.episode._contour, env.episode._radius, env.episode._way, d))
        ),
    )


class GantryContourEnv(ServoEnv):
    """Follow a circle or a square with X and Y of a gantry, close to the path and fast.

    A path generator runs along the contour anticlockwise and gives both drives their set-points in
    cyclic synchronous position mode; without the agent the drives follow as well as their
    controllers can. The agent corrects the set-points before they are sent, and overrides the feed:
    it may lead where the drives lag, and slow down in tight places. The square has sharp corners. Z
    is parked on its brake.

    ## Action space
    `Box(-1, 1, (3,), float32)`; with ``action="pdo"`` ten more a drive: `envs.exchange.faces`

    | no | name | action | object | scaling |
    |----|------|--------|--------|---------|
    | 0, 1 | correction[:] | correction of the set-point in X, Y | 607Ah | 1 is `correction` |
    | 2 | override | feed override | 607Ah target_position | -1 is 0.2, 1 is 1.0 |

    The path advances by override × `feed` × step time; the target position (1 µm) is the point of
    the path plus the correction of this step.

    ## Observation space
    `Box(-1, 1, (18,), float32)`, clipped

    | no | name | observation | object | 1.0 is |
    |----|------|-------------|--------|--------|
    | 0–7 | path[:, :] | \
path ahead: X and Y of its points 1, 2, 4 and 8 steps on, from where it is | | \
steps × `feed` × step time |
    | 8, 13 | axes[:].distance | path minus position, X and Y | 6064h | the window 6065h |
    | 9, 14 | axes[:].velocity | velocity | 606Ch | the maximum profile velocity 607Fh |
    | 10, 15 | axes[:].following_error | following error | 60F4h | its window 6065h |
    | 11, 16 | axes[:].torque | torque | 6077h torque_actual_value | the maximum torque 6072h |
    | 12, 17 | axes[:].correction | correction in force | 607Ah | `correction` |

    ## Reward
    In [0, 1]: 0.6 for closeness, ``1 / (1 + (contour error / 20 µm)²)``, and 0.4 for progress, the
    feed override. The contour error is the true perpendicular distance to the contour, positive
    outside. ``info`` has the terms, ``contour_error``, ``mean_error``, ``worst`` and
    ``worst_corner``, within 2 mm of a corner (m, so far, without sign), ``laps``, ``progress``,
    the travel as a share of that at full feed, and ``cost``, the share of the step at an internal
    limit. ``is_success`` means that a lap is done, `progress` is at least 0.8, and `worst` is
    within `tolerance`, so a policy that only keeps close by moving slowly does not succeed.

    ## Episode
    An episode starts at rest on the contour, at a place from ``np_random`` unless the reset's
    options give ``start`` (share of a lap, 0..1). A fault of a drive terminates
    (``info["fault"]``). Time truncates, after 600 steps (3 s).

    ## Arguments
    Those of `ServoEnv`, and `contour` ("circle" or "square"), `radius` (m, of the circle, or half
    the side of the square), `feed` (m/s, at override 1), `correction` (m, the largest),
    `feed_forward` (share of the drives' own feed-forward of velocity and acceleration; without it
    they lag by speed / position gain), `tolerance` and `following_error_window` (m).

    ## Version history
    * v0: first version
    """

    ID = "servogym/GantryContour-v0"
    STEPS = 600
    DRIVES = ("x", "y")
    RPDO = ("target_position",)
    ACTION = action(("correction", 2), "override")
    OBSERVATION = observation(("path", (len(AHEAD), 2)), ("axes", 2, AXIS))
    EPISODE = episode(
        ("contour_error", "f8"),  # perpendicular to the contour, positive outside (m)
        ("worst", "f8"),  # the largest so far, without sign (m)
        ("mean_error", "f8"),  # so far, without sign (m)
        ("worst_corner", "f8"),  # the largest so far at a corner of the square (m)
        ("progress", "f8"),  # travel so far, as a share of that at full feed
        ("laps", "f8"),
        ("reward_close", "f8"),
        ("reward_progress", "f8"),
        ("_contour", "i8"),  # place in CONTOURS
        ("_radius", "f8"),  # m
        ("_steps", "f8"),  # so far
        ("_sum", "f8"),  # of the contour error without sign (m)
        ("_begin", "f8"),  # place on the path at the start (m)
        ("_way", "f8"),  # present place on the path (m)
        ("_step", "f8"),  # of the path at full feed (m)
        ("_override", "f8"),
        ("_range", "f8"),  # of a correction (m)
        ("_correction", "f8", (2,)),  # shares of it
        ("_x_at", "i8"),  # places in MjData.qpos
        ("_y_at", "i8"),
        ("_speed", "f8"),  # maximum profile velocity (m/s)
        ("_window", "f8"),  # of the following error (m)
        ("_max_torque", "f8"),  # per mille
        ("_tolerance", "f8"),  # m
    )
    act = staticmethod(act)
    judge = staticmethod(judge)
    datasheet: GantryParameters

    BOUND = "contoured"
    POLICIES = ("constant_feed", "full_feed", "tuned_full_feed", "iterative_learning", "bound")
    REFERENCE = "full_feed"
    SLOWEST = SLOWEST
    STROKE = tuple(AXES[name][0] for name in DRIVES)
    METRICS = {  # noqa: RUF012
        "contour_error": Metric("mean contour error (µm)", "low", "perpendicular to the contour"),
        "contour_worst": Metric("worst contour error (µm)", "low", "perpendicular to the contour"),
        "corner_error": Metric(
            "worst at a corner (µm)", "low", "contour error within 2 mm of a corner of the square"
        ),
        "progress": Metric("progress", "high", "travel, as a share of that at full feed"),
    }
    DONE = ("a lap within the window", "no lap within the window")
    CHANNELS = (
        _tool(0), _tool(1),
        Channel(
            "outside of the\ncontour (µm)", lambda env: UM * float(env.episode.contour_error),
            window=lambda env: UM * env.tolerance,
        ),
        Channel(
            "speed of the\ntool (m/s)",
            lambda env: math.hypot(joint(env, "x")[1], joint(env, "y")[1]),
        ),
    )

    def __init__(
        self, drive: str | DriveModel = "generic", *, contour: str = "circle", radius: float = 0.04,
        feed: float = 0.2, correction: float = 1e-3, feed_forward: float = 0.0,
        tolerance: float = 50e-6, following_error_window: float = 5e-3, **arguments: Any
    ):
        choice("contour", contour, CONTOURS)
        self.contour = contour
        self.radius = in_range("radius", radius, 0.005, 0.2, "m")
        self.feed = in_range("feed", feed, 0.01, 0.5, "m/s")
        self.correction = in_range("correction", correction, 0.0, 0.01, "m")
        self.feed_forward = in_range("feed_forward", feed_forward, 0.0, 1.0, "of the full one")
        self.tolerance = in_range("tolerance", tolerance, 1e-6, 0.1, "m")
        window = in_range("following_error_window", following_error_window, 1e-6, 1.0, "m")
        self._window = self.following_error_window = window
        self.datasheet = GantryParameters()
        super().__init__(drive, **arguments)

    def _make(self, model: DriveModel) -> Machine:
        machine = of_datasheet(self, model)
        for drive in (machine.drives[name] for name in self.DRIVES):
            drive.commission(
                {
                    "velocity_feed_forward": 1000 * self.feed_forward,
                    "acceleration_feed_forward": int(drive.axis.od.acceleration_feed_forward)
                    * self.feed_forward,
                }
            )
        return machine

    def _begin(self, options: Options) -> None:
        start = options.number("start", self.np_random.uniform(), 0.0, 1.0, "of a lap")
        kind = CONTOURS.index(self.contour)
        way = start * length(kind, self.radius)
        self.place(
            {
                name: CENTRE[d] + point(kind, self.radius, way, d)
                for d, name in enumerate(self.DRIVES)
            }
        )
        episode, model = self.episode, self.machine.model
        episode._contour, episode._radius = kind, self.radius
        episode._begin = episode._way = way
        episode._step = self.feed * self.step_time
        episode._range = self.correction
        episode._x_at = model.joint("x").qposadr[0]
        episode._y_at = model.joint("y").qposadr[0]
        self.normalise()
        episode._tolerance = self.tolerance

    def figures(self) -> dict[str, float]:
        """Return metrics of the contour; nothing settles in this task."""
        episode = self.episode
        square = self.contour == "square"
        return {
            "contour_error": UM * episode.mean_error,
            "contour_worst": UM * episode.worst,
            "corner_error": UM * episode.worst_corner if square else math.nan,
            "progress": episode.progress,
            "settling_time": math.nan,
        }

    def path(self) -> np.ndarray:
        """Return the contour, at the height of the gripper."""
        episode = self.episode
        ways = np.linspace(0.0, length(episode._contour, episode._radius), 97)
        at = [
            [CENTRE[d] + point(episode._contour, episode._radius, way, d) for d in range(2)]
            for way in ways
        ]
        height = float(self.machine.data.geom("payload").xpos[2])
        return np.column_stack([at, np.full(len(at), height)])

    def ghosts(self) -> dict[str, np.ndarray]:
        """Return the gripper at the point of the path."""
        episode, qpos = self.episode, self.machine.data.qpos
        away = [
            CENTRE[d] + point(episode._contour, episode._radius, episode._way, d) - qpos[at]
            for d, at in enumerate((episode._x_at, episode._y_at))
        ]
        return {"gripper": np.array([*away, 0.0])}
