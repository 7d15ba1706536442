"""Checkpoints of a training run: one folder each, there completely or not at all.

What is in one: the policy (`training.policies.trained.saved`) and what the run goes on with
(`servogym.training.learn.state`). A folder is written beside its place and renamed, so a run that
is killed leaves the checkpoint before.
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
DECIDING = ("servogym", "mujoco")  # of them those that make another environment of the same id
STEPS_COLUMN = "time/total_timesteps"


def versions() -> dict[str, str]:
    """Return the versions of the packages on which a result depends."""
    return {name: version(name) for name in VERSIONED}


def save(model, about: dict[str, Any], folder: Path, *, resumable: bool = True) -> None:
    """Write a checkpoint of an algorithm of SB3 as `folder`, replacing it.

    Args:
        model: the algorithm with its environments.
        about: the run; steps, CPU-seconds and versions are added.
        folder: of this checkpoint.
        resumable: whether a run can go on from it; else it is the policy alone.
    """
    scratch = folder.with_name(f".{folder.name}.{os.getpid()}")
    shutil.rmtree(scratch, ignore_errors=True)  # Ctrl-C came while this one was written
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
    """Write the checkpoint of the present number of steps; only the latest has a replay buffer."""
    folder = out / FOLDER / f"{model.num_timesteps:010d}"
    save(model, about, folder)
    for other in numbered(out):
        if other != folder:
            (other / state.REPLAY).unlink(missing_ok=True)


def numbered(out: Path) -> list[Path]:
    """The checkpoints of a run, the oldest first."""
    return sorted(file.parent for file in (out / FOLDER).glob(f"[0-9]*/{ABOUT}"))


@contextlib.contextmanager
def alone(out: Path) -> Iterator[None]:
    """Have the folder of a run for oneself; the system releases what a dead process held.

    Raises ValueError where another process trains there.
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
            with contextlib.suppress(OSError):  # what holds something stays
                for folder in made:
                    folder.rmdir()


def tidy(out: Path) -> None:
    """Remove what was cut off while it was written."""
    for folder in [*out.glob(".best.*"), *(out / FOLDER).glob(".[0-9]*")]:
        shutil.rmtree(folder)


class Checkpoints(BaseCallback):
    """A checkpoint every `every` steps, where all that was counted has been learned from."""

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
            count = row.get(STEPS_COLUMN) or ""  # a row may have been cut off
            whole = None not in row and None not in row.values()
            if whole and count.isdigit() and int(count) <= steps:
                self.write(row, dict.fromkeys(row, ()))

    def write(self, key_values, key_excluded, step=0) -> None:
        """A row; what was read from the file is text, and stays unquoted."""
        numbers = {
            key: _number(value) if isinstance(value, str) else value
            for key, value in key_values.items()
        }
        super().write(numbers, key_excluded, step)


def _number(text: str) -> float | int | None:
    return None if not text else int(text) if text.lstrip("-").isdigit() else float(text)
