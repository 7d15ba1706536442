"""servogym/Commissioning-v0: bring a drive in fault to an axis in position, word by word."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from ...drive.kernel.faults import Cause, Reaction
from ...drive.kernel.jit import block
from ...drive.kernel.words import Mode, State
from ...drive.model.model import DriveModel
from ..engine.checks import Options, in_range
from ..engine.machine import Machine
from ..engine.tick import axes_at
from ..environment.servo_env import METRE, ServoEnv
from ..exchange.batch import episode
from ..exchange.faces import PDO, clip, world_of
from ..exchange.fields import action, observation
from ..plants.axis_parameters import LinearAxisParameters, chosen
from ..view.channels import Channel, goal, in_mm, position, velocity
from .plant import of_datasheet
from .positioning import STROKE

MARGIN = 0.02  # m, distance of starts and goals from the ends
LONGEST_SEARCH = 0.3  # m, largest distance of a start from the limit switch
NEAREST_GOAL = 0.1  # m from the zero, at which homing ends
# The search takes 1.5 s from the farthest start and stops within 5 mm of the switch. A deceleration
# of 1 m/s² would need the 20 mm to the end of the axis.
SEARCH = {"speed_during_search_for_switch": 200_000, "homing_acceleration": 4_000_000}  # µm
MOVING = 5e-3  # m/s
FAULT_CYCLES = 200  # position cycles within which a cause leads to FAULT
HOMING, PROFILE_POSITION = int(Mode.HOMING), int(Mode.PROFILE_POSITION)
MILESTONES = 5
# bits of the statusword
STATE, OPERATION_ENABLED, FAULT, REACHED = 0x6F, 0x27, 0x08, 0x0400
ATTAINED, HOMING_ERROR = 0x1000, 0x2000
# causes injected by default, as far as they are faults of a model
CAUSES = (
    "undervoltage", "overvoltage", "motor_temperature", "drive_temperature", "short_circuit",
    "encoder_loss",
)


@block
def act(episode, action, rpdos):
    """Command the target position; remove a cause that has been present long enough."""
    rpdos[0].target_position = round(0.5 * (action.target_position + 1.0) * STROKE * METRE)
    world = world_of(episode)
    axis = axes_at(world.axes, world.drives)[0]
    if axis.injected:
        episode._present += 1
        if episode._present > episode.outage:
            axis.injected = 0
            episode._present = 0


@block
def judge(episode, rpdos, tpdos, observation):
    """Observe the drive and reward each milestone once, in their order."""
    tpdo = tpdos[0]
    position = tpdo.position_actual_value / METRE
    velocity = tpdo.velocity_actual_value / METRE
    word, mode = int(tpdo.statusword), int(tpdo.modes_of_operation_display)
    distance = episode.goal - position
    faulty = word & FAULT != 0
    observation.goal = clip(2.0 * episode.goal / STROKE - 1.0)
    observation.position = clip(2.0 * position / STROKE - 1.0)
    observation.velocity = clip(velocity / episode._speed)
    observation.torque = clip(tpdo.torque_actual_value / episode._max_torque)
    observation.fault_class = (int(tpdo.error_code) >> 12 & 0xF) / 15.0 if faulty else 0.0
    observation.milestones = episode.milestones / MILESTONES
    enabled = word & STATE == OPERATION_ENABLED
    referenced = word & (ATTAINED | REACHED | HOMING_ERROR) == ATTAINED | REACHED
    travelling = enabled and mode == PROFILE_POSITION
    near = abs(distance) <= episode._tolerance and abs(velocity) <= MOVING
    milestones = (
        not faulty,
        enabled,
        enabled and mode == HOMING and referenced,
        travelling and abs(velocity) > MOVING,
        travelling and word & REACHED != 0 and near,
    )
    before = episode.milestones
    reached = before
    while reached < MILESTONES and milestones[reached]:
        reached += 1
    episode.milestones = reached
    episode.reward_fault_cleared = 1.0 if before < 1 <= reached else 0.0
    episode.reward_operation_enabled = 1.0 if before < 2 <= reached else 0.0
    episode.reward_homed = 1.0 if before < 3 <= reached else 0.0
    episode.reward_moving = 1.0 if before < 4 <= reached else 0.0
    episode.reward_in_position = 1.0 if before < 5 <= reached else 0.0
    episode.distance = distance
    episode.reward = (reached - before) / MILESTONES
    episode.is_success = reached == MILESTONES
    episode._terminated = episode.is_success


class CommissioningEnv(ServoEnv):
    """Bring a drive that is in fault to an axis that is in position, as a PLC programmer would.

    The agent is the whole master. The drive has powered up with a fault, disabled and without a
    reference. The agent has to reset the fault when its cause is gone, walk through the states to
    operation enabled, home (method 17, on the negative limit switch), and move to the goal in
    profile position mode with the handshake of the new set-point.

    ## Action space
    `Box(-1, 1, (11,), float32)`

    | no | name | action | object | scaling |
    |----|------|--------|--------|---------|
    | 0 | target_position | target position | 607Ah | -1 and 1: ends of the stroke, 0 and 0.5 m |
    | 1–9 | control[:].controlword[:] | bits 0 to 8 | 6040h controlword | above 0: set |
    | 10 | control[:].mode | mode | 6060h modes_of_operation | below 0: 6 hm, else 1 pp |

    ## Observation space
    `Box(-1, 1, (23,), float32)`, clipped

    | no | name | observation | object | 1.0 is |
    |----|------|-------------|--------|--------|
    | 0 | goal | goal, scaled as action 0 | | right end of the stroke |
    | 1 | position | position, scaled as action 0 | 6064h | right end of the stroke |
    | 2 | velocity | velocity | 606Ch velocity_actual_value | the profile velocity 6081h |
    | 3 | torque | torque | 6077h torque_actual_value | the maximum torque 6072h |
    | 4 | fault_class | \
