"""servogym/Homing-v0: find the reference of an axis fast, gently and repeatably."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from ...drive.kernel.jit import block
from ...drive.kernel.words import ENABLED, Mode
from ...drive.kernel.words import Controlword as C
from ...drive.master.master import Master
from ...drive.model.model import DriveModel, load
from ..engine.checks import Options, choice, in_range
from ..engine.machine import Machine
from ..engine.tick import HOME, NEGATIVE, POSITIVE
from ..environment.servo_env import METRE, ServoEnv
from ..exchange.batch import episode
from ..exchange.faces import PDO, clip, faulted, world_of
from ..exchange.fields import action, observation
from ..masters.homing_figures import FIELDS, HomingFigures, built_in, measure, prepare, true_home
from ..masters.port import MachinePort
from ..plants.axis_parameters import LinearAxisParameters, chosen
from ..view.channels import MM, Channel, in_mm, position, tolerance, velocity
from .exploration import CALM
from .plant import of_datasheet
from .positioning import STROKE
from .rewards import closeness

# reference -> the built-in method that looks for the same place, and the bit of its switch in 60FDh
REFERENCES = {"home_switch": (23, 2), "negative_limit_switch": (17, 0), "stop": (-17, None)}
MARGIN = 0.02  # m, distance of starts from the ends
HOMING = int(Mode.HOMING)
START = int(ENABLED | C.NEW_SET_POINT)  # homing operation start
THRESHOLD = 0.5  # of the action "reference here"
LEAST_TORQUE = 0.05  # smallest torque limit, as a share of the maximum torque
SHORTEST = 1e-3  # m, shortest travel to the reference, for the reward of the search
SEARCH, TAKEN = 0.2, 0.8  # rewards of the travel to the reference, and of the reference
COARSE, FINE = 0.05, 20.0  # m and tolerances, travel from an edge that is 1.0 in an observation
NEAR = 0.01  # m, error at which the accuracy has fallen to 0
DURATION = 1.0  # s, at which the reward for speed has fallen to one half
IMPACT = 0.1  # J, at which the reward for soft impacts has fallen to one half
NOWHERE = (1.0, -1.0)  # range of a switch that does not exist


@block
def act(episode, action, rpdos):
    """Command velocity and torque limit; above the threshold, declare home (mode hm, bit 4)."""
    rpdo = rpdos[0]
    rpdo.target_velocity = round(action.velocity * episode._max_velocity * METRE)
    share = LEAST_TORQUE + (1.0 - LEAST_TORQUE) * 0.5 * (1.0 + action.torque_limit)
    rpdo.max_torque = round(share * episode._max_torque)
    declared = action.reference > THRESHOLD
    rpdo.controlword = START if declared else ENABLED
    rpdo.modes_of_operation = HOMING if declared else episode._mode
    episode._time += episode._step_time


@block
def _terms(error, tolerance, time, impact_energy, greatest_torque):
    """Combine accuracy (half exactness, half closeness), speed and gentleness into a reward."""
    share = abs(error) / tolerance
    exact = 1.0 / (1.0 + share * share)
    close = closeness(share, NEAR / tolerance)
    impact = 1.0 / (1.0 + impact_energy / IMPACT)
    gentleness = 0.5 * impact + 0.5 * (1.0 - min(greatest_torque, 1.0))
    return 0.5 * exact + 0.5 * close, DURATION / (DURATION + time), gentleness


@block
def _worth(accuracy, speed, gentleness):
    """Return the reward of a reference, without that of the search."""
    return TAKEN * accuracy * (0.2 + 0.6 * speed + 0.2 * gentleness)


@block
def _watch_switches(episode, inputs, position):
    """Record the last limit switch, and the place where the reference switch last changed.

    The place is that in the middle of the step in which the switch changed.
    """
    if episode._switch >= 0:
        on = (inputs >> episode._switch & 1) != 0
        if on != episode._on:
            episode._edge = 0.5 * (episode._before + position)
            episode._edged = True
        episode._on = on
    episode._before = position
    if inputs & 3:
        episode._limit = 1.0 if inputs & 2 else -1.0


@block
def judge(episode, rpdos, tpdos, observation):
    """Observe the run so far; reward travel to the reference, and the reference at the end."""
    tpdo = tpdos[0]
    velocity = tpdo.velocity_actual_value / METRE
    behind = tpdo.velocity_demand_value / METRE - velocity
    inputs = int(tpdo.digital_inputs)
    observation.negative_limit_switch = inputs & 1
    observation.positive_limit_switch = inputs >> 1 & 1
    observation.home_switch = inputs >> 2 & 1
    observation.velocity = clip(velocity / episode._max_velocity)
    observation.torque = clip(tpdo.torque_actual_value / episode._max_torque)
    observation.velocity_error = clip(behind / episode._max_velocity)
    position = tpdo.position_actual_value / METRE
    if not episode._seen:
        episode._seen = True
        episode._power_on = episode._before = position
        episode._on = episode._switch >= 0 and (inputs >> episode._switch & 1) != 0
    observation.displacement = clip((position - episode._power_on) / STROKE)
    observation.torque_limit = clip(2.0 * rpdos[0].max_torque / episode._max_torque - 1.0)
    observation.time = episode._time / (episode._time + DURATION)
    _watch_switches(episode, inputs, position)
    way = position - episode._edge if episode._edged else 0.0
    observation.switched = 1.0 if episode._edged else 0.0
    observation.from_edge = clip(way / COARSE)
    observation.from_edge_fine = clip(way / (FINE * episode._tolerance))
    observation.last_limit_switch = episode._limit
    measure(world_of(episode), episode)
    home, now = episode._home, episode._position
    passed = (now - home) * (episode.start - home) <= 0.0
    left = 0.0 if passed else min(abs(now - home), episode._left)
    episode.reward_search = (episode._left - left) / max(abs(episode.start - home), SHORTEST)
    episode._left = left
    accuracy, speed, gentleness = _terms(
        episode.error, episode._tolerance, episode._time, episode.impact_energy,
        episode.greatest_torque,
    )
    ended = episode.attained
    episode.reward_accuracy = accuracy if ended else 0.0
    episode.reward_speed = speed if ended else 0.0
    episode.reward_gentleness = gentleness if ended else 0.0
    taken = _worth(episode.reward_accuracy, episode.reward_speed, episode.reward_gentleness)
    episode.reward = SEARCH * episode.reward_search + taken
    episode.is_success = ended and abs(episode.error) <= episode._tolerance
    episode._terminated = ended or faulted(tpdos)


def _home(env: Any) -> float:
    """Return the true home of the task, or of the built-in method that is running (m)."""
    return float(env.episode._home) if env.aim is None else env.aim


class HomingEnv(ServoEnv):
    """Find the reference of a linear axis: fast, gently and repeatably, from an unknown position.

    The drive is enabled and does not know its position. The agent moves it by velocity, in mode
    csv, or pv with a drive that lacks it. It observes switches, torque and the travel since
    power-on, and also which switches it has met, and where. At the reference the agent declares
    home: the drive then takes its present position as the reference, by homing mode and method 37
    or 35, which ends the episode. `built_in` runs a built-in method from the same start on the same
    machine, for comparison.

    ## Action space
    `Box(-1, 1, (3,), float32)`; with ``action="pdo"`` ten more: `servogym.envs.exchange.faces`

    | no | name | action | object | scaling |
    |----|------|--------|--------|---------|
    | 0 | velocity | velocity | 60FFh target_velocity | 1 is `max_velocity` |
    | 1 | torque_limit | torque limit | 6072h | -1 is 5 %, 1 is 100 % of the commissioned one |
    | 2 | reference | reference here | 6060h = 6, 6040h bit 4 | above 0.5 |

    With ``action="pdo"`` the agent itself commands mode and bit 4, and component 2 is without
    effect.

    ## Observation space
    `Box(-1, 1, (13,), float32)`, clipped

    | no | name | observation | object | 1.0 is |
    |----|------|-------------|--------|--------|
    | 0 | negative_limit_switch | negative limit switch | 60FDh digital_inputs bit 0 | active |
    | 1 | positive_limit_switch | positive limit switch | 60FDh bit 1 | active |
    | 2 | home_switch | home switch | 60FDh bit 2 | active |
    | 3 | velocity | velocity | 606Ch velocity_actual_value | `max_velocity` |
    | 4 | torque | torque | 6077h torque_actual_value | the commissioned 6072h |
    | 5 | velocity_error | velocity error | 606Bh velocity_demand_value - 606Ch | `max_velocity` |
    | 6 | displacement | travel since power-on | 6064h position_actual_value | the stroke, 0.5 m |
    | 7 | torque_limit | torque limit set, -1..1 | 6072h max_torque | the commissioned one |
    | 8 | time | time t | | t / (t + 1 s) |
    | 9 | switched | the switch of the reference has changed | 60FDh | at least once |
    | 10 | from_edge | travel since its last change, coarse | 6064h position_actual_value | 50 mm |
    | 11 | from_edge_fine | the same, fine | 6064h position_actual_value | 20 × `tolerance` |
    | 12 | last_limit_switch | limit switch met last | 60FDh bits 0, 1 | \
