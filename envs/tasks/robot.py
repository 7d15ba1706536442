"""servogym/Robot-v0: drives on the joints of any MJCF, and goals for its joints or for a site."""

import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from ...drive.kernel.jit import block
from ...drive.model.model import DriveModel
from ...drive.model.names import hint, named
from ..engine.checks import Options, in_range
from ..engine.machine import Machine
from ..engine.mjcf import JOINT_TYPES
from ..engine.mjcf_reading import read
from ..engine.tick import coordinates
from ..engine.touch import obstacles
from ..environment.servo_env import METRE, ServoEnv
from ..exchange.batch import episode
from ..exchange.faces import clip, world_of
from ..exchange.fields import action, observation
from ..plants.axis_parameters import Joints
from ..plants.commissioning import commission_joint
from ..view.channels import FIRST_DRIVE, Channel
from . import chain
from .rewards import closeness, decades

MOST = 32  # drives
FAR = 1000.0  # tolerances, distance without a reward
TRIES = 50  # goals that are drawn at most to find one without contacts
ARM = Path(__file__).parents[1].with_name("assets") / "mjcf/arm.xml"
AXIS = observation("distance", "distance_fine", "position", "velocity", "following_error", "torque")


@block
def act(episode, action, rpdos):
    """Move each set-point at action × profile velocity, with the profile acceleration."""
    for d in range(len(rpdos)):
        ramp = episode._ramp[d]
        wanted = action.velocity[d] * episode._way[d]
        episode._move[d] = min(max(wanted, episode._move[d] - ramp), episode._move[d] + ramp)
        target = episode._target[d] + episode._move[d]
        episode._target[d] = min(max(target, episode._low[d]), episode._high[d])
        rpdos[d].target_position = round(episode._target[d] * METRE)


@block
def judge(episode, rpdos, tpdos, observation):
    """Observe the TPDOs; reward the joints that have a goal, or the site."""
    farthest = fastest = 0.0
    for d in range(len(rpdos)):
        tpdo, axis = tpdos[d], observation.axes[d]
        position = tpdo.position_actual_value / METRE
        velocity = tpdo.velocity_actual_value / METRE
        away = episode._goal[d] - position if episode._sought[d] else 0.0
        axis.distance = clip(away / episode._range[d])
        axis.distance_fine = decades(away / episode._tolerance, FAR)
        axis.position = clip((position - episode._middle[d]) / episode._range[d])
        axis.velocity = clip(velocity / episode._speed[d])
        window = episode._windows[d]
        axis.following_error = clip(tpdo.following_error_actual_value / METRE / window)
        axis.torque = clip(tpdo.torque_actual_value / episode._torque[d])
        farthest = max(farthest, abs(away))
        fastest = max(fastest, abs(velocity))
    if episode._at_site:
        qpos = coordinates(world_of(episode))
        chain.place(episode._chain, qpos, episode._place)
        episode.x = episode._place[0]
        episode.y = episode._place[1]
        episode.z = episode._place[2]
        farthest = 0.0
        for k in range(3):
            away = episode._place_goal[k] - episode._place[k]
            observation.site[k] = clip(away / episode._reach)
            observation.site_fine[k] = decades(away / episode._tolerance, FAR)
            farthest += away * away
        farthest = math.sqrt(farthest)
    settled = farthest <= episode._tolerance and fastest <= episode._resting
    off = farthest / episode._tolerance + fastest / episode._resting
    episode.distance = farthest
    episode.reward_near = closeness(off, FAR)
    episode.reward_settled = 1.0 if settled else 0.0
    episode.reward = 0.5 * episode.reward_near + 0.5 * episode.reward_settled
    episode.is_success = settled


