"""ServoEnv: a Gymnasium environment in which an agent is the master of emulated drives.

A task is a subclass and defines the attributes of `task.Task`. This class provides the rest: it
builds the machine, begins episodes, runs the step and reports its result. The mapping of the
process data is in `process_data`, parameters drawn for an episode and injected faults in
`servogym.envs.variation`, rendering in `servogym.envs.view.picture`.
"""

import copy
import functools
import warnings
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import gymnasium as gym
import numpy as np

from ...drive.kernel.words import ENABLED, state_of
from ...drive.master.master import Master
from ...drive.model.model import DriveModel, load
from ...drive.model.names import named
from ..engine.checks import Options, choice, flag, refuse_unknown, whole
from ..engine.machine import Machine
from ..engine.rates import step_cycles
from ..exchange import fields
from ..exchange.batch import Batch, priced, shown
from ..exchange.faces import FACES, FAULT, PDO
from ..masters.port import MachinePort
from ..variation.injection import Faults, injections, sort
from ..variation.randomisation import Randomisation
from ..view import channels
from ..view.picture import Picture
from . import of_twin, process_data
from .needed import built, check, check_modes
from .task import METRE as METRE
from .task import Task

if TYPE_CHECKING:
    from ..exchange.over_ethercat import EtherCatLine
    from ..exchange.over_port import DriveSide, PortLine

MAX_HISTORY = 100
OWN = (  # attributes of an environment that belong to its snapshot
    "parameters", "_injected", "_steps", "_np_random", "_np_random_seed", "action_space",
    "observation_space",
)


