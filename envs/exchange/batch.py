"""The arrays by which any number of environments of one task exchange data with their machines.

Each row belongs to an environment: its machine, the record of its episode, the action, the process
images and the observation. A step of some rows makes three compiled calls: the task turns actions
into RPDO images; the loop latches them, runs, and collects TPDO images; the task judges the result.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np

from ...drive.drive import Drive
from ...drive.kernel.record import accessible
from ...drive.model.names import hint, named
from ...drive.model.uncompiled import telling
from ..engine import loop
from ..engine.checks import in_range
from ..engine.guard import Turn
from ..engine.machine import Machine
from . import fields
from .faces import CONTROL, STATUS, control, report
from .loops import acting, judging

PDO_BYTES = 8
COMMANDED = ("controlword", "modes_of_operation")  # first in each RPDO image
REPORTED = ("statusword", "modes_of_operation_display")  # first in each TPDO image
# fields that the episode of every task has
JUDGED = [
    ("reward", "f8"), ("cost", "f8"), ("is_success", "?"), ("_terminated", "?"),
    ("_world", "i8"),  # address of its machine while its task acts or judges, else 0
]
# Costs that can be subtracted from the reward of a step: price × the mean over the drives.
# torque: (6077h / rated torque)² at the end of the step, proportional to the loss in the winding.
# jerk: (change of the torque in the step / rated torque)², as the moved mass is constant.
PRICES = ("torque", "jerk")
DEAREST = 1000.0
TORQUE = "torque_actual_value"
JUDGED_NAMES = tuple(name for name, _ in JUDGED)


def shown(name: str) -> bool:
    """Whether the infos have a field; they omit the reward, which every step returns anyway."""
    return name != "reward" and not name.startswith("_")


def priced(prices: Mapping[str, float] | None) -> tuple[float, float]:
    """Return the prices in the order of `PRICES`, 0 where none is given.

    Raises ValueError for another name, or a price out of range.
    """
    given = named("prices", prices, '{"torque": 0.01}')
    for name, price in given.items():
        if name not in PRICES:
            raise ValueError(f"prices: there is none of {name!r}: {hint(name, PRICES)}")
        in_range(f"prices[{name!r}]", price, 0.0, DEAREST, "of the reward")
    torque, jerk = (float(given.get(name, 0.0)) for name in PRICES)
    return torque, jerk


def episode(*fields: tuple) -> np.dtype:
    """Return the record of an episode: the fields of every task, and `fields` of this one."""
    return np.dtype([*JUDGED, *fields], align=True)


def image_type(drive: Drive, names: Sequence[str]) -> np.dtype:
    """Return the process image of mapped objects. Raises ValueError if the drive lacks one."""
    missing = [name for name in names if name not in drive.objects.names]
    if missing:
        raise ValueError(
            f"drive {drive.model.name!r} has no object {', '.join(missing)}, which this task needs"
        )
    return np.dtype([(n, "<" + drive.objects.names[n].row.format) for n in names])


def mapping(image: np.dtype) -> list[list[str]]:
    """Divide the fields of an image into PDOs of at most 8 bytes, in their order."""
    pdos: list[list[str]] = [[]]
    free = PDO_BYTES
    for name in image.names or ():
        size = image[name].itemsize
        if size > free:
            pdos.append([])
            free = PDO_BYTES
        pdos[-1].append(name)
        free -= size
    return pdos


class Line(Protocol):
    """A connection other than memory that carries process images to the drives of a world."""

    def run(self, world: np.ndarray, ticks: int, rpdos: np.ndarray, tpdos: np.ndarray) -> None:
        """Run cycles as `loop.run` does, for one world and its images as bytes."""

    def look(self, world: np.ndarray, rpdos: np.ndarray, tpdos: np.ndarray) -> None:
        """Fill the TPDO images without running a cycle."""


class Part(NamedTuple):
    """Views of some rows of a `Batch`."""

    worlds: np.ndarray  # addresses; 0: left out
    episodes: np.ndarray
    actions: np.ndarray  # (n, actions)
    commands: np.ndarray  # records of the task in them
    controls: np.ndarray  # (n, drives), with the face "pdo"
    rpdos: np.ndarray  # (n, drives)
    tpdos: np.ndarray
    observations: np.ndarray  # (n, observations)
    seen: np.ndarray  # records of the task in them
    status: np.ndarray  # (n, drives), with the face "pdo"
    received: np.ndarray  # the images as bytes
    transmitted: np.ndarray
    turn: Turn  # of their machines


class Batch:
    """Arrays of `n` environments.

    Args:
        task: one of the environments, a `ServoEnv`.
        n: how many.
        drives: of one machine, with the mapping of the task.
        rpdo, tpdo: image of one drive.
        ticks: physics steps a step.
        modes: modes from which the agent chooses with ``action="pdo"``; empty for set-points only.
        history: observations kept, the latest first.
        previous_action: whether the action taken last is observed.
        prices: of torque and jerk.

    Raises ValueError for a price if the TPDO of the task lacks 6077h.
    """

    def __init__(
        self, task, n: int, *, drives: int, rpdo: np.dtype, tpdo: np.dtype, ticks: int,
        modes: Sequence[int] = (), history: int = 1, previous_action: bool = False,
        prices: tuple[float, float] = (0.0, 0.0),
    ):
        self._act = telling(task.act, acting(task.act))
        self._judge_each = telling(task.judge, judging(task.judge))
        self.ticks = ticks
        self.prices = prices
        if any(prices) and TORQUE not in (tpdo.names or ()):
            raise ValueError(f"prices: the TPDO of the task lacks {TORQUE}: add it")
        self.lines: dict[int, Line] = {}  # by world, where images go in frames
        self.stopped = False  # set by another thread: a step ends as soon as it can
        self.modes = np.array(modes, np.int8)
        self.action, self.observation = task.ACTION, task.OBSERVATION
        if modes:
            self.action = _with(self.action, "control", CONTROL, drives)
            self.observation = _with(self.observation, "status", STATUS, drives)
        actions, observations = fields.width(self.action), fields.width(self.observation)
        self.worlds = np.zeros(n, np.int64)
        self.machines: list[Machine | None] = [None] * n  # keeps them alive
        self.episodes = np.zeros(n, accessible(task.EPISODE))
        self.actions = np.zeros((n, actions))
        self.rpdos = np.zeros((n, drives), accessible(rpdo))
        self.tpdos = np.zeros((n, drives), accessible(tpdo))
        self.observations = np.zeros((n, observations), np.float32)
        faces = drives if modes else 0
        self._controls = np.zeros((n, faces), accessible(CONTROL))
        self._status = np.zeros((n, faces), accessible(STATUS))
        # without a face the records are the vectors; with one compiled code has them beside it, so
        # that it meets the same types
        commands = np.zeros((n, fields.width(task.ACTION))) if modes else self.actions
        seen = (
            np.zeros((n, fields.width(task.OBSERVATION)), np.float32)
            if modes
            else self.observations
        )
        self._commands = commands.view(accessible(task.ACTION))[:, 0]
        self._seen = seen.view(accessible(task.OBSERVATION))[:, 0]
        self.words = self.tpdos["statusword"]
        self._frames = np.zeros((n, history, observations), np.float32)
        self._previous_action = previous_action
        self.width = history * observations + previous_action * actions
        self._rpdo_images = _bytes(self.rpdos)
        self._tpdo_images = _bytes(self.tpdos)

    def part(self, begin: int, end: int) -> Part:
        """Return views of the rows `begin` to `end`, whose machines share a turn, for `run`."""
        arrays: Any = (
            self.worlds, self.episodes, self.actions, self._commands, self._controls, self.rpdos,
            self.tpdos, self.observations, self._seen, self._status, self._rpdo_images,
            self._tpdo_images,
        )
        machine: Any = self.machines[begin]
        return Part._make([*(array[begin:end] for array in arrays), machine.turn])

    def run(self, part: Part) -> None:
        """Run a step of the rows of a part, except those whose world is 0.

        Raises as `loop.run`, and RuntimeError once `stopped` is set.
        """
        with part.turn:
            if len(self.modes):
                _split(part.actions, part.commands, part.controls)
            self._act(part.worlds, part.episodes, part.commands, part.rpdos)
            if len(self.modes):
                control(part.worlds, part.controls, self.modes, part.rpdos)
            before = self.torque(part) if any(self.prices) else None
            self._exchange(part)
            self._judge(part)
            if before is not None:
                self.charge(part, before)

    def torque(self, part: Part) -> np.ndarray:
        """Return a copy of each drive's torque (rated torque), shape ``(n, drives)``."""
        return 1e-3 * np.asarray(part.tpdos[TORQUE], float)

    def charge(self, part: Part, before: np.ndarray) -> None:
        """Subtract the prices of torque and jerk from the rewards of the rows that have stepped."""
        torque = self.torque(part)
        terms = (torque**2).mean(axis=1), ((torque - before) ** 2).mean(axis=1)
        cost = sum(price * term for price, term in zip(self.prices, terms, strict=True))
        part.episodes["reward"] -= np.where(part.worlds != 0, cost, 0.0)

    def _exchange(self, part: Part) -> None:
        """Exchange process images with the machines, which run a step."""
        worlds, rpdos, tpdos = part.worlds, part.received, part.transmitted
        if not self.lines:
            loop.run(worlds, self.ticks, rpdos, tpdos, lambda: self.stopped)
            return
        for i in np.flatnonzero(worlds).tolist():
            if self.stopped:
                raise RuntimeError(loop.INTERRUPTED)
            self.lines[int(worlds[i])].run(worlds[i : i + 1], self.ticks, rpdos[i], tpdos[i])

    def _judge(self, part: Part) -> None:
        self._judge_each(part.worlds, part.episodes, part.rpdos, part.tpdos, part.seen)
        if len(self.modes):
            report(part.tpdos, self.modes, part.status)
            _join(part.seen, part.status, part.observations)

    def look(self, part: Part) -> None:
        """Latch the RPDO images as they are and judge the present, without a step."""
        with part.turn:
            if self.lines:
                for i in np.flatnonzero(part.worlds).tolist():
                    line = self.lines[int(part.worlds[i])]
                    line.look(part.worlds[i : i + 1], part.received[i], part.transmitted[i])
            else:
                loop.run(part.worlds, 0, part.received, part.transmitted)
            self._judge(part)

    def begin(self, row: int) -> None:
        """Fill the history of a row with its present observation."""
        self._frames[row] = self.observations[row]
        self.actions[row] = 0.0

    def remember(self, rows: np.ndarray | slice) -> None:
        """Put the present observations of `rows` in front of their history."""
        if self._frames.shape[1] > 1:
            self._frames[rows, 1:] = self._frames[rows, :-1]
        self._frames[rows, 0] = self.observations[rows]

    def history(self, row: int) -> np.ndarray:
        """Return a copy of a row's past observations, shape ``(history, observations)``."""
        return self._frames[row].copy()

    def set_history(self, row: int, frames: np.ndarray) -> None:
        """Restore the observations that `history` returned."""
        self._frames[row] = frames

    def observed(self, rows: slice) -> np.ndarray:
        """Return a copy of the observations of some agents, shape ``(n, width)``, float32."""
        frames = self._frames[rows]
        frames = frames.reshape(len(frames), -1)
        if not self._previous_action:
            return frames.copy()
        return np.concatenate([frames, self.actions[rows]], axis=1, dtype=np.float32)


def _with(record: np.dtype, name: str, kind: np.dtype, drives: int) -> np.dtype:
    """Return a task's record with the fields that the face "pdo" adds for each drive."""
    fields: list[Any] = [(n, record[n]) for n in record.names or ()]
    return np.dtype([*fields, (name, kind, (drives,))])


def _bytes(records: np.ndarray) -> np.ndarray:
    """View the memory as bytes, shape ``(n, bytes)``."""
    return records.view(np.ndarray).view(np.uint8).reshape(len(records), -1)


def _numbers(records: np.ndarray, number: type) -> np.ndarray:
    """View the memory as numbers, shape ``(n, numbers)``."""
    return records.view(np.ndarray).view(number).reshape(len(records), -1)


def _split(actions: np.ndarray, commands: np.ndarray, controls: np.ndarray) -> None:
    own = _numbers(commands, np.float64)
    own[:] = actions[:, : own.shape[1]]
    _numbers(controls, np.float64)[:] = actions[:, own.shape[1] :]


def _join(seen: np.ndarray, status: np.ndarray, observations: np.ndarray) -> None:
    own = _numbers(seen, np.float32)
    observations[:, : own.shape[1]] = own
    observations[:, own.shape[1] :] = _numbers(status, np.float32)
