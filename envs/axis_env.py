"""servogym/LinearAxis-v0: position a linear axis through the process data of its drive."""

import math
import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import gymnasium as gym
import mujoco
import numpy as np

from ..drive.model import DriveModel, load
from ..drive.words import Mode, state_of
from .linear_axis import LinearAxisParameters, linear_axis
from .supervisor import ENABLED, Supervisor

STROKE = 0.5  # m
MARGIN = 0.02  # m, starts and goals keep away from the ends
NEAR = 0.02  # m, distance at which the reward for nearness has fallen to one half
RESTING = 5e-3  # m/s, slower counts as settled
METRE = 1e6  # position units
RPDO = struct.Struct("<Hbi")  # controlword, modes of operation, target position
TPDO = struct.Struct("<Hihii")  # statusword, position, torque, velocity, following error
FAULT_BIT = 0x08
STATE_MASK = 0x6F
STATE_NAME = {  # by statusword & STATE_MASK
    word: state.name for word in range(STATE_MASK + 1) if (state := state_of(word)) is not None
}


class LinearAxisEnv(gym.Env[np.ndarray, np.ndarray]):
    """Bring the carriage of a linear axis to a goal and hold it there.

    The agent is the master of a drive in cyclic synchronous position mode: each step it moves the
    target position 607Ah in the RPDO, and sees what the TPDOs bring back. Before the first step the
    drive is enabled and referenced. What the agent asks for is limited as a real drive limits it:
    too steep a set-point ends in a following error, and the fault ends the episode.

    ## Action space
    `Box(-1, 1, (1,), float32)`

    | no | action | object | scaling |
    |----|--------|--------|---------|
    | 0 | velocity of the set-point | 607Ah target_position | 1 is the maximum velocity 607Fh |

    The target position (1 µm) moves by action × maximum velocity × step time, within the stroke.

    ## Observation space
    `Box(-1, 1, (6,), float32)`, clipped

    | no | observation | object | 1.0 is |
    |----|-------------|--------|--------|
    | 0 | goal minus position | 6064h position_actual_value | the stroke, 0.5 m |
    | 1 | position, -1 and 1 at the ends | 6064h position_actual_value | half the stroke |
    | 2 | velocity | 606Ch velocity_actual_value | the maximum profile velocity 607Fh |
    | 3 | following error | 60F4h following_error_actual_value | its window 6065h |
    | 4 | torque | 6077h torque_actual_value | the maximum torque 6072h |
    | 5 | set-point minus position | 607Ah, 6064h | its window 6065h |

    ## Reward
    In [0, 1]: half for nearness, ``1 / (1 + (distance / 20 mm)²)``, half for being settled: closer
    than `tolerance` and slower than 5 mm/s. The terms are in ``info``.

    ## Episode
    Starts at rest at a random position, with a random goal, both from ``np_random``. A fault of the
    drive terminates (``info["fault"]``: code and meaning). Time truncates, after 200 steps (1 s).

    ## Arguments
    `drive`: drive model by name, folder or loaded; it needs the modes csp and hm. `payload` (kg).
    `cycles_per_step`: position-controller cycles a step, a whole number. `tolerance` (m).
    `following_error_window` (m). `parameters`: `LinearAxisParameters` instead of `payload`.
    `faults`: probability per step of causes of faults to be injected, such as
    ``{"encoder_loss": 1e-4}``; what happened is in ``info["injected"]``.
    `render_mode`: None, "rgb_array" or "human".

    ## Version history
    * v0: first version
    """

    metadata = {"render_modes": ["rgb_array", "human"], "render_fps": 50}  # noqa: RUF012

    def __init__(
        self,
        drive: str | Path | DriveModel = "generic",
        *,
        payload: float = 5.0,
        parameters: LinearAxisParameters | None = None,
        cycles_per_step: int = 10,
        tolerance: float = 50e-6,
        following_error_window: float = 0.02,
        faults: Mapping[str, float] | None = None,
        render_mode: str | None = None,
    ):
        model = load(drive)
        for mode in (Mode.CYCLIC_SYNC_POSITION, Mode.HOMING):
            if mode not in model.modes:
                raise ValueError(
                    f"drive {model.name!r} has no mode {mode.name.lower()}, which this task needs: "
                    f"it has {', '.join(m.name.lower() for m in model.modes)}"
                )
        if cycles_per_step != int(cycles_per_step) or not 1 <= cycles_per_step <= 1000:
            raise ValueError(
                f"cycles_per_step = {cycles_per_step!r} must be a whole number 1..1000"
            )
        for name, value, high in (
            ("tolerance", tolerance, 0.1),
            ("following_error_window", following_error_window, 1.0),
        ):
            if not 1e-6 <= value <= high:
                raise ValueError(f"{name} = {value!r} is out of range 1e-06..{high} m")
        if render_mode is not None and render_mode not in self.metadata["render_modes"]:
            raise ValueError(f"render_mode = {render_mode!r}, use one of rgb_array, human or None")
        self._faults = dict(faults or {})
        for cause, probability in self._faults.items():
            if not 0.0 <= probability <= 1.0:
                raise ValueError(f"faults[{cause!r}] = {probability!r} is out of range 0..1")
        self.render_mode = render_mode
        self.tolerance = tolerance
        self.cycles_per_step = int(cycles_per_step)
        self.machine = linear_axis(
            model, parameters=parameters or LinearAxisParameters(payload=payload)
        )
        self.drive = self.machine.drives["x"]
        for cause in self._faults:
            if cause not in self.drive.injectable:
                known = ", ".join(self.drive.injectable)
                raise ValueError(f"faults: unknown cause {cause!r}, choose of {known}")
        self.step_time = self.cycles_per_step * self.machine.cycle_time
        self._configure(following_error_window)
        self.action_space = gym.spaces.Box(-1.0, 1.0, (1,), np.float32)
        self.observation_space = gym.spaces.Box(-1.0, 1.0, (6,), np.float32)
        self.goal = 0.0
        self._target = 0.0
        self._injected: list[str] = []
        self._renderer: mujoco.Renderer | None = None
        self._viewer: Any = None

    def _configure(self, following_error_window: float) -> None:
        """PDO mapping, interpolation period and windows, through the objects of the drive."""
        x = self.drive
        x.map_pdos(
            [["controlword", "modes_of_operation", "target_position"]],
            [
                ["statusword", "position_actual_value", "torque_actual_value"],
                ["velocity_actual_value", "following_error_actual_value"],
            ],
        )
        units, index = _interpolation_period(self.step_time)
        x.write("interpolation_time_period_value", units)
        x.write("interpolation_time_index", index)
        x.write("following_error_window", round(following_error_window * METRE))
        x.write("homing_method", 37 if 37 in x.model.homing_methods else 35)
        self._speed = x.read("max_profile_velocity") / METRE
        self._window = following_error_window
        self._max_torque = float(x.read("max_torque"))

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Start anew; `options` may give ``start`` and ``goal`` (m)."""
        super().reset(seed=seed)
        start, goal = self.np_random.uniform(MARGIN, STROKE - MARGIN, 2)
        options = options or {}
        start = self._place("start", options.get("start", start))
        self.goal = self._place("goal", options.get("goal", goal))
        self.machine.reset(positions={"x": start})
        self.drive.write("home_offset", -round(start * METRE))
        self._injected = []
        supervisor = Supervisor(self.machine, "x")
        supervisor.enable()
        supervisor.home()
        self._target = self.drive.read("position_actual_value") / METRE
        self._exchange()
        self._render_human()
        return self._observe()[0], self._info()

    @staticmethod
    def _place(name: str, value: float) -> float:
        if not 0.0 <= value <= STROKE:
            raise ValueError(f"options[{name!r}] = {value!r} is out of range 0..{STROKE} m")
        return float(value)

    def _exchange(self) -> None:
        """Latch the RPDO, run one agent step, fetch the TPDOs."""
        rpdo = RPDO.pack(ENABLED, Mode.CYCLIC_SYNC_POSITION, round(self._target * METRE))
        self.drive.latch(rpdo)
        self.machine.step(self.cycles_per_step)
        word, position, torque, velocity, error = TPDO.unpack(self.drive.collect())
        self._statusword = word
        self._position = position / METRE
        self._velocity = velocity / METRE
        self._torque = torque / self._max_torque
        self._following_error = error / METRE

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Move the set-point for one step. Raises ValueError for an action out of the space."""
        shape = np.shape(action)
        share = float(action[0]) if shape == (1,) else math.nan
        if not abs(share) <= 1.0 + 1e-6:
            raise ValueError(
                f"action = {action!r} is not in {self.action_space}: "
                "clip it, and see that the policy's output is finite"
            )
        way = share * self._speed * self.step_time
        self._target = min(max(self._target + way, 0.0), STROKE)
        self.inject_faults()
        self._exchange()
        observation, near, settled = self._observe()
        self._render_human()
        terminated = bool(self._statusword & FAULT_BIT)
        info = self._info(near, settled)
        return observation, 0.5 * near + 0.5 * settled, terminated, False, info

    def inject_faults(self) -> None:
        """Let the declared faults happen with their probabilities."""
        for cause, probability in self._faults.items():
            if self.np_random.random() < probability:
                self.drive.inject(cause)
                self._injected.append(cause)

    def measure(self, goal, target, position, velocity, error, torque):
        """The observed quantities and the terms of the reward, of one axis or of arrays of them.

        Takes goal, target, position (m), velocity (m/s), following error (m) and torque (share of
        the maximum); -> six quantities in the order of the observation, not yet clipped, the term
        for nearness, whether the axis is settled.
        """
        distance = goal - position
        quantities = (
            distance / STROKE,
            2.0 * position / STROKE - 1.0,
            velocity / self._speed,
            error / self._window,
            torque,
            (target - position) / self._window,
        )
        away = distance / NEAR
        settled = (abs(distance) <= self.tolerance) & (abs(velocity) <= RESTING)
        return quantities, 1.0 / (1.0 + away * away), settled

    def _observe(self) -> tuple[np.ndarray, float, bool]:
        """The observation, and the two terms of the reward."""
        quantities, near, settled = self.measure(
            self.goal, self._target, self._position, self._velocity, self._following_error,
            self._torque,
        )  # fmt: skip
        observation = np.array([min(max(q, -1.0), 1.0) for q in quantities], np.float32)
        return observation, near, settled

    def _info(self, near: float = 0.0, settled: bool = False) -> dict[str, Any]:
        word = self._statusword
        return {
            "fault": self.drive.fault if word & FAULT_BIT else "",
            "injected": tuple(self._injected),
            "state": STATE_NAME.get(word & STATE_MASK, "INVALID"),
            "distance": self.goal - self._position,
            "goal": self.goal,
            "time": self.machine.time,
            "reward_near": near,
            "reward_settled": float(settled),
            "is_success": settled,
        }

    def render(self) -> np.ndarray | None:  # type: ignore[override]
        """An image, shape ``(540, 960, 3)`` uint8, with a ghost of the carriage at the goal."""
        if self.render_mode != "rgb_array":
            return None
        if self._renderer is None:
            self._renderer = mujoco.Renderer(self.machine.model, 540, 960)
        self._renderer.update_scene(self.machine.data)
        self._ghost(self._renderer.scene)
        return self._renderer.render()

    def _ghost(self, scene: mujoco.MjvScene) -> None:
        """Add a translucent carriage at the goal to a scene."""
        if scene.ngeom >= scene.maxgeom:
            return
        geom = self.machine.model.geom("carriage")
        place = self.machine.model.body("carriage").pos + np.array([self.goal, 0.0, 0.0])
        mujoco.mjv_initGeom(
            scene.geoms[scene.ngeom],
            mujoco.mjtGeom.mjGEOM_BOX,
            np.asarray(geom.size, float) * 1.02,
            place,
            np.eye(3).ravel(),
            np.array([0.2, 0.75, 0.3, 0.35], np.float32),
        )
        scene.ngeom += 1

    def _render_human(self) -> None:
        if self.render_mode != "human":
            return
        if self._viewer is None:
            import mujoco.viewer

            self._viewer = mujoco.viewer.launch_passive(self.machine.model, self.machine.data)
        self._viewer.sync()

    def close(self) -> None:
        """Close window and renderer; may be called more than once."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None
        if self._viewer is not None:
            self._viewer.close()
            self._viewer = None


def _interpolation_period(step_time: float) -> tuple[int, int]:
    """60C2h: value and index with value × 10^index = `step_time` (s) exactly.

    Raises ValueError where UNSIGNED8 cannot express it.
    """
    for index in range(0, -7, -1):
        value = step_time / 10.0**index
        if 1 <= round(value) <= 255 and abs(value - round(value)) < 1e-6:
            return round(value), index
    raise ValueError(
        f"cycles_per_step: the step time {step_time * 1e3:g} ms cannot be written to 60C2h "
        "(1..255 times a power of ten): choose another number of cycles"
    )
