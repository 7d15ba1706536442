"""`servogym classroom`."""

import argparse
from pathlib import Path

from rich.console import Console

from . import arguments


def add(command: argparse.ArgumentParser) -> None:
    """Add the options of this command."""
    command.add_argument(
        "--pupils", type=arguments.Number(int, 1, 100), default=24,
        help="number of places, 1..100 (24)",
    )
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
    arguments.add_page(command, pictures=5, most=25)
    command.set_defaults(run=_classroom, inputs=("lessons",))


def _classroom(options: argparse.Namespace, console: Console) -> int:
    """Serve until Ctrl-C or SIGTERM."""
    from ...envs.course.exercise import load_all
    from ...envs.panel import server
    from ...envs.panel.classroom import Classroom
    from ...envs.panel.session import Session
    from ...envs.plants.catalogue import fresh
    from ...envs.tasks import fitting
    from ..policies.takeover import Laboratory

    served = arguments.page(options, console)
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

    if again:
        served["tell"](f"{again} of before have their places again, with fresh machines")
    server.serve_class(room, **served)
    return 0
