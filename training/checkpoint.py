"""Checkpoints of a training run: one folder each, there completely or not at all.

`model.zip` and `replay_buffer.pkl` are SB3's, `vecnormalize.pkl` has the running means; what the
run is and how far it has come is in `checkpoint.json`. A folder is written beside its place and
renamed, so a run that is killed leaves the checkpoint before.
"""

import csv
import json
import os
import shutil
from importlib.metadata import version
from pathlib import Path
from typing import Any

from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import CSVOutputFormat

FOLDER = "checkpoints"
ABOUT = "checkpoint.json"
MODEL, STATISTICS, REPLAY = "model.zip", "vecnormalize.pkl", "replay_buffer.pkl"
VERSIONED = ("servogym", "mujoco", "gymnasium", "stable-baselines3", "torch")
DECIDING = ("servogym", "mujoco")  # of them those that make another environment of the same id
STEPS_COLUMN = "time/total_timesteps"


def versions() -> dict[str, str]:
    """Of the packages a result depends on."""
    return {name: version(name) for name in VERSIONED}


def save(model, about: dict[str, Any], folder: Path, *, replay: bool = True) -> None:
    """Write a checkpoint of an algorithm of SB3 as `folder`, replacing it.

    Args:
        model: the algorithm with its environments.
        about: the run; steps and versions are added.
        folder: of this checkpoint.
        replay: whether a replay buffer is kept, for going on.
    """
    scratch = folder.with_name(f".{folder.name}.{os.getpid()}")
    scratch.mkdir(parents=True)
    model.save(scratch / MODEL)
    if (statistics := model.get_vec_normalize_env()) is not None:
        statistics.save(str(scratch / STATISTICS))
    if replay and hasattr(model, "save_replay_buffer"):
        model.save_replay_buffer(scratch / REPLAY)
    about = about | {"steps": model.num_timesteps, "versions": versions()}
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
            (other / REPLAY).unlink(missing_ok=True)


def numbered(out: Path) -> list[Path]:
    """The checkpoints of a run, the oldest first."""
    return sorted(file.parent for file in (out / FOLDER).glob(f"[0-9]*/{ABOUT}"))


def tidy(out: Path) -> None:
    """Remove what was cut off while it was written."""
    for folder in [*out.glob(".best.*"), *(out / FOLDER).glob(".[0-9]*")]:
        shutil.rmtree(folder)


def read(folder: Path) -> dict[str, Any]:
    """What `checkpoint.json` says. Raises ValueError where it is not what `save` wrote."""
    try:
        about = json.loads((folder / ABOUT).read_text(encoding="utf-8"))
        return about | {"steps": int(about["steps"]), "versions": dict(about["versions"])}
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ValueError(
            f"{folder / ABOUT} is no checkpoint of a training run ({error!r}): "
            "remove its folder, and the one before is taken"
        ) from None


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
