"""`servogym eds`."""

import argparse
from pathlib import Path

from rich.console import Console


def add(eds: argparse.ArgumentParser) -> None:
    """Its options."""
    eds.add_argument("model", help="name or folder of a model")
    eds.add_argument("-o", "--out", type=Path, required=True, help="file .eds or .dcf")
    eds.add_argument("--dcf", action="store_true", help="with the values of one node")
    eds.add_argument("--node-id", type=int, help="1..127, for --dcf")
    eds.set_defaults(run=_eds, files=("out",))


def _eds(options: argparse.Namespace, console: Console) -> int:
    from ...drive.canopen import eds
    from ...drive.model.model import load

    if options.dcf != (options.node_id is not None):
        raise ValueError("--dcf and --node-id belong together: a DCF is that of one node")
    count = eds.write(options.model, options.out, options.node_id)
    console.print(f"{options.out}: {count} objects of {load(options.model).name}")
    return 0
