"""`servogym node`."""

import argparse
import time
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.live import Live
from rich.text import Text

from . import arguments
from . import bus as buses

STYLE = {"OPERATION_ENABLED": "green", "FAULT": "red", "FAULT_REACTION_ACTIVE": "red"}


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


class Line:
    """The status line of a server: states, frames a second, the last SDO request."""

    def __init__(self, server: Any):
        from ...drive.canopen.decode import Decoder

        self._server = server
        self._decoders = {n.node_id: Decoder(n.drive.model, [n.node_id]) for n in server.nodes}
        self._then, self._count = 0.0, 0

    def text(self, now: float) -> Text:
        """The line at the time `now` (s)."""
        from ...drive.canopen.frame import Base

        s = self._server.statistics
        line = Text(no_wrap=True, overflow="ellipsis")
        for node in self._server.nodes:
            drive = node.drive
            style = STYLE.get(drive.state.name, "")
            line.append(f"{node.node_id} {drive.state.name}", style)
            mode = drive.model.mode_name(drive.mode)
            line.append(f" {drive.fault or mode}  " if drive.fault or mode else "  ")
        frames = s.received + s.sent
        rate = (frames - self._count) / max(now - self._then, 1e-9) if self._then else 0.0
        self._then, self._count = now, frames
        line.append(f"{rate:.0f} frames/s")
        if s.missed:
            line.append(f", {s.missed} deadlines missed", "yellow")
        if s.last_sdo is not None:
            node_id = s.last_sdo.id - Base.SDO_REQUEST
            if node_id in self._decoders:
                line.append(f"  {self._decoders[node_id].decode(s.last_sdo)}")
        return line


def _node(options: argparse.Namespace, console: Console) -> int:
    """Serve until Ctrl-C or SIGTERM."""
    import can

    from ...drive.wire.log import LogFile
    from ...drive.wire.server import Server
    from ...envs.plants.catalogue import machines_for

    def tell(text: str) -> None:
        console.print(text, markup=False, highlight=False)

    with console.status("compiling the control cycle, once per version (up to 30 s) ..."):
        machines = machines_for(
            options.drive, options.node_id or [1], options.axis, options.parameter_file
        )
    log = LogFile(options.log, tell) if options.log else None
    bus = buses.opened(options)
    server = Server(bus, machines, log, reopen=lambda: buses.opened(options), tell=tell)
    nodes = ", ".join(str(node.node_id) for node in server.nodes)
    shown = bus.channel_info  # "unknown" of interfaces that do not tell it
    if shown == can.BusABC.channel_info:
        shown = buses.where(options) or f"--interface {buses.INTERFACE} --channel {buses.CHANNEL}"
    tell(f"{options.drive} as node {nodes} on {shown}")
    arguments.real_time(options, console)
    try:
        if console.is_terminal:
            with Live(console=console, auto_refresh=False, transient=True) as live:
                line = Line(server)
                server.run(lambda: live.update(line.text(time.monotonic()), refresh=True))
        else:
            server.run()
    except KeyboardInterrupt:
        pass
    finally:
        server.close()
    s, adapter = server.statistics, server.adapter
    trouble = f", {adapter.failed} bus errors, {adapter.lost} frames lost" if adapter.failed else ""
    tell(
        f"{s.received} frames received, {s.sent} sent, {s.cycles} position cycles, "
        f"{s.missed} deadlines missed{trouble}"
    )
    return 0
