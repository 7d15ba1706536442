"""Options that several commands have."""

import argparse
import json
from typing import Any

from ..scale.work import Work

POLICY = "name, FILE.py:function, or folder of a training"


def add(parser: argparse.ArgumentParser) -> None:
    """``--argument NAME=VALUE`` of an environment."""
    parser.add_argument(
        "--argument", action="append", metavar="NAME=VALUE", type=_named,
        help="of the environment, VALUE in JSON or text; repeatable",
    )  # fmt: skip


def add_work(parser: argparse.ArgumentParser) -> None:
    """``--workers``, ``--ray`` and ``--resume``: who does the jobs of a command."""
    parser.add_argument("--workers", type=int, metavar="N", help="processes side by side")
    parser.add_argument(
        "--ray", nargs="?", const="", metavar="ADDRESS",
        help="a Ray cluster: HOST:PORT, ray://HOST:PORT, auto; without: one is started here",
    )  # fmt: skip
    parser.add_argument("--resume", action="store_true", help="only what is missing in --out")


def work(options: argparse.Namespace) -> Work:
    """Who does the jobs."""
    return Work(options.workers, options.ray, options.resume)


def _named(text: str) -> tuple[str, Any]:
    """``"payload=3"`` -> ``("payload", 3)``."""
    name, equals, value = text.partition("=")
    if not (name.isidentifier() and equals):
        raise argparse.ArgumentTypeError(f"{text!r} is not NAME=VALUE")
    try:
        return name, json.loads(value)
    except ValueError:
        return name, value
