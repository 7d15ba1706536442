"""`servogym benchmark`."""

import argparse
import re
import shlex
from pathlib import Path

from rich.console import Console

from . import arguments

SUITE, POLICY = "v1", "learned"
OF_SUITES = ("suite", "policy", "entry", "tasks", "conditions")


def add(benchmark: argparse.ArgumentParser) -> None:
    """Its options."""
    benchmark.add_argument("what", choices=("homing", "positioning", "learned"))
    benchmark.add_argument("--drive", help="drive model, see `servogym drives` (generic)")
    benchmark.add_argument("--quick", action="store_true", help="a small part of it")
    benchmark.add_argument("--out", type=Path, default=Path("out"), help="folder (out)")
    learned = benchmark.add_argument_group("learned: a policy on a suite, as a submission")
    learned.add_argument("--suite", help=f"version, or a file of your own ({SUITE})")
    learned.add_argument(
        "--policy", help=f"{arguments.POLICY}; one with such a folder a task ({POLICY})"
    )
    learned.add_argument("--entry", metavar="NAME", help="on the leaderboard (that of the policy)")
    learned.add_argument("--tasks", help="of the suite, separated by commas (all it fits)")
    learned.add_argument("--conditions", help="a part of them, to try; nothing is submitted")
    arguments.add_work(benchmark)
    benchmark.set_defaults(run=_benchmark, folders=("out",))


def _benchmark(options: argparse.Namespace, console: Console) -> int:
    if options.what == "learned":
        return _learned(options, console)
    if given := [name for name in OF_SUITES if getattr(options, name) is not None]:
        raise ValueError(f"--{given[0]} is for `servogym benchmark learned`")
    if options.what == "homing":
        from ..evaluate.homing import run
    else:
        from ..evaluate.positioning import run
    drive = options.drive or "generic"
    return run(drive, options.quick, options.out, console, arguments.work(options))


def _learned(options: argparse.Namespace, console: Console) -> int:
    from ..evaluate import leaderboard, suite

    for name in ("drive", "quick"):
        if getattr(options, name):
            raise ValueError(f"--{name} is not for suites, which say it themselves")
    chosen, policy = suite.read(options.suite or SUITE), options.policy or POLICY
    stem = Path(policy.partition(".py")[0]).name
    entry = options.entry or re.sub(r"[^\w+.-]", "_", stem)
    if not re.fullmatch(r"[\w+-][\w+. -]*", entry):
        raise ValueError(f"--entry {entry!r}: letters, digits, space and + - . _ will do")
    tasks, conditions = (
        [each for part in (given or "").split(",") if (each := part.strip())]
        for given in (options.tasks, options.conditions)
    )
    command = f"servogym benchmark learned --suite {options.suite or SUITE} --policy {policy}"
    command += f" --entry {shlex.quote(entry)}"
    command += f" --tasks {options.tasks}" if tasks else ""
    return leaderboard.enter(
        chosen, policy, entry, command, options.out, console, arguments.work(options),
        tasks=tasks, conditions=conditions,
    )  # fmt: skip
