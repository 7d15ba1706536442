"""`servogym results`."""

import argparse
from pathlib import Path

from rich.console import Console


def add(commands) -> None:
    """Its row in the table of commands."""
    results = commands.add_parser("results", help="write the page of what was learned")
    results.add_argument("folder", nargs="?", type=Path, help="with a folder a task (ours)")
    results.set_defaults(run=_results)


def _results(options: argparse.Namespace, console: Console) -> int:
    from ..evaluate import results
    from ..policies import SHIPPED

    return results.run(options.folder or SHIPPED, console)
