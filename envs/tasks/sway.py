"""servogym/GantrySway-v0: bring a load that hangs from a gantry to a goal, and to rest there."""

import math
from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np

from ...drive.jit import entry
from ...drive.model import DriveModel
from ..batch import episode
from ..checks import in_range
from ..faces import clip, faulted, limited
from ..gantry import GantryParameters, gantry
from ..loop import coordinates, speeds, world_at
from ..machine import Machine
from ..rewards import closeness, decades
from ..servo_env import METRE, ServoEnv
from ..vector_env import ServoVectorEnv

STROKE = (0.8, 0.5)  # m, of X and Y
MARGIN = 0.05  # m, starts and goals keep away from the ends
CABLE = 0.3  # m, what it is built with
CALM = math.radians(2.0)  # sway at which the reward for calm has fallen to one half
WIDEST = math.radians(20.0)  # sway that is 1.0 in an observation
AXES = ("x", "y")
SEEN, SENSED = 7, 2  # observations an axis: of the drive, of the sway sensor
RANDOMISED = {"payload": (1.0, 5.0), "cable_length": (0.2, 0.4)}


@entry
def act(worlds, episodes, actions, rpdos):
    """Move the set-points by action × speed × step time, within the strokes."""
    for w in range(len(worlds)):
        if worlds[w] == 0:
            continue
        targets = episodes[w]._target
        for d in range(rpdos.shape[1]):
            target = targets[d] + actions[w, d] * episodes[w]._way
            targets[d] = min(max(target, 0.0), STROKE[d])
            rpdos[w, d].target_position = round(targets[d] * METRE)


@entry
def judge(worlds, episodes, rpdos, tpdos, observations):
    """Observation of what the TPDOs brought back, reward of where the load is."""
    for w in range(len(worlds)):
        if worlds[w] == 0:
            continue
        episode, tpdo, seen = episodes[w], tpdos[w], observations[w]
        world = world_at(worlds[w], 1)[0]
        qpos, qvel = coordinates(world), speeds(world)
        distance = speed = sway = 0.0  # their squares, summed over the axes
        width = SEEN + (SENSED if episode._sensor else 0)
        for d in range(rpdos.shape[1]):
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
            at = d * width
            position = tpdo[d].position_actual_value / METRE
            seen[at] = clip((episode._goal[d] - position) / STROKE[d])
            seen[at + 1] = clip(2.0 * position / STROKE[d] - 1.0)
            seen[at + 2] = clip(tpdo[d].velocity_actual_value / METRE / episode._speed)
            seen[at + 3] = clip(tpdo[d].following_error_actual_value / METRE / episode._window)
            seen[at + 4] = clip(tpdo[d].torque_actual_value / episode._max_torque)
            seen[at + 5] = clip((episode._target[d] - position) / episode._window)
            if episode._sensor:
                seen[at + 6] = clip(angle / WIDEST)
                seen[at + 7] = clip(rate / (WIDEST * episode._natural))
            off = (episode._goal[d] - position) / episode._tolerance
            seen[at + width - 1] = decades(off, STROKE[d] / episode._tolerance)
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
        episode.cost = limited(tpdo)
        episode.is_success = settled
        episode._terminated = faulted(tpdo)


