"""The contract of a task: its process data, its records, and the methods that it may override."""

from collections.abc import Callable, Mapping
from typing import Any, ClassVar

import numpy as np

from ...drive.kernel.words import Mode
from ...drive.model.model import DriveModel
from ..engine.checks import Options
from ..engine.machine import Machine
from ..plants.axis_parameters import Joints, LinearAxisParameters
from ..plants.gantry import GantryParameters
from ..plants.rotary_parameters import RotaryParameters
from ..view import channels
from ..view.about import Metric, Sensor

METRE = 1e6  # position units


class Task:
    """The contract between a task and `ServoEnv`, which runs it.

    A task has to define the attributes without a value; the defaults of the others suit most tasks.
    Attributes that depend on the drive or on arguments are set on `self` before
    `ServoEnv.__init__`.
    """

    # the definition of a task
    MODES: tuple[Mode, ...] = (Mode.CYCLIC_SYNC_POSITION, Mode.HOMING)  # the first one moves
    DRIVES: tuple[str, ...] = ()  # commanded by the agent, first in the machine; empty: all
    RPDO: tuple[str, ...]  # objects that the agent commands, besides controlword and mode
    TPDO: ClassVar[tuple[str, ...]] = (  # objects that it observes, besides statusword and mode
        "position_actual_value", "torque_actual_value", "velocity_actual_value",
        "following_error_actual_value",
    )
    ID: ClassVar[str]  # in the registry of Gymnasium
    STEPS: ClassVar[int] = 200  # length of an episode, after which it is truncated
    STEP_TIME: ClassVar[float] = 5e-3  # length of a step (s), with every drive
    ACTION: np.dtype  # made by `fields.action`
    OBSERVATION: np.dtype  # made by `fields.observation`
    EPISODE: ClassVar[np.dtype]  # made by `episode`
    act: Callable[..., None]  # (episode, action, rpdos) of one world
    judge: Callable[..., None]  # (episode, rpdos, tpdos, observation) of one world

    # its description for training, evaluation and pictures
    MEMORY_ONLY: ClassVar[str] = ""  # why its drives cannot be on a bus; empty: they can
    REFERENCED: ClassVar[bool] = True  # whether the drives are referenced when an episode begins
    POLICIES: tuple[str, ...] = ()  # baselines by name, besides hold and random
    BOUND: ClassVar[str] = ""  # row of `training.policies.bound.BOUNDS`; empty: no known bound
    REFERENCE: str = ""  # baseline with score 1, hold has score 0; empty: no score
    HOLD: ClassVar[Mapping[str, float]] = {}  # actions that hold still, where they are not 0
    METRIC: ClassVar[str] = "episode_return"  # metric that ranks policies
    METRICS: ClassVar[Mapping[str, Metric]] = {}
    CHANNELS: ClassVar[tuple[channels.Channel, ...]] = channels.FIRST_DRIVE
    DONE: ClassVar[tuple[str, str]] = ("settled", "not settled")  # names of success and failure
    HYPERPARAMETERS: ClassVar[Mapping[str, Mapping[str, Any]]] = {}
    STROKE: ClassVar[tuple[float, ...]] = ()  # travel of each axis (m)
    UNIT: ClassVar[str] = "m"  # of its coordinates in headings: "m", "rad" or "m or rad"
    SENSOR: ClassVar[str] = ""  # argument that adds the `sensor`

    # data available to policies
    datasheet: LinearAxisParameters | GantryParameters | RotaryParameters | Joints | None = None
    homing_method: int | None = None  # of the drive, which finds the reference of the task
    units: float = METRE  # position units per m or rad, set before `ServoEnv.__init__`

    def _make(self, model: DriveModel) -> Machine:
        """Build and commission the machine."""
        raise NotImplementedError

    def _begin(self, options: Options) -> None:
        """Bring the machine to the start of an episode, by `np_random` and the reset's options."""
        raise NotImplementedError

    def sensor(self) -> Sensor | None:
        """Return the sensor at the load; None if there is no sensor."""
        return None

    def settling(self) -> dict[str, float]:
        """Return ``goal`` and ``window`` (m) of the load, for settling measured at physics steps.

        By default settling is measured by ``is_success`` at the steps of the agent.
        """
        return {}

    def figures(self) -> dict[str, float]:
        """Return metrics of an episode that has ended; they take precedence over measured ones."""
        return {}

    def declared(self) -> bool | None:
        """Return whether the agent has declared that it is done; None: success decides."""
        return None

    def outcome(self) -> str:
        """Return the reason other than a fault that ended the episode; empty: none."""
        return ""

    def ghosts(self) -> dict[str, np.ndarray]:
        """Return the displacement (m), ``(3,)``, of bodies or sites to their translucent goals."""
        return {}

    def goal_pose(self) -> np.ndarray | None:
        """Return coordinates of the machine at its goal, shape ``(nq,)``, drawn translucent."""
        return None

    def path(self) -> np.ndarray:
        """Return the path to be followed, shape ``(n, 3)`` (m), drawn as a line."""
        return np.zeros((0, 3))
