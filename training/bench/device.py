"""`servogym bench --gpu`: drives and physics of many machines on a device of warp.

What a step costs is measured twice: physics and drives alone, and the whole step of the vector with
its task, observations and infos. The vector of the loop, on the cores, is measured in the same run.
Kernels are compiled, and the graph is captured, in steps that do not count.
"""

import importlib.metadata
import json
import platform
import time
from typing import Any

import gymnasium as gym
import numpy as np
from rich.console import Console
from rich.table import Table

from ...envs import POINT_TO_POINT

ID = POINT_TO_POINT.ID
MANY = {"cpu": (2, 16), "cuda": (256, 4096, 16_384)}  # machines
STEPS = {"cpu": 5, "cuda": 100}  # of an agent, no more than an episode
WARM = 3
SLOW = 0.02  # of the maximum velocity, so that nobody reaches an end


def _vector(drive: str, n: int, **arguments: Any) -> Any:
    """Environments at the beginning of their episodes."""
    vector: Any = gym.make_vec(ID, n, drive=drive, **arguments)
    vector.reset(seed=1)
    return vector


def _seconds(vector: Any, step: Any, steps: int) -> float:
    for _ in range(WARM):
        step()
    _finish(vector)
    begin = time.perf_counter()
    for _ in range(steps):
        step()
    _finish(vector)
    return (time.perf_counter() - begin) / steps


def _finish(vector: Any) -> None:
    """Wait for what the device still has to do."""
    if hasattr(vector, "synchronize"):
        vector.synchronize()


def _cycles(vector: Any, n: int) -> float:
    """Velocity cycles of all drives in a step of the agent."""
    env = vector.envs[0]
    ticks = env.cycles_per_step * env.machine.physics_steps
    return n * float((ticks / env.machine.couplings["velocity_steps"]).sum())


def measure(drive: str, device: str) -> list[dict[str, float]]:
    """Steps and cycles a second, by the number of machines."""
    kind = "cpu" if device == "cpu" else "cuda"
    rows = []
    for n in MANY[kind]:
        vector, peer = _vector(drive, n, device=device), _vector(drive, n)
        there, here = vector.zeros() + SLOW, np.full((n, 1), SLOW)
        whole = _seconds(vector, lambda v=vector, a=there: v.step(a), STEPS[kind])
        alone = _seconds(vector, vector.step_physics, STEPS[kind])
        cores = _seconds(peer, lambda v=peer, a=here: v.step(a), STEPS[kind])
        cycles = _cycles(vector, n)
        rows.append({
            "machines": n, "cycles_per_s": cycles / alone, "steps_per_s": n / whole,
            "cycles_per_s_whole": cycles / whole, "cycles_per_s_on_the_cores": cycles / cores,
        })  # fmt: skip
        vector.close()
        peer.close()
    return rows


def run(drive: str, device: str, as_json: bool, console: Console) -> int:
    """Measure and print; -> exit status."""
    with console.status("measuring ..."):
        rows = measure(drive, device)
    packages = ("mujoco-warp", "warp-lang", "numba", "torch")
    results = {
        "drive": drive, "device": device, "python": platform.python_version(),
        "versions": {name: importlib.metadata.version(name) for name in packages}, "rows": rows,
    }  # fmt: skip
    if as_json:
        console.file.write(json.dumps(results, indent=1) + "\n")
        return 0
    table = Table(title=f"{ID}, drive {drive}, on the device {device}")
    for column in (
        "machines", "drive cycles/s\nwith physics", "drive cycles/s\nwhole step", "steps/s",
        "drive cycles/s\nof the loop",
    ):  # fmt: skip
        table.add_column(column, justify="right")
    for row in rows:
        keys = (
            "machines", "cycles_per_s", "cycles_per_s_whole", "steps_per_s",
            "cycles_per_s_on_the_cores",
        )  # fmt: skip
        table.add_row(*(f"{row[key]:,.0f}" for key in keys))
    console.print(table)
    return 0
