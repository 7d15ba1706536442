"""`servogym watch`."""

import argparse
from pathlib import Path

from rich.console import Console

from . import arguments


def add(watch: argparse.ArgumentParser) -> None:
    """Add the options of this command."""
    watch.add_argument("env", metavar="ENV", help="environment, such as LinearAxis-v0")
    watch.add_argument("--policy", default="hold", help=f"{arguments.POLICY} (hold)")
    watch.add_argument("--drive", default="generic", help="drive model, see `servogym drives`")
    watch.add_argument(
        "--episodes", type=arguments.COUNT, default=1, help="number of episodes, 1 or more (1)"
    )
    arguments.add_seed(watch, "the first reset")
    watch.add_argument(
        "--speed", type=arguments.Number(float, 0.01, 100.0), default=1.0,
        help="speed of the playback; 1 is real time (1)",
    )
    watch.add_argument(
        "--record", type=Path,
        help="record to an .mp4 or .gif file or into a folder, instead of a window",
    )
    arguments.add(watch)
    watch.set_defaults(run=_watch)


def _watch(options: argparse.Namespace, console: Console) -> int:
    from .. import watch

    if arguments.asked(options):
        return arguments.listing(options.env, console)
    if options.record is not None:
        from ..report import writable

        writable("--record", options.record, file=bool(options.record.suffix))
    return watch.run(
        arguments.setup(options), options.policy, options.episodes, options.seed, options.speed,
        options.record, console,
    )