class GantrySwayEnv(ServoEnv):
    """Bring a load that hangs from a gantry on a cable to a goal, and to rest there.

    The agent is the master of X, and with ``axes="xy"`` of Y too, in cyclic synchronous position
    mode. The load swings with a period of about ``2 π sqrt(length / g)``, 1.1 s for the 0.3 m of
    the nominal cable, and hardly damped; how long the cable is and how heavy the load is not known.
    A camera or a gyroscope at the hook tells of the sway; without it the torques do, by little, and
    `history` helps. Z, and Y if it is not used, do not move.

    ## Action space
    `Box(-1, 1, (1,), float32)`, with ``axes="xy"`` 2; with ``action="pdo"`` ten more an axis, see
    `servogym.envs.faces`

    | no | action | object | scaling |
    |----|--------|--------|---------|
    | 0, 1 | velocity of the set-point of X, Y | 607Ah target_position | 1 is `speed` |

    A target position (1 µm) moves by action × `speed` × step time, within the stroke.

    ## Observation space
    `Box(-1, 1, (9,), float32)`, clipped; 7, without 6 and 7, with ``sway_sensor=False``; with
    ``axes="xy"`` the same of Y follows

    | no | observation | object | 1.0 is |
    |----|-------------|--------|--------|
    | 0 | goal minus position | 6064h position_actual_value | the stroke, 0.8 m or 0.5 m |
    | 1 | position, -1 and 1 at the ends | 6064h position_actual_value | half the stroke |
    | 2 | velocity | 606Ch velocity_actual_value | the maximum profile velocity 607Fh |
    | 3 | following error | 60F4h following_error_actual_value | its window 6065h |
    | 4 | torque | 6077h torque_actual_value | the maximum torque 6072h |
    | 5 | set-point minus position | 607Ah, 6064h | its window 6065h |
    | 6 | sway, positive where the load is ahead | sensor | 20° |
    | 7 | rate of the sway | sensor | 20° × sqrt(g / 0.3 m) |
    | 8 | goal minus position, logarithmic | 6064h position_actual_value | the stroke |

    ## Reward
    In [0, 1], of the load, not of the axes: 0.4 for nearness, 0.1 for calm,
    ``1 / (1 + (sway / 2°)²)``, and 0.5 for being settled: closer than `tolerance` and slower than
    `resting`. Nearness is 1 at rest at the goal and 0 a stroke of X away from it, on a logarithmic
    scale of distance / `tolerance` + velocity / `resting` (`servogym.envs.rewards`). ``info`` has
    the terms, ``distance`` (m) and ``sway`` (rad) of the load, and ``cost``, 1 while an internal
    limit is active.

    ## Episode
    Starts with the load at rest, at a random start with a random goal, both from ``np_random``
    unless the reset's options give ``start`` and ``goal``: a number for each axis (m), one number
    for ``axes="x"``; and ``sway`` (rad), of the load in X, 0 if not given. A fault of a drive
    terminates (``info["fault"]``). Time truncates, after 400 steps (4 s).

    ## Arguments
    Those of `ServoEnv`, with 20 `cycles_per_step` and ``{"payload": (1.0, 5.0), "cable_length":
    (0.2, 0.4)}`` for `randomise` if they are not given; `axes` ("x" or "xy"), `sway_sensor`,
    `speed` (m/s), `tolerance` (m), `resting` (m/s), `following_error_window` (m).

    ## Version history
    * v0: first version
    """

    ID = "servogym/GantrySway-v0"
    STEPS = 400
    RPDO = ("target_position",)
    EPISODE = episode(
        ("goal_x", "f8"),  # of the load (m); of Y if it is used
        ("goal_y", "f8"),
        ("distance", "f8"),  # of the load from it (m)
        ("sway", "f8"),  # rad
        ("reward_near", "f8"),
        ("reward_calm", "f8"),
        ("reward_settled", "f8"),
        ("_goal", "f8", (2,)),  # the same
        ("_side", "f8", (2,)),  # of the goal as seen from the start, -1 or 1
        ("_overshoot", "f8"),  # farthest beyond the goal along an axis (m)
        ("_target", "f8", (2,)),  # set-points (m)
        ("_drive_at", "i8", (2,)),  # places in MjData.qpos and qvel
        ("_sway_at", "i8", (2,)),
        ("_length", "f8"),  # of the cable (m)
        ("_natural", "f8"),  # rate of the nominal pendulum (rad/s)
        ("_sensor", "?"),
        ("_way", "f8"),  # farthest a set-point goes in a step (m)
        ("_speed", "f8"),  # maximum profile velocity (m/s)
        ("_window", "f8"),  # of the following error (m)
        ("_max_torque", "f8"),  # per mille
        ("_tolerance", "f8"),  # m
        ("_resting", "f8"),  # m/s
    )
    act = staticmethod(act)
    judge = staticmethod(judge)

    def __init__(
        self,
        drive: str | DriveModel = "generic",
        *,
        axes: str = "x",
        sway_sensor: bool = True,
        speed: float = 0.5,
        tolerance: float = 5e-3,
        resting: float = 0.02,
        following_error_window: float = 0.02,
        cycles_per_step: int = 20,
        randomise: Mapping[str, float | tuple[float, float]] | None = None,
        **arguments: Any,
    ):
        if axes not in ("x", "xy"):
            raise ValueError(f"axes = {axes!r}, use one of x, xy")
        self.DRIVES = tuple(axes)
        self.sway_sensor = bool(sway_sensor)
        self.ACTIONS = len(axes)
        self.OBSERVATIONS = len(axes) * (SEEN + SENSED * self.sway_sensor)
        self.speed = in_range("speed", speed, 1e-3, 1.0, "m/s")
        self.tolerance = in_range("tolerance", tolerance, 1e-6, 0.1, "m")
        self.resting = in_range("resting", resting, 1e-4, 1.0, "m/s")
        window = in_range("following_error_window", following_error_window, 1e-6, 1.0, "m")
        self._window = window
        self._parameters = GantryParameters(cable_length=CABLE)
        randomise = RANDOMISED if randomise is None else randomise
        super().__init__(drive, cycles_per_step=cycles_per_step, randomise=randomise, **arguments)

    def _make(self, model: DriveModel) -> Machine:
        machine = gantry(model, parameters=self._parameters)
        for name in self.DRIVES:
            machine.drives[name].write("following_error_window", round(self._window * METRE))
        return machine

    def _begin(self, options: dict[str, Any]) -> None:
        places = {name: self._place_of(name, options.get(name)) for name in ("start", "goal")}
        sway = in_range("options['sway']", options.get("sway", 0.0), -0.5, 0.5, "rad")
        self.place({"y": 0.5 * STROKE[1]} | dict(zip(AXES, places["start"], strict=False)))
        episode, model, data = self.episode, self.machine.model, self.machine.data
        for d, drive in enumerate(self.drives):
            episode._goal[d] = places["goal"][d]
            episode._side[d] = 1.0 if places["goal"][d] >= places["start"][d] else -1.0
            episode._target[d] = drive.read("position_actual_value") / METRE
        episode.goal_x, episode.goal_y = episode._goal
        for d, name in enumerate(AXES):
            # all joints slide or turn, so a degree of freedom has the number of its coordinate
            episode._drive_at[d] = model.joint(name).qposadr[0]
            episode._sway_at[d] = model.joint(f"sway_{name}").qposadr[0]
        data.qpos[episode._sway_at[0]] = sway
        episode._length = -float(model.geom("payload").pos[2])
        episode._natural = math.sqrt(9.81 / CABLE)
        episode._sensor = self.sway_sensor
        self.normalise()
        episode._way = self.speed * self.step_time
        episode._tolerance = self.tolerance
        episode._resting = self.resting

    def _place_of(self, what: str, given: Any) -> list[float]:
        """A place of the load by the reset's options, or drawn; a number an axis (m)."""
        drawn = [float(self.np_random.uniform(MARGIN, s - MARGIN)) for s in STROKE]
        wanted = drawn[: self.ACTIONS] if given is None else list(np.atleast_1d(given))
        if len(wanted) != self.ACTIONS:
            raise ValueError(
                f"options[{what!r}] = {given!r} must have a number (m) for each of {self.DRIVES}"
            )
        return [
            in_range(f"options[{what!r}]", value, 0.0, STROKE[d], "m")
            for d, value in enumerate(wanted)
        ]

    def ghosts(self) -> dict[str, np.ndarray]:
        """The load at the goal."""
        place = self.machine.data.geom("payload").xpos
        away = [self.episode._goal[d] - place[d] for d in range(self.ACTIONS)]
        return {"payload": np.array([*away, *[0.0] * (3 - len(away))])}


vector = partial(ServoVectorEnv, GantrySwayEnv)
