"""`servogym eval` and `servogym compare`."""

import argparse
import shlex
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console

from . import arguments

if TYPE_CHECKING:
    from ..evaluate.comparison import Request


def add_eval(command: argparse.ArgumentParser) -> None:
    """Add the options of `eval`."""
    command.add_argument("env", help="environment, such as LinearAxis-v0")
    command.add_argument("--policy", help=arguments.POLICY)
    _add_episodes(command)


def add(command: argparse.ArgumentParser) -> None:
    """Add the options of `compare`."""
    command.add_argument("env", help="environment, such as LinearAxis-v0")
    command.add_argument("--policies", help="names of policies, separated by commas")
    command.add_argument(
        "--conditions", nargs="?", const="all", metavar="NAMES",
        help="off-nominal conditions: all (delay, noise, friction, …), a list of names or axes, or "
        "transfer (every drive with every mechanics)",
    )
    _add_episodes(command)


def _add_episodes(command: argparse.ArgumentParser) -> None:
    command.add_argument("--drive", default="generic", help="drive model, see `servogym drives`")
    command.add_argument(
        "--episodes", type=arguments.EPISODES, default=50, help="number of episodes, 1..1000 (50)"
    )
    arguments.add_seed(command, "the episodes")
    command.add_argument(
        "--trace", type=arguments.FROM_ZERO, default=0, help="episode to draw, counted from 0 (0)"
    )
    arguments.add(command)
    arguments.add_work(command)
    command.add_argument("--out", type=Path, help="output folder (a new one in out)")
    command.add_argument(
        "--port", metavar="OPTIONS",
        help="play on the drives of a bus, with these options of `servogym deploy` as one word, "
        'such as "-i socketcan -c can0 --yes"',
    )
    command.set_defaults(run=_compare, folders=("out",))


def asked(options: argparse.Namespace) -> "Request":
    """Return the request of a command line. Raises ValueError without a policy."""
    from ..evaluate.comparison import Request

    option = "policy" if options.command == "eval" else "policies"
    given = getattr(options, option)
    if given is None:
        raise ValueError(f"give --{option}: {arguments.POLICY}")
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
