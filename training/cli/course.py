"""`servogym course`."""

import argparse
import json
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path

from rich.console import Console
from rich.table import Table

from .arguments import add_drive, option


def add(command: argparse.ArgumentParser) -> None:
    """Add the options of `course`."""
    command.add_argument(
        "action", choices=("list", "show", "check", "replay"), nargs="?", default="list"
    )
    command.add_argument(
        "what", nargs="*", help="exercise to show, solutions to check, runs to replay"
    )
    add_drive(command)
    option(command, "--lessons", Path, "folder with the exercises that a run used")
    option(command, "--json", bool, "print a line of JSON for each solution")
    command.set_defaults(run=_course, inputs=("lessons",))


def _course(options: argparse.Namespace, console: Console) -> int:
    """List or show exercises, check solutions, or replay runs."""
    from ...envs.course import exercise

    def tell(text: str) -> None:
        console.print(text, markup=False, highlight=False, soft_wrap=True)

    if options.action == "list":
        table = Table("unit", "exercise", "title", "steps")
        for each in exercise.load_all():
            table.add_row(str(each.unit), each.name, each.title, str(len(each.steps)))
        console.print(table)
        return 0
    if not options.what:
        raise ValueError(f"{options.action}: name an exercise or a solution, see `servogym course`")
    if options.action == "show":
        for name in options.what:
            each = exercise.named(name)
            tell(f"{each.title}\n{each.about}")
            for number, step in enumerate(each.steps, 1):
                tell(f"{number}. {step.text}")
                if step.predict is not None:
                    tell(f"   First say: {step.predict.question}")
                    for n, text in enumerate(step.predict.options):
                        tell(f"   {n}: {text}")
        return 0
    if options.action == "replay":
        return _replay(options, tell)
    from ...envs.course.laboratory import check

    passed = True
    for file in options.what:
        report = check(Path(file), options.drive)
        passed &= report.done
        if options.json:
            print(json.dumps({"file": file} | asdict(report)))
        elif report.done:
            right = f", {sum(report.predictions)} of {len(report.predictions)} predictions right"
            tell(f"{file}: {report.exercise} passed after {report.times[-1]:.2f} s"
                 f"{right if report.predictions else ''}")
        else:
            why = report.wrong or "its goal was not reached"
            tell(f"{file}: {report.exercise} failed at step {report.step + 1}: {why}")
    return 0 if passed else 1


def _replay(options: argparse.Namespace, tell: Callable[[str], None]) -> int:
    """Replay runs on fresh machines; exit status 1 if one has another result."""
    from ...envs.course.exercise import SHIPPED, named
    from ...envs.panel import journal

    alike = True
    for file in options.what:
        run = journal.read(file)
        exercise = named(str(run["exercise"]), options.lessons or SHIPPED)
        tell(f"{file}: {run.get('pupil', 'somebody')}, {exercise.title}")
        attempt = journal.play(run, exercise, lambda at, said: tell(f"{at:9.3f} s  {said}"))
        report = attempt.report
        became = "done" if report.done else report.wrong or f"left at step {report.step + 1}"
        same = journal.same(run, attempt)
        tell(became if same else f"the replay says: {became}; the run says: {run['report']}")
        alike &= same
    return 0 if alike else 1
