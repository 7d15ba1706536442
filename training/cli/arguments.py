"""Options that several commands have."""

import argparse
import json
from typing import Any

POLICY = "name, FILE.py:function, or folder of a training"


def add(parser: argparse.ArgumentParser) -> None:
    """``--argument NAME=VALUE`` of an environment."""
    parser.add_argument(
        "--argument", action="append", metavar="NAME=VALUE", type=_named,
        help="of the environment, VALUE in JSON or text; repeatable",
    )  # fmt: skip


def _named(text: str) -> tuple[str, Any]:
    """``"payload=3"`` -> ``("payload", 3)``."""
    name, equals, value = text.partition("=")
    if not (name.isidentifier() and equals):
        raise argparse.ArgumentTypeError(f"{text!r} is not NAME=VALUE")
    try:
        return name, json.loads(value)
    except ValueError:
        return name, value
