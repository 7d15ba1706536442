"""Policies that were trained, as a training run saves them: one folder each.

`weights.npz` is the policy, `checkpoint.json` says what the run is and how far it has come. Earlier
versions wrote `model.zip` of stable-baselines3 and `vecnormalize.pkl`, which are pickles.
"""

import json
from contextlib import suppress
from pathlib import Path
from types import ModuleType
from typing import Any

BEST = "best"  # of a run, the policy of the best evaluation
ABOUT, MODEL, STATISTICS = "checkpoint.json", "model.zip", "vecnormalize.pkl"


def stable_baselines3() -> ModuleType:
    """The library. Raises ImportError, with the command that installs it, where it is missing."""
    try:
        import stable_baselines3
    except ModuleNotFoundError as error:
        raise ImportError(
            f"training needs stable-baselines3 ({error}): pip install 'servogym[train]'"
        ) from None
    with suppress(ImportError):  # optimizers do it, whose LLVM makes it crash after Mesa's
        import triton  # noqa: F401
    return stable_baselines3


def folder(of: Path) -> Path:
    """Of a checkpoint, or of a run its best one. Raises ValueError where there is neither."""
    if (of / ABOUT).is_file():
        return of
    if not (of / BEST).is_dir():
        raise ValueError(
            f"{of} is no checkpoint and has no {BEST}/, that of a run's best evaluation: go on "
            "with --resume, or give one of its checkpoints/"
        )
    return of / BEST


def read(folder: Path) -> dict[str, Any]:
    """What `checkpoint.json` says. Raises ValueError where it is not what a run wrote."""
    try:
        about = json.loads((folder / ABOUT).read_text(encoding="utf-8"))
        return about | {
            "steps": int(about["steps"]),
            "cpu_seconds": float(about.get("cpu_seconds", 0.0)),  # of all threads; 0: not known
            "versions": dict(about["versions"]),
        }
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        raise ValueError(
            f"{folder / ABOUT} is no checkpoint of a training run ({error!r}): "
            "remove its folder, and the one before is taken"
        ) from None
