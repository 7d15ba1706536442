"""`servogym panel`."""

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console

from . import arguments
from .arguments import POSITIVE, option
from .bus import CHANNEL, INTERFACE, opened, refuse, where

if TYPE_CHECKING:
    from ...envs.engine.machine import Machine
    from ...envs.panel.bench import Bench

RATE = 20.0  # as `envs.panel.bus`


def add(panel: argparse.ArgumentParser) -> None:
    """Add the options of this command."""
    from can.cli import add_bus_arguments

    option(panel, "--axis", str, f"machine: {arguments.AXES} (linear)")
    arguments.add_drive(panel)
    option(panel, "--mjcf", Path, "use a robot of your own instead of --axis")
    panel.add_argument("--joint", action="append", metavar="NAME",
                       help="joint of --mjcf that gets a drive; repeatable")
    option(panel, "--parameter-file", Path, "file into which 1010h stores, for one axis only")
    option(panel, "--twin", Path, "a twin of `servogym twin` beside the axis or node: it gets the "
           "same commands, the scope shows both", metavar="DIR")
    add_bus_arguments(panel, group_title="a running node on a bus (options of python-can)")
    option(panel, "--bus-config", str, "section of python-can's configuration file")
    panel.add_argument(
        "--node-id", type=arguments.NODE_ID, action="append",
        help="show, and on request command, this node (1..127) of a bus instead of a simulated "
        f"machine; repeatable; the default bus is -i {INTERFACE} -c {CHANNEL}",
    )
    option(panel, "--listen", bool, "send nothing on the bus and show only PDOs")
    option(panel, "--samples", POSITIVE, f"samples per second of the scope on a bus ({RATE:g})")
    option(panel, "--units", str, "on a bus: size of a position unit in m and of a velocity unit "
           "in m/s (the same)", metavar="M[,M/S]")
    option(panel, "--lessons", Path, "folder with .toml files of your own exercises")
    arguments.add_page(panel, pictures=25, most=60)
    panel.set_defaults(run=_panel, inputs=("twin", "lessons"))


def _machine(options: argparse.Namespace) -> "Machine":
    """Make the machine: one of the catalogue, or a robot."""
    from ...envs.plants.catalogue import AXES, fresh, of_mjcf

    if options.mjcf is None:
        if options.joint:
            raise ValueError("--joint names joints of --mjcf, which is not given")
        options.axis = options.axis or "linear"
        machine, places = fresh(options.axis, options.drive, "--axis"), AXES[options.axis][1]
    else:
        if options.axis:
            raise ValueError(f"--axis {options.axis} and --mjcf are two machines: give one of them")
        if not options.joint:
            raise ValueError("--mjcf needs --joint NAME for each joint that gets a drive")
        machine, places = of_mjcf(options.mjcf, options.joint, options.drive), {}
    if options.parameter_file is not None:
        if len(machine.drives) > 1:
            raise ValueError("--parameter-file is for one axis, this machine has several")
        next(iter(machine.drives.values())).use_parameter_file(options.parameter_file)
    machine.reset(positions=places)
    return machine


def _put_twin(bench: "Bench", options: argparse.Namespace) -> None:
    """Put a twin beside an axis of the bench, if one is given."""
    from ...envs.plants import twins
    from ...envs.plants.catalogue import of_twin, power_on

    if options.twin is None:
        return
    found = twins.read(options.twin)
    axis = found.axis if found.axis in bench.axes else bench.axes[0]
    if axis != found.axis and len(bench.axes) > 1:
        raise ValueError(
            f"--twin {options.twin} is of axis {found.axis!r}, but the axes here are "
            f"{', '.join(bench.axes)}"
        )
    machine = of_twin(options.twin)
    power_on(machine, {})
    bench.put_beside(machine, axis, found.axis)


def _bus(options: argparse.Namespace, tell: Callable[[str], None]):
    """Return nodes on a bus, and the adapter to it."""
    from ...drive.master import Units
    from ...drive.wire.adapter import Adapter
    from ...drive.wire.bus import CanPort
    from ...envs.panel.bus import BusBench

    arguments.refuse(options, "is for a machine, not for --node-id", "axis", "mjcf", "joint",
                     "parameter_file", "lessons")
    if len({*options.node_id}) < len(options.node_id):
        raise ValueError(f"--node-id {options.node_id}: a node-id is given twice")
    units = None
    if options.units:
        try:
            position, *velocity = (float(part) for part in options.units.split(","))
            (velocity_unit,) = velocity or [position]
        except ValueError:
            raise ValueError(f"--units {options.units!r}: give M or M,M/S such as 1e-6") from None
        if not (0 < position < 1 and 0 < velocity_unit < 1):
            raise ValueError(f"--units {options.units}: a unit is more than 0 and less than 1 m")
        units = Units(position, velocity_unit, "m")
    adapter = Adapter(opened(options), lambda: opened(options), tell)
    nodes = {f"node {number}": number for number in options.node_id}
    rate = RATE if options.samples is None else options.samples
    try:
        return BusBench(
            CanPort(adapter), nodes, options.drive, rate=rate, units=units,
            listen=options.listen, title=f"{', '.join(nodes)} on {where(options)}",
        ), adapter
    except ValueError:
        adapter.shutdown()
        raise


def _panel(options: argparse.Namespace, console: Console) -> int:
    """Serve until Ctrl-C or SIGTERM."""
    from ...envs.course.exercise import SHIPPED, load_all
    from ...envs.panel import server
    from ...envs.panel.session import Session
    from ...envs.tasks import fitting
    from ..policies.takeover import Laboratory

    served = arguments.page(options, console) | {"pictures": options.pictures}
    if options.node_id:
        bench, adapter = _bus(options, served["tell"])
        try:
            _put_twin(bench, options)
            server.serve(bench, **served)
        finally:
            adapter.shutdown()
        return 0
    refuse(options, "is for nodes on a bus: give --node-id", "listen", "units", "samples")
    with console.status("compiling the control cycle, once per version (up to 30 s) ..."):
        machine = _machine(options)
        machine.step()
    title = options.mjcf.stem if options.mjcf else options.axis.replace("-", " ")
    title += " axis" * (title in ("linear", "vertical"))
    session = Session(machine, title)
    _put_twin(session, options)
    session.lessons = tuple(load_all(options.lessons or SHIPPED))
    if options.mjcf is not None:
        mjcf = options.mjcf
        session.laboratory = Laboratory(lambda axis: fitting.robot(mjcf, machine, axis))
    else:
        arguments.offer_policies(session, options.axis)
    server.serve(session, **served)
    return 0
