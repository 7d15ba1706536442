"""`servogym results`."""

import argparse
import re
import shlex
from pathlib import Path

from rich.console import Console

from . import arguments
from .arguments import option


def add(results: argparse.ArgumentParser) -> None:
    """Add the options of this command."""
    option(results, "folder", Path, "folder with a subfolder for each task (that of this package)",
           nargs="?")
    option(results, "--again", bool, "first repeat the comparison of each folder")
    option(results, "--train", str, "repeat all trainings into this folder; without it, only print "
           "the commands and CPU-seconds", nargs="?", const="", metavar="OUT")
    option(results, "--costs", str, "in a checkout: list every committed result with its command "
           "and CPU-seconds, and first repeat those whose command contains WORDS",
           nargs="?", const="", metavar="WORDS")
    option(results, "--suite", str,
           "check the submissions in the folder for this suite and write the leaderboard")
    option(results, "--public", str, "with --suite: draw the episodes of all entries from a text "
           "that nobody could know before the last entry was handed in, such as the numbers of a "
           "lottery", metavar="TEXT")
    option(results, "--run-code", bool, "run the programs that the folder names; read them first")
    arguments.add_work(results)
    results.add_argument("-o", "--out", type=Path, help="page to write (README.md in the folder; "
                         "by default out/learned.md)")
    results.set_defaults(run=_results, files=("out",))


def _results(options: argparse.Namespace, console: Console) -> int:
    from ..evaluate import results

    if options.costs is not None:
        from ..evaluate import costs

        return costs.run(options.folder or Path(), options.costs, console)
    if options.suite is not None:
        return _leaderboard(options, console)
    if options.public is not None:
        raise ValueError("--public draws the episodes of a suite: add --suite")
    if options.train is not None:
        return _train(options, console)
    if options.again:
        if options.folder is None:
            raise ValueError("--again writes into the folder: name one of yours")
        _again(options.folder, options, console)
    elif options.workers or options.ray is not None or options.resume:
        raise ValueError("--workers, --ray and --resume are for what --again computes: add it")
    return results.run(options.folder, options.out, console, run_code=options.run_code)


def _train(options: argparse.Namespace, console: Console) -> int:
    from ..evaluate import repeat
    from ..policies import SHIPPED

    if options.again or options.ray is not None or options.resume:
        raise ValueError(
            "--train takes --workers alone; it goes on by itself where it was interrupted"
        )
    out = Path(options.train) if options.train else None
    if out is not None:
        from ..report import writable

        writable("--train", out, file=False)
    return repeat.run(
        options.folder or SHIPPED, out, options.workers, console, run_code=options.run_code
    )


def _leaderboard(options: argparse.Namespace, console: Console) -> int:
    from ..evaluate import leaderboard, suite

    if options.folder is None or options.again or options.train is not None:
        raise ValueError("--suite: name the folder of the submissions, without --again and --train")
    chosen = suite.read(options.suite, run_code=options.run_code)
    if options.public is not None:
        if not re.fullmatch(r"[\w.,:+ -]+", options.public):
            raise ValueError(f"--public {options.public!r}: letters, digits, space, . , : + - _")
        chosen = chosen.announced(options.public)
    return leaderboard.rank(
        chosen, options.folder, options.out or options.folder / "README.md", console,
        arguments.work(options), run_code=options.run_code,
    )


def _again(folder: Path, options: argparse.Namespace, console: Console) -> None:
    """Repeat each folder's comparison with the command in its `compare.json`."""
    from ..evaluate import compare as comparing
    from ..evaluate import results
    from . import compare, parser

    compared = parser("compare")
    for path in results.folders(folder):
        data = results.table_of(path, results.FILE, "servogym compare", run_code=options.run_code)
        then = compared.parse_args(shlex.split(data["command"])[1:])
        comparing.run(then.command, compare.asked(then), path, console, arguments.work(options))
