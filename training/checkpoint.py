"""Checkpoints of a training run: one folder each, there completely or not at all.

`model.zip` and `replay_buffer.pkl` are SB3's, `vecnormalize.pkl` has the running means; what the
run is and how far it has come is in `checkpoint.json`. A folder is written beside its place and
renamed, so a run that is killed leaves the checkpoint before.
"""

import json
import os
import shutil
from importlib.metadata import version
from pathlib import Path
from typing import Any

FOLDER = "checkpoints"
ABOUT = "checkpoint.json"
MODEL, STATISTICS, REPLAY = "model.zip", "vecnormalize.pkl", "replay_buffer.pkl"
VERSIONED = ("servogym", "mujoco", "gymnasium", "stable-baselines3", "torch")


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
