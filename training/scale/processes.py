"""Jobs done by processes of this machine; a job whose process dies is given to a new one."""

import signal
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import suppress
from multiprocessing import get_all_start_methods, get_context
from multiprocessing.connection import Connection, wait
from typing import Any

from ...envs.engine.checks import cores
from .job import Done, Job, do, result, stamp
from .template import prepare

DEATHS = 3  # of the processes of one job, until it is given up


def processes(
    jobs: Sequence[Job], workers: int, warm: Sequence[Job]
) -> Iterator[tuple[int, bytes]]:
    """Yield number and result of each job as soon as it is done.

    Args:
        jobs: the jobs.
        workers: number of processes.
        warm: jobs that are done before the workers start, so that nothing is compiled twice.

    Raises:
        RuntimeError: `DEATHS` processes have died during one job.
        Exception: the error of a job.
    """
    payloads = [job.sent() for job in jobs]
    if not prepare([(job.place, dict(job.arguments)) for job in warm]):
        for job in warm:
            job()
    workers = min(workers, len(jobs))
    threads = max(cores() // max(workers, 1), 1)
    waiting, deaths = deque(range(len(jobs))), [0] * len(jobs)
    busy: dict[Connection, tuple[int, _Worker]] = {}
    idle = [_Worker() for _ in range(workers)]
    try:
        while waiting or busy:
            while waiting and idle:
                worker, i = idle.pop(), waiting.popleft()
                worker.send((stamp(), threads, payloads[i]))
                busy[worker.connection] = i, worker
            for ready in wait(list(busy)):
                assert isinstance(ready, Connection)
                i, worker = busy.pop(ready)
                done = worker.answer()
                if done is not None:
                    idle.append(worker)
                    yield i, result(done, "a worker process")
                    continue
                deaths[i] += 1
                if deaths[i] == DEATHS:
                    raise RuntimeError(
                        f"{jobs[i].name}: {DEATHS} worker processes died over it, the last with "
                        f"{worker.end()}"
                    )
                waiting.appendleft(i)
                idle.append(_Worker())
    finally:
        for worker in [*idle, *(worker for _, worker in busy.values())]:
            worker.close()


class _Worker:
    """A process and the pipe to it; it ends when the pipe does."""

    def __init__(self):
        methods = get_all_start_methods()
        context: Any = get_context("forkserver" if "forkserver" in methods else "spawn")
        self.connection, other = context.Pipe()
        self.process = context.Process(target=_serve, args=(other,), daemon=True)
        self.process.start()
        other.close()

    def send(self, call: tuple[str, int, bytes]) -> None:
        with suppress(OSError):  # if the process has died, `answer` reports it
            self.connection.send(call)

    def answer(self) -> Done | None:
        """Return the answer; None if the process has died."""
        try:
            return Done(*self.connection.recv())
        except (EOFError, OSError):
            return None

    def end(self) -> str:
        self.process.join(10.0)
        code = self.process.exitcode
        return signal.Signals(-code).name if code is not None and code < 0 else f"status {code}"

    def close(self) -> None:
        self.connection.close()
        self.process.kill()  # it may be in the middle of a job
        self.process.join()


def _serve(connection: Connection) -> None:
    """Do jobs until the pipe ends; Ctrl-C is for the process that sends them."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    while True:
        try:
            call = connection.recv()
            connection.send(tuple(do(*call)))
        except (EOFError, OSError):
            return
