"""servogym/GantrySway-v0: bring a load that hangs from a gantry to rest at a goal."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from ...drive.kernel.jit import block
from ...drive.model.model import DriveModel
from ..engine.checks import Options, flag, in_range
from ..engine.tick import coordinates, load_noise, speeds
from ..environment.servo_env import METRE, ServoEnv
from ..exchange.batch import episode
from ..exchange.faces import clip, world_of
from ..exchange.fields import action, observation
from ..plants.gantry import GantryParameters
from ..view.about import Sensor
from ..view.channels import MM, Channel, drives, joint, tolerance
from .plant import of_datasheet
from .rewards import closeness, decades

STROKE = (0.8, 0.5)  # m, of X and Y
MARGIN = 0.05  # m, distance of starts and goals from the ends
CABLE = 0.3  # m, nominal length
CALM = math.radians(2.0)  # sway at which the reward for calm has fallen to one half
WIDEST = math.radians(20.0)  # sway that is 1.0 in an observation
AXES = ("x", "y")
MEASURED = ("distance", "position", "velocity", "following_error", "torque", "set_point")
LAST = "distance_logarithmic"
BLIND_AXIS = observation(*MEASURED, LAST)  # observations of an axis
AXIS = observation(*MEASURED, "sway", "sway_rate", LAST)
RANDOMISED = {"payload": (1.0, 5.0), "cable_length": (0.2, 0.4)}


@block
def act(episode, action, rpdos):
    """Move the set-points by action × speed × step time, within the strokes."""
    targets = episode._target
    for d in range(len(rpdos)):
        target = targets[d] + action.velocity[d] * episode._way
        targets[d] = min(max(target, 0.0), STROKE[d])
        rpdos[d].target_position = round(targets[d] * METRE)


@block
def _see(episode, tpdo, axis, d):
    """Observe the TPDO of an axis."""
    position = tpdo.position_actual_value / METRE
    axis.distance = clip((episode._goal[d] - position) / STROKE[d])
    axis.position = clip(2.0 * position / STROKE[d] - 1.0)
    axis.velocity = clip(tpdo.velocity_actual_value / METRE / episode._speed)
    axis.following_error = clip(tpdo.following_error_actual_value / METRE / episode._window)
    axis.torque = clip(tpdo.torque_actual_value / episode._max_torque)
    axis.set_point = clip((episode._target[d] - position) / episode._window)
    off = (episode._goal[d] - position) / episode._tolerance
    axis.distance_logarithmic = decades(off, STROKE[d] / episode._tolerance)


@block
def _judge(episode, tpdos):
    """Reward the true position of the load."""
    world = world_of(episode)
    qpos, qvel = coordinates(world), speeds(world)
    distance = speed = sway = 0.0  # their squares, summed over the axes
    for d in range(len(tpdos)):
        drive, rod = episode._drive_at[d], episode._sway_at[d]
        angle, rate = qpos[rod], qvel[rod]
        load = qpos[drive] + episode._length * math.sin(angle)
        away = episode._goal[d] - load
        moving = qvel[drive] + episode._length * math.cos(angle) * rate
        distance += away * away
        speed += moving * moving
        sway += angle * angle
        beyond = -episode._side[d] * away
        episode._overshoot = max(episode._overshoot, beyond)
    calm = sway / (CALM * CALM)
    off = math.sqrt(distance) / episode._tolerance + math.sqrt(speed) / episode._resting
    settled = (
        distance <= episode._tolerance * episode._tolerance
        and speed <= episode._resting * episode._resting
    )
    episode.distance = math.sqrt(distance)
    episode.sway = math.sqrt(sway)
    episode.reward_near = closeness(off, STROKE[0] / episode._tolerance)
    episode.reward_calm = 1.0 / (1.0 + calm)
    episode.reward_settled = 1.0 if settled else 0.0
    episode.reward = (
        0.4 * episode.reward_near + 0.1 * episode.reward_calm + 0.5 * episode.reward_settled
    )
    episode.is_success = settled


@block
def judge_blind(episode, rpdos, tpdos, observation):
    """Observe the TPDOs alone; reward the load."""
    for d in range(len(rpdos)):
        _see(episode, tpdos[d], observation.axes[d], d)
    _judge(episode, tpdos)


@block
def judge(episode, rpdos, tpdos, observation):
    """Observe the TPDOs and the sway; reward the load."""
    world = world_of(episode)
    qpos, qvel = coordinates(world), speeds(world)
    for d in range(len(rpdos)):
        axis = observation.axes[d]
        _see(episode, tpdos[d], axis, d)
        noise = load_noise(world) / episode._length
        axis.sway = clip((qpos[episode._sway_at[d]] + noise) / WIDEST)
        jump = (noise - episode._noise[d]) / episode._step_time  # in a rate that is a difference
        axis.sway_rate = clip((qvel[episode._sway_at[d]] + jump) / (WIDEST * episode._natural))
        episode._noise[d] = noise
    _judge(episode, tpdos)


def _hanging(env: Any, axis: str) -> tuple[float, float]:
    """Return position (m) and velocity (m/s) of the load along an axis."""
    (bridge, velocity), (angle, rate) = joint(env, axis), joint(env, f"sway_{axis}")
    length = env.episode._length
    return bridge + length * math.sin(angle), velocity + length * math.cos(angle) * rate


def _channels(d: int) -> tuple[Channel, ...]:
    """Return the channels of the load along an axis."""
    axis, of = "xy"[d], f" {'XY'[d]}"
    return (
        Channel(
            f"load in{of}\n(mm)", lambda env: MM * _hanging(env, axis)[0],
            lambda env: MM * env.episode._goal[d],
        ),
        Channel(
            f"load beyond\nthe goal in{of} (mm)",
            lambda env: MM * (_hanging(env, axis)[0] - env.episode._goal[d]), window=tolerance,
            nearest=15.0,
        ),
        Channel(f"velocity of the\nload in{of} (m/s)", lambda env: _hanging(env, axis)[1]),
        Channel(f"sway in{of}\n(degrees)", lambda env: math.degrees(joint(env, f"sway_{axis}")[0])),
    )


class GantrySwayEnv(ServoEnv):
    """Bring a load that hangs from a gantry on a cable to rest at a goal.

    The agent is the master of X, with ``axes="xy"`` also of Y, in cyclic synchronous position mode.
    The load swings almost undamped with a period of about ``2 π sqrt(length / g)``, 1.1 s for the
    nominal cable of 0.3 m. Length of the cable and mass of the load are unknown. A camera or a
    gyroscope at the hook measures the sway. Without it only the torques contain a trace of the
    sway, and `history` helps. Z, and Y if it is not used, do not move.

    ## Action space
    `Box(-1, 1, (1,), float32)`, 2 with ``axes="xy"``; with ``action="pdo"`` ten more per axis, see
    `servogym.envs.exchange.faces`

    | no | name | action | object | scaling |
    |----|------|--------|--------|---------|
    | 0, 1 | velocity[:] | velocity of the set-point of X, Y | 607Ah | 1 is `speed` |

    A target position (1 µm) moves by action × `speed` × step time, within the stroke.

    ## Observation space
    `Box(-1, 1, (9,), float32)`, clipped; with ``sway_sensor=False`` 7, without numbers 6 and 7;
    with ``axes="xy"`` the same numbers of Y follow

    | no | name | observation | object | 1.0 is |
    |----|------|-------------|--------|--------|
    | 0 | axes[:].distance | goal minus position | 6064h | the stroke, 0.8 m or 0.5 m |
    | 1 | axes[:].position | position, -1 and 1 at the ends | 6064h | half the stroke |
    | 2 | axes[:].velocity | velocity | 606Ch | the maximum profile velocity 607Fh |
    | 3 | axes[:].following_error | following error | 60F4h | its window 6065h |
    | 4 | axes[:].torque | torque | 6077h torque_actual_value | the maximum torque 6072h |
    | 5 | axes[:].set_point | set-point minus position | 607Ah, 6064h | its window 6065h |
    | 6 | axes[:].sway | sway, positive where the load is ahead | sensor | 20° |
    | 7 | axes[:].sway_rate | rate of the sway | sensor | 20° × sqrt(g / 0.3 m) |
    | 8 | axes[:].distance_logarithmic | goal minus position, logarithmic | 6064h | the stroke |

    ## Reward
    In [0, 1], for the load, not for the axes: 0.4 for nearness, 0.1 for calm,
    ``1 / (1 + (sway / 2°)²)``, and 0.5 for being settled (closer than `tolerance` and slower than
    `resting`). Nearness is 1 at rest at the goal and 0 a stroke of X away from it, on a logarithmic
    scale of distance / `tolerance` + velocity / `resting` (`servogym.envs.tasks.rewards`).
    ``info`` has the terms, ``distance`` (m) and ``sway`` (rad) of the load, and ``cost``, the
    share of the step at an internal limit.

    ## Episode
    An episode starts with the load at rest at a random start, with a random goal, both from
    ``np_random`` unless the reset's options give ``start`` and ``goal``, one number per axis (m).
    The option ``sway`` (rad) is the initial sway in X, by default 0. A fault of a drive
    terminates (``info["fault"]``). Time truncates, after 400 steps (4 s).

    ## Arguments
    Those of `ServoEnv`, where `step_time` is 10 ms and `randomise` is ``{"payload": (1.0, 5.0),
    "cable_length": (0.2, 0.4)}`` by default; `axes` ("x" or "xy"), `sway_sensor`,
    `speed` (m/s), `tolerance` (m), `resting` (m/s), `following_error_window` (m).

    ## Version history
    * v0: first version
    """

    ID = "servogym/GantrySway-v0"
    STEPS = 400
    STEP_TIME = 10e-3
    RPDO = ("target_position",)
    EPISODE = episode(
        ("goal_x", "f8"),  # goal of the load (m); that of Y counts if Y is used
        ("goal_y", "f8"),
        ("distance", "f8"),  # of the load from it (m)
        ("sway", "f8"),  # rad
        ("reward_near", "f8"),
        ("reward_calm", "f8"),
        ("reward_settled", "f8"),
        ("_goal", "f8", (2,)),  # the same
        ("_side", "f8", (2,)),  # direction from the start to the goal, -1 or 1
        ("_overshoot", "f8"),  # largest distance beyond the goal along an axis (m)
        ("_target", "f8", (2,)),  # set-points (m)
        ("_drive_at", "i8", (2,)),  # places in MjData.qpos and qvel
        ("_sway_at", "i8", (2,)),
        ("_length", "f8"),  # of the cable (m)
        ("_noise", "f8", (2,)),  # of the sensor, one step ago (rad)
        ("_step_time", "f8"),  # s
        ("_natural", "f8"),  # rate of the nominal pendulum (rad/s)
        ("_way", "f8"),  # largest travel of a set-point in a step (m)
        ("_speed", "f8"),  # maximum profile velocity (m/s)
        ("_window", "f8"),  # of the following error (m)
        ("_max_torque", "f8"),  # per mille
        ("_tolerance", "f8"),  # m
        ("_resting", "f8"),  # m/s
    )
    act = staticmethod(act)

    BOUND = "swayed"
    POLICIES = (
        "trapezoid", "jerk_limited", "ruckig", "ruckig+zv", "ruckig+zvd", "ruckig+notch", "lqr",
        "adaptive_lqr", "identified+zv", "identified+zvd", "mpc", "informed_lqr",
        "informed_ruckig+zv", "bound",
    )
    REFERENCE = "ruckig+zvd"  # plain ruckig leaves the load swinging, as holding still does
    METRIC = "settling_time"
    CHANNELS = _channels(0)
    STROKE = STROKE
    SENSOR = "sway_sensor"
    HYPERPARAMETERS = {"PPO": {"learning_rate": [1e-3, 0.0], "gamma": 0.99}}  # noqa: RUF012

    datasheet: GantryParameters

    def __init__(
        self, drive: str | DriveModel = "generic", *, axes: str = "x", sway_sensor: bool = True,
        speed: float = 0.5, tolerance: float = 5e-3, resting: float = 0.02,
        following_error_window: float = 0.02,
        randomise: Mapping[str, float | tuple[float, ...]] | None = None, **arguments: Any
    ):
        if axes not in ("x", "xy"):
            raise ValueError(f"axes = {axes!r}, use one of x, xy")
        self.DRIVES = tuple(axes)
        self.sway_sensor = flag("sway_sensor", sway_sensor)
        self.ACTION = action(("velocity", len(axes)))
        axis, self.judge = (AXIS, judge) if self.sway_sensor else (BLIND_AXIS, judge_blind)
        self.OBSERVATION = observation(("axes", len(axes), axis))
        self.speed = in_range("speed", speed, 1e-3, 1.0, "m/s")
        self.tolerance = in_range("tolerance", tolerance, 1e-6, 0.1, "m")
        self.resting = in_range("resting", resting, 1e-4, 1.0, "m/s")
        self._window = in_range("following_error_window", following_error_window, 1e-6, 1.0, "m")
        self.datasheet = GantryParameters(cable_length=CABLE)
        randomise = RANDOMISED if randomise is None else randomise
        super().__init__(drive, randomise=randomise, **arguments)

    _make = of_datasheet

    def _begin(self, options: Options) -> None:
        places = {name: self._place_of(name, options.get(name)) for name in ("start", "goal")}
        sway = options.number("sway", 0.0, -0.5, 0.5, "rad")
        self.place({"y": 0.5 * STROKE[1]} | dict(zip(AXES, places["start"], strict=False)))
        episode, model, data = self.episode, self.machine.model, self.machine.data
        for d, drive in enumerate(self.drives):
            episode._goal[d] = places["goal"][d]
            episode._side[d] = 1.0 if places["goal"][d] >= places["start"][d] else -1.0
            episode._target[d] = drive.read("position_actual_value") / METRE
        episode.goal_x, episode.goal_y = episode._goal
        for d, name in enumerate(AXES):
            # all joints are slides or hinges, so qpos and qvel have the same numbers
            episode._drive_at[d] = model.joint(name).qposadr[0]
            episode._sway_at[d] = model.joint(f"sway_{name}").qposadr[0]
        data.qpos[episode._sway_at[0]] = sway
        episode._length = -float(model.geom("payload").pos[2])
        episode._natural = math.sqrt(9.81 / CABLE)
        self.normalise()
        episode._way = self.speed * self.step_time
        episode._step_time = self.step_time
        episode._tolerance = self.tolerance
        episode._resting = self.resting

    def _place_of(self, what: str, given: Any) -> list[float]:
        """Return a position of the load from the reset's options, or drawn, per axis (m)."""
        drawn = [float(self.np_random.uniform(MARGIN, s - MARGIN)) for s in STROKE]
        wanted = drawn[: len(self.DRIVES)] if given is None else list(np.atleast_1d(given))
        if len(wanted) != len(self.DRIVES):
            raise ValueError(
                f"options[{what!r}] = {given!r} must have a number (m) for each of {self.DRIVES}"
            )
        return [
            in_range(f"options[{what!r}]", value, 0.0, STROKE[d], "m")
            for d, value in enumerate(wanted)
        ]

    def sensor(self) -> Sensor | None:
        """Return the sensor at the hook, if there is one, with lengths of the nominal cable."""
        widest, natural = WIDEST * CABLE, math.sqrt(9.81 / CABLE)
        return Sensor("sway", "sway_rate", widest, widest * natural) if self.sway_sensor else None

    def channels(self) -> tuple[Channel, ...]:
        """Return the channels of the load along each axis of the agent, and of the drives."""
        along = [channel for d in range(len(self.DRIVES)) for channel in _channels(d)]
        return tuple(along) + drives(len(self.drives) > 1)

    def figures(self) -> dict[str, float]:
        """Return the overshoot of the load."""
        return {"overshoot": 1e6 * self.episode._overshoot}

    def ghosts(self) -> dict[str, np.ndarray]:
        """Return the load at the goal."""
        place = self.machine.data.geom("payload").xpos
        away = [self.episode._goal[d] - place[d] for d in range(len(self.DRIVES))]
        return {"payload": np.array([*away, *[0.0] * (3 - len(away))])}
