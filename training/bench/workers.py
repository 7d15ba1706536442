"""`servogym bench --workers`: `servogym compare` alone and by workers, in turns, as a user runs it.

Each run is a process of its own, from its start to its end; the files of both have to be the same.
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
from ...envs.registry import short, task
from ..evaluate.compare import ZERO
from ..policies import LEARNED, SHIPPED

EPISODES = 50


def rows() -> list[tuple[str, str]]:
    """Of each task that something learned comes for, its id and four policies."""
    found = [short(each.ID) for each in TASKS if (SHIPPED / each.ID.rpartition("/")[2]).is_dir()]
    return [(env, ",".join([ZERO, LEARNED, *task(env).POLICIES[:2]])) for env in found]


def _seconds(env: str, policies: str, drive: str, out: Path, more: list[str]) -> float:
    words = ["compare", env, "--policies", policies, "--drive", drive]
    words += ["--episodes", str(EPISODES), "--out", str(out), *more]
    begin = time.perf_counter()
    done = subprocess.run(
        [sys.executable, "-m", "servogym.training.cli", *words], capture_output=True, text=True
    )
    seconds = time.perf_counter() - begin
    if done.returncode:
        raise RuntimeError(f"servogym {' '.join(words)}: {done.stderr.strip()}")
    return seconds


def _files(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def measure(env: str, policies: str, drive: str, workers: int, repeat: int) -> dict[str, Any]:
    """Seconds of `repeat` pairs of runs, and the median of their ratios.

    Raises RuntimeError where the files differ, or a run fails.
    """
    pairs = []
    with tempfile.TemporaryDirectory() as scratch:
        alone, shared = Path(scratch, "alone"), Path(scratch, "shared")
        _seconds(env, policies, drive, alone, [])  # compiles what is not kept yet
        for _ in range(repeat):
            pairs.append((
                _seconds(env, policies, drive, alone, []),
                _seconds(env, policies, drive, shared, ["--workers", str(workers)]),
            ))  # fmt: skip
            if _files(alone) != _files(shared):
                raise RuntimeError(f"{env}: the files of {workers} workers are not those of none")
    return {
        "env": env,
        "policies": policies,
        "alone_s": median(one for one, _ in pairs),
        "workers_s": median(other for _, other in pairs),
        "ratio": median(one / other for one, other in pairs),
        "pairs": pairs,
    }


def run(
    drive: str, workers: int, compared: Sequence[tuple[str, str]], repeat: int, as_json: bool,
    console: Console,
) -> int:  # fmt: skip
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
    for column in ("", "alone (s)", f"--workers {workers} (s)", "ratio"):
        table.add_column(column, justify="right" if column else "left")
    for row in results["rows"]:
        seconds = (f"{row[name]:.1f}" for name in ("alone_s", "workers_s"))
        table.add_row(f"{row['env']}: {row['policies']}", *seconds, f"{row['ratio']:.2f}")
    console.print(table)
    return 0
