"""`servogym serve`."""

import argparse
import signal
import threading
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console, Group
from rich.live import Live

from . import arguments, status
from . import bus as buses

if TYPE_CHECKING:
    from ...envs.serve.description import Description
    from ...envs.serve.laboratory import Laboratory


def add(command: argparse.ArgumentParser) -> None:
    """Add the options of `serve`."""
    command.epilog = f"the default bus of a task is -i {buses.INTERFACE} -c {buses.CHANNEL}"
    command.add_argument(
        "file", help="machine file (see the how-to page on serving), or the id of a task, such as "
        "LinearAxis-v0, whose machine is served for `servogym deploy`",
    )
    of_task = command.add_argument_group("for a task: settings that a machine file would contain")
    of_task.add_argument("--drive", help="drive model (generic)")
    of_task.add_argument(
        "--ethercat", metavar="IFACE", help="serve on this network interface instead of CAN"
    )
    of_task.add_argument(
        "--node-id", type=arguments.NODE_ID, help="node-id of its first drive on CAN (1)"
    )
    of_task.add_argument(
        "--clock", help="clock: real, sync or sync_end; on EtherCAT frame, dc or real"
    )
    of_task.add_argument("--log", help="log all frames: .pcapng on EtherCAT, .log on CAN")
    arguments.add(of_task)
    buses.add(command)
    arguments.add_seed(command, "faults with a rate")
    command.add_argument("--check", action="store_true", help="read the file and build the "
                         "machines, but open no bus")
    arguments.add_real_time(command)
    command.set_defaults(run=_serve)


def _serve(options: argparse.Namespace, console: Console) -> int:
    """Serve the file, or the task."""
    from ...drive import run_code
    from ...envs.serve.description import read

    if arguments.asked(options):
        return arguments.listing(options.file, console)
    if _is_task(options.file):
        description = _of_task(options)
    else:
        buses.refuse(options, "is for a task: it stands in the file", *ONLY_OF_TASKS)
        description = read(options.file, run_code=options.run_code)
    for model in description.drive_models if options.run_code else ():
        run_code(model)
    serve(description, options, console, _said, check=options.check)
    return 0


def serve(
    description: "Description", options: argparse.Namespace, console: Console,
    said: Callable[["Laboratory"], Iterable[str]], check: bool = False,
) -> None:
    """Serve what is described until Ctrl-C or SIGTERM: `serve`, `node` and `ethercat`.

    Args:
        description: the machines and their buses.
        options: with ``real_time``, and ``seed`` where faults have a rate.
        console: of the command.
        said: what is printed once the buses are open.
        check: build the machines, but open no bus.
    """
    from ...envs.serve.buses import check_access
    from ...envs.serve.laboratory import Laboratory

    def tell(text: str) -> None:
        console.print(text, markup=False, highlight=False, soft_wrap=True)

    if not check:
        if not description.by_options:
            otherwise = 'set udp = "127.0.0.1" instead of interface'
        else:
            otherwise = "use --udp instead" if hasattr(options, "udp") else ""
        check_access(description, otherwise)
    with console.status("compiling the control cycle, once per version (up to 40 s) ..."):
        laboratory = Laboratory(description, getattr(options, "seed", 0), tell)
    if check:
        tell(f"{options.file}: {', '.join(laboratory.drives)}: nothing to object to")
        return
    ended = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: ended.set())
    arguments.real_time(options, console)
    with laboratory:
        for line in said(laboratory):
            tell(line)
        shown = {name: status.of(server) for name, server in laboratory.servers.items()}
        if console.is_terminal:
            with Live(console=console, auto_refresh=False, transient=True) as live:
                laboratory.run(ended, lambda: live.update(
                    Group(*(each.now() for each in shown.values())), refresh=True
                ))
        else:
            laboratory.run(ended)
    for name, each in shown.items():
        tell(f"{name}: {each.end()}" if len(shown) > 1 else each.end())


def _said(laboratory: "Laboratory") -> Iterator[str]:
    """A line for each machine: where it is, and its drives."""
    for bus in laboratory.description.buses:
        for machine in laboratory.description.of(bus):
            drives = ", ".join(
                f"{name} ({drive.model.name}{f', node {drive.node_id}' * (bus.kind == 'can')})"
                for name, drive in laboratory.machines[machine.name].drives.items()
            )
            yield (f"{bus.name} on {laboratory.where[bus.name]}, clock {bus.clock}: "
                   f"{machine.name} with {drives}")


ONLY_OF_TASKS = ("drive", "ethercat", "node_id", "clock", "log", "argument")


def _is_task(name: str) -> bool:
    """Whether the argument is a task, not a file."""
    return not (Path(name).suffix or Path(name).exists())


def _of_task(options: argparse.Namespace) -> "Description":
    """Describe the machine of a task on the bus of the options."""
    from ...envs.serve.description import BusRow, Description, MachineRow

    given: dict[str, Any] = {"clock": options.clock or "", "log": options.log or ""}
    node_id = 0 if options.ethercat else options.node_id or 1
    machine = MachineRow(
        "machine", "bus", task=options.file, drive=options.drive or "generic", node_id=node_id,
        parameters=dict(options.argument or ()),
    )
    if options.ethercat:
        buses.refuse(options, "is for CAN, not for --ethercat", "node_id")
    try:
        bus = (
            BusRow("bus", "ethercat", interface=options.ethercat, **given) if options.ethercat
            else buses.row(options, **given)
        )
        return Description((bus,), (machine,), by_options=True)
    except ValueError as error:
        raise ValueError(f"--{error}") from None
