"""The table engine: cells that jobs play, whoever plays them, and what was found in each.

All evaluations are grids. The key of a cell names its row and column; a cell is what a few jobs
find out: fixed episodes under a policy, runs of a homing method, a comparison, or a grid again.
Where the jobs run, the progress, what an interrupted command keeps and what is cleared at its end
are here.
"""

from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Generic, Protocol, TypeVar

from rich.console import Console

from ..scale.job import Job, Result
from ..scale.work import Work

Key = TypeVar("Key", bound=Hashable)
Found = TypeVar("Found")
FoundOut = TypeVar("FoundOut", covariant=True)


class Cell(Protocol[FoundOut]):
    """What jobs find out."""

    @property
    def jobs(self) -> Sequence[Job]:
        """The jobs, in the order in which `results` takes what they gave."""

    def results(self, found: Sequence[Result]) -> FoundOut:
        """What was found, from the results of the jobs."""


class Grid(Generic[Key, Found]):
    """Cells by row and column, in the order in which they are played; a cell itself.

    Args:
        cells: by their keys; others may be added.
    """

    def __init__(self, cells: Mapping[Key, Cell[Found]] | None = None):
        self.cells = dict(cells or {})
        self.gaps: dict[Key, str] = {}  # cells that cannot be played: the reason

    @contextmanager
    def tried(self, key: Key) -> Iterator[None]:
        """For the block that adds a cell: where it raises ValueError there is a gap, with that."""
        try:
            yield
        except ValueError as error:
            self.gaps[key] = str(error)

    @property
    def jobs(self) -> list[Job]:
        """Jobs of all cells."""
        return [job for cell in self.cells.values() for job in cell.jobs]

    def results(self, found: Sequence[Result]) -> dict[Key, Found]:
        """What was found in each cell."""
        left = iter(found)
        return {
            key: cell.results([next(left) for _ in cell.jobs]) for key, cell in self.cells.items()
        }


@contextmanager
def played(
    cell: Cell[Found], work: Work, console: Console, folder: Path | None = None, *,
    warm: Sequence[Job] = (), then: Callable[[int, Result], None] | None = None,
) -> Iterator[Found]:
    """What is found in a cell or grid; results of jobs are kept until the block has ended well.

    Args:
        cell: whose jobs are done.
        work: who does them.
        console: where to show progress.
        folder: where results are kept, so that an interrupted command can go on; none if not given.
        warm: as `Work.map`.
        then: as `Work.map`.
    """
    jobs = cell.jobs
    yield cell.results(work.map(jobs, folder=folder, console=console, warm=warm, then=then))
    if folder is not None:
        work.clear(jobs, folder)
