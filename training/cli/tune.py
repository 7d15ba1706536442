"""`servogym tune`."""

import argparse
from pathlib import Path

from rich.console import Console

from . import arguments, machines


def add(tune: argparse.ArgumentParser) -> None:
    """Add the options of this command."""
    machines.add(tune)
    tune.add_argument(
        "--gain-margin", type=arguments.POSITIVE, default=6.0,
        help="gain margin of both loops in dB (6)",
    )
    tune.add_argument(
        "--phase-margin", type=arguments.POSITIVE, default=35.0,
        help="phase margin of both loops in degrees (35)",
    )
    tune.add_argument(
        "--move", type=arguments.FINITE,
        help="distance of the move that shows the following error, m or rad",
    )
    tune.add_argument(
        "--detuned", type=arguments.POSITIVE, default=1.0, metavar="FACTOR",
        help="start from velocity and position gains multiplied by this factor (1)",
    )
    tune.add_argument(
        "--amplitude", type=arguments.POSITIVE, default=0.1,
        help="rms amplitude as a share of the rated torque (0.1)",
    )
    arguments.add_seed(tune, "the excitation's phases")
    tune.add_argument(
        "--out", type=Path, default=Path("out"),
        help="folder for tune.png and parameters.json (out)",
    )
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
