"""`Work`: takes a list of jobs and returns their results in order, whoever does them."""

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
    """The executor of jobs.

    Args:
        workers: number of processes, or of cores of a cluster that is started here; None uses this
            process alone.
        ray: address of a Ray cluster; empty to start one on this machine; None for no cluster.
        resume: use the results that exist already.

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
        """Return the results of all jobs in their order.

        Args:
            jobs: the jobs.
            folder: where results are kept until `clear`; nothing is kept without one.
            console: shows the progress.
            warm: small jobs that are done first on each machine, so that it compiles once.
            then: receives the number and the result of each job as soon as it is done, one after
                another; on a thread of its own if others do the jobs.

        Raises:
            Exception: the error of a job, of the executor or of `then`; earlier results are kept.
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
        """Yield `then` as `map` calls it; at the end wait for its calls and raise their error."""
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
        """Remove the kept results of jobs whose results have been written."""
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