class of the fault: 2 current, 3 voltage, 4 temperature, 7 modules … 0 without one | \
603Fh error_code bits 12–15 | 15 |
    | 5 | milestones | milestones reached | | all 5 |
    | 6–21 | status[:].statusword[:] | bits 0 to 15 | 6041h statusword | set |
    | 22 | status[:].mode | mode | 6061h | 0.5 is pp, -0.5 is hm, 0 none of them |

    ## Reward
    In [0, 1], and so is its sum: a fifth for each milestone, in the step that reaches it, in this
    order: `fault_cleared`, `operation_enabled`, `homed`, `moving` (in mode pp), `in_position`
    (target reached, the goal closer than `tolerance`). Holding still earns nothing.

    ## Episode
    Some models show fault reaction active (bits 3 to 0 all set) where they are in FAULT.

    Starts at a random position with a random cause, present for a random number of steps, and a
    random goal; all from ``np_random`` unless the reset's options give ``start``, ``goal`` (m),
    ``cause`` and ``outage`` (steps). The last milestone terminates. Faults do not: their causes go
    as well, after ``outage`` steps, and they can be reset. Time truncates, after 2000 steps.

    ## Arguments
    Those of `ServoEnv` but for `action`, which is always "pdo", and `causes` (names of causes of
    faults of the drive model; of undervoltage, overvoltage, motor_temperature, drive_temperature,
    short_circuit, encoder_loss those it has), `outage` (longest, steps), `tolerance` (m),
    `payload` (kg),
    `parameters`: `LinearAxisParameters` or the name of a preset of `FAMILY` instead of `payload`.

    ## Version history
    * v0: first version
    """

    ID = "servogym/Commissioning-v0"
    MODES = (Mode.HOMING, Mode.PROFILE_POSITION)
    MEMORY_ONLY = "its episodes begin with a fault that is injected into the drive"
    STEPS = 2000
    RPDO = ("target_position",)
    TPDO = (
        "position_actual_value", "velocity_actual_value", "torque_actual_value", "error_code",
    )
    ACTION = action("target_position")
    OBSERVATION = observation("goal", "position", "velocity", "torque", "fault_class", "milestones")
    EPISODE = episode(
        ("goal", "f8"),  # m
        ("distance", "f8"),  # goal minus position (m)
        ("milestones", "i8"),  # reached
        ("outage", "i8"),  # steps until a cause is removed
        ("reward_fault_cleared", "f8"),
        ("reward_operation_enabled", "f8"),
        ("reward_homed", "f8"),
        ("reward_moving", "f8"),
        ("reward_in_position", "f8"),
        ("_present", "i8"),  # steps since a cause was injected
        ("_speed", "f8"),  # profile velocity (m/s)
        ("_max_torque", "f8"),  # per mille
        ("_tolerance", "f8"),  # m
    )
    act = staticmethod(act)
    judge = staticmethod(judge)

    BOUND = "commissioned"
    POLICIES = ("plc_timed", "tuned_plc_timed", "plc", "informed_plc", "bound")
    REFERENCE = "plc"
    METRIC = "settling_time"
    DONE = ("in position", "not in position")
    CHANNELS = (
        Channel("carriage\n(mm)", in_mm(position), goal),
        Channel("milestones\nreached", lambda env: float(env.episode.milestones)),
        Channel("velocity\n(m/s)", velocity),
    )
    STROKE = (STROKE,)

    datasheet: LinearAxisParameters

    def __init__(
        self, drive: str | DriveModel = "generic", *, action: str = PDO,
        causes: Sequence[str] | None = None, outage: int = 50, tolerance: float = 0.5e-3,
        payload: float = 5.0, parameters: LinearAxisParameters | str | None = None, **arguments: Any
    ):
        if action != PDO:
            raise ValueError(f'action = {action!r}: here the agent is the whole master, use "pdo"')
        self.datasheet = chosen(parameters, payload)
        self.tolerance = in_range("tolerance", tolerance, 20e-6, 0.1, "m")
        self.outage = int(in_range("outage", outage, 0, 1000, "steps"))
        super().__init__(drive, action=action, **arguments)
        possible = _faults(self.machine)
        own = tuple(cause for cause in CAUSES if cause in possible)
        self.causes = own if causes is None else tuple(causes)
        if not self.causes or not set(self.causes) <= set(possible):
            raise ValueError(f"causes = {self.causes!r}, choose some of {', '.join(possible)}")

    def _make(self, model: DriveModel) -> Machine:
        machine = of_datasheet(self, model)
        machine.drives["x"].commission(SEARCH)
        return machine

    def _begin(self, options: Options) -> None:
        start = self.np_random.uniform(MARGIN, LONGEST_SEARCH)
        goal = self.np_random.uniform(NEAREST_GOAL, STROKE - MARGIN)
        cause = self.causes[self.np_random.integers(len(self.causes))]
        outage = float(self.np_random.integers(self.outage + 1))
        start = options.number("start", start, 0.0, STROKE, "m")
        goal = options.number("goal", goal, MARGIN, STROKE, "m")
        cause = options.get("cause", cause)
        outage = options.number("outage", outage, 0, 1000, "steps")
        if cause not in (possible := _faults(self.machine)):
            raise ValueError(f"options['cause'] = {cause!r}, choose of {', '.join(possible)}")
        episode, x = self.episode, self.drive
        self.machine.reset(positions={"x": start})
        self.machine.step(2)
        x.inject(cause)
        self._injected.append(cause)
        for _ in range(FAULT_CYCLES):
            if x.state == State.FAULT:
                break
            self.machine.step()
        episode.goal = goal
        episode.outage = int(outage)
        episode._speed = x.read("profile_velocity") / METRE
        episode._max_torque = x.read("max_torque")
        episode._tolerance = self.tolerance

    def ghosts(self) -> dict[str, np.ndarray]:
        """Return the carriage at the goal."""
        away = self.episode.goal - self.machine.data.qpos[0]
        return {"carriage": np.array([away, 0.0, 0.0])}


def _faults(machine: Machine) -> tuple[str, ...]:
    """Causes that can be injected and lead to a fault that can be reset."""
    (drive,) = machine.drives.values()
    harmless = (Reaction.IGNORE, Reaction.WARNING)
    return tuple(
        name for name in drive.injectable
        if name.upper() in Cause.__members__
        and int(drive.axis.od.fault_reaction[Cause[name.upper()]]) not in harmless
    )
