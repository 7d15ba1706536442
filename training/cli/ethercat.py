"""`servogym ethercat`."""

import argparse
import signal
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console
from rich.live import Live
from rich.table import Table

from . import arguments

if TYPE_CHECKING:
    from ...drive.wire.ethercat import EtherCatServer, Port


MOST_SLAVES = 0xFFFF  # their positions have 16 bits (ETG.1000.4)


def add(command: argparse.ArgumentParser) -> None:
    """Add the options of this command."""
    command.add_argument(
        "-i", "--interface", action="append", default=[],
        help="network interface, such as veth1; a second one is the master's second port "
        "(redundancy)",
    )
    command.add_argument(
        "--udp", nargs="?", const="127.0.0.1", metavar="ADDRESS",
        help="listen on UDP port 88A4h instead (127.0.0.1)",
    )
    command.add_argument(
        "--drive", action="append",
        help="drive model (kollmorgen_akd); several form a line in this order",
    )
    command.add_argument(
        "--axis",
        default="linear",
        help="linear, vertical, rotary-table, conveyor, gantry, gantry-x1x2 or none: "
        "the drive alone, as with a motor that is held (linear)",
    )
    command.add_argument(
        "--slaves", type=arguments.COUNT, default=1, help="number of slaves of each model (1)"
    )
    command.add_argument("--clock", default="frame", help="clock: frame, dc or real (frame)")
    command.add_argument("--log", type=Path, help="write all frames to this .pcapng file")
    command.add_argument(
        "--fault", action="append", default=[], metavar="LINE",
        help='inject a fault, such as "drop at=cycle:100 count=3" or "retreat at=op:50 slave=1"; '
        'repeatable',
    )
    arguments.add_seed(command, "faults with a rate")
    arguments.add_real_time(command)
    command.set_defaults(run=_ethercat, files=("log",))


def _ethercat(options: argparse.Namespace, console: Console) -> int:
    """Serve until Ctrl-C or SIGTERM."""
    from ...drive.ethercat.bus import Clock
    from ...drive.ethercat.faulty import Fault
    from ...drive.wire.ethernet import RawPort, UdpPort

    if bool(options.interface) == bool(options.udp) or len(options.interface) > 2:
        raise ValueError("name one interface with -i, two for redundancy, or use --udp")
    if options.clock not in tuple(Clock):
        raise ValueError(f"--clock = {options.clock!r}: use one of {', '.join(Clock)}")
    if options.log and options.log.suffix != ".pcapng":
        raise ValueError(f"--log = {options.log}: captures are .pcapng")
    most = MOST_SLAVES // len(options.drive or [1])
    if not 1 <= options.slaves <= most:
        raise ValueError(
            f"--slaves = {options.slaves}: give 1 to {most}, a segment has at most {MOST_SLAVES}"
        )
    for line in options.fault:
        Fault.parse(line)
    with ExitStack() as stack:
        ports: list[Port] = []
        for interface in options.interface:
            ports.append(RawPort(interface))
            stack.callback(ports[-1].close)
        if options.udp:
            ports.append(UdpPort(options.udp))
            stack.callback(ports[-1].close)
        return _serve(options, console, ports)


def _serve(options: argparse.Namespace, console: Console, ports: "list[Port]") -> int:
    """Make the drives and answer at the ports."""
    from ...drive.ethercat.bus import Bus
    from ...drive.ethercat.faulty import FaultyBus
    from ...drive.wire.ethercat import EtherCatServer
    from ...drive.wire.pcapng import Writer
    from ...envs.plants.catalogue import ethercat_line

    models = [m for m in options.drive or ["kollmorgen_akd"] for _ in range(options.slaves)]
    with console.status("compiling the control cycle, once per version (up to 40 s) ..."):
        segment, machines = ethercat_line(models, options.axis, ring=len(ports) == 2)
    names = tuple(port.name for port in ports)
    bus = (
        FaultyBus(segment, machines, options.clock, faults=options.fault, seed=options.seed)
        if options.fault
        else Bus(segment, machines, options.clock)
    )
    server = EtherCatServer(
        bus, ports,
        Writer(options.log, names) if options.log else None,
        lambda line: console.print(line, soft_wrap=True),
    )
    signal.signal(signal.SIGTERM, lambda *_: server.stop())
    signal.signal(signal.SIGINT, lambda *_: server.stop())
    console.print(f"{len(segment)} slaves on {', '.join(names)}, clock {options.clock}")
    arguments.real_time(options, console)
    try:
        if console.is_terminal:
            with Live(_table(server, 0.0), console=console, auto_refresh=False) as live:
                before = [server.now, 0]

                def show() -> None:
                    now, cycles = server.now, server.bus.statistics.cycles
                    rate = (cycles - before[1]) / max(now - before[0], 1) * 1e9
                    before[:] = now, cycles
                    live.update(_table(server, rate), refresh=True)

                server.run(show=show)
        else:
            server.run()
    finally:
        server.close()
    s = server.bus.statistics
    console.print(
        f"{s.frames} frames received, {s.answered} answered, {s.cycles} cycles of process data, "
        f"{s.missed} deadlines missed"
    )
    return 0


def _table(server: "EtherCatServer", rate: float) -> Table:
    """The status line of the slaves."""
    s = server.bus.statistics
    table = Table(
        title=f"{s.cycles} cycles, {rate:.0f}/s, working counter {server.working_counter}, "
        f"{s.missed} missed"
    )
    for column in ("slave", "drive", "AL state", "status", "device control"):
        table.add_column(column)
    for i, station in enumerate(server.bus.segment.stations):
        pdi = server.bus.segment.pdis[i]
        status, code = pdi.get(0x0130, 2), pdi.get(0x0134, 2)
        table.add_row(
            str(i), station.drive.model.name, AL_STATES.get(status & 0x0F, f"{status:02X}h"),
            f"{code:04X}h" if status & 0x10 else "", station.drive.state.name,
        )
    return table


AL_STATES = {1: "INIT", 2: "PRE_OP", 3: "BOOT", 4: "SAFE_OP", 8: "OP"}
