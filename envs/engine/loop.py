"""Runs machines in the compiled loop (`job`), and refuses what it cannot run."""

import time
from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np

from ...drive.memory import peek
from . import job as compiled
from .clock import clock
from .guard import guarded
from .job import FAILED, FAULTY, MAPPING, MISFIT, MORE, OPTION, RUNNING
from .job import INTEGRATORS as INTEGRATORS
from .job import SOUND as SOUND
from .job import enter as enter
from .job import settle as settle
from .world import WORLD

BREATH = 0.02  # s, after which a long step returns to Python, which handles Ctrl-C
INTERRUPTED = "the step was interrupted"
RESET = "the machine stands in the middle of a step, reset() it or restore() a snapshot"
REFUSALS: dict[int, tuple[type[Exception], str]] = {
    FAILED: (RuntimeError, f"an earlier step failed: {RESET}"),
    MISFIT: (
        ValueError,
        "`couplings`, `mechanics` or `probes` hold a number of a coordinate, actuator or tendon "
        "that the model does not have, or a period below 1: build the machine anew",
    ),
    MAPPING: (
        RuntimeError,
        "the PDO mapping of a drive has changed, its process image has another size now: "
        "map what the task needs, or make the environment anew",
    ),
    OPTION: (
        ValueError,
        "model.opt has been changed since the machine was made: the cycles of its drives are whole "
        "multiples of the timestep it had, and its integrator takes one step, so it is not RK4. "
        "Set them back, or build the machine anew",
    ),
}


def run(
    worlds: np.ndarray, ticks: int, rpdos: np.ndarray, tpdos: np.ndarray,
    stopped: Callable[[], bool] | None = None,
) -> None:
    """Advance machines by `ticks` physics steps, exchanging the process images of their drives.

    The caller holds the turn of the machines and keeps them alive. The loop returns to Python about
    every 20 ms to handle Ctrl-C; the machines then stand between two physics steps.

    Args:
        worlds: addresses of WORLD records, shape ``(n,)``; rows with 0 are left out.
        ticks: physics steps.
        rpdos: RPDO images, latched after the delay of their machine, shape ``(n, bytes)``; without
            bytes none is latched.
        tpdos: receives the TPDO images at the end, shape ``(n, bytes)``; without bytes none is
            collected.
        stopped: returns whether another thread wants this one to give up.

    Raises:
        mujoco.FatalError: MuJoCo reports an error; that machine has to be reset.
        Exception: an exception of a MuJoCo callback; that machine has to be reset.
        RuntimeError: a machine has failed before, or its PDO mapping no longer matches the images,
            and the others have been advanced; or `stopped` returned True.
        ValueError: an index in the couplings or mechanics is invalid.
    """
    job, further = guarded.job, False
    with clock:
        begin = time.perf_counter()
        while _piece(job, worlds, ticks, rpdos, tpdos, further):
            _settle_pace(int(job["paced"][0]), time.perf_counter() - begin)
            if stopped and stopped():
                raise RuntimeError(INTERRUPTED)
            further, begin = True, time.perf_counter()
    if job["refused"][0]:
        row = int(np.flatnonzero(worlds == job["refused"][0])[0])
        kind, remedy = REFUSALS[int(job["status"][0])]
        raise kind(f"{f'machine {row}: ' if len(worlds) > 1 else ''}{remedy}")


def _settle_pace(place: int, passed: float) -> None:
    """Adapt the pace of the WORLD at an address to the time (s) that a piece took."""
    world: Any = peek(WORLD, place, 1)[0]
    if passed > BREATH:
        world.pace = max(world.pace // 2, 1)
    elif passed < BREATH / 4:
        world.pace *= 2


def _piece(job, worlds: np.ndarray, ticks: int, rpdos, tpdos, further: bool) -> bool:
    """Run a piece of the job; -> whether more is left."""
    guarded.running = True
    try:
        done = compiled.piece(guarded.address, job, worlds, ticks, rpdos, tpdos, further)
    except SystemError as error:  # the form in which Python reports the exception of a callback
        _stop(worlds)
        raise (error.__cause__ or error) from None
    except BaseException:  # without JIT
        _stop(worlds)
        raise
    finally:
        guarded.running = False
    if done == FAULTY:
        message = guarded.batch.error() if guarded.batch else ""
        _stop(worlds)
        raise mujoco.FatalError(f"{message}: {RESET}")
    return done == MORE


def _stop(worlds: np.ndarray) -> None:
    """Mark the machine that MuJoCo left in the middle of a step, and release shared memory."""
    for place in filter(None, worlds.tolist()):
        world: Any = peek(WORLD, place, 1)[0]
        if world.status == RUNNING:
            world.status = FAILED
            compiled.abandon(world.mj_model, world.mj_data)
            if world.resident:
                peek(np.dtype("i8"), world.resident, 1)[0] = 0