class RobotEnv(ServoEnv):
    """Bring the joints of a robot, or a site on it, to a goal and hold it there.

    The robot is any MJCF; `Machine.from_mjcf` and `commission_joint` put drives on its joints. The
    agent moves the target positions in cyclic synchronous position mode. Before the first step the
    drives are enabled, and referenced at the present pose of the robot.

    ## Action space
    `Box(-1, 1, (n,), float32)` for n drives; with ``action="pdo"`` ten more for each

    | no | name | action | object | scaling |
    |----|------|--------|--------|---------|
    | 0 to n-1 | velocity[:] | velocity of the set-point, reached at 6083h | 607Ah | 1 is 6081h |

    ## Observation space
    `Box(-1, 1, (6 n + 6,), float32)`, clipped; for each drive:

    | name | observation | object | 1.0 is |
    |------|-------------|--------|--------|
    | axes[:].distance | goal minus position, 0 without a goal | 6064h | half the range |
    | axes[:].distance_fine | the same, logarithmic | 6064h | 1000 `tolerance` |
    | axes[:].position | from the middle of the range | 6064h | half the range |
    | axes[:].velocity | velocity | 606Ch | the maximum profile velocity 607Fh |
    | axes[:].following_error | following error | 60F4h | its window 6065h |
    | axes[:].torque | torque | 6077h | the maximum torque 6072h |

    then ``site[:]`` and ``site_fine[:]``, goal minus place of the site in the world's X, Y and Z,
    0 without a site; 1.0 is `reach`, or 1000 `tolerance` on a logarithmic scale.

    ## Reward
    In [0, 1]: half for nearness, half for being settled (closer than `tolerance`, and no joint
    faster than `resting`). The distance is that of the joint farthest from its goal (rad or m), or
    that of the site (m). ``info`` has the terms, `distance`, `x`, `y`, `z` (m) of the site,
    ``is_success`` and ``info["cost"]``, the share of the step at an internal limit.

    ## Episode
    An episode starts at rest in the first keyframe of the MJCF, or at its zero. Goals are poses
    drawn within `span` of it, in which the robot has no contacts beyond those at the start; the
    goal of a site is its position in such a pose. The reset's options may give ``start``
    and ``goal``: rad or m by joint, ``goal`` with a site its place (m, three numbers). A fault of a
    drive terminates. Time truncates, after 400 steps (2 s).

    ## Arguments
    Those of `ServoEnv`, and `mjcf` (path or text; by default an arm with three joints), `drives`
    (names of joints or actuators, or a drive model for each by name; by default all joints with an
    actuator, otherwise all hinges and slides), `gears` and `folder` of `Machine.from_mjcf`, `goals`
    (names of the drives that have goals, by default all), `site` (its name; the goal is then a
    position), `span` (share of the range around the start; rad or m for an unlimited joint),
    `tolerance` and `reach` (rad or m), `resting` (rad/s or m/s), and `max_velocity` and
    `max_acceleration` of `commission_joint`, for all joints.

    ## Version history
    * v0: first version
    """

    ID = "servogym/Robot-v0"
    STEPS = 400
    RPDO = ("target_position",)
    ACTION = action(("velocity", (1,)))
    OBSERVATION = observation(("axes", (1,), AXIS), ("site", (3,)), ("site_fine", (3,)))
    EPISODE = episode(
        ("distance", "f8"),  # m or rad
        ("x", "f8"),  # place of the site in the world (m)
        ("y", "f8"),
        ("z", "f8"),
        ("reward_near", "f8"),
        ("reward_settled", "f8"),
        *(
            (name, "f8", (MOST,))
            for name in (
                "_target", "_way", "_move", "_ramp", "_low", "_high", "_goal", "_sought",
                "_range", "_middle", "_speed", "_windows", "_torque",
            )
        ),
        ("_at_site", "?"),
        ("_chain", "f8", (chain.LONGEST, chain.WIDTH)),
        ("_place", "f8", (3,)),
        ("_place_goal", "f8", (3,)),
        ("_reach", "f8"),
        ("_tolerance", "f8"),
        ("_resting", "f8"),
    )
    act = staticmethod(act)
    judge = staticmethod(judge)
    BOUND = "reached"
    POLICIES: tuple[str, ...] = (
        "trapezoid", "proportional", "tuned_proportional", "informed_trapezoid", "bound",
    )
    REFERENCE: str = "trapezoid"
    UNIT = "m or rad"
    CHANNELS = (
        Channel("from the goal\n(m)", lambda env: float(env.episode.distance), nearest=15.0,
                window=lambda env: env.tolerance),
        *FIRST_DRIVE,
    )

    def __init__(
        self, drive: str | Path | DriveModel = "generic", *, mjcf: str | Path = ARM,
        drives: Mapping[str, str | DriveModel] | Sequence[str] | None = None,
        gears: Mapping[str, float] | None = None, folder: str | Path | None = None,
        goals: Sequence[str] | None = None, site: str | None = None, span: float = 0.25,
        tolerance: float = 1e-3, reach: float = 1.0, resting: float = 0.05,
        max_velocity: float | None = None, max_acceleration: float | None = None, **arguments: Any
    ):
        self._robot = mjcf, gears, folder
        self._speeds: dict[str, Any] = {
            "max_velocity": max_velocity,
            "max_acceleration": max_acceleration,
        }
        spec = read(mjcf, folder)
        if drives is None or isinstance(drives, Mapping):
            self._models = named("drives", drives, '{"joint": "generic"}')
        elif not isinstance(drives, Iterable):
            raise ValueError(f"drives = {drives!r}: give names, or drive models by name")
        else:
            self._models = dict.fromkeys([drives] if isinstance(drives, str) else drives, "")
        self._models = self._models or dict.fromkeys(_drivable(spec), "")
        names = list(self._models)
        if not 0 < len(names) <= MOST:
            raise ValueError(f"drives: {len(names)} joints would get one, 1..{MOST} are possible")
        goals = [goals] if isinstance(goals, str) else goals
        if not (goals is None or (isinstance(goals, Iterable) and [*goals])):
            raise ValueError(f"goals = {goals!r}: give names of drives, as ['{names[0]}']")
        for name in goals or ():
            if name not in names:
                raise ValueError(f"goals: there is no drive {name!r}: {hint(str(name), names)}")
        if site is not None and (not isinstance(site, str) or spec.site(site) is None):
            known = [each.name for each in spec.sites if each.name]
            raise ValueError(f"site = {site!r}: {hint(str(site), known) or 'the model has none'}")
        self.goals, self.site = tuple(goals or names), site
        self.span = in_range("span", span, 0.0, 100.0, "of the range, rad or m")
        self.tolerance = in_range("tolerance", tolerance, 1e-6, 1.0, "m or rad")
        self.reach = in_range("reach", reach, 1e-3, 100.0, "m")
        self.resting = in_range("resting", resting, 1e-6, 100.0, "m/s or rad/s")
        self.ACTION = action(("velocity", (len(names),)))
        self.OBSERVATION = observation(
            ("axes", (len(names),), AXIS), ("site", (3,)), ("site_fine", (3,))
        )
        if site is not None:
            self.POLICIES, self.REFERENCE = (), ""  # which command joints
        super().__init__(drive, **arguments)
        self.datasheet = Joints(tuple(self._half(i) for i in range(len(names))))

    def highest_reward(self, distance: np.ndarray) -> np.ndarray:
        """Return the reward at rest for each distance (m or rad) of the farthest joint."""
        near = np.array([closeness(each / self.tolerance, FAR) for each in distance])
        return 0.5 * near + 0.5 * (distance <= self.tolerance)

    def _half(self, i: int) -> float:
        """Return half the range of the i-th drive."""
        low, high = (self.drives[i].read(f"{end}_position_limit") / METRE for end in ("min", "max"))
        return math.pi if low >= high else 0.5 * (high - low)

    def _make(self, model: DriveModel) -> Machine:
        mjcf, gears, folder = self._robot
        models = {name: own or model for name, own in self._models.items()}
        machine = Machine.from_mjcf(mjcf, models, gears=gears, folder=folder)
        robot, data = machine.model, machine.data
        if robot.nkey:
            data.qpos[:] = robot.key_qpos[0]
        self._own = {
            name: self._within(machine, name, float(data.qpos[machine.couplings[i].qpos]))
            for i, name in enumerate(machine.drives)
        }
        machine.reset(positions=self._own)
        for name in machine.drives:
            commission_joint(machine, name, tuned=self.tuned, **self._speeds)
        self._scratch = mujoco.MjData(robot)
        self._table = (
            np.full((chain.LONGEST, chain.WIDTH), -1.0)
            if self.site is None
            else chain.table(robot, robot.site(self.site).id)
        )
        return machine

    @staticmethod
    def _within(machine: Machine, name: str, position: float) -> float:
        """Limit a coordinate of a drive to the range of its joint."""
        low, high = machine.range(name)
        return min(max(position, low), high)

    def _begin(self, options: Options) -> None:
        start = self._own | self._given("start", options.get("start"))
        self.place(start)
        if self.face != "pdo":
            self.machine.step()
        goal, at = self._goal(start, options.get("goal"))
        episode = self.episode
        for i, (name, x) in enumerate(self.machine.drives.items()):
            read = {
                key: x.read(key) / METRE
                for key in ("min_position_limit", "max_position_limit", "profile_velocity",
                            "profile_acceleration",
                            "max_profile_velocity", "following_error_window")
            }
            low, high = read["min_position_limit"], read["max_position_limit"]
            free = low >= high
            episode._low[i], episode._high[i] = (-math.inf, math.inf) if free else (low, high)
            episode._range[i] = self._half(i)
            episode._middle[i] = 0.0 if free else 0.5 * (high + low)
            episode._target[i] = x.read("position_actual_value") / METRE
            episode._way[i] = read["profile_velocity"] * self.step_time
            episode._ramp[i] = read["profile_acceleration"] * self.step_time**2
            episode._speed[i] = read["max_profile_velocity"]
            episode._windows[i] = read["following_error_window"]
            episode._torque[i] = x.read("max_torque")
            episode._goal[i] = goal[name]
            episode._sought[i] = name in self.goals and self.site is None
        episode._at_site = self.site is not None
        episode._chain, episode._place_goal = self._table, at
        episode._reach, episode._tolerance = self.reach, self.tolerance
        episode._resting = self.resting

    def ghosts(self) -> dict[str, np.ndarray]:
        """Return the site at its goal."""
        if self.site is None:
            return {}
        return {self.site: self.episode._place_goal - self.machine.data.site(self.site).xpos}

    def goal_pose(self) -> np.ndarray | None:
        """Return the pose with all joints at their goals; a site has no unique pose."""
        if self.site is not None:
            return None
        pose = self.machine.data.qpos.copy()
        for coupling, goal, sought in zip(
            self.machine.couplings, self.episode._goal, self.episode._sought, strict=False
        ):
            if sought:
                pose[coupling.qpos] = goal
        return pose

    def _given(self, option: str, places: Any) -> dict[str, float]:
        """Check an option with positions by drive, each in the range of its joint."""
        given = named(f"options[{option!r}]", places, '{"joint": 0.3}')
        names = [*self.machine.drives]
        for name, place in given.items():
            if name not in names:
                raise ValueError(
                    f"options[{option!r}]: there is no drive {name!r}: {hint(name, names)}"
                )
            in_range(f"options[{option!r}][{name!r}]", place, *self.machine.range(name), "m or rad")
        return given

    def _goal(self, start: Mapping[str, float], given: Any) -> tuple[dict[str, float], np.ndarray]:
        """Return the goal of each drive, and that of the site (m)."""
        if self.site is not None and given is not None:
            place = np.array(given, float) if np.shape(given) == (3,) else np.full(3, np.nan)
            if not np.isfinite(place).all():
                raise ValueError(f"options['goal'] = {given!r}: give the place of the site (m)")
            return dict(start), place
        wanted = self._given("goal", given)
        before, goal = self._touching(start), dict(start)
        for _ in range(TRIES):
            goal = dict(start)
            for name in self.machine.drives:
                if name in self.goals:
                    low, high = self.machine.range(name)
                    way = self.span * (high - low if math.isfinite(high - low) else 1.0)
                    drawn = start[name] + self.np_random.uniform(-way, way)
                    goal[name] = self._within(self.machine, name, drawn)
            goal |= wanted
            if self._touching(goal) <= before:
                break
        place = np.zeros(3)
        if self.site is not None:
            place = self._scratch.site(self.site).xpos.copy()
        return goal, place

    def _touching(self, pose: Mapping[str, float]) -> set[str]:
        """Return the contacts of the driven joints in a pose."""
        model, data = self.machine.model, self._scratch
        data.qpos[:] = self.machine.data.qpos
        for i, name in enumerate(self.machine.drives):
            data.qpos[self.machine.couplings[i].qpos] = pose[name]
        mujoco.mj_forward(model, data)
        joints = model.dof_jntid[self.machine.couplings["dof"]].tolist()
        return {contact for joint in joints for contact in obstacles(model, data, joint)}


def _drivable(spec: mujoco.MjSpec) -> list[str]:
    """Return the joints with an actuator, otherwise all hinges and slides with a name."""
    joints = [joint.name for joint in spec.joints if joint.type in JOINT_TYPES and joint.name]
    acting = [actuator.target for actuator in spec.actuators]
    return [name for name in joints if acting.count(name) == 1] or joints
