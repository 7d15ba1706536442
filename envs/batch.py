"""Batch: the arrays in which any number of environments of one task meet their machines.

One row an environment: its machine, what its task remembers, the action, the process images, the
observation. A step of some rows is three compiled calls: the task makes RPDO images of the actions,
the loop latches them, runs and collects TPDO images, and the task judges what came back.
"""

from collections.abc import Sequence

import numpy as np

from ..drive.drive import Drive
from ..drive.record import accessible
from . import loop
from .faces import CONTROL_ACTIONS, STATUS_OBSERVATIONS, control, report

PDO_BYTES = 8
CONTROL = ("controlword", "modes_of_operation")  # first in each RPDO image
STATUS = ("statusword", "modes_of_operation_display")  # first in each TPDO image
# what every task keeps of an episode; fields with an underscore are not shown in the infos
JUDGED = [("reward", "f8"), ("cost", "f8"), ("is_success", "?"), ("_terminated", "?")]


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
    """

    def __init__(
        self, task, n: int, *, drives: int, rpdo: np.dtype, tpdo: np.dtype, ticks: int,
        modes: Sequence[int] = (), history: int = 1, previous_action: bool = False,
    ):  # fmt: skip
        self.task = task
        self.ticks = ticks
        self.modes = np.array(modes, np.int8)
        faces = drives if modes else 0
        actions = task.ACTIONS + faces * CONTROL_ACTIONS
        observations = task.OBSERVATIONS + faces * STATUS_OBSERVATIONS
        self.worlds = np.zeros(n, np.int64)
        self.episodes = np.zeros(n, accessible(task.EPISODE))
        self.actions = np.zeros((n, actions))
        self.rpdos = np.zeros((n, drives), accessible(rpdo))
        self.tpdos = np.zeros((n, drives), accessible(tpdo))
        self.observations = np.zeros((n, observations), np.float32)
        self.words = self.tpdos["statusword"]
        self._frames = np.zeros((n, history, observations), np.float32)
        self._previous_action = previous_action
        self.width = history * observations + previous_action * actions
        self._rpdo_images = self.rpdos.view(np.ndarray).view(np.uint8).reshape(n, -1)
        self._tpdo_images = self.tpdos.view(np.ndarray).view(np.uint8).reshape(n, -1)

    def part(self, begin: int, end: int) -> tuple[np.ndarray, ...]:
        """Views of the rows `begin` to `end`, as `run` takes them."""
        arrays = (
            self.worlds, self.episodes, self.actions, self.rpdos, self.tpdos, self.observations,
            self._rpdo_images, self._tpdo_images,
        )  # fmt: skip
        return tuple(array[begin:end] for array in arrays)

    def run(self, part: tuple[np.ndarray, ...]) -> None:
        """One step of the rows of a part; rows whose world is 0 are left out."""
        worlds, episodes, actions, rpdos, tpdos, observations, received, transmitted = part
        self.task.act(worlds, episodes, actions, rpdos)
        if len(self.modes):
            control(worlds, actions, self.task.ACTIONS, self.modes, rpdos)
        loop.run(worlds, self.ticks, received, transmitted)
        self._judge(worlds, episodes, rpdos, tpdos, observations)

    def _judge(self, worlds, episodes, rpdos, tpdos, observations) -> None:
        self.task.judge(worlds, episodes, rpdos, tpdos, observations)
        if len(self.modes):
            report(tpdos, self.modes, observations, self.task.OBSERVATIONS)

    def look(self, part: tuple[np.ndarray, ...]) -> None:
        """Latch the RPDO images as they are and judge the present, without a step."""
        worlds, episodes, _, rpdos, tpdos, observations, received, transmitted = part
        loop.run(worlds, 0, received, transmitted)
        self._judge(worlds, episodes, rpdos, tpdos, observations)

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
