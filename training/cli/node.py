"""`servogym node`."""

import argparse
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from rich.console import Console

from . import arguments
from . import bus as buses
from .serve import serve


def add(node: argparse.ArgumentParser) -> None:
    """Add the options of this command."""
    node.epilog = (
        f"the default bus is -i {buses.INTERFACE} -c {buses.CHANNEL}, which needs no hardware"
    )
    node.add_argument("--drive", default="generic", help="drive model, see `servogym drives`")
    node.add_argument(
        "--node-id", type=arguments.NODE_ID, action="append", help="node-id, 1..127 (1); repeatable"
    )
    node.add_argument(
        "--axis",
        default="linear",
        help="linear, vertical, rotary-table, conveyor, gantry, gantry-x1x2 (linear)",
    )
    buses.add(node)
    node.add_argument("--log", help="log all frames to this file: .log (candump), .asc, .blf ...")
    node.add_argument(
        "--parameter-file", type=Path,
        help="file into which 1010h and LSS store and from which power-on loads; with several "
        "drives, each has a file "
        "with the node-id in its name",
    )
    arguments.add_real_time(node)
    node.set_defaults(run=_node, files=("log", "parameter_file"))


def _node(options: argparse.Namespace, console: Console) -> int:
    """Serve until Ctrl-C or SIGTERM."""
    import can

    from ...envs.serve.description import Description, nodes

    bus = buses.row(options, log=options.log or "")
    machines = nodes(options.drive, options.node_id or [1], options.axis,
                     f"{options.parameter_file or ''}")

    def said(laboratory: Any) -> Iterator[str]:
        opened = laboratory.servers["bus"].bus
        shown = opened.channel_info  # "unknown" of interfaces that do not tell it
        if shown == can.BusABC.channel_info:
            shown = buses.where(options)
        served = ", ".join(str(drive.node_id) for drive in laboratory.drives.values())
        yield f"{options.drive} as node {served} on {shown}"

    serve(Description((bus,), machines, by_options=True), options, console, said)
    return 0
