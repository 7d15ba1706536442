"""`servogym train` and `servogym curves`."""

import argparse
from pathlib import Path
from typing import Any

from rich import get_console
from rich.console import Console

from . import arguments


def add(train: argparse.ArgumentParser) -> None:
    """Add the options of `train`."""
    train.add_argument("env", help="environment, such as LinearAxis-v0")
    train.add_argument("--drive", help="drive model, see `servogym drives` (generic)")
    train.add_argument(
        "--algorithm", choices=("PPO", "SAC"), type=str.upper,
        help="algorithm of stable-baselines3 (PPO)",
    )
    train.add_argument(
        "--seed", type=arguments.FROM_ZERO, help="seed of environments, weights and actions (0)"
    )
    train.add_argument(
        "--steps", type=arguments.COUNT, help="total number of steps of all environments"
    )
    train.add_argument("--envs", type=arguments.COUNT, help="number of parallel environments")
    arguments.add(train)
    train.add_argument("--residual", metavar="POLICY", help="learn a correction of this policy")
    train.add_argument(
        "--bounds", type=arguments.several(arguments.Number(float, 0.0)),
        help="largest correction of each action, such as 0.05,0.05"
    )
    train.add_argument(
        "--start", type=Path, metavar="FOLDER", help="start from the weights of this training"
    )
    train.add_argument(
        "--demonstrate", metavar="POLICY",
        help="imitate this policy instead of learning from rewards",
    )
    train.add_argument(
        "--device", help="warp device for the training, cuda or cpu; see `servogym bench --gpu`"
    )
    train.add_argument(
        "--setting", action="append", metavar="NAME=VALUE", type=arguments.named,
        help="hyper-parameter, VALUE in JSON; repeatable",
    )
    train.add_argument("--out", type=Path, help="output folder (out/ENV-DRIVE-ALGORITHM-SEED)")
    train.add_argument(
        "--resume", action="store_true", help="resume from the latest checkpoint in --out"
    )
    train.add_argument(
        "--checkpoint-every", type=arguments.COUNT, help="steps between checkpoints (50000)"
    )
    train.add_argument(
        "--evaluate-every", type=arguments.COUNT,
        help="steps between evaluations (25000; there is also one at the end)",
    )
    train.set_defaults(run=_train, folders=("out",), inputs=("start",))


def add_curves(curves: argparse.ArgumentParser) -> None:
    """Add the options of `curves`."""
    curves.add_argument("folder", type=Path, help="folder of a training, or of several in seed_*")
    curves.add_argument(
        "-o", "--out", type=Path, default=Path("out/curves.png"),
        help="output picture (out/curves.png)",
    )
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

    console = get_console()  # on which the bar lives: what is printed comes above it
    return train.run(asked, console, progress=console.is_terminal)


def _curves(options: argparse.Namespace, console: Console) -> int:
    from ..evaluate import curves

    return curves.run(options.folder, options.out, console)
