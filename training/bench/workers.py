"""`servogym bench --workers`: `servogym compare` alone and by workers, in turns, as a user runs it.

Alone it steps physics on all cores, so it is measured on one thread too. Each run is a process of
its own, from its start to its end; the files of all have to be the same.
"""

import json
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
from rich.table import Table

from ...envs import TASKS
from ...envs.environment.registry import short, task
from ..evaluate.comparison import ZERO
from ..policies import LEARNED, SHIPPED

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

    Raises RuntimeError where the files differ, or a run fails.
    """
    taken = []
    with tempfile.TemporaryDirectory() as scratch:
        serial, alone, shared = (Path(scratch, name) for name in ("serial", "alone", "shared"))
        _seconds(env, policies, drive, alone)  # compiles what is not kept yet
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


def run(
    drive: str, workers: int, compared: Sequence[tuple[str, str]], repeat: int, as_json: bool,
    console: Console,
) -> int:
    """Measure and print; -> exit status. `compared`: environments and policies; else `rows`."""
    results: dict[str, Any] = {"workers": workers, "cores": os.cpu_count(), "rows": []}
    if hasattr(os, "getloadavg"):
        results["load_before"] = round(os.getloadavg()[0], 1)
    with console.status("") as status:
        for env, policies in compared or rows():
            status.update(f"measuring {env} ...")
            results["rows"].append(measure(env, policies, drive, workers, repeat))
    if as_json:
        console.file.write(json.dumps(results, indent=1) + "\n")
        return 0
    table = Table(
        title=f"servogym compare, {EPISODES} episodes; {results['cores']} cores, load "
        f"before {results.get('load_before', 'unknown')}; the files are the same"
    )
    heads = ("one thread\n(s)", "alone\n(s)", f"--workers {workers}\n(s)",
             "over\none thread", "over\nalone")
    for column in ("", *heads):
        table.add_column(column, justify="right" if column else "left")
    for row in results["rows"]:
        seconds = (f"{row[name]:.1f}" for name in ("one_thread_s", "alone_s", "workers_s"))
        ratios = (f"{row[name]:.2f}" for name in ("ratio_to_one_thread", "ratio"))
        table.add_row(f"{row['env']}: {row['policies']}", *seconds, *ratios)
    console.print(table)
    return 0
