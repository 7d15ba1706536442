"""`servogym bench --workers`: `servogym compare` in one process and by workers, in turn.

One process steps physics on all cores, so it is also measured with one thread. Each run is a new
process, measured from start to end; all runs have to write the same files.
"""

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from statistics import median
from typing import Any

from rich.console import Console

from ...envs import TASKS
from ...envs.environment.registry import short, task
from ..evaluate.comparison import ZERO
from ..policies import LEARNED, SHIPPED
from ..scale.work import Work
from . import Tell, show_table

EPISODES = 50


def rows() -> list[tuple[str, str]]:
    """Return the id and four policies of each task with a learned policy."""
    found = [short(each.ID) for each in TASKS if (SHIPPED / each.ID.rpartition("/")[2]).is_dir()]
    return [(env, ",".join([ZERO, LEARNED, *task(env).POLICIES[:2]])) for env in found]


def _seconds(
    env: str, policies: str, drive: str, out: Path, more: Sequence[str] = (), **variables: str
) -> float:
    words = ["compare", env, "--policies", policies, "--drive", drive]
    words += ["--episodes", str(EPISODES), "--out", str(out), *more]
    begin = time.perf_counter()
    done = subprocess.run(
        [sys.executable, "-m", "servogym.training.cli", *words],
        capture_output=True, text=True, env=os.environ | variables,
    )
    seconds = time.perf_counter() - begin
    if done.returncode:
        raise RuntimeError(f"servogym {' '.join(words)}: {done.stderr.strip()}")
    return seconds


def _files(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def measure(env: str, policies: str, drive: str, workers: int, repeat: int) -> dict[str, Any]:
    """Seconds of `repeat` runs on one thread, on all and by workers, and medians of their ratios.

    Raises RuntimeError if the files differ or a run fails.
    """
    taken = []
    with tempfile.TemporaryDirectory() as scratch:
        serial, alone, shared = (Path(scratch, name) for name in ("serial", "alone", "shared"))
        _seconds(env, policies, drive, alone)  # compiles what is not in the cache yet
        for _ in range(repeat):
            taken.append((
                _seconds(env, policies, drive, serial, SERVOGYM_THREADS="1"),
                _seconds(env, policies, drive, alone),
                _seconds(env, policies, drive, shared, ["--workers", str(workers)]),
            ))
            if not _files(serial) == _files(alone) == _files(shared):
                raise RuntimeError(f"{env}: the files of {workers} workers are not those of none")
    return {
        "env": env,
        "policies": policies,
        "one_thread_s": median(one for one, _, _ in taken),
        "alone_s": median(two for _, two, _ in taken),
        "workers_s": median(three for _, _, three in taken),
        "ratio_to_one_thread": median(one / three for one, _, three in taken),
        "ratio": median(two / three for _, two, three in taken),
        "taken": taken,
    }


def results(options: Any, tell: Tell) -> dict[str, Any]:
    """Measure the requested comparisons, by default those of `rows`."""
    Work(options.workers)  # refuses an invalid number
    found: dict[str, Any] = {"workers": options.workers, "cores": os.cpu_count(), "rows": []}
    if hasattr(os, "getloadavg"):
        found["load_before"] = round(os.getloadavg()[0], 1)
    for env, policies in options.compare or rows():
        tell(f"measuring {env} ...")
        found["rows"].append(
            measure(env, policies, options.drive, options.workers, options.repeat)
        )
    return found


def show(results: dict[str, Any], console: Console) -> None:
    """Print the results as tables."""
    title = (
        f"servogym compare, {EPISODES} episodes; {results['cores']} cores, load "
        f"before {results.get('load_before', 'unknown')}; the files are the same"
    )
    heading = ("", "one thread\n(s)", "alone\n(s)", f"--workers {results['workers']}\n(s)",
               "over\none thread", "over\nalone")
    rows = []
    for row in results["rows"]:
        seconds = (f"{row[name]:.1f}" for name in ("one_thread_s", "alone_s", "workers_s"))
        ratios = (f"{row[name]:.2f}" for name in ("ratio_to_one_thread", "ratio"))
        rows.append((f"{row['env']}: {row['policies']}", *seconds, *ratios))
    show_table(console, title, heading, rows)
