"""`servogym homing`."""

import argparse
from pathlib import Path

from rich.console import Console

from .arguments import SIGNED_BYTE, add_drive, option


def add(homing: argparse.ArgumentParser) -> None:
    """Add the options of this command."""
    option(homing, "--gallery", Path, "folder for the pictures", required=True)
    add_drive(homing)
    homing.add_argument("--method", type=SIGNED_BYTE, action="append",
                        help="draw only this method; repeatable")
    option(homing, "--format", str, "format of the pictures", "svg", choices=("svg", "png"))
    homing.set_defaults(run=_homing, folders=("gallery",))


def _homing(options: argparse.Namespace, console: Console) -> int:
    from ..pictures import homing_gallery

    return homing_gallery.run(
        options.gallery, options.method, options.format, console, options.drive
    )
