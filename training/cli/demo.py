"""`servogym demo`."""

import argparse
from pathlib import Path

from rich.console import Console

from . import arguments


def add(demo: argparse.ArgumentParser) -> None:
    """Add the options of this command."""
    demo.add_argument("--drive", default="generic", help="drive model, see `servogym drives`")
    demo.add_argument("--out", type=Path, default=Path("out"), help="folder for scope.png")
    demo.add_argument(
        "--payload", type=arguments.Number(float, 0.0, 100.0), default=5.0,
        help="payload on the carriage in kg (5)",
    )
    demo.set_defaults(run=_demo, folders=("out",))


def _demo(options: argparse.Namespace, console: Console) -> int:
    from ..pictures import demo

    return demo.run(options.drive, options.out, options.payload, console)
