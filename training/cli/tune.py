"""`servogym tune`."""

import argparse
from pathlib import Path

from rich.console import Console

from . import machines
from .arguments import FINITE, POSITIVE, add_seed, option


def add(tune: argparse.ArgumentParser) -> None:
    """Add the options of this command."""
    machines.add(tune)
    option(tune, "--gain-margin", POSITIVE, "gain margin of both loops in dB", 6.0)
    option(tune, "--phase-margin", POSITIVE, "phase margin of both loops in degrees", 35.0)
    option(tune, "--move", FINITE, "distance of the move that shows the following error, m or rad")
    option(tune, "--detuned", POSITIVE,
           "start from velocity and position gains multiplied by this factor", 1.0,
           metavar="FACTOR")
    option(tune, "--amplitude", POSITIVE, "rms amplitude as a share of the rated torque", 0.1)
    add_seed(tune, "the phases of the excitation")
    option(tune, "--out", Path, "folder for tune.png and parameters.json", Path("out"))
    tune.set_defaults(run=_tune, folders=("out",))


def _tune(options: argparse.Namespace, console: Console) -> int:
    from ...envs.autotune.needs import scipy
    from ...envs.autotune.stand import Stand, detune
    from ...envs.autotune.tune import tune

    scipy("interpolate")
    machine, name = machines.made(options)
    if options.detuned != 1.0:
        for mover in Stand(machine, name).movers:
            detune(machine.drives[mover], options.detuned)
    tuned = tune(
        machine, name, gain_margin=options.gain_margin, phase_margin=options.phase_margin,
        move=options.move, amplitude=options.amplitude, seed=options.seed,
    )
    print(tuned)
    for file in ("tune.png", "parameters.json"):
        tuned.save(options.out / file)
        print(options.out / file)
    return 0
