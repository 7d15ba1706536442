"""`Work`: a list of jobs in, their results in the same order out, whoever does them."""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from ...envs.engine.checks import cores, whole
from .job import Job, Result, decoded, encoded
from .result_store import ResultStore

MOST = 10_000  # workers


@dataclass(frozen=True)
class Work:
    """Who does the jobs.

    Args:
        workers: processes of this machine, or cores asked of a cluster that is started here; None:
            no others than this process.
        ray: address of a Ray cluster; empty: one is started on this machine; None: no Ray.
        resume: take the results that are there already.

    Raises:
        ValueError: numbers out of range.
    """

    workers: int | None = None
    ray: str | None = None
    resume: bool = False

    def __post_init__(self):
        if self.workers is not None:
            whole("--workers", self.workers, 1, MOST)

    def map(
        self, jobs: Sequence[Job], *, folder: Path | None = None, console: Console | None = None,
        warm: Sequence[Job] = (), then: Callable[[int, Result], None] | None = None,
    ) -> list[Result]:
        """Results of all, in the order of the jobs.

        Args:
            jobs: to be done; equal ones are done once.
            folder: where results are kept until `clear`; none are if not given.
            console: where to tell how far it is.
            warm: small jobs, done once a machine before the others, so that it compiles once.
            then: gets the number and the result of each job as soon as it is there, one after the
                other; where others do the jobs, on a thread beside them.

        Raises:
            Exception: of a job, of the executor or of `then`; what was done until then is kept.
        """
        console, kept = console or Console(quiet=True), ResultStore(folder, self.resume)
        found = [kept.get(job) for job in jobs]
        missing = [i for i, result in enumerate(found) if result is None]
        if self.resume and len(missing) < len(jobs):
            console.print(f"{len(jobs) - len(missing)} of {len(jobs)} jobs are there already")
        columns = (
            TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(),
            TimeRemainingColumn(elapsed_when_finished=True),
        )
        shown = Progress(*columns, console=console, transient=True, disable=not missing)
        try:
            with shown, self._beside(then) as tell:
                for i, result in enumerate(found):
                    if result is not None:
                        tell(i, result)
                bar = shown.add_task("jobs", total=len(jobs), completed=len(jobs) - len(missing))
                todo = [jobs[i] for i in missing]
                for k, data in self._done(todo, warm, console) if todo else ():
                    kept.save(todo[k], data)
                    found[missing[k]] = result = decoded(data)
                    tell(missing[k], result)
                    shown.update(bar, advance=1, description=todo[k].name)
        except BaseException:
            done = sum(result is not None for result in found)
            if folder and done:
                console.print(
                    f"{done} of {len(jobs)} jobs are kept in {kept.folder}: the same command with "
                    "--resume goes on", highlight=False,
                )
            raise
        return [result for result in found if result is not None]

    @contextmanager
    def _beside(
        self, then: Callable[[int, Result], None] | None
    ) -> Iterator[Callable[[int, Result], Any]]:
        """`then` as `map` calls it; the end waits for it, and raises what it raised."""
        if then is None or self.alone:
            yield then or (lambda i, result: None)
            return
        calls: list[Future[None]] = []
        thread = ThreadPoolExecutor(1, "servogym")
        try:
            yield lambda i, result: calls.append(thread.submit(then, i, result))
            for each in calls:
                each.result()
        finally:
            thread.shutdown(cancel_futures=True)

    @property
    def alone(self) -> bool:
        """Whether this process does the jobs itself."""
        return self.ray is None and self.workers is None

    def clear(self, jobs: Sequence[Job], folder: Path) -> None:
        """Remove what was kept of them: the results are written."""
        ResultStore(folder, self.resume).clear(list(jobs))

    def _done(
        self, jobs: Sequence[Job], warm: Sequence[Job], console: Console
    ) -> Iterator[tuple[int, bytes]]:
        if self.ray is not None:
            from .cluster import cluster

            return cluster(jobs, self.ray, self.workers, warm)
        if self.workers is not None:
            from .processes import processes

            if self.workers > cores():
                console.print(
                    f"note: {self.workers} workers on {cores()} cores take turns; no faster than "
                    f"--workers {cores()}", highlight=False,
                )
            return processes(jobs, self.workers, warm)
        return ((i, encoded(job())) for i, job in enumerate(jobs))


ALONE = Work()
