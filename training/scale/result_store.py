"""Results of jobs in a folder: each there completely or not at all, under the digest of its job."""

from pathlib import Path

from ..report import write_bytes
from .job import Job, Result, decoded

FOLDER = "jobs"  # in the folder of the results


class ResultStore:
    """Stored results of one run, or of none.

    Args:
        folder: in which to keep them; nothing is kept if not given.
        resume: take what is there; else it is done anew.
    """

    def __init__(self, folder: Path | None, resume: bool):
        self.folder = folder / FOLDER if folder else None
        self._resume = resume

    def get(self, job: Job) -> Result | None:
        """The result of an earlier run; None where there is none, or a damaged one."""
        if self.folder is None or not self._resume:
            return None
        try:
            return decoded(self._path(job).read_bytes())
        except (OSError, ValueError):
            return None

    def save(self, job: Job, data: bytes) -> None:
        """Keep a result. Raises OSError as the disk does, naming the file."""
        if self.folder is None:
            return
        path = self._path(job)
        try:
            write_bytes(path, data)
        except FileNotFoundError:  # the same command, run beside this one, has just cleared all
            write_bytes(path, data)

    def clear(self, jobs: list[Job]) -> None:
        """Remove those of these jobs, and the folder where no other is in it."""
        if self.folder is None or not self.folder.is_dir():
            return
        for job in jobs:
            self._path(job).unlink(missing_ok=True)
        for left in self.folder.iterdir():
            if left.suffix != ".npz":
                left.unlink(missing_ok=True)  # half of one, of a process that was killed
        if not any(self.folder.iterdir()):
            self.folder.rmdir()

    def _path(self, job: Job) -> Path:
        assert self.folder is not None
        return self.folder / f"{job.digest()}.npz"