class ServoEnv(Task, gym.Env[np.ndarray, np.ndarray]):
    """Base class of the environments.

    Args:
        drive: drive model of all axes, by name, folder or loaded; it must support the task's modes.
        step_time: length of an agent's step (s), rounded to 1..1000 whole position-controller
            cycles of the drive; by default the task's.
        action: "setpoint", or "pdo" for controlword, mode and set-points, see
            `servogym.envs.exchange.faces`.
        history: number of past observations in an observation, the latest first, 1..100.
        previous_action: whether the observation ends with the previous action.
        prices: charges for torque and jerk in the reward, see
            `servogym.envs.exchange.batch.PRICES`; by default none.
        randomise: ranges by name, from which each episode draws, see
            `servogym.envs.variation.randomisation`; ``"twin"`` draws from the intervals of a twin.
        twin: folder made by `servogym twin`; its plant and drive replace those of the task.
        faults: probabilities of faults. Causes inside a drive have a probability per step:
            ``{"encoder_loss": 1e-4}`` for each drive of the agent, ``{"x2.encoder_loss": 1e-4}``
            for one. Faults of an EtherCAT bus have one per frame: ``{"drop": 0.01}``,
            ``{"retreat at=op:50": 1}``. A list of lines as ``servogym ethercat --fault`` takes them
            injects faults of the bus alone. Bus faults put the drives on EtherCAT, see
            `servogym.envs.exchange.over_ethercat`.
        tuned: whether the axes are commissioned for their plant and motor, as `linear_axis` does by
            default, or with the gains of the simple rule that version 0 uses.
        port: drives on a bus, such as `servogym.envs.exchange.over_port.CanDrives`, in place of a
            machine in this process. Steps then run in the time of the bus, and parameters drawn by
            `randomise` do not describe the machine on it.
        render_mode: None, "rgb_array" or "human".

    Raises:
        ValueError: names the argument, its value and the possible values.
    """

    metadata = {"render_modes": ["rgb_array", "human"], "render_fps": 200}  # noqa: RUF012

    machine: Machine
    _window: float  # of the following error (m), of tasks that `normalise` by it
    _arguments: tuple[tuple[Any, ...], dict[str, Any]]

    def __new__(cls, *args: Any, **arguments: Any) -> "ServoEnv":
        """Record the arguments, from which a copy is built."""
        refuse_unknown(cls, arguments)
        env = super().__new__(cls)
        env._arguments = args, arguments
        return env

    def __init__(
        self, drive: str | Path | DriveModel = "generic", *, step_time: float | None = None,
        action: str = "setpoint", history: int = 1, previous_action: bool = False,
        prices: Mapping[str, float] | None = None,
        randomise: Mapping[str, float | tuple[float, ...]] | str | None = None,
        twin: str | Path | None = None, faults: Faults = None, tuned: bool = False,
        port: "DriveSide | None" = None, render_mode: str | None = None,
    ):
        check(self, ServoEnv)
        causes, bus_faults = sort(faults)
        identified, drive = of_twin.found(self, twin, drive)
        model = load(drive, "ethercat" if bus_faults else None)
        check_modes(self, model)
        if render_mode is not None:
            choice("render_mode", render_mode, self.metadata["render_modes"])
        self.render_mode = render_mode
        self.face = choice("action", action, FACES)
        self.tuned = flag("tuned", tuned)
        self.machine = built(self, self._make(model))
        if identified is not None:
            identified.give(self.machine)
        self.drive_names = [*(self.DRIVES or self.machine.drives)]  # that the agent commands
        self.drives = [self.machine.drives[name] for name in self.drive_names]
        self.drive = self.drives[0]
        self.cycles_per_step = step_cycles(step_time, self.STEP_TIME, self.machine.cycle_time)
        self.step_time = self.cycles_per_step * self.machine.cycle_time
        self.metadata = self.metadata | {"render_fps": round(1.0 / self.step_time)}
        self._faults = injections(causes, self.machine.drives, self.drives)
        ranges = of_twin.ranges(randomise, identified)
        self.randomisation = Randomisation(
            self.machine, named("randomise", ranges, '{"payload": (1.0, 10.0)}'),
            self.cycles_per_step,
        )
        self._history = whole("history", history, 1, MAX_HISTORY)
        self._previous_action = flag("previous_action", previous_action)
        self.prices = priced(prices)
        self._images = process_data.mapped(self)
        self.line: EtherCatLine | PortLine | None = None
        if port is not None:
            self.line = process_data.port_line(self, port, bool(faults))
        if bus_faults:
            from ..exchange import over_ethercat

            parts = self.machine, self.drives, self.step_time
            self.line = over_ethercat.EtherCatLine(*parts, bus_faults)
        self.join(self.batch(1), 0)
        self.action_record, self.observation_record = self._batch.action, self._batch.observation
        actions = (self._batch.actions.shape[1],)
        self.action_space = gym.spaces.Box(-1.0, 1.0, actions, np.float32)
        self.observation_space = gym.spaces.Box(-1.0, 1.0, (self._batch.width,), np.float32)
        names = self.EPISODE.names or ()
        self._shown = [(i, name) for i, name in enumerate(names) if shown(name)]
        self._judged = names.index("reward"), names.index("_terminated")
        self.parameters: dict[str, float] = {}
        self._injected: list[str] = []
        self._steps = -1  # no episode has begun
        self._picture = Picture(self)

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.machine!r}, action={self.face})"

    def use_parameter_file(self, file: str | Path) -> None:
        """Load the stored parameters of the first drive, except for the PDO mapping of the task.

        Raises ValueError if the drive does not accept the file.
        """
        self.drive.use_parameter_file(file)
        self._images = process_data.mapped(self)

    def batch(self, n: int) -> Batch:
        """Return empty arrays for `n` environments like this one."""
        rpdo, tpdo = self._images
        return Batch(
            self, n, drives=len(self.drives), rpdo=rpdo, tpdo=tpdo,
            ticks=self.cycles_per_step * self.machine.physics_steps,
            modes=self.MODES if self.face == PDO else (),
            history=self._history, previous_action=self._previous_action, prices=self.prices,
        )

    def join(self, batch: Batch, row: int) -> None:
        """Use a row of `batch` for observations and process images from the next reset on."""
        self._batch, self._row, self._rows = batch, row, slice(row, row + 1)
        batch.machines[row] = self.machine
        self._part = batch.part(row, row + 1)
        self.episode: Any = batch.episodes[row]
        batch.worlds[row] = self.machine.addresses[0]
        if self.line is not None:
            batch.lines[int(batch.worlds[row])] = self.line

    # -------------------------------------------------------------------- the episode

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin an episode. The docstring of each task lists its `options`."""
        super().reset(seed=seed)
        self.restart(options)
        self._picture.update()
        return self._batch.observed(self._rows)[0], self.info()

    def restart(self, options: dict[str, Any] | None = None) -> None:
        """Begin an episode: draw parameters, reset the machine, make the first observation."""
        self.parameters = self.randomisation.draw(self.np_random)
        self._injected = []
        self._steps = 0
        if self.line is not None:
            self.line.begin(self.np_random.spawn(1)[0])
        for array in (self._part.episodes, self._part.rpdos):
            array.view(np.ndarray).view(np.uint8)[:] = 0
        given = Options(named("options", options, '{"start": 0.1}'))
        self._begin(given)
        given.refuse_unread()
        if self.face != PDO:
            self._part.rpdos["controlword"] = ENABLED
            self._part.rpdos["modes_of_operation"] = self.MODES[0]
        self._batch.look(self._part)
        self._batch.begin(self._row)

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Run one step of the agent. Raises ValueError for an action outside the action space."""
        self._part.actions[0] = self._checked(action)
        if self._steps < 0:
            raise gym.error.ResetNeeded("call reset() before the first step")
        self.inject_faults()
        self._batch.run(self._part)  # act, exchange process images while time passes, judge
        self._steps += 1
        self._batch.remember(self._rows)
        self._picture.update()
        episode = self._part.episodes.item(0)
        reward, terminated = (episode[at] for at in self._judged)
        observation = self._batch.observed(self._rows)[0]
        return observation, reward, terminated, False, self._info(episode)

    def _checked(self, action: np.ndarray) -> list[float]:
        """The numbers of an action. Raises ValueError if it is outside the action space."""
        numbers: list[float] = []
        if np.shape(action) == self.action_space.shape:
            with suppress(TypeError, ValueError):
                numbers = [float(number) for number in action]
        if not numbers or not all(abs(number) <= 1.0 + 1e-6 for number in numbers):
            raise ValueError(
                f"action = {action!r} is not in {self.action_space}: "
                "clip it, and see that the policy's output is finite"
            )
        return numbers

    def inject_faults(self) -> None:
        """Inject the declared faults with their probabilities."""
        for name, drive, cause, probability in self._faults:
            if self.np_random.random() < probability:
                drive.inject(cause)
                self._injected.append(name)

    def info(self) -> dict[str, Any]:
        """Return the ``info`` of the present state; its keys are always the same."""
        return self._info(self._part.episodes.item(0))

    def _info(self, episode: tuple[Any, ...]) -> dict[str, Any]:
        words = self._part.tpdos["statusword"][0].tolist()
        info = {name: episode[i] for i, name in self._shown}
        info["fault"] = self.faults(words)
        info["injected"] = tuple(self._injected)
        info["state"] = state_name(words[0])
        info["time"] = self.time
        info["parameters"] = dict(self.parameters)
        if self.line is not None:
            info["frames_lost"] = self.line.lost
        return info

    @property
    def time(self) -> float:
        """Time since the episode began (s)."""
        return self._steps * self.step_time

    def faults(self, words: list[int]) -> str:
        """Return code and meaning of the first fault, with the drive's name if there are several.

        The text is empty without a fault. If a bus has lost the frame with the statusword, the
        drive itself is read.
        """
        for name, drive, word in zip(self.drive_names, self.drives, words, strict=True):
            if word & FAULT or (self.line is not None and drive.axis.fault):
                return drive.fault + f" ({name})" * (len(self.drives) > 1)
        return ""

    def named(self, observation: np.ndarray) -> Any:
        """Return an observation as a record with the names of its components.

        ``env.named(observation).velocity``; `observation_record` lists all names. Of an observation
        with history the latest one is taken.
        """
        return fields.named(self.observation_record, observation)

    def seen(self, observation: np.ndarray) -> Any:
        """Return `named`. Deprecated since 0.2, to be removed in 0.3."""
        warnings.warn("use env.named(observation)", DeprecationWarning, stacklevel=2)
        return self.named(observation)

    # --------------------------------------------------- for `_begin` of a task

    def place(
        self, positions: Mapping[str, float], believed: Mapping[str, float] | None = None
    ) -> None:
        """Switch on with the joints at `positions` (m or rad), and reference all drives there.

        A drive named in `believed` is referenced to that position instead of its true one. With
        ``action="pdo"`` the drives stay disabled, otherwise they are enabled in the task's mode.
        """
        positions = self.placed(positions)
        self.machine.reset(positions=positions)
        master = Master(MachinePort(self.machine), *positions)
        for name, position in (dict(positions) | dict(believed or {})).items():
            drive = self.machine.drives[name]
            drive.write("home_offset", -round(position * self.units))
            drive.write("homing_method", drive.model.homes_here)
        master.enable()
        master.home()
        if self.face == PDO:
            for drive in self.drives:
                drive.write("controlword", 0)
            self.machine.step()
        if "target_position" in self.RPDO:  # in force until the first RPDO of the agent arrives
            positions_now = [drive.read("position_actual_value") for drive in self.drives]
            self._part.rpdos["target_position"][0] = positions_now

    @property
    def on_a_bus(self) -> bool:
        """Whether the drives are on a bus, so that this machine is only a model of theirs."""
        return hasattr(self.line, "place")

    def placed(
        self, positions: Mapping[str, float], search: tuple[int, float] | None = None
    ) -> Mapping[str, float]:
        """Let the master of a bus bring the axes to `positions`; -> where they are.

        In memory these are the positions themselves. `search`: see `PortLine.place`.
        """
        if not self.on_a_bus:
            return positions
        line: Any = self.line
        return line.place(positions, self.MODES[0], search)

    def normalise(self) -> None:
        """Record the scales of observations: limits of the first drive, following error window."""
        self.episode._speed = self.drive.read("max_profile_velocity") / self.units
        self.episode._max_torque = self.drive.read("max_torque")
        self.episode._window = self._window

    # ------------------------------------------------------------------ copies and pictures

    def __reduce__(self) -> tuple[Any, ...]:
        """A copy or a pickle is built from the same arguments and continues; no window is kept."""
        return _rebuild, (type(self), *self._arguments, self.snapshot())

    def snapshot(self) -> tuple[Any, ...]:
        """Return the complete state of the environment; `restore` continues from it bit by bit."""
        with self.machine.turn:
            return (
                self.machine.snapshot(), [array.tobytes() for array in self._part[1:-1]],
                self._batch.history(self._row),
                copy.deepcopy({name: getattr(self, name) for name in OWN}),
                None if self.line is None else self.line.state(),
            )

    def restore(self, snapshot: tuple[Any, ...]) -> None:
        """Restore the state of a `snapshot` of an environment with the same arguments."""
        machine, rows, history, own, line = snapshot
        with self.machine.turn:
            self.machine.restore(machine)
            for array, row in zip(self._part[1:-1], rows, strict=True):
                array.view(np.ndarray).view(np.uint8).reshape(-1)[:] = np.frombuffer(row, np.uint8)
            self._batch.set_history(self._row, history)
            vars(self).update(copy.deepcopy(own))
            if self.line is not None:
                self.line.become(line)

    def channels(self) -> tuple[channels.Channel, ...]:
        """Return the channels that a picture of an episode shows, of the task and its drives."""
        return channels.of(self)

    def render(self) -> np.ndarray | None:  # type: ignore[override]
        """Return an image with an overlay, shape ``(540, 960, 3)``, uint8."""
        return self._picture.image() if self.render_mode == "rgb_array" else None

    def close(self) -> None:
        """Close window and renderer and release drives on a bus; may be called repeatedly."""
        close = getattr(self.line, "close", None)
        if close is not None:
            close()
        self._picture.close()


def _rebuild(task: type[ServoEnv], args: tuple, arguments: dict, snapshot: tuple) -> ServoEnv:
    env = task(*args, **arguments)
    env.restore(snapshot)
    return env


@functools.cache
def state_name(statusword: int) -> str:
    """Name of the state that a statusword shows."""
    state = state_of(statusword)
    return "INVALID" if state is None else state.name
