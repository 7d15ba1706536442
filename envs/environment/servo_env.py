"""ServoEnv: a Gymnasium environment in which an agent is the master of emulated drives.

A task is a subclass and defines the attributes of `task.Task`. This class provides the rest: PDO
mapping, enabling and homing, the step, randomisation, fault injection, infos, rendering, pickling.
"""

import copy
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import gymnasium as gym
import numpy as np

from ...drive.kernel.words import ENABLED, Mode, state_of
from ...drive.master.master import Master
from ...drive.model.model import DriveModel, load
from ...drive.model.names import named
from ...drive.objects.abort import SdoAbort
from ..engine.checks import Options, UnknownArgument, accepted, choice, flag, whole
from ..engine.machine import Machine
from ..engine.rates import interpolation_period, step_cycles
from ..exchange import fields
from ..exchange.batch import (
    COMMANDED,
    JUDGED_NAMES,
    REPORTED,
    Batch,
    image_type,
    mapping,
    priced,
    shown,
)
from ..exchange.faces import FACES, FAULT, PDO
from ..masters.port import MachinePort
from ..variation.injection import Faults, injections, sort
from ..variation.randomisation import Randomisation
from ..view import channels
from ..view.picture import Picture
from . import of_twin
from .needed import NEEDED, built, check
from .task import METRE as METRE
from .task import Task

if TYPE_CHECKING:
    from ..exchange.over_ethercat import EtherCatLine
    from ..exchange.over_port import DriveSide, PortLine

