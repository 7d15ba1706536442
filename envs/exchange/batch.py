"""Batch: the arrays in which any number of environments of one task meet their machines.

One row an environment: its machine, what its task remembers, the action, the process images, the
observation. A step of some rows is three compiled calls: the task makes RPDO images of the actions,
the loop latches them, runs and collects TPDO images, and the task judges what came back.
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
# what every task keeps of an episode
JUDGED = [
    ("reward", "f8"), ("cost", "f8"), ("is_success", "?"), ("_terminated", "?"),
    ("_world", "i8"),  # address of its machine while its task acts or judges, else 0
]
# What a step may cost beside what a task judges, taken off its reward: price × the mean over the
# drives. torque: (6077h / rated torque)² at the end of the step, in proportion to the loss in the
# winding. jerk: (its change in the step / rated torque)², since what is moved has one mass.
PRICES = ("torque", "jerk")
DEAREST = 1000.0
TORQUE = "torque_actual_value"
JUDGED_NAMES = tuple(name for name, _ in JUDGED)


def shown(name: str) -> bool:
    """Whether the infos have a field; a step gives the reward, libraries keep theirs in infos."""
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
    """The record a task keeps of an episode: what is judged, and `fields` of its own."""
    return np.dtype([*JUDGED, *fields], align=True)


def image_type(drive: Drive, names: Sequence[str]) -> np.dtype:
    """The process image of mapped objects as a record. Raises ValueError if one is missing."""
    missing = [name for name in names if name not in drive.objects.names]
    if missing:
        raise ValueError(
            f"drive {drive.model.name!r} has no object {', '.join(missing)}, which this task needs"
        )
    return np.dtype([(n, "<" + drive.objects.names[n].row.format) for n in names])


def mapping(image: np.dtype) -> list[list[str]]:
    """The fields of an image shared out to PDOs of 8 bytes, in their order."""
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
    """A way of process images to the drives of a world, other than by memory."""

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
        modes: that the agent chooses from with ``action="pdo"``; none: it moves set-points only.
        history: observations kept, the latest first.
        previous_action: whether the action taken last is observed.
        prices: of torque and jerk.

    Raises ValueError for a price without the object 6077h among those the task sees.
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
            raise ValueError(f"prices: the task does not see {TORQUE}, take it into its TPDO")
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
        """Views of the rows `begin` to `end`, whose machines share a turn, as `run` takes them."""
        arrays: Any = (
            self.worlds, self.episodes, self.actions, self._commands, self._controls, self.rpdos,
            self.tpdos, self.observations, self._seen, self._status, self._rpdo_images,
            self._tpdo_images,
        )
        machine: Any = self.machines[begin]
        return Part._make([*(array[begin:end] for array in arrays), machine.turn])

    def run(self, part: Part) -> None:
        """One step of the rows of a part; rows whose world is 0 are left out.

        Raises what `loop.run` does, and RuntimeError once `stopped`.
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
        """Torque of each drive as a share of the rated torque, shape ``(n, drives)``, a copy."""
        return 1e-3 * np.asarray(part.tpdos[TORQUE], float)

    def charge(self, part: Part, before: np.ndarray) -> None:
        """Take torque and jerk off the rewards of the rows that have stepped."""
        torque = self.torque(part)
        terms = (torque**2).mean(axis=1), ((torque - before) ** 2).mean(axis=1)
        cost = sum(price * term for price, term in zip(self.prices, terms, strict=True))
        part.episodes["reward"] -= np.where(part.worlds != 0, cost, 0.0)

    def _exchange(self, part: Part) -> None:
        """Images against a step of the machines."""
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
        """The observations kept for a row, shape ``(history, observations)``, a copy."""
        return self._frames[row].copy()

    def set_history(self, row: int, frames: np.ndarray) -> None:
        """Give a row the observations that `history` gave."""
        self._frames[row] = frames

    def observed(self, rows: slice) -> np.ndarray:
        """What the agents of `rows` see, shape ``(n, width)`` float32, a copy."""
        frames = self._frames[rows]
        frames = frames.reshape(len(frames), -1)
        if not self._previous_action:
            return frames.copy()
        return np.concatenate([frames, self.actions[rows]], axis=1, dtype=np.float32)


def _with(record: np.dtype, name: str, kind: np.dtype, drives: int) -> np.dtype:
    """A record of a task, and what the face "pdo" adds for each drive."""
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