the positive one; -1 the negative, 0 none |

    The travel counts from the middle of the step in which the switch changed. Without a switch of
    the reference 9, 10 and 11 are 0.

    ## Reference
    The true home is that of a built-in method. A switch has a hysteresis of 0.3 mm.

    | ``reference`` | true home | method | switches |
    |---------------|-----------|--------|----------|
    | home_switch | left edge of the home switch, left to the left | 23 | all |
    | negative_limit_switch | its edge, left to the right | 17 | all |
    | stop | the left end stop | -17 | none |

    ## Reward
    In [0, 1]: ``0.2 search + 0.8 accuracy (0.2 + 0.6 speed + 0.2 gentleness)``. `search` is the
    share of the distance from the start to the reference that this step has covered for the first
    time; its sum is 1 as soon as the reference has been passed. The other terms come at the end:
    `accuracy` is one half of 1 / (1 + (e / tolerance)²) with the error e, and one half on a
    logarithmic scale from 1 at 0 to 0 at 10 mm; `speed` is 1 / (1 + time / 1 s); `gentleness` is
    one half of the share of the torque that was never used, and one half of
    1 / (1 + impact energy / 0.1 J). ``info`` has error (m), greatest_torque (share of the maximum,
    at the ends of steps), impact_energy (J), the position at power-on, start (m), and ``cost``, the
    share of the step at an internal limit.

    ## Episode
    An episode starts at rest at a random position; the switches are displaced by up to
    `switch_tolerance`. Both values come from ``np_random`` unless the reset's options give
    ``start`` and ``switch_offset`` (m). The episode terminates with the reference, a success within
    `tolerance`, or with a fault (``info["fault"]``). Time truncates, after 2000 steps.

    ## Arguments
    Those of `ServoEnv`, and `reference`, `max_velocity` (m/s), `tolerance` (m), `switch_tolerance`
    (m), `payload` (kg) and `parameters`, `LinearAxisParameters` or the name of a preset of `FAMILY`
    instead of `payload`. `randomise` varies friction and payload of an episode.

    ## Version history
    * v0: first version
    """

    ID = "servogym/Homing-v0"
    REFERENCED = False
    STEPS = 2000
    RPDO = ("target_velocity", "max_torque")
    TPDO = (
        "digital_inputs", "position_actual_value", "velocity_actual_value",
        "velocity_demand_value", "torque_actual_value",
    )
    ACTION = action("velocity", "torque_limit", "reference")
    OBSERVATION = observation(
        "negative_limit_switch", "positive_limit_switch", "home_switch", "velocity", "torque",
        "velocity_error", "displacement", "torque_limit", "time", "switched", "from_edge",
        "from_edge_fine", "last_limit_switch",
    )
    EPISODE = episode(
        *FIELDS,
        ("start", "f8"),  # m
        ("reward_search", "f8"),
        ("reward_accuracy", "f8"),
        ("reward_speed", "f8"),
        ("reward_gentleness", "f8"),
        ("_left", "f8"),  # smallest distance to the reference so far (m)
        ("_time", "f8"),  # s
        ("_step_time", "f8"),  # s
        ("_mode", "i8"),  # mode in which the agent moves
        ("_max_velocity", "f8"),  # m/s
        ("_max_torque", "f8"),  # as commissioned (per mille)
        ("_power_on", "f8"),  # position actual value (m)
        ("_switch", "i8"),  # bit of 60FDh; -1: none
        ("_on", "?"),
        ("_seen", "?"),  # whether a first observation has been made
        ("_edged", "?"),  # whether the switch has changed
        ("_edge", "f8"),  # position actual value at its last change (m)
        ("_limit", "f8"),  # limit switch met last: -1, 1, or 0
        ("_before", "f8"),  # position actual value a step ago (m)
        ("_tolerance", "f8"),  # m
    )
    act = staticmethod(act)
    judge = staticmethod(judge)

    BOUND = "homed"
    POLICIES = ("search", "tuned_search", "built_in", "built_in_fast", "informed_search", "bound")
    REFERENCE = "search"
    HOLD = {"torque_limit": 1.0, "reference": -1.0}  # noqa: RUF012, full torque, no reference
    METRIC = "settling_time"
    DONE = ("home declared", "no home declared")
    CHANNELS = (
        Channel("carriage\n(mm)", in_mm(position), lambda env: MM * _home(env)),
        Channel(
            "beyond the true\nreference (mm)", lambda env: MM * (position(env) - _home(env)),
            window=tolerance, nearest=30.0,
        ),
        Channel("velocity\n(m/s)", velocity),
    )
    STROKE = (STROKE,)
    # most of the reward comes at the end, hundreds of steps later
    HYPERPARAMETERS = {  # noqa: RUF012
        "PPO": CALM
        | {
            "learning_rate": 5e-4,
            "gamma": 0.998,
            "n_steps": 128,
            "batch_size": 1024,
            "sde_sample_freq": 32,
            "policy_kwargs": {"log_std_init": -2.5, "net_arch": [64, 64]},
        },
    }

    datasheet: LinearAxisParameters
    aim: float | None = None  # m, home of a built-in method while it runs

    def __init__(
        self, drive: str | DriveModel = "generic", *, reference: str = "home_switch",
        max_velocity: float = 0.5, tolerance: float = 100e-6, switch_tolerance: float = 5e-3,
        payload: float = 5.0, parameters: LinearAxisParameters | str | None = None, **arguments: Any
    ):
        choice("reference", reference, REFERENCES)
        self.reference = reference
        self.homing_method = REFERENCES[reference][0]
        self.max_velocity = in_range("max_velocity", max_velocity, 0.01, 2.0, "m/s")
        self.tolerance = in_range("tolerance", tolerance, 1e-6, 0.1, "m")
        self.switch_tolerance = in_range("switch_tolerance", switch_tolerance, 0.0, 0.02, "m")
        self.datasheet = chosen(parameters, payload)
        cyclic = Mode.CYCLIC_SYNC_VELOCITY in load(drive).modes
        own = Mode.CYCLIC_SYNC_VELOCITY if cyclic else Mode.PROFILE_VELOCITY
        self.MODES = (own, Mode.HOMING)
        super().__init__(drive, **arguments)

    def _make(self, model: DriveModel) -> Machine:
        machine = of_datasheet(self, model)
        coupling, x = machine.couplings[0], machine.drives["x"]
        if self.reference == "stop":
            for switch in (NEGATIVE, POSITIVE, HOME):
                coupling.switch_from[switch], coupling.switch_to[switch] = NOWHERE
        self._max_torque = x.read("max_torque")
        self._switches = coupling.switch_from.copy(), coupling.switch_to.copy()
        self._here = model.homes_here
        return machine

    def _begin(self, options: Options) -> None:
        start = self.np_random.uniform(MARGIN, STROKE - MARGIN)
        offset = self.np_random.uniform(-self.switch_tolerance, self.switch_tolerance)
        start = options.number("start", start, 0.0, STROKE, "m")
        offset = options.number("switch_offset", offset, -0.02, 0.02, "m")
        if self.on_a_bus:
            offset = 0.0  # its switches cannot be moved
        coupling, x = self.machine.couplings[0], self.drive
        for ends, places in zip(
            (coupling.switch_from, coupling.switch_to), self._switches, strict=True
        ):
            ends[:] = places + offset
        x.write("max_torque", self._max_torque)  # an agent may have left its own
        method, switch = REFERENCES[self.reference]
        home = true_home(self.machine, method)
        start = self.placed({"x": start}, (method, home))["x"]
        self.machine.reset(positions={"x": start})
        x.write("homing_method", self._here)
        master = Master(MachinePort(self.machine))
        x.write("modes_of_operation", self.MODES[0])
        master.enable()
        if self.face == PDO:
            master.control(0)
        episode = self.episode
        prepare(self.machine, episode, home)
        episode.start = start
        episode._left = abs(start - episode._home)
        episode._step_time = self.step_time
        episode._mode = self.MODES[0]
        episode._max_velocity = self.max_velocity
        episode._max_torque = self._max_torque
        episode._switch = -1 if switch is None else switch
        episode._tolerance = self.tolerance
        self._part.rpdos["max_torque"] = self._max_torque

    def figures(self) -> dict[str, float]:
        """Return the error of the home, and the energy of the impacts on the stops."""
        error = 1e6 * abs(self.episode.error) if self.episode.attained else math.nan
        return {"reference_error": error, "impact_energy": self.episode.impact_energy}

    def declared(self) -> bool:
        """Return whether home is declared, correctly or not."""
        return bool(self.machine.axes["homed"][0])

    def ghosts(self) -> dict[str, np.ndarray]:
        """Return the carriage at the true reference."""
        away = self.episode._home - self.machine.data.qpos[0]
        return {"carriage": np.array([away, 0.0, 0.0])}

    def built_in(
        self, method: int, objects: dict[str, int] | None = None,
        observer: Callable[[float], None] | None = None,
    ) -> HomingFigures:
        """Run a homing method of the drive with this episode's start, switches and loads.

        `objects` are written before, such as its speeds (position units/s). `observer` is called at
        the start and after each step with the time since the start (s). For errors see
        `servogym.envs.masters.homing_figures.built_in`.
        """
        if self.drive.model.search(method) is not None:
            self.aim = true_home(self.machine, method, self.episode.start)
        try:
            return built_in(
                self.machine, method, self.episode.start, stride=self.cycles_per_step,
                objects={"max_torque": self._max_torque} | (objects or {}), observer=observer,
            )
        finally:
            self.aim = None

    def judged(
        self, method: int, objects: dict[str, int] | None = None,
        observer: Callable[[float], None] | None = None,
    ) -> dict[str, float]:
        """Return the metrics of `built_in`; without a home there is no settling time."""
        figures = self.built_in(method, objects, observer)
        found = figures.attained
        metrics = {
            "episode_return": self.worth(figures),
            "success": found and abs(figures.error) <= self.tolerance,
            "peak_torque": figures.greatest_torque * self._max_torque * 1e-3,
            "reference_error": 1e6 * abs(figures.error) if found else math.nan,
            "impact_energy": figures.impact_energy,
        }
        return metrics | ({"settling_time": figures.time} if found else {})

    def worth(self, figures: HomingFigures) -> float:
        """Return the return that an agent would have earned with such a run."""
        if not figures.attained:
            return 0.0
        return SEARCH + _worth(*_terms(
            figures.error, self.tolerance, figures.time, figures.impact_energy,
            figures.greatest_torque,
        ))
