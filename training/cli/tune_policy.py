"""`servogym tune-policy`."""

import argparse
from pathlib import Path

from rich.console import Console


def add(tune: argparse.ArgumentParser) -> None:
    """Its options."""
    tune.add_argument("policy", help="one whose numbers are fitted: basis_feed_forward")
    tune.add_argument("--episodes", type=int, help="that it is fitted on (64)")
    tune.add_argument("--out", type=Path, default=Path("out/tuned.npz"), help="file of its numbers")
    tune.set_defaults(run=_tune, files=("out",))


def _tune(options: argparse.Namespace, console: Console) -> int:
    from ..policies import tuned

    return tuned.run(options.policy, options.episodes, options.out, console)
