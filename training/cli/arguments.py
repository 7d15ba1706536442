"""Options that several commands share."""

import argparse
import importlib
import inspect
import json
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.table import Table

if TYPE_CHECKING:
    from ...envs.panel.session import Session
    from ..scale.work import Work
    from ..setup import Setup

POLICY = "name, FILE.py:function, folder of a training, or model.zip of stable-baselines3"
LISTED = "help"  # given instead of NAME=VALUE to list the names
AXES = "linear, vertical, rotary-table, conveyor, gantry or gantry-x1x2"  # `catalogue.AXES`


@dataclass(frozen=True)
class Number:
    """The type of an option with a number: whole or finite, and within its range.

    Args:
        kind: int or float.
        low: least value; the number has to be above it if `above` is set.
        high: greatest value.
        above: whether `low` itself is excluded.
    """

    kind: type[int] | type[float]
    low: float = -1e9
    high: float = 1e9
    above: bool = False

    def __call__(self, text: str) -> Any:
        """Parse a number. Raises argparse.ArgumentTypeError for any other text or number."""
        try:
            number = self.kind(text)
        except ValueError:
            number = math.nan
        if not math.isfinite(number):
            kind = "whole number" if self.kind is int else "finite number"
            raise argparse.ArgumentTypeError(f"{text!r} is not a {kind}")
        if not self.low <= number <= self.high or (self.above and number == self.low):
            low = f"above {self.low:g}, up to " if self.above else f"{self.low:.10g}.."
            raise argparse.ArgumentTypeError(f"{text} is out of range {low}{self.high:.10g}")
        return number

    def __str__(self) -> str:
        """The range for a help text, if both of its ends mean something to a reader."""
        bounded = self.low > -1e9 and self.high < 1e9 and not self.above
        return f", {self.low:g}..{self.high:g}" if bounded else ""


COUNT = Number(int, 1)
FROM_ZERO = Number(int, 0, 2**63 - 1)
NODE_ID = Number(int, 1, 127)
POSITION = Number(int, 0, 65535)  # of a slave in its segment
SIGNED_BYTE = Number(int, -128, 127)  # modes of operation, homing methods
FINITE = Number(float)
POSITIVE = Number(float, 0.0, above=True)
EPISODES = Number(int, 1, 1000)  # as `evaluate.episodes`
WORKERS = Number(int, 1, 10_000)  # as `scale.work`


def option(
    parser: argparse._ActionsContainer, name: str, kind: Any = str, text: str = "",
    default: Any = None, **more: Any,
) -> None:
    """Add an option to a command; its help shows the range of a number and the default.

    Args:
        parser: of the command, or one of its groups.
        name: ``--option``, or the name of a positional argument.
        kind: type of the value; bool for an option without a value.
        text: what the option does.
        default: value if the option is not given.
        more: further arguments of ``add_argument``.
    """
    if kind is bool:
        parser.add_argument(name, action="store_true", help=text)
        return
    numbers = f"{kind}" if isinstance(kind, Number) else ""
    shown = "" if default in (None, "") else f" ({default})"
    parser.add_argument(name, type=kind, default=default, help=f"{text}{numbers}{shown}", **more)


def add_env(parser: argparse.ArgumentParser) -> None:
    """Add the environment of a command."""
    option(parser, "env", str, "environment, such as LinearAxis-v0", metavar="ENV")


def add_drive(parser: argparse.ArgumentParser) -> None:
    """Add ``--drive``."""
    option(parser, "--drive", str, "drive model, see `servogym drives`", "generic")


def add(parser: argparse._ActionsContainer) -> None:
    """Add ``--argument`` and ``--twin`` of an environment."""
    parser.add_argument(
        "--argument", action="append", metavar="NAME=VALUE", type=_argument, nargs="?",
        const=(LISTED, None),
        help="set an argument of the environment, VALUE in JSON or as text; repeatable; without a "
        "value, list all arguments",
    )
    parser.add_argument(
        "--twin", dest="argument", action="append", metavar="FOLDER",
        type=lambda folder: ("twin", folder),
        help="use plant and drive of a twin made by `servogym twin`; the same as --argument "
        "twin=FOLDER",
    )


def add_real_time(parser: argparse.ArgumentParser) -> None:
    """Add ``--real-time``, for processes that others must not delay."""
    option(parser, "--real-time", bool,
           "run with real-time priority if the system permits it (SCHED_FIFO, locked memory)")


def real_time(options: argparse.Namespace, console: Console) -> None:
    """Request real-time priority if wanted, and report what the system refuses."""
    if options.real_time:
        from ...drive.wire import real_time as system

        if missing := system.ask():
            console.print(f"without {' and '.join(missing)}", highlight=False)


def add_seed(parser: argparse.ArgumentParser, of: str) -> None:
    """Add ``--seed``; `of` names what it seeds."""
    option(parser, "--seed", FROM_ZERO, f"seed of {of}", 0)


PORT = 8402  # as `envs.panel.server`


def add_page(parser: argparse.ArgumentParser, pictures: int, most: int) -> None:
    """Add the options of a command that serves a page; pictures per second: default, maximum."""
    option(parser, "--port", Number(int, 1, 65535), "TCP port", PORT)
    option(parser, "--host", str, "listen on this address; 0.0.0.0 for other computers",
           "127.0.0.1")
    option(parser, "--pictures", Number(int, 1, most), "pictures per second", pictures)
    option(parser, "--no-browser", bool, "do not open a browser")


def page(options: argparse.Namespace, console: Console) -> dict[str, Any]:
    """Return the keywords of `panel.server.serve`. Raises ValueError if the port is taken."""
    from ...envs.panel import server

    server.free(options.host, options.port)

    def tell(text: str) -> None:
        console.print(text, markup=False, highlight=False, soft_wrap=True)

    return {
        "host": options.host, "port": options.port, "browser": not options.no_browser, "tell": tell
    }


