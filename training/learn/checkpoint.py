"""Checkpoints of a training run: one folder each, either complete or absent.

A checkpoint holds the policy (`training.policies.trained.saved`) and the state from which the run
continues (`servogym.training.learn.state`). Its folder is written under another name and then
renamed, so a run that is killed leaves the previous checkpoint intact.
"""

import contextlib
import csv
import hashlib
import json
import os
import shutil
import time
from collections.abc import Iterator
from importlib.metadata import version
from pathlib import Path
from typing import Any

from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import CSVOutputFormat

from ..policies.trained import weights
from ..policies.trained.saved import ABOUT
from . import state

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

FOLDER, LOCK = "checkpoints", ".lock"
VERSIONED = ("servogym", "mujoco", "gymnasium", "stable-baselines3", "torch")
DECIDING = ("servogym", "mujoco")  # other versions make another environment of the same id
STEPS_COLUMN = "time/total_timesteps"


def versions() -> dict[str, str]:
    """Return the versions of the packages on which a result depends."""
    return {name: version(name) for name in VERSIONED}


def save(model, about: dict[str, Any], folder: Path, *, resumable: bool = True) -> None:
    """Write a checkpoint of an algorithm of SB3 as `folder`, replacing it.

    Args:
        model: the algorithm with its environments.
        about: description of the run; steps, CPU-seconds and versions are added.
        folder: folder of this checkpoint.
        resumable: whether a run can continue from it; otherwise it holds the policy alone.
    """
    scratch = folder.with_name(f".{folder.name}.{os.getpid()}")
    shutil.rmtree(scratch, ignore_errors=True)  # left by an interrupted save
    scratch.mkdir(parents=True)
    weights.save(model, scratch)
    if resumable:
        state.save(model, scratch)
        if hasattr(model, "replay_buffer"):
            state.save_replay(model, scratch)
    about = about | {
        "steps": model.num_timesteps,
        "cpu_seconds": round(time.process_time() - getattr(model, "cpu_begin", 0.0), 1),
        "versions": versions(),
        "sha256": hashlib.sha256((scratch / weights.WEIGHTS).read_bytes()).hexdigest(),
    }
    (scratch / ABOUT).write_text(json.dumps(about, indent=1) + "\n", encoding="utf-8")
    if folder.exists():
        old = scratch.with_suffix(".old")
        folder.rename(old)
        scratch.rename(folder)
        shutil.rmtree(old)
    else:
        scratch.rename(folder)


def save_numbered(model, about: dict[str, Any], out: Path) -> None:
    """Write a checkpoint named after its steps; only the latest one has a replay buffer."""
    folder = out / FOLDER / f"{model.num_timesteps:010d}"
    save(model, about, folder)
    for other in numbered(out):
        if other != folder:
            (other / state.REPLAY).unlink(missing_ok=True)


def numbered(out: Path) -> list[Path]:
    """Return the checkpoints of a run, the oldest first."""
    return sorted(file.parent for file in (out / FOLDER).glob(f"[0-9]*/{ABOUT}"))


@contextlib.contextmanager
def alone(out: Path) -> Iterator[None]:
    """Lock the folder of a run; the system releases the lock of a dead process.

    Raises ValueError if another process trains there.
    """
    if fcntl is None:
        yield
        return
    made = [folder for folder in (out, *out.parents) if not folder.exists()]
    out.mkdir(parents=True, exist_ok=True)
    with open(out / LOCK, "a") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise ValueError(
                f"{out}: another process is training there; wait for it, or give another --out"
            ) from None
        try:
            yield
        finally:
            (out / LOCK).unlink(missing_ok=True)
            with contextlib.suppress(OSError):  # folders that are not empty stay
                for folder in made:
                    folder.rmdir()


def tidy(out: Path) -> None:
    """Remove checkpoints whose writing was interrupted."""
    for folder in [*out.glob(".best.*"), *(out / FOLDER).glob(".[0-9]*")]:
        shutil.rmtree(folder)


class Checkpoints(BaseCallback):
    """Saves a checkpoint every `every` steps, when all counted steps have been learned from."""

    def __init__(self, about: dict[str, Any], out: Path, every: int):
        super().__init__()
        self.about, self.out, self.every = about, out, every

    def _on_training_start(self) -> None:
        self.last = self.model.num_timesteps

    def _on_rollout_start(self) -> None:
        if self.model.num_timesteps - self.last >= self.every:
            self.last = self.model.num_timesteps
            save_numbered(self.model, self.about, self.out)

    def _on_step(self) -> bool:
        return True


class ContinuedCsv(CSVOutputFormat):
    """SB3's CSV file, with the rows of an earlier session up to `steps`."""

    def __init__(self, file: Path, steps: int):
        rows = []
        if steps and file.is_file():
            with file.open(newline="", encoding="utf-8") as earlier:
                rows = list(csv.DictReader(earlier))
        super().__init__(str(file))
        for row in rows:
            count = row.get(STEPS_COLUMN) or ""  # the last row may be incomplete
            whole = None not in row and None not in row.values()
            if whole and count.isdigit() and int(count) <= steps:
                self.write(row, dict.fromkeys(row, ()))

    def write(self, key_values, key_excluded, step=0) -> None:
        """Write a row; numbers that were read from the file as text stay unquoted."""
        numbers = {
            key: _number(value) if isinstance(value, str) else value
            for key, value in key_values.items()
        }
        super().write(numbers, key_excluded, step)


def _number(text: str) -> float | int | None:
    return None if not text else int(text) if text.lstrip("-").isdigit() else float(text)
