"""`servogym benchmark`."""

import argparse
import re
import shlex
from pathlib import Path
from typing import Any

from rich.console import Console

from . import arguments
from .arguments import POLICY, POSITIVE, SIGNED_BYTE, Number, option, refuse, several

SUITE, LEARNED = "v2", "learned"
OF_SUITES = ("suite", "entry", "tasks", "conditions")
OF_AXES = ("mechanics", "payload", "distance", "method", "runs", "parameter_file")


def add(benchmark: argparse.ArgumentParser) -> None:
    """Add the options of this command."""
    benchmark.add_argument("what", choices=("homing", "positioning", "learned", "headroom"))
    option(benchmark, "--drive", str, "drive model, see `servogym drives` (generic)")
    option(benchmark, "--quick", bool, "run only a small part")
    option(benchmark, "--out", Path, "output folder", Path("out"))
    own = benchmark.add_argument_group("homing, positioning: other cells than those of the page")
    option(own, "--mechanics", str, "mechanics of the family, separated by commas (all)")
    option(own, "--payload", several(Number(float, 0.0)),
           "payload (kg); for positioning, several separated by commas")
    option(own, "--distance", several(POSITIVE),
           "positioning: distances (m), separated by commas (0.01,0.05,0.2)")
    option(own, "--method", several(SIGNED_BYTE),
           "homing: further methods, separated by commas")
    option(own, "--policy", str, "positioning: strategies of your own beside those of the page, by "
           "name or FILE.py:name; homing: FILE.py:function, which is called with a Master of the "
           f"axis; learned: {POLICY}, or a folder with one for each task ({LEARNED})")
    option(own, "--runs", Number(int, 2), "homing: runs in each cell (50)")
    option(own, "--parameter-file", Path, "stored parameters, as `servogym tune` writes them")
    learned = benchmark.add_argument_group("learned: submit a policy to a suite")
    option(learned, "--suite", str, f"version, or a file of your own ({SUITE})")
    option(learned, "--entry", str, "name on the leaderboard (the policy's own)", metavar="NAME")
    option(learned, "--tasks", str,
           "tasks of the suite, separated by commas (all that the policy fits)")
    option(learned, "--conditions", str,
           "try only these conditions; no submission is written")
    option(benchmark, "comparison", Path, "headroom: compare.json of each task, which `servogym "
           "compare` wrote; every row is compared with what is possible", nargs="*")
    arguments.add_work(benchmark)
    benchmark.set_defaults(
        run=_benchmark, folders=("out",), inputs=("parameter_file",)
    )


def _benchmark(options: argparse.Namespace, console: Console) -> int:
    if options.what == "headroom":
        return _headroom(options, console)
    if options.comparison:
        raise ValueError(f"{options.comparison[0]} is for `servogym benchmark headroom`")
    if options.what == "learned":
        return _learned(options, console)
    refuse(options, "is for `servogym benchmark learned`", *OF_SUITES)
    chosen = _chosen(options)
    from ..evaluate import benchmark, homing, positioning

    kind = homing.HOMING if options.what == "homing" else positioning.POSITIONING
    return benchmark.run(
        kind, options.drive or "generic", options.quick, options.out, console,
        arguments.work(options), chosen,
    )


def _chosen(options: argparse.Namespace) -> dict[str, Any]:
    """Return the options that the benchmark takes."""
    payloads = options.payload or []
    chosen: dict[str, Any] = {
        "mechanics": arguments.listed(options.mechanics), "parameter_file": options.parameter_file,
    }
    if options.what == "positioning":
        refuse(options, "is for `servogym benchmark homing`", "method", "runs")
        chosen |= {"payloads": payloads, "distances": options.distance,
                   "strategies": arguments.listed(options.policy)}
    else:
        refuse(options, "is for `servogym benchmark positioning`", "distance")
        if len(payloads) > 1:
            raise ValueError(f"--payload = {options.payload}: homing takes one payload")
        chosen |= {
            "payload": payloads[0] if payloads else None,
            "runs": options.runs,
            "methods": [*(options.method or ()), *arguments.listed(options.policy)],
        }
    return {name: value for name, value in chosen.items() if value}


def _headroom(options: argparse.Namespace, console: Console) -> int:
    from ..evaluate import headroom

    refuse(options, "is not for `servogym benchmark headroom`", "drive", "quick", "policy",
           *OF_SUITES, *OF_AXES)
    return headroom.run(options.comparison, options.out, console, run_code=options.run_code)


def _learned(options: argparse.Namespace, console: Console) -> int:
    from ..evaluate import leaderboard, suite

    refuse(options, "is not for suites, which contain it", "drive", "quick", *OF_AXES)
    chosen = suite.read(options.suite or SUITE, run_code=options.run_code)
    policy = options.policy or LEARNED
    stem = Path(policy.partition(".py")[0]).name
    entry = options.entry or re.sub(r"[^\w+.-]", "_", stem)
    if not re.fullmatch(r"[\w+-][\w+. -]*", entry):
        raise ValueError(f"--entry {entry!r}: letters, digits, space and + - . _ will do")
    tasks, conditions = map(arguments.listed, (options.tasks, options.conditions))
    command = f"servogym benchmark learned --suite {options.suite or SUITE} --policy {policy}"
    command += f" --entry {shlex.quote(entry)}"
    command += f" --tasks {options.tasks}" if tasks else ""
    return leaderboard.enter(
        chosen, policy, entry, command, options.out, console, arguments.work(options),
        tasks=tasks, conditions=conditions,
    )
