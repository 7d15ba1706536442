"""The table engine: cells, the jobs that fill them, and their results.

All evaluations are grids. The key of a cell names its row and column. A cell collects the results
of a few jobs: fixed episodes under a policy, runs of a homing method, a comparison, or another
grid. This module runs the jobs, shows the progress, keeps the results of an interrupted command and
clears them at its end.
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
    """A cell of a grid: its jobs, and the result that they give together."""

    @property
    def jobs(self) -> Sequence[Job]:
        """Return the jobs in the order in which `results` takes their results."""

    def results(self, found: Sequence[Result]) -> FoundOut:
        """Combine the results of the jobs into the result of the cell."""


class Grid(Generic[Key, Found]):
    """Cells by row and column, in the order in which they are played; a grid is itself a cell.

    Args:
        cells: by their keys; more may be added later.
    """

    def __init__(self, cells: Mapping[Key, Cell[Found]] | None = None):
        self.cells = dict(cells or {})
        self.gaps: dict[Key, str] = {}  # cells that cannot be played: the reason

    @contextmanager
    def tried(self, key: Key) -> Iterator[None]:
        """Wrap the block that adds a cell: a ValueError in it becomes a gap with that reason."""
        try:
            yield
        except ValueError as error:
            self.gaps[key] = str(error)

    @property
    def jobs(self) -> list[Job]:
        """Return the jobs of all cells."""
        return [job for cell in self.cells.values() for job in cell.jobs]

    def results(self, found: Sequence[Result]) -> dict[Key, Found]:
        """Return the result of each cell."""
        left = iter(found)
        return {
            key: cell.results([next(left) for _ in cell.jobs]) for key, cell in self.cells.items()
        }


@contextmanager
def played(
    cell: Cell[Found], work: Work, console: Console, folder: Path | None = None, *,
    warm: Sequence[Job] = (), then: Callable[[int, Result], None] | None = None,
) -> Iterator[Found]:
    """Play a cell or grid; the results of its jobs are kept until the block ends without error.

    Args:
        cell: the cell or grid to be played.
        work: runs the jobs.
        console: shows the progress.
        folder: keeps results, so that an interrupted command can continue; by default none.
        warm: as `Work.map`.
        then: as `Work.map`.
    """
    jobs = cell.jobs
    yield cell.results(work.map(jobs, folder=folder, console=console, warm=warm, then=then))
    if folder is not None:
        work.clear(jobs, folder)
