"""What a task says: the names in its process images, what it remembers, and what it overrides."""

from collections.abc import Callable, Mapping
from typing import Any, ClassVar

import numpy as np

from ...drive.kernel.words import Mode
from ...drive.model.model import DriveModel
from ..engine.machine import Machine
from ..plants.axis_parameters import Joints, LinearAxisParameters
from ..plants.gantry import GantryParameters
from ..plants.rotary_parameters import RotaryParameters
from ..view import channels
from ..view.about import Metric, Sensor

METRE = 1e6  # position units


class Task:
    """The contract between a task and `ServoEnv`, which plays it.

    What stands here without a value, a task gives; the rest will do for most. What depends on the
    drive or on arguments is set on `self` before `ServoEnv.__init__`.
    """

    # what makes a task
    # the first is its own; what depends on drive or arguments is set before `ServoEnv.__init__`
    MODES: tuple[Mode, ...] = (Mode.CYCLIC_SYNC_POSITION, Mode.HOMING)
    DRIVES: tuple[str, ...] = ()  # that the agent commands, first in the machine; none: all of it
    RPDO: tuple[str, ...]  # objects the agent commands, beside controlword and mode
    TPDO: ClassVar[tuple[str, ...]] = (  # objects it sees, beside statusword and mode displayed
        "position_actual_value", "torque_actual_value", "velocity_actual_value",
        "following_error_actual_value",
    )
    ID: ClassVar[str]  # in the registry of Gymnasium
    STEPS: ClassVar[int] = 200  # of an episode, until time truncates it
    STEP_TIME: ClassVar[float] = 5e-3  # of the agent (s), with every drive
    ACTION: np.dtype  # made by `fields.action`; may depend on arguments, as may DRIVES and
    OBSERVATION: np.dtype  # made by `fields.observation`
    EPISODE: ClassVar[np.dtype]  # made by `episode`
    act: Callable[..., None]  # (episode, action, rpdos) of one world
    judge: Callable[..., None]  # (episode, rpdos, tpdos, observation) of one world

    # what it tells of itself, for those who train, judge and draw; this will do for most
    MEMORY_ONLY: ClassVar[str] = ""  # why its drives cannot be on a bus; empty: they can
    REFERENCED: ClassVar[bool] = True  # whether the drives are, at the beginning of an episode
    POLICIES: tuple[str, ...] = ()  # baselines by name, beside hold and random
    BOUND: ClassVar[str] = ""  # row of `training.policies.bound.BOUNDS`; none: no bound is known
    REFERENCE: ClassVar[str] = ""  # the one whose score is 1, as hold's is 0; none: no score
    HOLD: ClassVar[Mapping[str, float]] = {}
    METRIC: ClassVar[str] = "episode_return"  # by which one policy is better than another
    METRICS: ClassVar[Mapping[str, Metric]] = {}
    CHANNELS: ClassVar[tuple[channels.Channel, ...]] = channels.FIRST_DRIVE
    DONE: ClassVar[tuple[str, str]] = ("settled", "not settled")  # what success is called
    HYPERPARAMETERS: ClassVar[Mapping[str, Mapping[str, Any]]] = {}
    STROKE: ClassVar[tuple[float, ...]] = ()  # of each axis (m)
    UNIT: ClassVar[str] = "m"  # of its coordinates in headings: "m", "rad" or "m or rad"
    SENSOR: ClassVar[str] = ""  # the argument that gives `sensor`

    # what policies may know
    datasheet: LinearAxisParameters | GantryParameters | RotaryParameters | Joints | None = None
    homing_method: int | None = None  # of the drive, that looks for what the agent looks for
    units: float = METRE  # position units per m or rad, set before `ServoEnv.__init__`

    def _make(self, model: DriveModel) -> Machine:
        """The machine, commissioned."""
        raise NotImplementedError

    def _begin(self, options: dict[str, Any]) -> None:
        """Bring the machine where an episode begins, from `np_random` and the reset's options."""
        raise NotImplementedError

    def sensor(self) -> Sensor | None:
        """Return the sensor at the load; None if there is no sensor."""
        return None

    def settling(self) -> dict[str, float]:
        """``goal`` and ``window`` (m) in which what is moved settles, watched at physics steps.

        Without them settling is what ``is_success`` says at the steps of the agent.
        """
        return {}

    def figures(self) -> dict[str, float]:
        """Metrics, common or own, of an episode that has ended; they stand before measured ones."""
        return {}

    def declared(self) -> bool | None:
        """Whether the agent has declared itself done; None: it does not, success decides."""
        return None

    def outcome(self) -> str:
        """What ended the episode, beside a fault; empty: nothing did."""
        return ""

    def ghosts(self) -> dict[str, np.ndarray]:
        """Where bodies or sites should be, by name: displacement (m), ``(3,)``; translucent."""
        return {}

    def goal_pose(self) -> np.ndarray | None:
        """Coordinates of the whole machine at its goal, shape ``(nq,)``; drawn translucent."""
        return None

    def path(self) -> np.ndarray:
        """What is to be followed, shape ``(n, 3)`` (m); drawn as a line."""
        return np.zeros((0, 3))
