"""`servogym eval` and `servogym compare`."""

import argparse
import shlex
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console

from . import arguments
from .arguments import EPISODES, FROM_ZERO, POLICY, option

if TYPE_CHECKING:
    from ..evaluate.comparison import Request


def add_eval(command: argparse.ArgumentParser) -> None:
    """Add the options of `eval`."""
    arguments.add_env(command)
    option(command, "--policy", str, POLICY)
    _add_episodes(command)


def add(command: argparse.ArgumentParser) -> None:
    """Add the options of `compare`."""
    arguments.add_env(command)
    option(command, "--policies", str, "names of policies, separated by commas")
    option(command, "--conditions", str, "off-nominal conditions: all (delay, noise, friction, …), "
           "a list of names or axes, or transfer (every drive with every mechanics)",
           nargs="?", const="all", metavar="NAMES")
    _add_episodes(command)


def _add_episodes(command: argparse.ArgumentParser) -> None:
    arguments.add_drive(command)
    option(command, "--episodes", EPISODES, "number of episodes", 50)
    arguments.add_seed(command, "the episodes")
    option(command, "--trace", FROM_ZERO, "episode to draw, counted from 0", 0)
    arguments.add(command)
    arguments.add_work(command)
    option(command, "--out", Path, "output folder (a new one in out)")
    option(command, "--port", str, "play on the drives of a bus, with these options of `servogym "
           'deploy` as one word, such as "-i socketcan -c can0 --yes"', metavar="OPTIONS")
    command.set_defaults(run=_compare, folders=("out",))


def asked(options: argparse.Namespace) -> "Request":
    """Return the request of a command line. Raises ValueError without a policy."""
    from ..evaluate.comparison import Request

    option = "policy" if options.command == "eval" else "policies"
    given = getattr(options, option)
    if given is None:
        raise ValueError(f"give --{option}: {POLICY}")
    policies = [given] if options.command == "eval" else arguments.listed(given)
    if not policies:
        raise ValueError("--policies is empty: give names, separated by commas")
    return Request(
        arguments.setup(options), policies, options.episodes, options.seed, options.trace
    )


def _compare(options: argparse.Namespace, console: Console) -> int:
    arguments.prepare(options)
    from ..evaluate import compare

    if arguments.asked(options):
        return arguments.listing(options.env, console)
    if options.port is not None:
        return _deployed(options, console)
    request, work = asked(options), arguments.work(options)
    if getattr(options, "conditions", None) is not None:
        from ..evaluate import off_nominal

        return off_nominal.run(request, options.conditions, options.out, console, work)
    return compare.run(options.command, request, options.out, console, work)


def _deployed(options: argparse.Namespace, console: Console) -> int:
    """Play the same policies and episodes on a bus."""
    from . import deploy

    policies = asked(options).policies
    parser = argparse.ArgumentParser("--port")
    deploy.add(parser)
    words = [options.env, "--drive", options.drive, "--seed", f"{options.seed}"]
    words += ["--episodes", f"{options.episodes}"]
    words += [word for policy in policies for word in ("--policy", policy)]
    given = parser.parse_args([*words, *shlex.split(options.port)])
    given.argument = [*(options.argument or ()), *(given.argument or ())] or None
    return int(given.run(given, console))
