"""Jobs done by a Ray cluster: a temporary one on this machine, or an existing one."""

import os
import socket
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any
from urllib.parse import urlsplit

from .job import Done, Job, do, result, stamp

SECONDS = 10.0  # time limit of a connection to an address
CONNECT = 60.0  # time limit of joining a cluster
RETRIES = 3  # of a job whose worker or node died


def cluster(
    jobs: Sequence[Job], address: str, cores: int | None, warm: Sequence[Job]
) -> Iterator[tuple[int, bytes]]:
    """Yield number and result of each job as soon as it is done.

    Args:
        jobs: the jobs, each on one core and one thread.
        address: ``HOST:PORT``, ``ray://HOST:PORT`` or ``auto``; empty to start a cluster here.
        cores: number of cores of a cluster that is started here; all by default.
        warm: jobs that are done first on each node, so that it compiles once.

    Raises:
        ValueError: nothing answers at the address.
        RuntimeError: a node has another version.
        Exception: the error of a job.
    """
    payloads = [job.sent() for job in jobs]
    with _connected(address, cores) as ray:
        task = ray.remote(num_cpus=1, max_retries=RETRIES)(do)
        pinned = ray.util.scheduling_strategies.NodeAffinitySchedulingStrategy
        nodes = [node for node in ray.nodes() if node["Alive"] and node["Resources"].get("CPU")]
        first = {
            task.options(scheduling_strategy=pinned(node["NodeID"], soft=False)).remote(
                stamp(), 1, job.sent()
            ): (job, f"node {node['NodeManagerHostname']}")
            for node in nodes for job in warm
        }
        for reference, (job, node) in first.items():
            result(_answer(ray, reference, job.name, node), node)
        numbers = {task.remote(stamp(), 1, payload): i for i, payload in enumerate(payloads)}
        while numbers:
            for reference in ray.wait(list(numbers), num_returns=1)[0]:
                i = numbers.pop(reference)
                yield i, result(_answer(ray, reference, jobs[i].name, "a worker"), "a worker")


def _answer(ray: Any, reference: Any, name: str, where: str) -> Done:
    """Return the answer of a job. Raises RuntimeError in one line if Ray failed."""
    try:
        return ray.get(reference)
    except ray.exceptions.RayError as error:
        text = " ".join(str(error).split())
        if "servogym" in text and "No module named" in text:
            raise RuntimeError(f"{where} has no servogym: install {stamp()} there") from None
        raise RuntimeError(f"{name}: {type(error).__name__} on {where}: {text[:300]}") from None


@contextmanager
def _connected(address: str, cores: int | None) -> Iterator[Any]:
    """Connect to Ray; afterwards it is in the same state as before."""
    os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")  # else Ray warns of it
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    try:
        import ray
        import ray.util.scheduling_strategies  # noqa: F401  (used as an attribute of ray.util)
    except ImportError as error:
        raise ImportError(f"{error}: --ray needs pip install 'servogym[ray]'") from None
    if ray.is_initialized():
        yield ray
        return
    quiet: dict[str, Any] = {"log_to_driver": False, "logging_level": "ERROR"}
    quiet |= {"configure_logging": False}
    if address:
        _reach(address)
        _bounded(address, lambda: ray.init(address=address, **quiet))
    else:
        ray.init(address="local", num_cpus=cores, include_dashboard=False, **quiet)
    try:
        yield ray
    finally:
        ray.shutdown()


def _reach(address: str) -> None:
    """Raise ValueError if nothing listens at an address: Ray itself would wait for minutes."""
    if address == "auto":
        return
    try:
        parts = urlsplit(address if "://" in address else f"//{address}")
        host, port = parts.hostname, parts.port
    except ValueError:
        host = port = None
    if not host or not port:
        raise ValueError(
            f"--ray {address!r} is not an address: give HOST:PORT, ray://HOST:PORT, auto"
        )
    try:
        socket.create_connection((host, port), SECONDS).close()
    except OSError as error:
        raise ValueError(
            f"--ray {address}: nobody answers there ({error.strerror or error}): see "
            "`ray status` on that machine"
        ) from None


def _bounded(address: str, connect: Any) -> None:
    """Connect; raise ValueError if that fails or takes longer than `CONNECT`."""
    failed: list[BaseException] = []

    def run() -> None:
        try:
            connect()
        except BaseException as error:
            failed.append(error)

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    thread.join(CONNECT)
    if thread.is_alive():
        raise ValueError(f"--ray {address}: what answers there is no Ray cluster")
    if failed:
        text = " ".join(str(failed[0]).split())
        raise ValueError(f"--ray {address}: {text[:300]}") from None
