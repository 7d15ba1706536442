"""`servogym curves`: learning curves of the trainings of one policy, with their interval."""

from pathlib import Path

import numpy as np
from rich.console import Console

from ...drive.model import foreign
from ..report import GRID, INK
from .metrics import summarise

FILE = "evaluations.npz"


def read(folder: Path) -> tuple[np.ndarray, list[np.ndarray]]:
    """Read steps, shape ``(n,)``, and the returns of each training, shape ``(n, episodes)``.

    If trainings were evaluated at different steps, only the common steps are returned.

    Raises:
        ValueError: there are no trainings, or they have no step in common.
    """
    files = sorted(folder.glob(f"seed_*/{FILE}")) or sorted(folder.glob(FILE))
    runs = []
    for file in files:
        found = foreign.arrays(file)
        try:
            runs.append((found["timesteps"], found["results"]))
        except KeyError as error:
            raise ValueError(f"{file} holds no evaluations: it lacks {error}") from None
    common = set.intersection(*(set(steps.tolist()) for steps, _ in runs)) if runs else set()
    if not common:
        raise ValueError(
            f"{folder}: no {FILE} of `servogym train` in it or in seed_*, or none at the same steps"
        )
    steps = np.array(sorted(common))
    return steps, [returns[np.isin(at, steps)] for at, returns in runs]


def run(folder: Path, out: Path, console: Console) -> int:
    """Draw the curves to a file; -> exit status."""
    from matplotlib.figure import Figure

    steps, runs = read(folder)
    summaries = [summarise(np.array([run[i] for run in runs])) for i in range(len(steps))]
    figure = Figure((7.0, 3.6), layout="constrained")
    axes = figure.subplots()
    for returns in runs:
        axes.plot(steps, returns.mean(axis=1), color=INK, lw=0.8, alpha=0.4)
    low, high = ([getattr(s, name) for s in summaries] for name in ("low", "high"))
    axes.fill_between(steps, low, high, color=INK, alpha=0.18, lw=0, label="95 % interval")
    axes.plot(steps, [s.iqm for s in summaries], color=INK, lw=2, label="interquartile mean")
    axes.plot([], [], color=INK, lw=0.8, alpha=0.4, label=f"mean of each of {len(runs)} trainings")
    axes.set_xlabel("steps of training")
    axes.set_ylabel("return of an episode")
    axes.set_xlim(left=0)
    axes.grid(**GRID)
    axes.legend(loc="lower right")
    axes.set_title(folder.name, fontsize=11)
    out.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(out, dpi=110, metadata={"Software": None})
    console.print(f"{out}: {len(runs)} trainings, {len(steps)} evaluations of each")
    return 0