STATE_MASK = 0x6F
STATE_NAME = {  # by statusword & STATE_MASK
    word: state.name for word in range(STATE_MASK + 1) if (state := state_of(word)) is not None
}
MAX_HISTORY = 100
INTERPOLATING = {  # modes in which the drive has to know the period of the set-points, 60C2h
    Mode.INTERPOLATED_POSITION, Mode.CYCLIC_SYNC_POSITION, Mode.CYCLIC_SYNC_VELOCITY,
    Mode.CYCLIC_SYNC_TORQUE,
}


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
        randomise: ranges by name, drawn anew for each episode, see
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
        known, drive = of_twin.found(self, twin, drive)
        model = load(drive, "ethercat" if bus_faults else None)
        for mode in self.MODES:
            if mode not in model.modes:
                raise ValueError(
                    f"drive {model.name!r} has no mode {mode.name.lower()}, which this task needs: "
                    f"it has {', '.join(m.name.lower() for m in model.modes)}"
                )
        choice("action", action, FACES)
        if render_mode is not None and render_mode not in self.metadata["render_modes"]:
            raise ValueError(f"render_mode = {render_mode!r}, use one of rgb_array, human or None")
        self.render_mode = render_mode
        self.face = action
        self.tuned = flag("tuned", tuned)
        self.machine = built(self, self._make(model))
        if known is not None:
            known.give(self.machine)
        self.drives = [self.machine.drives[name] for name in self.drive_names]
        self.drive = self.drives[0]
        self.cycles_per_step = step_cycles(step_time, self.STEP_TIME, self.machine.cycle_time)
        self.step_time = self.cycles_per_step * self.machine.cycle_time
        self.metadata = self.metadata | {"render_fps": round(1.0 / self.step_time)}
        self._faults = injections(causes, self.machine.drives, self.drives)
        self.randomisation = Randomisation(
            self.machine,
            named("randomise", of_twin.ranges(randomise, known), '{"payload": (1.0, 10.0)}'),
            self.cycles_per_step,
        )
        self._history = whole("history", history, 1, MAX_HISTORY)
        self._previous_action = flag("previous_action", previous_action)
        self.prices = priced(prices)
        self._configure()
        self.line: EtherCatLine | PortLine | None = None
        if port is not None:
            self.line = self._on_a_bus(port, alone=not (faults or action == PDO))
        if bus_faults:
            from ..exchange import over_ethercat

            parts = self.machine, self.drives, self.step_time
            self.line = over_ethercat.EtherCatLine(*parts, bus_faults)
        self.join(self.batch(1), 0)
        width = self._batch.actions.shape[1]
        self.action_space = gym.spaces.Box(-1.0, 1.0, (width,), np.float32)
        self.observation_space = gym.spaces.Box(-1.0, 1.0, (self._batch.width,), np.float32)
        self.parameters: dict[str, float] = {}
        self._injected: list[str] = []
        self._steps = -1  # not begun
        self._picture: Picture | None = None

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.machine!r}, action={self.face})"

    def __new__(cls, *args: Any, **arguments: Any) -> "ServoEnv":
        """Remember the arguments, for pickling."""
        known = accepted(cls) if arguments else {}  # type: ignore[arg-type]
        for name in arguments:
            if name not in known:
                raise UnknownArgument.of(cls.__name__, name, known)
        env = super().__new__(cls)
        env._arguments = args, arguments
        return env

    # ------------------------------------------------------------------- setting up

    def use_parameter_file(self, file: str | Path) -> None:
        """Load the stored parameters of the first drive, but for the PDO mapping, the task's own.

        Raises ValueError for a file that the drive does not take.
        """
        self.drive.use_parameter_file(file)
        self._configure()

    def _configure(self) -> None:
        """PDO mapping and interpolation period, through the objects of the drives."""
        for drive in self.drives:
            self._images = [
                image_type(drive, [*COMMANDED, *self.RPDO]),
                image_type(drive, [*REPORTED, *self.TPDO]),
            ]
            try:
                drive.map_pdos(*(mapping(image) for image in self._images))
            except (SdoAbort, ValueError) as error:
                raise ValueError(f"drive {drive.model.name!r}: {error}") from None
            cyclic = not INTERPOLATING.isdisjoint(self.MODES)
            if cyclic and "interpolation_time_period_value" in drive.objects.names:
                units, index = interpolation_period(self.step_time)
                drive.write("interpolation_time_period_value", units)
                drive.write("interpolation_time_index", index)
        for drive in self.machine.drives.values():
            if drive not in self.drives:  # its PDOs would be part of the images
                drive.map_pdos([], [])

    @property
    def drive_names(self) -> list[str]:
        """Names of the drives that the agent commands."""
        return [*(self.DRIVES or self.machine.drives)]

    def _on_a_bus(self, port: "DriveSide", alone: bool) -> "PortLine":
        from ..exchange.over_port import PortLine

        if self.MEMORY_ONLY:
            raise ValueError(f"port: {self.ID} runs in memory alone: {self.MEMORY_ONLY}")
        if not alone:
            raise ValueError(
                "port: faults and action='pdo' are for drives in this process; those on a bus are "
                "commanded by set-points, behind a guard"
            )
        pdos = [mapping(image) for image in self._images]
        names, period = self.drive_names, self.step_time
        line = PortLine(
            self.machine, names, self._images, pdos, period, self.units, port, self.REFERENCED
        )
        args, arguments = self._arguments
        plain = type(self)(*args, **arguments | {"port": None})
        plain.reset(seed=0)  # what is compiled is loaded now: drives with power do not wait for it
        plain.step(np.zeros_like(plain._part.actions[0]))
        return line

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
        """Use a row of `batch` for observations and images from the next reset on."""
        self._batch, self._row = batch, row
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
        self._show()
        return self._batch.observed(slice(self._row, self._row + 1))[0], self.info()

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
        """Whether the drives are on a bus, and this machine only shows what is known of them."""
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

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Run one step of the agent. Raises ValueError for an action outside the action space."""
        self._take(action)
        if self._steps < 0:
            raise gym.error.ResetNeeded("call reset() before the first step")
        self.inject_faults()
        self._batch.run(self._part)  # act, process images against time, judge
        self._steps += 1
        rows = slice(self._row, self._row + 1)
        self._batch.remember(rows)
        self._show()
        info = self.info()
        observation = self._batch.observed(rows)[0]
        return observation, self._reward, self._terminated, False, info

    def _take(self, action: np.ndarray) -> None:
        if np.shape(action) != self.action_space.shape:
            raise ValueError(self._refusal(action))
        for i, value in enumerate(action):
            try:
                value = float(value)
            except (TypeError, ValueError):
                raise ValueError(self._refusal(action)) from None
            if not abs(value) <= 1.0 + 1e-6:
                raise ValueError(self._refusal(action))
            self._part.actions[0, i] = value

    def _refusal(self, action: Any) -> str:
        return (
            f"action = {action!r} is not in {self.action_space}: "
            "clip it, and see that the policy's output is finite"
        )

    def named(self, observation: np.ndarray) -> Any:
        """Return an observation as a record with the names of its components.

        ``env.named(observation).velocity``; `observation_record` lists all names. Of an observation
        with history the latest one is taken.
        """
        return fields.named(self._batch.observation, observation)

    def seen(self, observation: np.ndarray) -> Any:
        """Return `named`. Deprecated since 0.2, to be removed in 0.3."""
        warnings.warn("use env.named(observation)", DeprecationWarning, stacklevel=2)
        return self.named(observation)

    @property
    def action_record(self) -> np.dtype:
        """Record type of an action, including what ``action="pdo"`` adds; see `fields.names`."""
        return self._batch.action

    @property
    def observation_record(self) -> np.dtype:
        """Record type of an observation without history, including what ``action="pdo"`` adds."""
        return self._batch.observation

    def channels(self) -> tuple[channels.Channel, ...]:
        """Return the channels that a picture of an episode shows, of the task and its drives."""
        return channels.of(self)

    def inject_faults(self) -> None:
        """Inject the declared faults with their probabilities."""
        for name, drive, cause, probability in self._faults:
            if self.np_random.random() < probability:
                drive.inject(cause)
                self._injected.append(name)

    def info(self) -> dict[str, Any]:
        """Return the ``info`` of the present state; its keys are always the same."""
        values = self._part.episodes.item(0)
        self._reward, self._terminated = values[self._REWARD], values[self._TERMINATED]
        words = self._part.tpdos["statusword"][0].tolist()
        info = {name: values[i] for i, name in self._SHOWN}
        info["fault"] = self.faults(words)
        info["injected"] = tuple(self._injected)
        info["state"] = STATE_NAME.get(words[0] & STATE_MASK, "INVALID")
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
        for n, (drive, word) in enumerate(zip(self.drives, words, strict=True)):
            if word & FAULT or (self.line is not None and drive.axis.fault):
                several = f" ({self.drive_names[n]})"
                return drive.fault + several * (len(self.drives) > 1)
        return ""

    def __init_subclass__(cls, **arguments: Any):
        super().__init_subclass__(**arguments)
        episode: Any = getattr(cls, "EPISODE", None)  # without one no environment can be made
        names = episode.names if NEEDED["EPISODE"].fits(episode) else JUDGED_NAMES
        cls._REWARD, cls._TERMINATED = names.index("reward"), names.index("_terminated")
        cls._SHOWN = [(i, name) for i, name in enumerate(names) if shown(name)]

    _REWARD: ClassVar[int]
    _TERMINATED: ClassVar[int]
    _SHOWN: ClassVar[list[tuple[int, str]]]

    # ------------------------------------------------------------------ keeping, seeing

    def __reduce__(self) -> tuple[Any, ...]:
        """A copy or a pickle: as built, and all that has happened since; a window is not kept."""
        return _rebuild, (type(self), *self._arguments, self.kept())

    def kept(self) -> tuple[Any, ...]:
        """Return everything that has happened since construction, for `resume`."""
        with self.machine.turn:
            return (
                dict(self.parameters), self.machine.snapshot(),
                [array.tobytes() for array in self._part[1:-1]], self._batch.history(self._row),
                list(self._injected), self._steps, copy.deepcopy(self._np_random),
                copy.deepcopy((self.action_space, self.observation_space)),
                None if self.line is None else self.line.state(),
            )

    def resume(self, kept: tuple[Any, ...]) -> None:
        """Continue from a result of `kept` of an environment with the same arguments."""
        with self.machine.turn:
            parameters, machine, rows, history, injected, self._steps, *others = kept
            generator, spaces, line = others
            self.parameters, self._injected = dict(parameters), list(injected)
            self.machine.restore(machine)
            for array, row in zip(self._part[1:-1], rows, strict=True):
                array.view(np.ndarray).view(np.uint8).reshape(-1)[:] = np.frombuffer(row, np.uint8)
            self._batch.set_history(self._row, history)
            self._np_random = generator
            self.action_space, self.observation_space = spaces
            if self.line is not None:
                self.line.become(line)

    def render(self) -> np.ndarray | None:  # type: ignore[override]
        """Return an image with an overlay, shape ``(540, 960, 3)``, uint8."""
        return self._drawn().image() if self.render_mode == "rgb_array" else None

    def _show(self) -> None:
        if self.render_mode == "human":
            self._drawn().show()
        elif self._picture is not None:
            self._picture.follow()

    def _drawn(self) -> Picture:
        if self._picture is None:
            self._picture = Picture(self)
        return self._picture

    def close(self) -> None:
        """Close window and renderer and release drives on a bus; may be called repeatedly."""
        close = getattr(self.line, "close", None)
        if close is not None:
            close()
        if self._picture is not None:
            self._picture.close()
            self._picture = None


def _rebuild(task: type[ServoEnv], args: tuple, arguments: dict, kept: tuple) -> ServoEnv:
    env = task(*args, **arguments)
    env.resume(kept)
    return env
