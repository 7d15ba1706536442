"""`servogym bode`."""

import argparse
from pathlib import Path

from rich.console import Console

from . import machines
from .arguments import POSITIVE, add_seed, option


def add(bode: argparse.ArgumentParser) -> None:
    """Add the options of this command."""
    machines.add(bode)
    option(bode, "--amplitude", POSITIVE, "rms amplitude as a share of the rated torque", 0.1)
    option(bode, "--speed", POSITIVE, "speed of travel, m/s or rad/s (a tenth of 6081h)")
    option(bode, "--lowest", POSITIVE, "lowest frequency in Hz (2, lower for a slow axis)")
    option(bode, "--highest", POSITIVE, "highest frequency in Hz")
    add_seed(bode, "the phases of the excitation")
    option(bode, "--out", Path, "folder for bode.png and bode.csv", Path("out"))
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
