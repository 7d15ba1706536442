"""servogym/CompliantAxis-v0: move a load on a spring to a goal without residual vibration."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from ...drive.kernel.jit import block
from ...drive.model.model import DriveModel
from ..engine.checks import Options, flag, in_range
from ..engine.tick import FARTHEST, coordinates, load_noise, speeds
from ..environment.servo_env import METRE, ServoEnv
from ..exchange.batch import episode
from ..exchange.faces import clip, world_of
from ..exchange.fields import action, observation
from ..plants.axis_parameters import chosen
from ..plants.linear_axis import LinearAxisParameters
from ..view.about import Sensor
from ..view.channels import MM, Channel, joint
from ..view.channels import linear_axis as linear_axis_channels
from .exploration import CALM
from .plant import of_datasheet
from .positioning import MARGIN, RESTING, STROKE
from .rewards import closeness, decades

DEFLECTION = 5e-3  # m, deflection of the spring that is 1.0 for the load sensor
RATE = 0.3  # m/s, rate of that amplitude at 10 Hz
GENTLE = 0.05  # J, vibration energy at which the reward for gentleness has fallen to one half
# On a held carriage a load of 5 kg vibrates at 10 Hz. The damping ratio of 0.01 is typical for
# bolted steel structures (0.005..0.02, inferred).
PARAMETERS = LinearAxisParameters(payload=5.0, stiffness=20_000.0, structural_damping=6.3)
RANDOMISE = {"payload": (2.0, 8.0), "stiffness": (0.5, 2.0), "structural_damping": (0.5, 2.0)}


@block
def act(episode, action, rpdos):
    """Move the set-point by action × maximum velocity × step time; add torque."""
    target = episode._target + action.velocity * episode._way
    episode._target = min(max(target, 0.0), STROKE)
    rpdos[0].target_position = round(episode._target * METRE)
    rpdos[0].torque_offset = round(action.torque * episode._torque_range)


@block
def _finite(x):
    """Return `x`, or if the physics has failed a number too large for any reward."""
    return x if abs(x) < FARTHEST else FARTHEST


@block
def judge(episode, rpdos, tpdos, observation):
    """Observe the TPDOs and the load sensor; reward the true position of the load."""
    tpdo = tpdos[0]
    world = world_of(episode)
    qpos, qvel = coordinates(world), speeds(world)
    deflection = _finite(qpos[episode._load])
    rate = _finite(qvel[episode._load])
    distance = episode.goal - _finite(qpos[episode._x]) - deflection
    velocity = _finite(qvel[episode._x]) + rate
    position = tpdo.position_actual_value / METRE
    observation.distance = clip((episode.goal - position) / STROKE)
    observation.position = clip(2.0 * position / STROKE - 1.0)
    observation.velocity = clip(tpdo.velocity_actual_value / METRE / episode._speed)
    observation.following_error = clip(tpdo.following_error_actual_value / METRE / episode._window)
    observation.torque = clip(tpdo.torque_actual_value / episode._max_torque)
    observation.set_point = clip((episode._target - position) / episode._window)
    noise = load_noise(world)
    observation.deflection = clip((deflection + noise) / DEFLECTION) if episode._sensor else 0.0
    jump = (noise - episode._noise) / episode._step_time  # in a rate that is a difference
    observation.deflection_rate = clip((rate + jump) / RATE) if episode._sensor else 0.0
    episode._noise = noise
    far = STROKE / episode._tolerance
    observation.distance_logarithmic = decades((episode.goal - position) / episode._tolerance, far)
    sag = deflection - episode._rest
    energy = 0.5 * (episode._stiffness * sag * sag + episode._mass * rate * rate)
    off = abs(distance) / episode._tolerance + abs(velocity) / RESTING
    settled = abs(distance) <= episode._tolerance and abs(velocity) <= RESTING
    episode.distance = distance
    episode.deflection = deflection
    episode.energy = energy
    episode.reward_near = closeness(off, far)
    episode.reward_settled = 1.0 if settled else 0.0
    episode.reward_gentle = 1.0 / (1.0 + energy / GENTLE)
    kept = 0.4 * episode.reward_near + 0.4 * episode.reward_settled
    episode.reward = kept + 0.2 * episode.reward_near * episode.reward_gentle
    episode.is_success = settled


class CompliantAxisEnv(ServoEnv):
    """Bring a load on a spring to rest at a goal.

    The motor moves a carriage on which the load is mounted elastically: a two-mass system with an
    unknown resonance, because payload, stiffness and damping differ from episode to episode. The
    agent is the master of a drive in cyclic synchronous position mode. Before the first step the
    drive is enabled and referenced. The drive measures the carriage only.

    ## Action space
    `Box(-1, 1, (2,), float32)`; with ``action="pdo"`` ten more: `servogym.envs.exchange.faces`

    | no | name | action | object | scaling |
    |----|------|--------|--------|---------|
    | 0 | velocity | velocity of the set-point | 607Ah | 1 is the maximum velocity 607Fh |
    | 1 | torque | torque feed-forward | 60B2h | 1 is `torque_range` × maximum torque 6072h |

    The target position (1 µm) moves by action × maximum velocity × step time, within the stroke.

    ## Observation space
    `Box(-1, 1, (9,), float32)`, clipped; `history` and `previous_action` let an agent identify the
    resonance

    | no | name | observation | object | 1.0 is |
    |----|------|-------------|--------|--------|
    | 0 | distance | goal minus position | 6064h position_actual_value | the stroke, 0.5 m |
    | 1 | position | position, -1 and 1 at the ends | 6064h | half the stroke |
    | 2 | velocity | velocity | 606Ch velocity_actual_value | the maximum profile velocity 607Fh |
    | 3 | following_error | following error | 60F4h | its window 6065h |
    | 4 | torque | torque | 6077h torque_actual_value | the maximum torque 6072h |
    | 5 | set_point | set-point minus position | 607Ah, 6064h | its window 6065h |
    | 6 | deflection | deflection of the load from the carriage | load sensor | 5 mm |
    | 7 | deflection_rate | velocity of the deflection | load sensor | 0.3 m/s |
    | 8 | distance_logarithmic | goal minus position, logarithmic | 6064h | the stroke, 0.5 m |

    The load sensor is an encoder or an integrated accelerometer on the load. It is wired to the
    master and not to the drive, and also has the `encoder_noise` of `randomise`. Without it
    (``load_sensor=False``) 6 and 7 are 0.

    ## Reward
    In [0, 1], by the true motion of the load: 0.4 for nearness, 0.4 for being settled (closer than
    `tolerance` and slower than 5 mm/s), and 0.2 for nearness × gentleness, where gentleness is
    ``1 / (1 + energy / 0.05 J)`` with the energy of spring and load relative to the carriage.
    Nearness is 1 at rest at the goal and 0 a stroke away from it, on a logarithmic scale of
    distance / `tolerance` + velocity / 5 mm/s (`servogym.envs.tasks.rewards`). ``info`` has the
    terms, ``distance`` and ``deflection`` (m) of the load, ``energy`` (J), and ``cost``, the share
    of the step at an internal limit.

    ## Episode
    An episode starts at rest at a random position, with a random goal, both from ``np_random``
    unless the reset's options give ``start`` and ``goal`` (m, of the load). A fault of the drive
    terminates (``info["fault"]``: code and meaning). Time truncates, after 400 steps (2 s).

    ## Arguments
    Those of `ServoEnv`, where `randomise` is payload 2..8 kg, stiffness and structural damping
    0.5..2 of the nominal by default, and `load_sensor`, `torque_range` (0..1; 0: action 1 has no
    effect), `tolerance` (m), `following_error_window` (m) and `parameters`, `LinearAxisParameters`
    with a stiffness; by default 5 kg on 20 kN/m with 6.3 N·s/m.

    ## Version history
    * v0: first version
    """

    ID = "servogym/CompliantAxis-v0"
    STEPS = 400
    RPDO = ("target_position", "torque_offset")
    ACTION = action("velocity", "torque")
    OBSERVATION = observation(
        "distance", "position", "velocity", "following_error", "torque", "set_point",
        "deflection", "deflection_rate", "distance_logarithmic",
    )
    EPISODE = episode(
        ("goal", "f8"),  # of the load (m)
        ("distance", "f8"),  # goal minus position of the load (m)
        ("deflection", "f8"),  # of the load from the carriage (m)
        ("energy", "f8"),  # of the vibration (J)
        ("reward_near", "f8"),
        ("reward_settled", "f8"),
        ("reward_gentle", "f8"),
        ("_x", "i8"),  # places of the carriage and of the load in qpos and qvel
        ("_load", "i8"),
        ("_mass", "f8"),  # of the load (kg)
        ("_stiffness", "f8"),  # N/m
        ("_rest", "f8"),  # deflection by the weight on an inclined axis (m)
        ("_sensor", "?"),
        ("_noise", "f8"),  # of the sensor at the load, one step ago (m)
        ("_step_time", "f8"),  # s
        ("_target", "f8"),  # set-point (m)
        ("_way", "f8"),  # largest travel of the set-point in a step (m)
        ("_speed", "f8"),  # maximum profile velocity (m/s)
        ("_window", "f8"),  # of the following error (m)
        ("_max_torque", "f8"),  # per mille
        ("_torque_range", "f8"),  # per mille, of action 1
        ("_tolerance", "f8"),  # m
    )
    act = staticmethod(act)
    judge = staticmethod(judge)

    BOUND = "positioned"
    POLICIES = (
        "trapezoid", "jerk_limited", "ruckig", "ruckig+zv", "ruckig+zvd", "ruckig+notch",
        "ruckig+ff", "lqr", "adaptive_lqr", "identified+zv", "identified+zvd", "mpc",
        "proportional", "informed_lqr", "informed_ruckig+zvd", "bound",
    )
    REFERENCE = "ruckig"
    METRIC = "settling_time"
    CHANNELS = linear_axis_channels(
        "load", Channel("deflection of\nthe load (mm)", lambda env: MM * joint(env, "load")[0])
    )
    STROKE = (STROKE,)
    SENSOR = "load_sensor"
    HYPERPARAMETERS = {"PPO": CALM}  # noqa: RUF012

    datasheet: LinearAxisParameters

    def __init__(
        self, drive: str | DriveModel = "generic", *, load_sensor: bool = True,
        torque_range: float = 0.1, parameters: LinearAxisParameters | str = PARAMETERS,
        tolerance: float = 100e-6, following_error_window: float = 0.02,
        randomise: Mapping[str, float | tuple[float, ...]] | None = None, **arguments: Any
    ):
        parameters = chosen(parameters, PARAMETERS.payload)
        if not (parameters.stiffness > 0.0 and parameters.payload > 0.0):
            raise ValueError(
                f"parameters: stiffness = {parameters.stiffness!r} N/m and payload = "
                f"{parameters.payload!r} kg must both be above 0: this task needs a load on a "
                "spring, for a rigid one take servogym/LinearAxis-v0"
            )
        self.datasheet = parameters
        self.load_sensor = flag("load_sensor", load_sensor)
        self.torque_range = in_range("torque_range", torque_range, 0.0, 1.0, "of 6072h")
        self.tolerance = in_range("tolerance", tolerance, 1e-6, 0.1, "m")
        self._window = in_range("following_error_window", following_error_window, 1e-6, 1.0, "m")
        ranges = _possible(parameters) if randomise is None else randomise
        super().__init__(drive, randomise=ranges, **arguments)

    _make = of_datasheet

    def _begin(self, options: Options) -> None:
        start, goal = self.np_random.uniform(MARGIN, STROKE - MARGIN, 2)
        start = options.number("start", start, 0.0, STROKE, "m")
        goal = options.number("goal", goal, 0.0, STROKE, "m")
        self.place({"x": start})
        episode, x, model = self.episode, self.drive, self.machine.model
        load = model.joint("load")
        episode.goal = goal
        episode._x = self.machine.couplings[0].qpos
        episode._load = load.qposadr[0]
        episode._mass = model.body("payload").mass[0]
        episode._stiffness = load.stiffness[0]
        episode._rest = episode._mass * model.opt.gravity[0] / episode._stiffness
        episode._sensor = self.load_sensor
        episode._step_time = self.step_time
        episode._target = x.read("position_actual_value") / METRE
        self.normalise()
        episode._way = episode._speed * self.step_time
        episode._torque_range = self.torque_range * episode._max_torque
        episode._tolerance = self.tolerance

    def sensor(self) -> Sensor | None:
        """Return the sensor at the load, if there is one."""
        one = Sensor("deflection", "deflection_rate", DEFLECTION, RATE)
        return one if self.load_sensor else None

    def settling(self) -> dict[str, float]:
        """Return goal and tolerance of the load."""
        return {"goal": float(self.episode.goal), "window": self.tolerance}

    def ghosts(self) -> dict[str, np.ndarray]:
        """Return the carriage and the load at the goal."""
        x, deflection = self.machine.data.qpos[self.episode._x], self.episode.deflection
        away = self.episode.goal - x - self.episode._rest
        return {
            "carriage": np.array([away, 0.0, 0.0]),
            "payload": np.array([away + self.episode._rest - deflection, 0.0, 0.0]),
        }


def _possible(parameters: LinearAxisParameters) -> dict[str, tuple[float, float]]:
    """The default ranges; a damping of 0 cannot be scaled."""
    ranges = dict(RANDOMISE)
    if parameters.structural_damping == 0.0:
        del ranges["structural_damping"]
    return ranges
