"""`servogym bench --gpu`: drives and physics of many machines on a device of warp.

The time of a step is measured in three ways: physics and drives alone, with and without the graph,
and the whole step of the vector with its task, observations and infos. The smallest number of
machines also steps on the cores, in the same run and under the same actions, to compare speed and
results. Kernels are compiled, and the graph is captured, in steps that do not count.
"""

import importlib.metadata
import platform
import time
from typing import Any

import gymnasium as gym
import numpy as np
from rich.console import Console

from ...envs import POINT_TO_POINT
from . import Tell, show_table

ID = POINT_TO_POINT.ID
MANY = {"cpu": (2, 16), "cuda": (256, 4096, 16_384)}  # machines
STEPS = {"cpu": 5, "cuda": 100}  # agent steps, no more than an episode
WARM = 3
SLOW = 0.02  # of the maximum velocity, so that no axis reaches an end
APART = {"position_um": 1e6, "velocity_um_s": 1e6, "torque_mNm": 1e3}


def _vector(drive: str, n: int, **arguments: Any) -> Any:
    """Make environments and start their episodes."""
    vector: Any = gym.make_vec(ID, n, drive=drive, **arguments)
    vector.reset(seed=1)
    return vector


def _seconds(vector: Any, step: Any, steps: int) -> float:
    """Mean time of a step (s), until the device has finished."""
    for _ in range(WARM):
        step()
    _finish(vector)
    begin = time.perf_counter()
    for _ in range(steps):
        step()
    _finish(vector)
    return (time.perf_counter() - begin) / steps


def _finish(vector: Any) -> None:
    """Wait until the device has finished."""
    if hasattr(vector, "synchronize"):
        vector.synchronize()


def _cycles(vector: Any, n: int) -> float:
    """Velocity cycles of all drives in an agent step."""
    env = vector.envs[0]
    ticks = env.cycles_per_step * env.machine.physics_steps
    return n * float((ticks / env.machine.couplings["velocity_steps"]).sum())


def measure(drive: str, device: str) -> tuple[list[dict[str, float]], dict[str, float]]:
    """Steps and cycles per second by the number of machines, and the same on the cores."""
    kind = "cpu" if device == "cpu" else "cuda"
    rows: list[dict[str, float]] = []
    beside: dict[str, float] = {}
    for n in MANY[kind]:
        vector = _vector(drive, n, device=device)
        there = vector.zeros() + SLOW
        whole = _seconds(vector, lambda v=vector, a=there: v.step(a), STEPS[kind])
        if not rows:
            peer = _vector(drive, n)
            here = np.full((n, 1), SLOW)
            cores = _seconds(peer, lambda v=peer, a=here: v.step(a), STEPS[kind])
            beside = {
                "machines": n, "cycles_per_s": _cycles(peer, n) / cores,
                "after_steps": WARM + STEPS[kind], **_apart(vector, peer),
            }
            peer.close()
        alone = _seconds(vector, vector.step_physics, STEPS[kind])
        graphs, vector.in_graphs = vector.in_graphs, False
        plain = _seconds(vector, vector.step_physics, STEPS[kind]) if graphs else alone
        cycles = _cycles(vector, n)
        rows.append({
            "machines": n, "cycles_per_s": cycles / alone,
            "step_ms": 1e3 * alone, "step_ms_no_graph": 1e3 * plain, "in_graphs": graphs,
            "steps_per_s": n / whole, "cycles_per_s_whole": cycles / whole,
        })
        vector.close()
    return rows, beside


def _apart(vector: Any, peer: Any) -> dict[str, float]:
    """The largest differences of joints between a device and the cores (µm, µm/s, mNm)."""
    away = {}
    for name, unit, there in zip(("qpos", "qvel", "ctrl"), APART, vector.state(), strict=True):
        here = np.array([getattr(env.machine.data, name) for env in peer.envs])
        away[unit] = APART[unit] * float(np.abs(there - here).max())
    return away


def results(options: Any, tell: Tell) -> dict[str, Any]:
    """Measure everything."""
    rows, beside = measure(options.drive, options.gpu)
    packages = ("mujoco-warp", "warp-lang", "numba", "torch")
    return {
        "drive": options.drive, "device": options.gpu, "python": platform.python_version(),
        "versions": {name: importlib.metadata.version(name) for name in packages}, "rows": rows,
        "beside": beside,
    }


def show(results: dict[str, Any], console: Console) -> None:
    """Print the results as tables."""
    table = []
    for row in results["rows"]:
        table.append([f"{row[key]:,.0f}" for key in ("machines", "cycles_per_s")])
        table[-1].append(f"{row['step_ms']:,.2f}" if row["in_graphs"] else "no graph")
        table[-1].append(f"{row['step_ms_no_graph']:,.2f}")
        table[-1] += [f"{row[key]:,.0f}" for key in ("cycles_per_s_whole", "steps_per_s")]
    title = f"{ID}, drive {results['drive']}, on the device {results['device']}"
    heading = (
        "machines", "drive cycles/s\nwith physics", "ms a step\nin graphs", "without",
        "drive cycles/s\nwhole step", "steps/s",
    )
    show_table(console, title, heading, table, texts=())
    beside = results["beside"]
    console.print(
        f"on the cores, {beside['machines']} machines: {beside['cycles_per_s']:,.0f} drive "
        f"cycles/s; after {beside['after_steps']} steps under the same actions the device is "
        f"{beside['position_um']:.3g} µm, {beside['velocity_um_s']:.3g} µm/s and "
        f"{beside['torque_mNm']:.3g} mNm away from them at most"
    )
