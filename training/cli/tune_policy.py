"""`servogym tune-policy`."""

import argparse
from pathlib import Path

from rich.console import Console


def add(tune: argparse.ArgumentParser) -> None:
    """Its options."""
    tune.add_argument("policy", help="one with numbers: basis_feed_forward, identified+zv …")
    tune.add_argument("--task", help="the task it is tuned for, where several offer it")
    tune.add_argument("--budget", type=int, help="steps of the environment (300000)")
    tune.add_argument("--episodes", type=int, help="basis_feed_forward: that it is fitted on (64)")
    tune.add_argument("--out", type=Path, help="file of its numbers (out/tuned.npz or .json)")
    tune.set_defaults(run=_tune, files=("out",))


def _tune(options: argparse.Namespace, console: Console) -> int:
    from ..evaluate import tuner
    from ..policies import tuned

    if tuner.tunable(options.policy) is None:
        out = options.out or Path("out/tuned.npz")
        return tuned.run(options.policy, options.episodes, out, console, tuner.offered())
    out, budget = options.out or Path("out/tuned.json"), options.budget or tuner.BUDGET
    return tuner.run(options.policy, options.task, budget, out, console)
