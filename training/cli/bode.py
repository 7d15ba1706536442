"""`servogym bode`."""

import argparse
from pathlib import Path

from rich.console import Console

from . import arguments, machines


def add(bode: argparse.ArgumentParser) -> None:
    """Add the options of this command."""
    machines.add(bode)
    bode.add_argument(
        "--amplitude", type=arguments.POSITIVE, default=0.1,
        help="rms amplitude as a share of the rated torque (0.1)",
    )
    bode.add_argument(
        "--speed", type=arguments.POSITIVE, help="speed of travel, m/s or rad/s (a tenth of 6081h)"
    )
    bode.add_argument(
        "--lowest", type=arguments.POSITIVE,
        help="lowest frequency in Hz (2, lower for a slow axis)",
    )
    bode.add_argument(
        "--highest", type=arguments.POSITIVE, help="highest frequency in Hz"
    )
    arguments.add_seed(bode, "the excitation's phases")
    bode.add_argument(
        "--out", type=Path, default=Path("out"), help="folder for bode.png and bode.csv (out)"
    )
    bode.set_defaults(run=_bode, folders=("out",))


def _bode(options: argparse.Namespace, console: Console) -> int:
    from ...envs.autotune.bode import bode
    from ...envs.autotune.needs import scipy

    scipy("interpolate")
    machine, name = machines.made(options)
    response = bode(
        machine, name, amplitude=options.amplitude, speed=options.speed, lowest=options.lowest,
        highest=options.highest, seed=options.seed,
    )
    print(response)
    options.out.mkdir(parents=True, exist_ok=True)
    for suffix in (".png", ".csv"):
        file = options.out / f"bode{suffix}"
        response.save(file)
        print(file)
    return 0
