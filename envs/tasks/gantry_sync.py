"""servogym/GantrySync-v0: square a gantry with two drives in X on its way to a goal."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from ...drive.kernel.jit import block
from ...drive.model.model import DriveModel
from ..engine.checks import Options, in_range
from ..engine.tick import coordinates
from ..environment.servo_env import METRE, ServoEnv
from ..exchange.batch import episode
from ..exchange.faces import clip, faulted, world_of
from ..exchange.fields import action, observation
from ..plants.gantry import MAX_SKEW, SPAN, GantryParameters
from ..view.about import Metric
from ..view.channels import MM, UM, Channel, goal, joint, tolerance
from .plant import of_datasheet

STROKE = 0.8  # m, of X
Y_STROKE = 0.5  # m
STARTS, GOALS = (0.12, 0.18), (0.26, 0.4)  # m; the home switches lie between them, at 0.2..0.23 m
NEAR = 0.02  # m, distance at which the reward for nearness has fallen to one half
SQUARE = 0.5e-3  # m, skew at which the reward for squareness has fallen to one half
RESTING = 5e-3  # m/s, slower counts as settled
HOME_SWITCH = 0x04  # 60FDh bit 2
SIDE = observation("distance", "velocity", "following_error", "torque", "home_switch")
RANDOMISED = {"payload": (0.5, 6.0), "friction": (0.5, 2.0)}


@block
def act(episode, action, rpdos):
    """Move each set-point by action × speed × step time, within the stroke."""
    targets = episode._target
    for d in range(2):
        target = targets[d] + action.velocity[d] * episode._way
        targets[d] = min(max(target, 0.0), STROKE)
        rpdos[d].target_position = round(targets[d] * METRE)


@block
def judge(episode, rpdos, tpdos, observation):
    """Observe the TPDOs; reward the position and the skew of the bridge."""
    fastest = 0.0
    for d in range(2):
        side = observation.sides[d]
        position = tpdos[d].position_actual_value / METRE
        velocity = tpdos[d].velocity_actual_value / METRE
        fastest = max(fastest, abs(velocity))
        home = 1 if int(tpdos[d].digital_inputs) & HOME_SWITCH else 0
        if home and not episode._home[d]:
            episode._edge[d] = position
            episode._edges[d] = 1
        episode._home[d] = home
        side.distance = clip((episode.goal - position) / STROKE)
        side.velocity = clip(velocity / episode._speed)
        side.following_error = clip(tpdos[d].following_error_actual_value / METRE / episode._window)
        side.torque = clip(tpdos[d].torque_actual_value / episode._max_torque)
        side.home_switch = home
    apart = episode._target[1] - episode._target[0]
    found = episode._edges[0] and episode._edges[1]
    observation.set_point_difference = clip(apart / episode._max_twist)
    observation.switches_met = 1.0 if found else 0.0
    observation.switch_difference = 0.0
    if found:
        difference = episode._edge[1] - episode._edge[0]
        observation.switch_difference = clip(difference / episode._max_twist)
    qpos = coordinates(world_of(episode))
    skew = qpos[episode._skew_at] * episode._span
    distance = episode.goal - qpos[episode._bridge_at]
    away, twist = distance / NEAR, skew / SQUARE
    settled = (
        abs(distance) <= episode._tolerance
        and abs(skew) <= episode._skew_tolerance
        and fastest <= RESTING
    )
    episode.skew = skew
    episode._steps += 1.0
    episode._squares += skew * skew
    episode.distance = distance
    episode.reward_square = 1.0 / (1.0 + twist * twist)
    episode.reward_near = 1.0 / (1.0 + away * away)
    episode.reward_settled = 1.0 if settled else 0.0
    episode.reward = (
        0.4 * episode.reward_square + 0.3 * episode.reward_near + 0.3 * episode.reward_settled
    )
    episode.is_success = settled
    episode.twisted = not abs(skew) <= episode._max_twist
    episode._terminated = episode.twisted or faulted(tpdos)


class GantrySyncEnv(ServoEnv):
    """Bring the bridge of a gantry to a goal, square, with one drive on each of its rails.

    At power-up the bridge is skewed by an unknown amount, and the absolute encoders of x1 and x2
    show the same position: x1 is right, x2 is wrong by the skew. Slide and payload load the sides
    unequally. No drive measures the skew. It follows from the home switches, which lie at the same
    position of both rails (0.2 m) between start and goal, and from the torques that hold the bridge
    skewed. The agent is the master of both drives, in cyclic synchronous position mode. Y is held
    by its drive, Z is parked on its brake.

    ## Action space
    `Box(-1, 1, (2,), float32)`; with ``action="pdo"`` ten more a drive: `envs.exchange.faces`

    | no | name | action | object | scaling |
    |----|------|--------|--------|---------|
    | 0, 1 | velocity[:] | velocity of the set-point of x1, x2 | 607Ah | 1 is `speed` |

    A target position (1 µm) moves by action × `speed` × step time, within the stroke.

    ## Observation space
    `Box(-1, 1, (13,), float32)`, clipped; 0 to 4 of x1, 5 to 9 of x2

    | no | name | observation | object | 1.0 is |
    |----|------|-------------|--------|--------|
    | 0, 5 | sides[:].distance | goal minus position | 6064h | the stroke, 0.8 m |
    | 1, 6 | sides[:].velocity | velocity | 606Ch | the maximum profile velocity 607Fh |
    | 2, 7 | sides[:].following_error | following error | 60F4h | its window 6065h |
    | 3, 8 | sides[:].torque | torque | 6077h torque_actual_value | the maximum torque 6072h |
    | 4, 9 | sides[:].home_switch | home switch | 60FDh digital_inputs, bit 2 | active, else 0 |
    | 10 | set_point_difference | set-point of x2 minus that of x1 | 607Ah | `max_twist` |
    | 11 | switches_met | both home switches have been met | 60FDh | yes, else 0 |
    | 12 | switch_difference | \
