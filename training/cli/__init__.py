"""The command line ``servogym``: a module a command, each with its row of the table."""

import argparse
import os
import signal
import sys
import threading
from importlib.metadata import version

from rich.console import Console

from ...drive.objects.abort import SdoAbort
from . import (
    bench,
    benchmark,
    bode,
    compare,
    decode,
    demo,
    drives,
    eds,
    esi,
    ethercat,
    homing,
    node,
    panel,
    results,
    sweep,
    train,
    tune,
    watch,
)

COMMANDS = (
    demo, bench, drives, node, ethercat, eds, esi, decode, bode, tune, homing, watch, panel, train,
    compare, results, benchmark, sweep,
)  # fmt: skip


def parser() -> argparse.ArgumentParser:
    """All commands with their options."""
    parser = argparse.ArgumentParser(
        prog="servogym",
        description="A laboratory for motion control: axes in MuJoCo, moved by an emulated drive.",
    )
    parser.add_argument("--version", action="version", version=f"servogym {version('servogym')}")
    commands = parser.add_subparsers(dest="command", required=True, metavar="command")
    for command in COMMANDS:
        command.add(commands)
    return parser


def main(arguments: list[str] | None = None) -> int:
    """Run a command; what a user got wrong is one line on stderr and exit status 2.

    SIGTERM ends a command as Ctrl-C does.
    """
    if os.getcwd() not in sys.path:
        sys.path.append(os.getcwd())  # modules with tasks of your own, as `python -m` finds them
    options = parser().parse_args(arguments)
    console = Console()
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        return options.run(options, console)
    except (ValueError, OSError, TimeoutError, RuntimeError, ImportError, SdoAbort) as error:
        print(f"servogym {options.command}: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return 130
