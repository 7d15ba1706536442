"""`servogym serve`."""

import argparse
import signal
import threading
from pathlib import Path
from typing import Any

from rich.console import Console

from . import arguments
from . import bus as buses


def add(command: argparse.ArgumentParser) -> None:
    """Add the options of `serve`."""
    command.epilog = f"the default bus of a task is -i {buses.INTERFACE} -c {buses.CHANNEL}"
    command.add_argument(
        "file", help="machine file (see the how-to page on serving), or the id of a task, such as "
        "LinearAxis-v0, whose machine is served for `servogym deploy`",
    )
    of_task = command.add_argument_group("for a task: settings that a machine file would contain")
    of_task.add_argument("--drive", default="", help="drive model (generic)")
    of_task.add_argument("-i", "--interface", help="interface of python-can")
    of_task.add_argument("-c", "--channel", help="channel of that interface")
    of_task.add_argument(
        "--ethercat", default="", metavar="IFACE",
        help="serve on this network interface instead of CAN",
    )
    of_task.add_argument(
        "--node-id", type=arguments.NODE_ID, help="node-id of its first drive on CAN (1)"
    )
    of_task.add_argument(
        "--clock", default="", help="clock: real, sync or sync_end; on EtherCAT frame, dc or real"
    )
    of_task.add_argument(
        "--log", default="", help="log all frames: .pcapng on EtherCAT, .log on CAN"
    )
    arguments.add(of_task)
    arguments.add_seed(command, "faults with a rate")
    command.add_argument("--check", action="store_true", help="read the file and build the "
                         "machines, but open no bus")
    arguments.add_real_time(command)
    command.set_defaults(run=_serve)


def _serve(options: argparse.Namespace, console: Console) -> int:
    """Serve until Ctrl-C or SIGTERM."""
    from ...drive import run_code
    from ...envs.serve.description import read
    from ...envs.serve.laboratory import Laboratory

    def tell(text: str) -> None:
        console.print(text, markup=False, highlight=False)

    if arguments.asked(options):
        return arguments.listing(options.file, console)
    if not _is_task(options.file):
        for name in ONLY_OF_TASKS:
            if getattr(options, name) not in (None, ""):
                raise ValueError(f"--{name.replace('_', '-')}: it stands in the file")
    source = _of_task(options) if _is_task(options.file) else options.file
    description = read(source, run_code=options.run_code)
    for model in description.drive_models if options.run_code else ():
        run_code(model)
    with console.status("building the machines ..."):
        laboratory = Laboratory(description, options.seed)
    if options.check:
        tell(f"{options.file}: {', '.join(laboratory.drives)}: nothing to object to")
        return 0
    ended = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: ended.set())
    arguments.real_time(options, console)
    with laboratory:
        for bus in laboratory.description.buses:
            for machine in laboratory.description.of(bus):
                drives = ", ".join(
                    f"{name} ({drive.model.name}{f', node {drive.node_id}' * (bus.kind == 'can')})"
                    for name, drive in laboratory.machines[machine.name].drives.items()
                )
                tell(f"{bus.name} on {laboratory.where[bus.name]}, clock {bus.clock}: "
                     f"{machine.name} with {drives}")
        while not ended.wait(0.25):
            laboratory.check()
    return 0


ONLY_OF_TASKS = ("drive", "interface", "channel", "ethercat", "node_id", "clock", "log", "argument")


def _is_task(name: str) -> bool:
    """Whether the argument is a task, not a file."""
    return not (Path(name).suffix or Path(name).exists())


def _of_task(options: argparse.Namespace) -> dict[str, Any]:
    """Return the content of a machine file that has only this task."""
    if options.ethercat:
        buses.refuse(options, "is for CAN, not for --ethercat", "node_id")
        bus = {"kind": "ethercat", "interface": options.ethercat}
    else:
        bus = {
            "kind": "can", "interface": options.interface or buses.INTERFACE,
            "channel": options.channel or (buses.CHANNEL if not options.interface else ""),
        }
    machine = {"bus": "bus", "task": options.file, "drive": options.drive or "generic"}
    if not options.ethercat:
        machine["node_id"] = 1 if options.node_id is None else options.node_id
    machine["parameters"] = dict(options.argument or ())
    given = {"clock": options.clock, "log": options.log}
    return {"bus": {"bus": bus | given}, "machine": {"machine": machine}}
