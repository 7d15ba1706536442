"""`servogym classroom`."""

import argparse
from pathlib import Path

from rich.console import Console

from . import arguments
from .arguments import Number, option


def add(command: argparse.ArgumentParser) -> None:
    """Add the options of this command."""
    option(command, "--pupils", Number(int, 1, 100), "number of places", 24)
    option(command, "--axis", str, f"machine of each pupil: {arguments.AXES}", "linear")
    arguments.add_drive(command)
    option(command, "--lessons", Path, "folder with exercises of your own")
    option(command, "--results", Path, "write results.csv and each run to this folder; `servogym "
           "course replay` replays runs", metavar="DIR")
    option(command, "--code", str, "code of the class, drawn at random if not given; with the code "
           "and the --results of an earlier class, pupils get their places back", "")
    arguments.add_page(command, pictures=5, most=25)
    command.set_defaults(run=_classroom, inputs=("lessons",))


def _classroom(options: argparse.Namespace, console: Console) -> int:
    """Serve until Ctrl-C or SIGTERM."""
    from ...envs.course.exercise import SHIPPED, load_all
    from ...envs.panel import server
    from ...envs.panel.classroom import Classroom
    from ...envs.panel.session import Session
    from ...envs.plants.catalogue import fresh

    served = arguments.page(options, console)
    title = options.axis.replace("-", " ")

    def make(cycles: int) -> Session:
        session = Session(fresh(options.axis, options.drive), title, cycles)
        arguments.offer_policies(session, options.axis, shipped_only=True)
        return session

    lessons = load_all(options.lessons or SHIPPED)
    room = Classroom(
        make, options.axis, options.drive, [each for each in lessons if each.axis == options.axis],
        options.pupils, options.pictures, options.results, options.code,
    )
    with console.status("compiling the control cycle, once per version (up to 30 s) ..."):
        make(1).exchange()
    if again := room.resume():
        served["tell"](f"{again} pupils have their places back, with fresh machines")
    server.serve_class(room, **served)
    return 0
