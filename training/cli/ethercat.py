"""`servogym ethercat`."""

import argparse
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from rich.console import Console

from . import arguments
from .serve import serve

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
    from ...drive.ethercat.faulty import Fault
    from ...envs.serve.description import BusRow, Description, MachineRow

    if bool(options.interface) == bool(options.udp) or len(options.interface) > 2:
        raise ValueError("name one interface with -i, two for redundancy, or use --udp")
    try:
        bus = BusRow(
            "line", "ethercat", options.clock, options.interface, udp=options.udp or "",
            faults=options.fault, log=f"{options.log or ''}",
        )
    except ValueError as error:
        raise ValueError(f"--{error}") from None
    drives = options.drive or ["kollmorgen_akd"]
    most = MOST_SLAVES // len(drives)
    if not 1 <= options.slaves <= most:
        raise ValueError(
            f"--slaves = {options.slaves}: give 1 to {most}, a segment has at most {MOST_SLAVES}"
        )
    for line in options.fault:
        Fault.parse(line)
    models = [drive for drive in drives for _ in range(options.slaves)]
    machines = [MachineRow(f"{n}", "line", options.axis, drive=m) for n, m in enumerate(models)]

    def said(laboratory: Any) -> Iterator[str]:
        where = laboratory.where["line"]
        yield f"{len(laboratory.drives)} slaves on {where}, clock {options.clock}"

    serve(Description((bus,), (*machines,), by_options=True), options, console, said)
    return 0
