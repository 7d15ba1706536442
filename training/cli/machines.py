"""Options for a machine by name or from a file, which commands share; `servogym machines`."""

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from ...envs import (
    FAMILY,
    ROTARY_FAMILY,
    Machine,
    commission_joint,
    gantry,
    linear_axis,
    rotary_axis,
)
from ...envs.engine.mjcf_reading import read
from . import arguments
from .arguments import FINITE, option

GANTRIES: dict[str, dict[str, Any]] = {"gantry": {}, "gantry-x1x2": {"x_drives": 2}}
OPTIONS = ("drive", "mechanics", "parameters", "parameter_file", "twin")
NAMES = [*FAMILY, *ROTARY_FAMILY, *GANTRIES]


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
    for name in NAMES:
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
    option(parser, "machine", str, f"{', '.join(NAMES)}, {'' if others else 'or '}an MJCF file"
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
    mjcf = options.twin is None and options.machine not in NAMES
    if options.gear is not None and not mjcf:
        raise ValueError("--gear applies to an MJCF; the built-in machines have feed_constant")
    machine = _machine(options) if options.twin is None else _of_twin(options)
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


def _of_twin(options: argparse.Namespace) -> Machine:
    from ...envs.plants.catalogue import of_twin

    if options.set or options.machine not in (None, "rigid"):
        raise ValueError("--twin is a machine by itself: leave out --set and the machine's name")
    return of_twin(options.twin, None if options.drive == "generic" else options.drive)


def _middles(machine: Machine) -> dict[str, float]:
    places = {}
    for name in machine.drives:
        low, high = machine.range(name)
        if abs(low) < 1e6 and abs(high) < 1e6:
            places[name] = (low + high) / 2
    return places


def _machine(options: argparse.Namespace) -> Machine:
    name, values = options.machine, dict(options.set)
    makers: dict[str, Callable[..., Machine]] = {
        **dict.fromkeys(FAMILY, linear_axis), **dict.fromkeys(ROTARY_FAMILY, rotary_axis),
        **dict.fromkeys(GANTRIES, gantry),
    }
    if name in makers:
        given = GANTRIES.get(name, {"mechanics": name})
        if taken := values.keys() & {*given, *OPTIONS}:
            raise ValueError(
                f"--set {min(taken)}: the machine's name, --drive, --parameter-file, --twin say it"
            )
        return makers[name](options.drive, **given, **values)
    if not Path(name).is_file():
        raise ValueError(f"machine {name!r} is unknown: {', '.join(NAMES)}, or an MJCF file")
    if values:
        raise ValueError("--set is for the machines of the laboratory; edit the MJCF instead")
    if not options.axis:
        joints = ", ".join(joint.name for joint in read(name).joints if joint.name)
        raise ValueError(
            f"{name}: name the joint that gets the drive with --axis: it has {joints or 'none'}"
        )
    gears = {} if options.gear is None else {options.axis: options.gear}
    machine = Machine.from_mjcf(name, {options.axis: options.drive}, gears=gears)
    commission_joint(machine, options.axis)
    return machine
