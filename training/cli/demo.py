"""`servogym demo`."""

import argparse
from pathlib import Path

from rich.console import Console

from .arguments import Number, add_drive, option


def add(demo: argparse.ArgumentParser) -> None:
    """Add the options of this command."""
    add_drive(demo)
    option(demo, "--out", Path, "folder for scope.png", Path("out"))
    option(demo, "--payload", Number(float, 0.0, 100.0), "payload on the carriage in kg", 5.0)
    demo.set_defaults(run=_demo, folders=("out",))


def _demo(options: argparse.Namespace, console: Console) -> int:
    from ..pictures import demo

    return demo.run(options.drive, options.out, options.payload, console)
