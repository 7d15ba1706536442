"""`servogym benchmark`."""

import argparse
from pathlib import Path

from rich.console import Console

from . import arguments


def add(commands) -> None:
    """Its row in the table of commands."""
    benchmark = commands.add_parser("benchmark", help="homing methods, positioning strategies")
    benchmark.add_argument("what", choices=("homing", "positioning"))
    benchmark.add_argument("--drive", default="generic", help="drive model, see `servogym drives`")
    benchmark.add_argument("--quick", action="store_true", help="a small part of it")
    benchmark.add_argument("--out", type=Path, default=Path("out"), help="folder (out)")
    arguments.add_work(benchmark)
    benchmark.set_defaults(run=_benchmark, folders=("out",))


def _benchmark(options: argparse.Namespace, console: Console) -> int:
    if options.what == "homing":
        from ..evaluate.homing import run
    else:
        from ..evaluate.positioning import run
    return run(options.drive, options.quick, options.out, console, arguments.work(options))
