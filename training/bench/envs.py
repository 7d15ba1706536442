"""`servogym bench --envs`: what the environments cost, beside the loop and beside their peers.

Blocks alternate, so that a machine that grows slower meanwhile slows all of them. Peers that are
not installed are left out: ``pip install gym-electric-motor`` in an environment of its own.
"""

import ctypes
import gc
import platform
import time
import warnings
from collections.abc import Callable
from contextlib import suppress
from importlib.metadata import version
from typing import Any

import gymnasium as gym
import numpy as np
from rich.console import Console

from ...envs import POINT_TO_POINT, TASKS
from . import Tell, show_table

ID = POINT_TO_POINT.ID
STEPS = 190  # a block: less than an episode, so that resets stay out
MANY, FEW = 256, 8  # environments of our vector, and of Gymnasium's
PEERS = {"Cont-SC-PermExDc-v0": 1e-4, "InvertedPendulum-v5": 0.04}  # id: s a step


def _seconds(step: Callable[[], Any], steps: int) -> float:
    begin = time.perf_counter()
    for _ in range(steps):
        step()
    return (time.perf_counter() - begin) / steps


def overhead(drive: str, repeat: int) -> dict[str, float]:
    """Measure one environment: a step, the compiled loop alone, and the rest (µs, medians)."""
    env = POINT_TO_POINT(drive)
    action = np.zeros(1, np.float32)
    times = []
    for _ in range(repeat):
        env.reset(seed=1)
        whole = _seconds(lambda: env.step(action), STEPS)
        loop = _seconds(lambda: env.machine.step(env.cycles_per_step), STEPS)
        times.append((whole, loop, whole - loop))
    step, loop, rest = np.median(times, axis=0) * 1e6
    return {"step_us": step, "loop_us": loop, "overhead_us": rest}


def vectors(drive: str, repeat: int, threads: int) -> dict[str, float]:
    """Agent steps a second of our vector and of Gymnasium's, and the ratio (medians)."""
    ours = gym.make_vec(ID, MANY, drive=drive, threads=threads)
    theirs = gym.make_vec(ID, FEW, vectorization_mode="sync", drive=drive)
    rates = []
    for _ in range(repeat):
        row = []
        for envs, n in ((ours, MANY), (theirs, FEW)):
            envs.reset(seed=1)
            actions = np.zeros((n, 1), np.float32)
            row.append(n / _seconds(lambda e=envs, a=actions: e.step(a), STEPS))  # type: ignore[misc]
        rates.append((*row, row[0] / row[1]))
    ours.close()
    theirs.close()
    many, few, ratio = np.median(rates, axis=0)
    return {"ours": many, "sync_vector_env": few, "ratio": ratio, "threads": threads}


def memory(drive: str) -> float:
    """KB in use for one more machine of a vector, what the allocator keeps for later left out."""
    arguments = {"drive": drive, "randomise": {"payload": (1.0, 9.0)}}
    gym.make_vec(ID, FEW, **arguments).reset(seed=1)  # type: ignore[arg-type]
    before = _resident()
    envs = gym.make_vec(ID, MANY, **arguments)  # type: ignore[arg-type]
    envs.reset(seed=1)
    used = (_resident() - before) / MANY / 1e3
    envs.close()
    return used


def _resident() -> float:
    """Bytes of the process in memory; NaN where the system does not tell."""
    gc.collect()
    with suppress(OSError, AttributeError):
        ctypes.CDLL(None).malloc_trim(0)
    try:
        with open("/proc/self/statm") as file:
            return int(file.read().split()[1]) * 4096
    except OSError:
        return float("nan")


def peers(repeat: int) -> list[dict[str, Any]]:
    """Steps and simulated time a second of our environments and of those of others."""
    kinds: list[tuple[str, gym.Env, float]] = []
    for task in TASKS:
        env = gym.make(task.ID)
        kinds.append((task.ID, env, env.unwrapped.step_time))  # type: ignore[attr-defined]
    with suppress(ImportError), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import gym_electric_motor  # noqa: F401
    for name, period in PEERS.items():
        with suppress(gym.error.Error, ImportError), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            kinds.append((name, gym.make(name), period))
    rates: list[list[float]] = []
    for _ in range(repeat):
        rates.append([])
        for _, env, _ in kinds:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                env.action_space.seed(1)
                env.reset(seed=1)
                rates[-1].append(1.0 / _seconds(lambda e=env: _step(e), STEPS))  # type: ignore[misc]
    medians = np.median(rates, axis=0)
    return [
        {"id": name, "step_s": period, "steps_per_s": rate, "times_real_time": rate * period}
        for (name, _, period), rate in zip(kinds, medians, strict=True)
    ]


def _step(env: gym.Env) -> None:
    """One random step, and a reset where the episode ends."""
    *_, terminated, truncated, _ = env.step(0.1 * env.action_space.sample())
    if terminated or truncated:
        env.reset()


def results(options: Any, tell: Tell) -> dict[str, Any]:
    """What is measured."""
    drive, repeat = options.drive, options.repeat
    return {
        "drive": drive,
        "python": platform.python_version(),
        "versions": {name: version(name) for name in ("gymnasium", "mujoco", "numba")},
        "memory_kb": memory(drive),
        "one": overhead(drive, repeat),
        "vector": vectors(drive, max(repeat // 3, 3), 2),
        "peers": peers(repeat),
    }


def show(results: dict[str, Any], console: Console) -> None:
    """Print the results as tables."""
    one, vector = results["one"], results["vector"]
    console.print(
        f"{ID}, drive {results['drive']}: a step takes {one['step_us']:.1f} µs, "
        f"{one['loop_us']:.1f} of them drive and physics, {one['overhead_us']:.1f} all else"
    )
    console.print(
        f"{MANY} of them on {vector['threads']} threads: {vector['ours']:,.0f} steps/s, "
        f"{vector['ratio']:.1f} times the {vector['sync_vector_env']:,.0f} of SyncVectorEnv of "
        f"{FEW}; {results['memory_kb']:.0f} kB a machine"
    )
    rows = [
        (
            row["id"], f"{row['step_s'] * 1e3:g}", f"{row['steps_per_s']:,.0f}",
            f"{row['times_real_time']:,.1f}",
        )
        for row in results["peers"]
    ]
    heading = ("environment", "step (ms)", "steps/s", "simulated time / real time")
    show_table(console, "one environment, random actions, resets included", heading, rows)
