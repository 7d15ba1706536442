"""`servogym train` and `servogym curves`."""

import argparse
from pathlib import Path
from typing import Any

from rich import get_console
from rich.console import Console

from . import arguments
from .arguments import COUNT, FROM_ZERO, Number, option


def add(train: argparse.ArgumentParser) -> None:
    """Add the options of `train`."""
    arguments.add_env(train)
    option(train, "--drive", str, "drive model, see `servogym drives` (generic)")
    option(train, "--algorithm", str.upper, "algorithm of stable-baselines3 (PPO)",
           choices=("PPO", "SAC"))
    option(train, "--seed", FROM_ZERO, "seed of environments, weights and actions (0)")
    option(train, "--steps", COUNT, "total number of steps of all environments")
    option(train, "--envs", COUNT, "number of parallel environments")
    arguments.add(train)
    option(train, "--residual", str, "learn a correction of this policy", metavar="POLICY")
    option(train, "--bounds", arguments.several(Number(float, 0.0)),
           "largest correction of each action, such as 0.05,0.05")
    option(train, "--start", Path, "start from the weights of this training", metavar="FOLDER")
    option(train, "--demonstrate", str, "imitate this policy instead of learning from rewards",
           metavar="POLICY")
    option(train, "--device", str,
           "warp device for the training, cuda or cpu; see `servogym bench --gpu`")
    train.add_argument(
        "--setting", action="append", metavar="NAME=VALUE", type=arguments.named,
        help="hyper-parameter, VALUE in JSON; repeatable",
    )
    option(train, "--out", Path, "output folder (out/ENV-DRIVE-ALGORITHM-SEED)")
    option(train, "--resume", bool, "resume from the latest checkpoint in --out")
    option(train, "--checkpoint-every", COUNT, "steps between checkpoints (50000)")
    option(train, "--evaluate-every", COUNT,
           "steps between evaluations, beside the one at the end (25000)")
    train.set_defaults(run=_train, folders=("out",), inputs=("start",))


def add_curves(curves: argparse.ArgumentParser) -> None:
    """Add the options of `curves`."""
    option(curves, "folder", Path, "folder of a training, or of several in seed_*")
    curves.add_argument("-o", "--out", type=Path, default=Path("out/curves.png"),
                        help="output picture (out/curves.png)")
    curves.set_defaults(run=_curves, files=("out",))


def _train(options: argparse.Namespace, console: Console) -> int:
    from ..learn.training import OPTIONS, Training

    if arguments.asked(options):
        return arguments.listing(options.env, console)
    given: dict[str, Any] = {name: getattr(options, name, None) for name in OPTIONS}
    given |= {
        "arguments": dict(options.argument) if options.argument else None,
        "settings": dict(options.setting) if options.setting else None,
    }
    asked = Training(**{name: value for name, value in given.items() if value is not None})
    from ..learn import train

    console = get_console()  # that of the progress bar, so that output appears above it
    return train.run(asked, console, progress=console.is_terminal)


def _curves(options: argparse.Namespace, console: Console) -> int:
    from ..evaluate import curves

    return curves.run(options.folder, options.out, console)
