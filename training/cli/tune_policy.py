"""`servogym tune-policy`."""

import argparse
from pathlib import Path

from rich.console import Console

from . import arguments


def add(tune: argparse.ArgumentParser) -> None:
    """Add the options of this command."""
    tune.add_argument(
        "policy", help="policy with tunable numbers, such as basis_feed_forward or identified+zv"
    )
    tune.add_argument("--task", help="task to tune for, if several tasks offer the policy")
    tune.add_argument(
        "--budget", type=arguments.COUNT, help="budget in steps of the environment (300000)"
    )
    tune.add_argument(
        "--episodes", type=arguments.COUNT,
        help="basis_feed_forward: number of episodes for the fit (64)",
    )
    tune.add_argument(
        "--out", type=Path, help="output file for the numbers (out/tuned.npz or .json)"
    )
    tune.set_defaults(run=_tune, files=("out",))


def _tune(options: argparse.Namespace, console: Console) -> int:
    from ..evaluate import tuner

    return tuner.run(
        options.policy, options.task, options.budget, options.episodes, options.out, console
    )
