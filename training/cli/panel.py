"""`servogym panel`."""

import argparse
from pathlib import Path

from rich.console import Console

PORT = 8402  # as `envs.panel.server`


def add(commands) -> None:
    """Its row in the table of commands."""
    panel = commands.add_parser("panel", help="a drive's commissioning tool in the browser")
    panel.add_argument(
        "--axis",
        default="linear",
        help="linear, vertical, rotary-table, conveyor, gantry, gantry-x1x2 (linear)",
    )
    panel.add_argument("--drive", default="generic", help="drive model, see `servogym drives`")
    panel.add_argument("--mjcf", type=Path, help="a robot of your own instead of --axis")
    panel.add_argument(
        "--joint", action="append", metavar="NAME", help="of --mjcf that gets a drive; repeatable"
    )
    panel.add_argument("--parameter-file", type=Path, help="where 1010h stores, one axis only")
    panel.add_argument(
        "--lessons", type=Path, help="folder with exercises of your own, .toml files"
    )
    panel.add_argument("--port", type=int, default=PORT, help=f"TCP port ({PORT})")
    panel.add_argument(
        "--host", default="127.0.0.1",
        help="listen on this address instead of the loopback; needs a token, which is printed",
    )  # fmt: skip
    panel.add_argument("--pictures", type=int, default=25, help="a second, 1..60 (25)")
    panel.add_argument("--no-browser", action="store_true", help="do not open a browser")
    panel.set_defaults(run=_panel)


def _machine(options: argparse.Namespace):
    from ...envs import Machine, commission_joint
    from ...envs.plants.catalogue import AXES

    if options.mjcf is None:
        if options.joint:
            raise ValueError("--joint names joints of --mjcf, which is not given")
        if options.axis not in AXES:
            raise ValueError(f"--axis = {options.axis!r}: use one of {', '.join(AXES)}")
        make, places = AXES[options.axis]
        machine = make(options.drive)
    else:
        if not options.joint:
            raise ValueError("--mjcf needs --joint NAME for each joint that gets a drive")
        machine = Machine.from_mjcf(options.mjcf, dict.fromkeys(options.joint, options.drive))
        for joint in options.joint:
            commission_joint(machine, joint)
        places = {}
    if options.parameter_file is not None:
        if len(machine.drives) > 1:
            raise ValueError("--parameter-file is for one axis, this machine has several")
        next(iter(machine.drives.values())).use_parameter_file(options.parameter_file)
    machine.reset(positions=places)
    return machine


def _panel(options: argparse.Namespace, console: Console) -> int:
    """Serve until Ctrl-C or SIGTERM."""
    from ...envs.panel import server
    from ...envs.panel.lessons import load_all
    from ...envs.panel.session import Session
    from ..policies.takeover import Laboratory

    if not 1 <= options.port <= 65535:
        raise ValueError(f"--port = {options.port} is out of range 1..65535")
    if not 1 <= options.pictures <= 60:
        raise ValueError(f"--pictures = {options.pictures} is out of range 1..60")
    server.free(options.host, options.port)
    with console.status("compiling the control cycle, once per version (up to 30 s) ..."):
        machine = _machine(options)
        machine.step()
    title = options.mjcf.stem if options.mjcf else options.axis.replace("-", " ") + " axis"
    session = Session(machine, title)
    session.lessons = tuple(load_all(options.lessons) if options.lessons else load_all())
    if len(machine.drives) == 1 and machine.joint(session.axes[0])[1] == "m":
        session.laboratory = Laboratory()
    server.serve(
        session, host=options.host, port=options.port,
        browser=not options.no_browser, pictures=options.pictures,
        tell=lambda text: console.print(text, markup=False, highlight=False, soft_wrap=True),
    )  # fmt: skip
    return 0
