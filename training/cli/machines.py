"""Options for a machine by name or from a file, which commands share; `servogym machines`."""

import argparse
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from ...envs.engine.machine import Machine
from ...envs.engine.mjcf_reading import read
from ...envs.plants.catalogue import FACTORIES, of_mjcf, of_twin
from . import arguments
from .arguments import FINITE, option

OPTIONS = ("drive", "mechanics", "parameters", "parameter_file", "twin")


def add_machines(machines: argparse.ArgumentParser) -> None:
    """Add the options of `servogym machines`."""
    add(machines)
    machines.set_defaults(run=_machines, machine=None)


def _machines(options: argparse.Namespace, console: Console) -> int:
    from ...envs.plants.sheet import size

    if options.machine is not None or options.twin is not None:
        machine, name = made(options)
        for each in [name] if options.axis else machine.drives:
            print(size(machine, each))
        return 0
    if options.parameter_file or options.axis or options.at is not None:
        raise ValueError("--parameter-file, --axis and --at need a machine: name one first")
    table = Table(box=None, padding=(0, 1, 0, 0))  # 80 columns are few for ten quantities
    refused = []
    for name in FACTORIES:
        options.machine = name
        try:
            machine, _ = made(options)
        except ValueError as error:
            refused.append(f"{name}: {error}")
            continue
        for drive in machine.drives:
            row = size(machine, drive).row
            if not table.columns:
                table.add_column("machine", no_wrap=True)
                for heading in row:  # the rows of a table have m or rad
                    table.add_column(heading.partition(" (m")[0], overflow="fold")
            cells = (value.replace("/", "/ ") for value in row.values())  # where it may be folded
            table.add_row(name if len(machine.drives) == 1 else f"{name} {drive}", *cells)
    if not table.columns:
        raise ValueError(f"there is no such machine; {refused[0]}")
    console.print(table)
    for line in refused:
        print(line)
    return 0


def add(parser: argparse.ArgumentParser, others: str = "") -> None:
    """Add options for machine, drive and position; `others` names alternatives to a machine."""
    option(parser, "machine", str, f"{', '.join(FACTORIES)}, {'' if others else 'or '}an MJCF file"
           f"{others and ', '}{others}", "rigid", nargs="?")
    arguments.add_drive(parser)
    option(parser, "--axis", str, "drive of the machine (the first), or joint of an MJCF")
    option(parser, "--gear", FINITE, "gear ratio for an MJCF: rad of the motor per m or rad")
    option(parser, "--at", FINITE, "position of the axis, m or rad (the middle)")
    parser.add_argument(
        "--set", action="append", metavar="NAME=VALUE", default=[], type=_value,
        help="set a parameter of the machine, such as payload=10; repeatable",
    )
    option(parser, "--twin", Path,
           "use the twin in this folder (of `servogym twin`) instead of a machine")
    option(parser, "--parameter-file", Path,
           "the drive's stored parameters, as `servogym tune` writes them")
    parser.set_defaults(inputs=("twin", "parameter_file"))


def _value(text: str) -> tuple[str, Any]:
    name, equals, value = text.partition("=")
    if not (name.isidentifier() and equals):
        raise argparse.ArgumentTypeError(f"{text!r} is not NAME=VALUE")
    return name, arguments.read_value(value)


def made(options: argparse.Namespace) -> tuple[Machine, str]:
    """Make the machine of the options at rest in its place; -> it, and the chosen drive's name.

    Raises:
        ValueError: an unknown machine, parameter or axis.
    """
    mjcf = options.twin is None and options.machine not in FACTORIES
    if options.gear is not None and not mjcf:
        raise ValueError("--gear applies to an MJCF; the built-in machines have feed_constant")
    machine = _machine(options)
    name = options.axis or next(iter(machine.drives))
    if name not in machine.drives:
        raise ValueError(f"--axis = {name!r}: the machine has {', '.join(machine.drives)}")
    if options.parameter_file is not None:
        machine.drives[name].use_parameter_file(options.parameter_file)
    if options.at is not None:
        machine.reset(positions={name: options.at})
    elif not mjcf:
        machine.reset(positions=_middles(machine))
    return machine, name


def _middles(machine: Machine) -> dict[str, float]:
    places = {}
    for name in machine.drives:
        low, high = machine.range(name)
        if abs(low) < 1e6 and abs(high) < 1e6:
            places[name] = (low + high) / 2
    return places


def _machine(options: argparse.Namespace) -> Machine:
    name, values = options.machine, dict(options.set)
    if options.twin is not None:
        if values or name not in (None, "rigid"):
            raise ValueError("--twin is a machine by itself: omit --set and the machine's name")
        return of_twin(options.twin, None if options.drive == "generic" else options.drive)
    if name in FACTORIES:
        if taken := values.keys() & {*FACTORIES[name].keywords, *OPTIONS}:
            raise ValueError(
                f"--set {min(taken)}: use the machine's name, --drive, --parameter-file or --twin"
            )
        return FACTORIES[name](options.drive, **values)
    if not Path(name).is_file():
        raise ValueError(f"machine {name!r} is unknown: {', '.join(FACTORIES)}, or an MJCF file")
    if values:
        raise ValueError("--set is for the machines of the laboratory; edit the MJCF instead")
    if not options.axis:
        joints = ", ".join(joint.name for joint in read(name).joints if joint.name)
        raise ValueError(
            f"{name}: name the joint that gets the drive with --axis: it has {joints or 'none'}"
        )
    gears = {} if options.gear is None else {options.axis: options.gear}
    return of_mjcf(name, [options.axis], options.drive, gears)
