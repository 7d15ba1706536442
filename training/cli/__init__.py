"""The command line ``servogym``: a module a command, each with its row of the table."""

import argparse
import importlib
import os
import re
import signal
import sys
import threading
from importlib.metadata import version
from pathlib import Path
from typing import NoReturn

from rich.console import Console

COMMANDS = {  # by the modules that add them, which are loaded when they are asked for
    "demo": ("demo",), "bench": ("bench",), "drives": ("drives",), "node": ("node",),
    "ethercat": ("ethercat",), "eds": ("eds",), "esi": ("esi",), "decode": ("decode",),
    "bode": ("bode",), "tune": ("tune",), "scope": ("scope",), "homing": ("homing",),
    "watch": ("watch",), "panel": ("panel",), "train": ("train", "curves"),
    "compare": ("eval", "compare"), "results": ("results",), "benchmark": ("benchmark",),
    "sweep": ("sweep",),
}  # fmt: skip
# threads of NumPy's linear algebra: our matrices are small, so they would only wait for one another
BLAS = "OPENBLAS_NUM_THREADS"


class Parser(argparse.ArgumentParser):
    """One that says what might have been meant."""

    commands: dict[str, "Parser"]

    def error(self, message: str) -> NoReturn:
        """Usage, what is wrong, and near names; exit status 2."""
        from ...drive.model.near import near

        if wrong := re.search(r"invalid choice: '(.*?)' \(choose from (.*)\)", message):
            known = re.findall(r"[^\s,']+", wrong[2])
            hint = near(wrong[1], known)
            message = f"{message.partition('invalid choice')[0]}there is no {wrong[1]!r}: {hint}"
        super().error(message)

    def refuse(self, unknown: list[str]) -> NoReturn:
        """Options and words that no command has."""
        from ...drive.model.near import near

        known = [*self._option_string_actions]
        options = [word.partition("=")[0] for word in unknown if word.startswith("-")]
        hints = [near(option, known) for option in options if option.startswith("--")]
        hints = [f"; {hint}" for hint in hints if hint.startswith("did")]
        self.error(f"unrecognized: {' '.join(unknown)}{hints[0] if hints else ''}")


def parser(asked: str = "") -> Parser:
    """All commands with their options; those of one module where `asked` is a command."""
    parser = Parser(
        prog="servogym",
        description="A laboratory for motion control: axes in MuJoCo, moved by an emulated drive.",
    )
    parser.add_argument("--version", action="version", version=f"servogym {version('servogym')}")
    commands = parser.add_subparsers(dest="command", required=True, metavar="command")
    one = [module for module, names in COMMANDS.items() if asked in names]
    for module in one or COMMANDS:
        importlib.import_module(f".{module}", __name__).add(commands)
    parser.commands = commands.choices
    return parser


def _joined(words: list[str]) -> list[str]:
    """``hold, ruckig`` is one word, as if there were no space after the comma."""
    joined: list[str] = []
    for word in words:
        if joined and joined[-1].endswith(",") and len(joined[-1]) > 1 and word[:1] not in "-":
            joined[-1] += word
        else:
            joined.append(word)
    return joined


def _parsed(words: list[str]) -> argparse.Namespace:
    own = parser(next((word for word in words if not word.startswith("-")), ""))
    options, unknown = own.parse_known_args(words)
    if unknown:
        own.commands[options.command].refuse(unknown)
    return options


def _told(error: Exception) -> str:
    """An error of the user, their task or policy in a line; empty for one of ours."""
    from ...drive.objects.abort import SdoAbort
    from ...envs.checks import place_of, told

    if not isinstance(error, (ValueError, OSError, RuntimeError, ImportError, SdoAbort)):
        return told(error) if place_of(error) else ""
    if isinstance(error, OSError) and error.strerror:  # what the system says, without its number
        return f"{error.filename}: {error.strerror}" if error.filename else error.strerror
    return " ".join(str(error).split())


def main(arguments: list[str] | None = None) -> int:
    """Run a command; what a user got wrong is one line on stderr and exit status 2.

    SIGTERM ends a command as Ctrl-C does.
    """
    os.environ.setdefault(BLAS, "1")
    if os.getcwd() not in sys.path:
        sys.path.append(os.getcwd())  # modules with tasks of your own, as `python -m` finds them
    options = _parsed(_joined(sys.argv[1:] if arguments is None else arguments))
    console = Console()
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        for kind in ("files", "folders"):
            for name in getattr(options, kind, ()):
                if (path := getattr(options, name)) is not None:
                    from ..report import writable

                    writable(f"--{name.replace('_', '-')}", Path(path), file=kind == "files")
        return options.run(options, console)
    except Exception as error:
        line = _told(error)
        if not line:
            raise
        print(f"servogym {options.command}: {line}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return 130
