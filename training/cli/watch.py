"""`servogym watch`."""

import argparse
from pathlib import Path

from rich.console import Console

from . import arguments
from .arguments import COUNT, POLICY, Number, option


def add(watch: argparse.ArgumentParser) -> None:
    """Add the options of this command."""
    arguments.add_env(watch)
    option(watch, "--policy", str, POLICY, "hold")
    arguments.add_drive(watch)
    option(watch, "--episodes", COUNT, "number of episodes, 1 or more", 1)
    arguments.add_seed(watch, "the first reset")
    option(watch, "--speed", Number(float, 0.01, 100.0), "playback speed, 1 is real time", 1.0)
    option(watch, "--record", Path, "record to an .mp4 or .gif file or into a folder, instead of "
           "a window")
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
