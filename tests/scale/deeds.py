"""What the jobs of these tests do; workers import it."""

import os
import signal
import time
from pathlib import Path

import numpy as np


def square(x, delay=0.0):
    time.sleep(delay)
    return {"square": np.array([x * x, np.pi * x]), "name": f"{x}", "none": float("nan")}


def counted(x, folder, fails=()):
    """Leaves a line a call; raises for some."""
    with (Path(folder) / "calls").open("a") as file:
        file.write(f"{x}\n")
    if x in fails:
        raise ValueError(f"x = {x} is out of range")
    return {"x": x}


def interrupted(x, folder):
    if x == 2 and not (Path(folder) / "once").exists():
        (Path(folder) / "once").touch()
        raise KeyboardInterrupt
    return counted(x, folder)


def killed(x, folder, always=False):
    """Dies at once the first time, as by ``kill -9``."""
    once = Path(folder) / f"once{x}"
    if always or (x % 2 and not once.exists()):
        once.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return {"x": x}


def threads():
    from servogym.envs.engine.checks import threads as granted

    return {"threads": granted()}


def loaded():
    """What the process has that this one was forked from."""
    from servogym.envs.exchange.loops import judging
    from servogym.envs.tasks import positioning

    compiled = judging(positioning.LinearAxisEnv.judge).signatures  # or read from the cache
    return {
        "played": bool(compiled),
        "given": os.environ.get("SERVOGYM_TEMPLATE", ""),
        "blas": os.environ.get("OPENBLAS_NUM_THREADS", ""),
    }
