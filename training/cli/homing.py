"""`servogym homing`."""

import argparse
from pathlib import Path

from rich.console import Console

from . import arguments


def add(homing: argparse.ArgumentParser) -> None:
    """Add the options of this command."""
    homing.add_argument("--gallery", type=Path, required=True, help="folder for the pictures")
    homing.add_argument("--drive", default="generic", help="drive model, see `servogym drives`")
    homing.add_argument(
        "--method", type=arguments.SIGNED_BYTE, action="append",
        help="draw only this method; repeatable",
    )
    homing.add_argument("--format", choices=("svg", "png"), default="svg")
    homing.set_defaults(run=_homing, folders=("gallery",))


def _homing(options: argparse.Namespace, console: Console) -> int:
    from ..pictures import homing_gallery

    return homing_gallery.run(
        options.gallery, options.method, options.format, console, options.drive
    )
