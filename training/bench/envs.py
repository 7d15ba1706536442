"""`servogym bench --envs`: time of the environments, compared with the loop and with their peers.

Peers that are not installed are left out: ``pip install gym-electric-motor`` in an environment of
its own.
"""

import ctypes
import gc
import platform
import warnings
from contextlib import suppress
from functools import partial
from importlib.metadata import version
from typing import Any

import gymnasium as gym
import numpy as np
from rich.console import Console

from ...envs import POINT_TO_POINT, TASKS
from . import Peer, Tell, alternate, rates, show_table, step_time
from .vectors import FEW, ID, MANY, of_gymnasium

STEPS = 190  # in a block: less than an episode, so that no reset is included
PEERS = {"Cont-SC-PermExDc-v0": 1e-4, "InvertedPendulum-v5": 0.04}  # id: time of a step (s)


def overhead(drive: str, repeat: int) -> dict[str, float]:
    """Measure one environment: a step, the compiled loop alone, and the rest (µs, medians)."""
    env = POINT_TO_POINT(drive)
    action = np.zeros(1, np.float32)

    def times() -> tuple[float, float, float]:
        env.reset(seed=1)
        whole = step_time(lambda: env.step(action), STEPS)
        loop = step_time(lambda: env.machine.step(env.cycles_per_step), STEPS)
        return whole, loop, whole - loop

    step, loop, rest = np.median(alternate([times], repeat), axis=0)[0] * 1e6
    return {"step_us": step, "loop_us": loop, "overhead_us": rest}


def vectors(drive: str, repeat: int, threads: int) -> dict[str, float]:
    """Agent steps per second of our vector and of Gymnasium's, and their ratio (medians)."""
    ours = gym.make_vec(ID, MANY, drive=drive, threads=threads)
    theirs = gym.make_vec(ID, FEW, vectorization_mode="sync", drive=drive)
    peers = [of_gymnasium("ours", ours, MANY), of_gymnasium("sync", theirs, FEW)]
    many, few = rates(peers, STEPS, repeat)
    ours.close()
    theirs.close()
    return {
        "ours": many["per_s"], "sync_vector_env": few["per_s"], "ratio": few["ours_over"],
        "threads": threads,
    }


def memory(drive: str) -> float:
    """Memory of one more machine of a vector (KB), without free memory of the allocator."""
    arguments = {"drive": drive, "randomise": {"payload": (1.0, 9.0)}}
    gym.make_vec(ID, FEW, **arguments).reset(seed=1)  # type: ignore[arg-type]
    before = _resident()
    envs = gym.make_vec(ID, MANY, **arguments)  # type: ignore[arg-type]
    envs.reset(seed=1)
    used = (_resident() - before) / MANY / 1e3
    envs.close()
    return used


def _resident() -> float:
    """Resident memory of the process (bytes); NaN if the system does not report it."""
    gc.collect()
    with suppress(OSError, AttributeError):
        ctypes.CDLL(None).malloc_trim(0)
    try:
        with open("/proc/self/statm") as file:
            return int(file.read().split()[1]) * 4096
    except OSError:
        return float("nan")


def peers(repeat: int) -> list[dict[str, Any]]:
    """Steps and simulated time per second of our environments and of others."""
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
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        rows = rates(
            [Peer(name, "", 1, partial(_step, env), partial(_restart, env))
             for name, env, _ in kinds],
            STEPS, repeat,
        )
    return [
        {
            "id": name, "step_s": period, "steps_per_s": row["per_s"],
            "times_real_time": row["per_s"] * period,
        }
        for (name, _, period), row in zip(kinds, rows, strict=True)
    ]


def _restart(env: gym.Env) -> None:
    env.action_space.seed(1)
    env.reset(seed=1)


def _step(env: gym.Env) -> None:
    """Take one random step, and reset the environment if the episode ends."""
    *_, terminated, truncated, _ = env.step(0.1 * env.action_space.sample())
    if terminated or truncated:
        env.reset()


def results(options: Any, tell: Tell) -> dict[str, Any]:
    """Measure everything."""
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
