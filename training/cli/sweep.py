"""`servogym sweep`."""

import argparse
import json
import re
import shlex
from pathlib import Path
from typing import Any

from rich.console import Console

from . import arguments
from .arguments import COUNT, EPISODES, FROM_ZERO, option

RANGE = re.compile(r"([^.,]+(?:\.[^.,]+)?)\.\.(.+?)(:log)?$")  # LOW..HIGH, LOW..HIGH:log


def add(sweep: argparse.ArgumentParser) -> None:
    """Add the options of this command."""
    option(sweep, "envs", str, "environments, separated by commas")
    option(sweep, "--policies", str, "policies that play in each cell, separated by commas", "")
    option(sweep, "--train", str.upper, "train a policy in each cell instead", "",
           choices=("PPO", "SAC"))
    option(sweep, "--steps", COUNT, "steps of each training", 100_000)
    option(sweep, "--drives", str, "drive models, separated by commas", "generic")
    option(sweep, "--conditions", str, "conditions, as for `servogym compare`", "")
    option(sweep, "--seeds", arguments.several(FROM_ZERO),
           "seeds of the episodes or of the trainings, such as 0,1,2", "0")
    sweep.add_argument(
        "--vary", action="append", default=[], metavar="NAME=VALUES", type=_varied,
        help="values of an argument or hyper-parameter, such as 1,2,5; with --trials also "
        "LOW..HIGH[:log]",
    )
    option(sweep, "--trials", COUNT,
           "run an Optuna study with this many trials instead of the grid")
    option(sweep, "--episodes", EPISODES, "episodes of each cell", 50)
    arguments.add(sweep)
    arguments.add_work(sweep)
    option(sweep, "--out", Path, "output folder", Path("out/sweep"))
    sweep.set_defaults(run=_sweep)


def _varied(text: str) -> tuple[str, Any]:
    """``"a=1,2"`` -> ``("a", [1, 2])``; ``"a=1e-4..1e-2:log"`` -> a range."""
    name, equals, values = text.partition("=")
    if not (name.isidentifier() and equals and values):
        raise argparse.ArgumentTypeError(f"{text!r} is not NAME=VALUES")
    if found := RANGE.match(values):
        from ..evaluate.sweep import Range

        low, high = arguments.read_value(found[1]), arguments.read_value(found[2])
        numbers = isinstance(low, int | float) and isinstance(high, int | float)
        if numbers and low < high and (low > 0 or not found[3]):
            return name, Range(low, high, bool(found[3]))
        raise argparse.ArgumentTypeError(f"{text!r}: a range is LOW..HIGH; of :log above 0")
    return name, [arguments.read_value(value) for value in values.split(",")]


def _sweep(options: argparse.Namespace, console: Console) -> int:
    from ..evaluate import sweep
    from ..evaluate.comparison import quoted
    from ..setup import Setup

    given = dict(options.argument or ())
    whole = sweep.Sweep(
        [Setup.of(env, arguments=given) for env in arguments.listed(options.envs)],
        arguments.listed(options.policies), options.drives.split(","), options.conditions,
        options.seeds, dict(options.vary), options.episodes, options.train, options.steps,
    )
    given = {"--policies": options.policies, "--train": options.train, "--drives": options.drives,
             "--conditions": options.conditions, "--seeds": ",".join(map(str, options.seeds)),
             "--episodes": str(options.episodes), "--trials": str(options.trials or ""),
             "--steps": str(options.steps) if options.train else ""}
    words = ["servogym", "sweep", options.envs]
    words += [word for name, value in given.items() if value for word in (name, value)]
    for name, values in options.vary:
        if isinstance(values, sweep.Range):
            text = f"{values.low}..{values.high}{':log' if values.log else ''}"
        else:
            text = ",".join(v if isinstance(v, str) else json.dumps(v) for v in values)
        words += ["--vary", f"{name}={text}"]
    command = shlex.join(words)
    command += "".join(f" --argument {quoted(*one)}" for one in options.argument or ())
    work = arguments.work(options)
    return sweep.run(whole, options.trials, command, options.out, console, work)
