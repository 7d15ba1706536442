"""`servogym tune-policy`."""

import argparse
from pathlib import Path

from rich.console import Console

from .arguments import COUNT, option


def add(tune: argparse.ArgumentParser) -> None:
    """Add the options of this command."""
    option(tune, "policy", str,
           "policy with tunable numbers, such as basis_feed_forward or identified+zv")
    option(tune, "--task", str, "task to tune for, if several tasks offer the policy")
    option(tune, "--budget", COUNT, "budget in steps of the environment (300000)")
    option(tune, "--episodes", COUNT, "basis_feed_forward: number of episodes for the fit (64)")
    option(tune, "--out", Path, "output file for the numbers (out/tuned.npz or .json)")
    tune.set_defaults(run=_tune, files=("out",))


def _tune(options: argparse.Namespace, console: Console) -> int:
    from ..evaluate import tuner

    return tuner.run(
        options.policy, options.task, options.budget, options.episodes, options.out, console
    )
