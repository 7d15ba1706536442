"""Options that several commands have."""

import argparse
import importlib
import inspect
import json
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.table import Table

if TYPE_CHECKING:
    from ..scale.work import Work
    from ..setup import Setup

POLICY = "name, FILE.py:function, folder of a training, or model.zip of stable-baselines3"
LISTED = "help"  # instead of NAME=VALUE


def add(parser: argparse._ActionsContainer) -> None:
    """``--argument NAME=VALUE`` of an environment."""
    parser.add_argument(
        "--argument", action="append", metavar="NAME=VALUE", type=_argument, nargs="?",
        const=(LISTED, None),
        help="of the environment, VALUE in JSON or text; repeatable; without a value: lists them",
    )
    parser.add_argument(
        "--twin", dest="argument", action="append", metavar="FOLDER",
        type=lambda folder: ("twin", folder),
        help="of `servogym twin`: its plant and drive; the same as --argument twin=FOLDER",
    )


def add_real_time(parser: argparse.ArgumentParser) -> None:
    """``--real-time``, for what others are not to hold up."""
    parser.add_argument(
        "--real-time", action="store_true",
        help="before all other programs, where the system permits it (SCHED_FIFO, locked memory)",
    )


def real_time(options: argparse.Namespace, console: Console) -> None:
    """Ask for it where it is wanted, and say what is missing."""
    if options.real_time:
        from ...drive.wire import real_time as system

        if missing := system.ask():
            console.print(f"without {' and '.join(missing)}", highlight=False)


MODELS = ("drive", "model")  # where the options of a command keep the drive models it is given


def add_run_code(parser: argparse.ArgumentParser) -> None:
    """``--run-code``, for each command that takes a drive model, which may bring a program."""
    if any(action.dest in MODELS for action in parser._actions):
        parser.add_argument(
            "--run-code", action="store_true",
            help="you have read hooks.py and modes.py in the folder of the drive model: run them",
        )


def consent(options: argparse.Namespace) -> None:
    """Let the programs run that the drive models of a command bring, if that was asked for."""
    given = [getattr(options, name, None) for name in MODELS]
    if not getattr(options, "run_code", False) or not any(given):
        return
    if getattr(options, "workers", None) or getattr(options, "ray", None) is not None:
        raise ValueError("--run-code holds in one process: leave out --workers and --ray")
    from ...drive import run_code

    for model in given:
        for each in model if isinstance(model, list) else [model]:
            if each is not None:
                run_code(each)


def add_work(parser: argparse.ArgumentParser) -> None:
    """``--workers``, ``--ray`` and ``--resume``: who does the jobs of a command."""
    parser.add_argument("--workers", type=int, metavar="N", help="processes side by side")
    parser.add_argument(
        "--ray", nargs="?", const="", metavar="ADDRESS",
        help="a Ray cluster: HOST:PORT, ray://HOST:PORT, auto; without: one is started here",
    )
    parser.add_argument("--resume", action="store_true", help="only what is missing in --out")


def work(options: argparse.Namespace) -> "Work":
    """Who does the jobs."""
    from ..scale.work import Work

    return Work(options.workers, options.ray, options.resume)


def setup(options: argparse.Namespace) -> "Setup":
    """Task, drive and arguments of a command. Raises ValueError for an unknown environment."""
    from ..setup import Setup

    return Setup.of(options.env, options.drive or "generic", dict(options.argument or ()))


def prepare(options: argparse.Namespace) -> None:
    """Load the command, and meanwhile have workers on this machine loaded."""
    if options.workers and options.workers > 0 and options.ray is None:
        from ..scale.template import prepare

        played = {"env": options.env, "drive": options.drive}
        prepare([("servogym.training.evaluate.parts:once", played)])
    importlib.import_module("servogym.training.evaluate.compare")


def listed(text: str | None) -> list[str]:
    """``"a, b"`` -> ``["a", "b"]``: words separated by commas, without empty ones."""
    return [word.strip() for word in (text or "").split(",") if word.strip()]


def named(text: str) -> tuple[str, Any]:
    """``"payload=3"`` -> ``("payload", 3)``."""
    name, equals, value = text.partition("=")
    name = name.strip().replace("-", "_")
    if not equals and name == LISTED:
        return LISTED, None
    if not (name.isidentifier() and equals):
        raise argparse.ArgumentTypeError(f"{text!r} is not NAME=VALUE")
    try:
        return name, json.loads(value)
    except ValueError:
        return name, value.strip()


def _argument(text: str) -> tuple[str, Any]:
    """Parse ``NAME=VALUE`` as an argument of an environment."""
    name, value = named(text)
    if name == "drive":
        raise argparse.ArgumentTypeError(f"the drive model is an option: --drive {value}")
    return name, value


def asked(options: argparse.Namespace) -> bool:
    """Whether the arguments are to be listed."""
    return any(name == LISTED for name, _ in options.argument or ())


def listing(env: str, console: Console) -> int:
    """Print the arguments of an environment with their defaults; -> exit status."""
    from ...envs.environment.registry import task

    kind = task(env)
    table = Table("argument", "default", title=f"arguments of {kind.ID}")
    for name, parameter in arguments_of(kind).items():
        if name not in ("drive", "render_mode"):  # options of their own
            table.add_row(name, json.dumps(parameter.default, default=str))
    console.print(table)
    page = inspect.getdoc(kind) or ""
    told = page.partition("## Arguments\n")[2].partition("\n## ")[0].strip()
    console.print(told, highlight=False, markup=False)
    return 0


def arguments_of(kind: type) -> dict[str, inspect.Parameter]:
    """All an environment takes, of its own and of its bases."""
    from ...envs.engine.checks import accepted

    return accepted(kind)
