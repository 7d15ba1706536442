"""`servogym classroom`."""

import argparse
from pathlib import Path

from rich.console import Console

PORT = 8402  # as `envs.panel.server`


def add(command: argparse.ArgumentParser) -> None:
    """Add the options of this command."""
    command.add_argument("--pupils", type=int, default=24, help="number of places, 1..100 (24)")
    command.add_argument(
        "--axis", default="linear",
        help="linear, vertical, rotary-table, conveyor, gantry, gantry-x1x2 (linear)",
    )
    command.add_argument("--drive", default="generic", help="drive model, see `servogym drives`")
    command.add_argument("--lessons", type=Path, help="folder with exercises of your own")
    command.add_argument(
        "--results", type=Path, metavar="DIR",
        help="write results.csv and each run to this folder; `servogym course replay` replays runs",
    )
    command.add_argument(
        "--code", default="",
        help="code of the class, one is drawn if not given; with the code and the --results of "
        "before, pupils have their places again",
    )
    command.add_argument("--port", type=int, default=PORT, help=f"TCP port ({PORT})")
    command.add_argument(
        "--host", default="127.0.0.1",
        help="listen on this address instead of the loopback; 0.0.0.0 for other computers",
    )
    command.add_argument(
        "--pictures", type=int, default=5, help="pictures per second for each page, 1..25 (5)"
    )
    command.add_argument("--no-browser", action="store_true", help="do not open a browser")
    command.set_defaults(run=_classroom)


def _classroom(options: argparse.Namespace, console: Console) -> int:
    """Serve until Ctrl-C or SIGTERM."""
    from ...envs.course.exercise import load_all
    from ...envs.panel import server
    from ...envs.panel.classroom import Classroom
    from ...envs.panel.session import Session
    from ...envs.plants.catalogue import fresh
    from ...envs.tasks import fitting
    from ..policies.takeover import Laboratory

    for name, most in (("port", 65535), ("pictures", 25)):
        if not 1 <= getattr(options, name) <= most:
            raise ValueError(f"--{name} = {getattr(options, name)} is out of range 1..{most}")
    server.free(options.host, options.port)

    title = options.axis.replace("-", " ")

    def make(cycles: int) -> Session:
        session = Session(fresh(options.axis, options.drive), title, cycles)
        if options.axis in fitting.FITTING:
            session.laboratory = Laboratory(
                lambda axis: fitting.FITTING[options.axis], shipped_only=True
            )
        else:
            session.no_policies = fitting.NONE[options.axis]
        return session

    lessons = load_all(options.lessons) if options.lessons else load_all()
    room = Classroom(
        make, options.axis, options.drive, [each for each in lessons if each.axis == options.axis],
        options.pupils, options.pictures, options.results, options.code,
    )
    with console.status("compiling the control cycle, once per version (up to 30 s) ..."):
        make(1).exchange()
    again = room.resume()

    def tell(text: str) -> None:
        console.print(text, markup=False, highlight=False, soft_wrap=True)

    if again:
        tell(f"{again} of before have their places again, with fresh machines")
    server.serve_class(
        room, host=options.host, port=options.port, browser=not options.no_browser, tell=tell
    )
    return 0
