"""`servogym bench --vectors`: our vector compared with others, and drive cycles with am-sdk.

The vectors of Gymnasium and stable-baselines3 step the same environment; EnvPool steps a MuJoCo
environment of its own; am-sdk emulates the drive of a joint in Python. Peers that are not installed
are left out: ``pip install envpool am-sdk`` in an environment of its own.
"""

import os
import time
import warnings
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from functools import partial
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import gymnasium as gym
import numpy as np
from rich.console import Console

from ...drive.drive import Drive
from ...drive.kernel.words import Mode
from ...envs import POINT_TO_POINT
from . import Peer, Tell, rates, show_table

ID = POINT_TO_POINT.ID
MANY, FEW = 256, 8
STEPS = 100  # a block: less than an episode, so that resets stay out
CYCLES = 1000  # cycles of a drive in a block
CONTROLLED = (Mode.CYCLIC_SYNC_POSITION, Mode.PROFILE_POSITION)  # the first supported one is used
SHAFT = 1e-4  # rad off the demand, so that the controllers act
ENVPOOL = "HalfCheetah-v4"  # 5 steps of physics a step


def of_gymnasium(name: str, vector: Any, n: int) -> Peer:
    """A vector of Gymnasium with `n` environments of `ID`."""
    actions = np.zeros((n, *vector.single_action_space.shape), np.float32)
    return Peer(name, ID, n, partial(vector.step, actions), partial(vector.reset, seed=1))


def _made(drive: str) -> gym.Env:
    return gym.make(ID, drive=drive)


def vectors(drive: str, stack: ExitStack) -> Iterator[Peer]:
    """Yield the vectors that are installed; the stack closes them."""
    for mode, n in (("vector_entry_point", MANY), ("sync", FEW), ("async", FEW)):
        vector = gym.make_vec(ID, n, vectorization_mode=mode, drive=drive)
        stack.callback(vector.close)
        names = {"sync": "Gymnasium SyncVectorEnv", "async": "Gymnasium AsyncVectorEnv"}
        yield of_gymnasium(names.get(mode, "ours"), vector, n)
    with suppress(ImportError):
        from stable_baselines3.common.vec_env import DummyVecEnv, SubprocVecEnv

        for kind in (DummyVecEnv, SubprocVecEnv):
            made: Any = kind([partial(_made, drive) for _ in range(FEW)])
            stack.callback(made.close)
            actions = np.zeros((FEW, *made.action_space.shape), np.float32)
            yield Peer(f"SB3 {kind.__name__}", ID, FEW, partial(made.step, actions), made.reset)
    with suppress(ImportError), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import envpool

        pool = envpool.make_gymnasium(ENVPOOL, num_envs=MANY)
        stack.callback(pool.close)
        actions = np.zeros((MANY, *pool.action_space.shape))
        yield Peer("EnvPool", ENVPOOL, MANY, partial(pool.step, actions), pool.reset)


def drives(drive: str) -> Iterator[Peer]:
    """A position cycle of one drive that controls, called from Python."""
    ours = Drive(drive)
    mode = next((mode for mode in CONTROLLED if mode in ours.model.modes), ours.model.modes[0])
    ours.write("modes_of_operation", int(mode))  # without a mode no controller runs
    for word in (0x06, 0x07, 0x0F):
        ours.write("controlword", word)
        ours.cycle(0.0, 0.0)
    what = f"Drive.cycle of {drive}, {mode.name}"
    yield Peer("ours", what, 1, partial(ours.cycle, SHAFT, 0.0), int)
    with suppress(ImportError):
        import am_sdk

        session = am_sdk.am_init(am_sdk.AmSessionConfig(interface="sim:M"))
        joint = am_sdk.am_open_joint(session, 0)
        am_sdk.am_start(session)
        am_sdk.am_set_mode(joint, am_sdk.AmMode.IMPEDANCE)
        am_sdk.am_enable(joint, timeout_ms=1000)
        yield Peer("am-sdk", "am_cycle of sim:M", 1, partial(am_sdk.am_cycle, session), int)


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return ""


def results(options: Any, tell: Tell) -> dict[str, Any]:
    """Measure everything."""
    drive, repeat = options.drive, max(options.repeat // 20, 3)
    with ExitStack() as stack:
        rows = rates([*vectors(drive, stack)], STEPS, repeat)
    return {
        "drive": drive,
        "cores": os.cpu_count(),
        "versions": {n: _version(n) for n in
                     ("gymnasium", "stable-baselines3", "envpool", "am-sdk", "mujoco")},
        "vectors": rows,
        # a block takes about a millisecond, so other programs would dominate its wall time
        "drives": rates([*drives(drive)], CYCLES, repeat, time.process_time),
    }


def show(results: dict[str, Any], console: Console) -> None:
    """Print the results as tables."""
    for title, rows in (
        ("steps", results["vectors"]),
        ("drive cycles, processor time", results["drives"]),
    ):
        shown = [
            (row["name"], row["what"], str(row["envs"]), f"{row['per_s']:,.0f}",
             f"{row['ours_over']:.2f}")
            for row in rows
        ]
        heading = ("", "of", "environments", "a second", "ours over it")
        show_table(console, f"{title}, {results['cores']} cores", heading, shown, texts=(0, 1))