def offer_policies(session: "Session", axis: str, *, shipped_only: bool = False) -> None:
    """Offer the policies of the task that fits a machine of the catalogue, if there is one."""
    from ...envs.tasks import fitting
    from ..policies.takeover import Laboratory

    if axis in fitting.FITTING:
        session.laboratory = Laboratory(lambda _: fitting.FITTING[axis], shipped_only=shipped_only)
    else:
        session.no_policies = fitting.NONE[axis]


MODELS = ("drive", "model")  # options that name drive models


def add_run_code(parser: argparse.ArgumentParser) -> None:
    """Add ``--run-code`` to a command that takes a drive model, which may contain a program."""
    if any(action.dest in MODELS for action in parser._actions):
        option(parser, "--run-code", bool,
               "run hooks.py and modes.py from the folder of the drive model; read them first")


def consent(options: argparse.Namespace) -> None:
    """Allow the programs of a command's drive models to run, if ``--run-code`` was given."""
    given = [getattr(options, name, None) for name in MODELS]
    if not getattr(options, "run_code", False) or not any(given):
        return
    if getattr(options, "workers", None) or getattr(options, "ray", None) is not None:
        raise ValueError("--run-code holds in one process: leave out --workers and --ray")
    from ...drive import run_code

    for model in given:
        for each in model if isinstance(model, list) else [model] if model else []:
            run_code(each)


def add_work(parser: argparse.ArgumentParser) -> None:
    """Add ``--workers``, ``--ray`` and ``--resume``, which say where the jobs of a command run."""
    parser.add_argument("--workers", type=WORKERS, metavar="N", help="number of parallel processes")
    option(parser, "--ray", str, "use the Ray cluster at HOST:PORT, ray://HOST:PORT or auto; "
           "without an address, start one here", nargs="?", const="", metavar="ADDRESS")
    option(parser, "--resume", bool,
           "continue an interrupted command: run only what is missing in --out")


def work(options: argparse.Namespace) -> "Work":
    """Return the workers that the options ask for."""
    from ..scale.work import Work

    return Work(options.workers, options.ray, options.resume)


def setup(options: argparse.Namespace) -> "Setup":
    """Return task, drive and arguments of a command. Raises ValueError for an unknown task."""
    from ..setup import Setup

    return Setup.of(options.env, options.drive or "generic", dict(options.argument or ()))


def prepare(options: argparse.Namespace) -> None:
    """Load the command while the workers on this machine start."""
    if options.workers and options.ray is None:
        from ..scale.template import prepare

        played = {"env": options.env, "drive": options.drive}
        prepare([("servogym.training.evaluate.parts:once", played)])
    importlib.import_module("servogym.training.evaluate.compare")


def refuse(options: argparse.Namespace, reason: str, *names: str) -> None:
    """Raise ValueError if one of these options, which would have no effect, was given."""
    for name in names:
        if getattr(options, name, None) not in (None, False, []):
            raise ValueError(f"--{name.replace('_', '-')} {reason}")


def several(number: Number) -> Callable[[str], list[Any]]:
    """Return the type of an option with numbers that are separated by commas."""

    def parse(text: str) -> list[Any]:
        if numbers := [number(word) for word in _words(text)]:
            return numbers
        raise argparse.ArgumentTypeError(f"{text!r}: give numbers with commas between")

    return parse


def listed(text: str | None) -> list[str]:
    """``"a, b"`` -> ``["a", "b"]``: words separated by commas, without empty ones.

    Raises ValueError for commas without a word, which is not the same as no list.
    """
    words = _words(text or "")
    if text and not words:
        raise ValueError(f"{text!r} lists nothing: give words with commas between")
    return words


def _words(text: str) -> list[str]:
    return [word.strip() for word in text.split(",") if word.strip()]


def named(text: str) -> tuple[str, Any]:
    """``"payload=3"`` -> ``("payload", 3)``."""
    name, equals, value = text.partition("=")
    name = name.strip().replace("-", "_")
    if not equals and name == LISTED:
        return LISTED, None
    if not (name.isidentifier() and equals):
        raise argparse.ArgumentTypeError(f"{text!r} is not NAME=VALUE")
    return name, read_value(value)


def read_value(text: str) -> Any:
    """A value in JSON or as Python writes it, or the text itself where it is neither."""
    text = {"True": "true", "False": "false", "None": "null"}.get(text.strip(), text)
    try:
        return json.loads(text)
    except ValueError:
        return text.strip()


def _argument(text: str) -> tuple[str, Any]:
    """Parse ``NAME=VALUE`` as an argument of an environment."""
    name, value = named(text)
    if name == "drive":
        raise argparse.ArgumentTypeError(f"the drive model is an option: --drive {value}")
    return name, value


def asked(options: argparse.Namespace) -> bool:
    """Whether the command line asks for a list of the arguments."""
    return any(name == LISTED for name, _ in options.argument or ())


def listing(env: str, console: Console) -> int:
    """Print the arguments of an environment with their defaults; -> exit status."""
    from ...envs.engine.checks import accepted
    from ...envs.environment.registry import task

    kind: Any = task(env)
    table = Table("argument", "default", title=f"arguments of {kind.ID}")
    for name, parameter in accepted(kind).items():
        if name not in ("drive", "render_mode"):  # options of their own
            table.add_row(name, json.dumps(parameter.default, default=str))
    console.print(table)
    page = inspect.getdoc(kind) or ""
    section = page.partition("## Arguments\n")[2].partition("\n## ")[0].strip()
    console.print(section, highlight=False, markup=False)
    return 0
