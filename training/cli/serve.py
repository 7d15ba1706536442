"""`servogym serve`."""

import argparse
import signal
import threading
from pathlib import Path

from rich.console import Console


def add(command: argparse.ArgumentParser) -> None:
    """Options of `serve`."""
    command.add_argument("file", type=Path, help="machine file, see the how-to page on serving")
    command.add_argument("--seed", type=int, default=0, help="of faults with a rate (0)")
    command.add_argument("--check", action="store_true", help="read the file and build the "
                         "machines, but open no bus")  # fmt: skip
    command.add_argument(
        "--run-code", action="store_true",
        help="you have read the hooks.py in the folders of its drive models: run them",
    )  # fmt: skip
    command.set_defaults(run=_serve)


def _serve(options: argparse.Namespace, console: Console) -> int:
    """Serve until Ctrl-C or SIGTERM."""
    from ...drive import run_code
    from ...envs.serve.description import read
    from ...envs.serve.laboratory import Laboratory

    def tell(text: str) -> None:
        console.print(text, markup=False, highlight=False)

    description = read(options.file)
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
    with laboratory:
        for bus in laboratory.description.buses:
            for machine in laboratory.description.of(bus):
                drives = ", ".join(
                    f"{name} ({drive.model.name}{f', node {drive.node_id}' * (bus.kind == 'can')})"
                    for name, drive in laboratory.machines[machine.name].drives.items()
                )
                tell(f"{bus.name} on {laboratory.where[bus.name]}, clock {bus.clock}: "
                     f"{machine.name} with {drives}")  # fmt: skip
        while not ended.wait(0.25):
            laboratory.check()
    return 0
