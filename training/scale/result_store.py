"""Results of jobs in a folder, each written completely or not at all, named by a digest."""

from pathlib import Path

from ..report import write_bytes
from .job import Job, Result, decoded

FOLDER = "jobs"  # in the folder of the results


class ResultStore:
    """Stored results of one run, or of none.

    Args:
        folder: folder of the results; nothing is kept without one.
        resume: return stored results; otherwise every job is done again.
    """

    def __init__(self, folder: Path | None, resume: bool):
        self.folder = folder / FOLDER if folder else None
        self._resume = resume

    def get(self, job: Job) -> Result | None:
        """Return the result of an earlier run; None if it is missing or damaged."""
        if self.folder is None or not self._resume:
            return None
        try:
            return decoded(self._path(job).read_bytes())
        except (OSError, ValueError):
            return None

    def save(self, job: Job, data: bytes) -> None:
        """Store a result. Raises OSError with the name of the file."""
        if self.folder is None:
            return
        path = self._path(job)
        try:
            write_bytes(path, data)
        except FileNotFoundError:  # the same command in another process has just cleared the folder
            write_bytes(path, data)

    def clear(self, jobs: list[Job]) -> None:
        """Remove the results of these jobs, and the folder if it is empty then."""
        if self.folder is None or not self.folder.is_dir():
            return
        for job in jobs:
            self._path(job).unlink(missing_ok=True)
        for left in self.folder.iterdir():
            if left.suffix != ".npz":
                left.unlink(missing_ok=True)  # an incomplete result of a process that was killed
        if not any(self.folder.iterdir()):
            self.folder.rmdir()

    def _path(self, job: Job) -> Path:
        assert self.folder is not None
        return self.folder / f"{job.digest()}.npz"