position of x2 minus that of x1, each when its switch last became active | 6064h |\
 `max_twist` |

    The skew is number 10 minus number 12. Its accuracy depends on how slowly the bridge passes the
    switches, because a step lasts 5 ms (generic drive).

    ## Reward
    In [0, 1], by the true state: 0.4 for squareness, ``1 / (1 + (skew / 0.5 mm)²)``, 0.3 for
    nearness of the middle of the bridge, ``1 / (1 + (distance / 20 mm)²)``, and 0.3 for being
    settled: distance within `tolerance`, skew within `skew_tolerance`, both sides slower than 5
    mm/s. ``info`` has the terms, ``skew`` (m, positive where x2 is ahead), and ``cost``, the share
    of the step at an internal limit.

    ## Episode
    An episode starts at rest; ``np_random`` draws start (of x1), goal, the position of the slide
    and the skew, unless the reset's options give ``start``, ``goal``, ``y`` or ``skew`` (m). A skew
    of more than `max_twist` terminates (``info["twisted"]``), as does a fault of a drive
    (``info["fault"]``). Time truncates, after 600 steps (3 s).

    ## Arguments
    Those of `ServoEnv`, where `randomise` is ``{"payload": (0.5, 6.0), "friction": (0.5, 2.0)}`` by
    default; `skew` (m), the largest at the start; `max_twist`, `tolerance`,
    `skew_tolerance`, `following_error_window` (m); `speed` (m/s).

    ## Version history
    * v0: first version
    """

    ID = "servogym/GantrySync-v0"
    MEMORY_ONLY = "its episodes begin with a wrong reference of one drive of a bridge"
    STEPS = 600
    DRIVES = ("x1", "x2")
    RPDO = ("target_position",)
    TPDO = (*ServoEnv.TPDO, "digital_inputs")
    ACTION = action(("velocity", 2))
    OBSERVATION = observation(
        ("sides", 2, SIDE), "set_point_difference", "switches_met", "switch_difference"
    )
    EPISODE = episode(
        ("goal", "f8"),  # m
        ("distance", "f8"),  # goal minus the middle of the bridge (m)
        ("skew", "f8"),  # end of the bridge on x2 ahead of the one on x1 (m)
        ("twisted", "?"),  # beyond the permitted skew
        ("reward_square", "f8"),
        ("reward_near", "f8"),
        ("reward_settled", "f8"),
        ("_steps", "f8"),  # so far, the reset included
        ("_squares", "f8"),  # sum of skew² (m²)
        ("_target", "f8", (2,)),  # set-points (m)
        ("_home", "u1", (2,)),  # home switches one step ago
        ("_edge", "f8", (2,)),  # position at which the switch last became active (m)
        ("_edges", "u1", (2,)),  # whether the switch has become active
        ("_skew_at", "i8"),  # places in MjData.qpos
        ("_bridge_at", "i8"),
        ("_span", "f8"),  # between the rails (m)
        ("_way", "f8"),  # largest travel of a set-point in a step (m)
        ("_speed", "f8"),  # maximum profile velocity (m/s)
        ("_window", "f8"),  # of the following error (m)
        ("_max_torque", "f8"),  # per mille
        ("_max_twist", "f8"),  # m
        ("_tolerance", "f8"),  # m
        ("_skew_tolerance", "f8"),  # m
    )
    act = staticmethod(act)
    judge = staticmethod(judge)
    datasheet: GantryParameters

    STROKE = (STROKE, STROKE)
    BOUND = "squared"
    POLICIES = ("squaring_slow", "squaring", "tuned_squaring", "informed_squaring", "bound")
    REFERENCE = "squaring"
    METRIC = "settling_time"
    METRICS = {  # noqa: RUF012
        "rms_skew": Metric("rms skew (µm)", "low", "of the bridge, over the episode"),
        "last_skew": Metric("skew at the end (µm)", "low", "of the bridge"),
    }
    CHANNELS = (
        Channel("bridge\n(mm)", lambda env: MM * joint(env, "x")[0], goal),
        Channel(
            "bridge beyond\nthe goal (mm)",
            lambda env: MM * (joint(env, "x")[0] - env.episode.goal), window=tolerance, nearest=15.0
        ),
        Channel(
            "skew of the\nbridge (mm)", lambda env: MM * float(env.episode.skew),
            window=lambda env: MM * env.skew_tolerance,
        ),
        Channel("velocity of the\nbridge (m/s)", lambda env: joint(env, "x")[1]),
    )

    def __init__(
        self, drive: str | DriveModel = "generic", *, skew: float = 3e-3, max_twist: float = 0.01,
        tolerance: float = 1e-3, skew_tolerance: float = 0.2e-3, speed: float = 0.2,
        following_error_window: float = 5e-3,
        randomise: Mapping[str, float | tuple[float, ...]] | None = None, **arguments: Any
    ):
        self.max_twist = in_range("max_twist", max_twist, 1e-3, MAX_SKEW, "m")
        self.skew = in_range("skew", skew, 0.0, self.max_twist, "m")
        self.tolerance = in_range("tolerance", tolerance, 1e-6, 0.1, "m")
        self.skew_tolerance = in_range("skew_tolerance", skew_tolerance, 1e-6, 0.1, "m")
        self.speed = in_range("speed", speed, 1e-3, 1.0, "m/s")
        self._window = in_range("following_error_window", following_error_window, 1e-6, 1.0, "m")
        self.datasheet = GantryParameters(x_drives=2)
        randomise = RANDOMISED if randomise is None else randomise
        super().__init__(drive, randomise=randomise, **arguments)

    _make = of_datasheet

    def _begin(self, options: Options) -> None:
        limit = self.max_twist
        drawn = [
            self.np_random.uniform(*span)
            for span in (STARTS, GOALS, (0.0, Y_STROKE), (-self.skew, self.skew))
        ]
        start = options.number("start", drawn[0], limit, STROKE - limit, "m")
        goal = options.number("goal", drawn[1], 0.0, STROKE, "m")
        y = options.number("y", drawn[2], 0.0, Y_STROKE, "m")
        skew = options.number("skew", drawn[3], -limit, limit, "m")
        self.place({"x1": start, "x2": start + skew, "y": y}, believed={"x2": start})
        episode, model = self.episode, self.machine.model
        episode.goal = goal
        for d, drive in enumerate(self.drives):
            episode._target[d] = drive.read("position_actual_value") / METRE
            episode._home[d] = 1 if drive.read("digital_inputs") & HOME_SWITCH else 0
        episode._skew_at = model.joint("skew").qposadr[0]
        episode._bridge_at = model.joint("x").qposadr[0]
        episode._span = SPAN
        self.normalise()
        episode._way = self.speed * self.step_time
        episode._max_twist = self.max_twist
        episode._tolerance = self.tolerance
        episode._skew_tolerance = self.skew_tolerance

    def figures(self) -> dict[str, float]:
        """Return the skew over the episode and at its end."""
        episode = self.episode
        return {
            "rms_skew": UM * (episode._squares / episode._steps) ** 0.5,
            "last_skew": UM * abs(episode.skew),
        }

    def outcome(self) -> str:
        """Return whether the bridge was twisted too far."""
        return "bridge twisted" if self.episode.twisted else ""

    def ghosts(self) -> dict[str, np.ndarray]:
        """Return the bridge at the goal."""
        away = self.episode.goal - self.machine.data.joint("x").qpos[0]
        return {"bridge": np.array([away, 0.0, 0.0])}
