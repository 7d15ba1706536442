"""`servogym homing --gallery DIR`: a diagram of each homing method, drawn from emulated runs.

The diagrams look as in the manual of a drive: position to the right, time downwards, a line for
each start position, the switches and index pulses below, the home position marked.
"""

import math
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import track

from ...drive.diagrams import homing_words
from ...drive.kernel.words import State
from ...drive.master import HomingFailed, Master, Timeout
from ...drive.model.model import load
from ...envs.engine import tick
from ...envs.engine.machine import Machine
from ...envs.masters.port import MachinePort
from ...envs.plants.linear_axis import linear_axis

STARTS = {"left": 0.1, "on the switch": 0.205, "right": 0.37}  # m
SWITCH = (0.155, 0.27)  # m; it is wider than the 60 mm between two index pulses
COLOURS = ("#1f5fa8", "#d9822b", "#2f8f5b")
# methods whose home switch extends to the end of the axis: the field of that end, its place (m)
TO_THE_END = {3: ("switch_to", 2.0), 4: ("switch_to", 2.0)}
TO_THE_END |= {5: ("switch_from", -1.0), 6: ("switch_from", -1.0)}


@dataclass(frozen=True)
class Run:
    """One homing run: carriage position (m) over time (s), and the home it found."""

    start: str
    time: np.ndarray
    position: np.ndarray
    home: float | None
    error: int


def fit_home_switch(machine: Machine, method: int, own: tuple[float, float]) -> None:
    """Place the home switch at `own` (m), extended to the end of the axis if a method needs it."""
    coupling = machine.couplings[0]
    coupling["switch_from"][tick.HOME], coupling["switch_to"][tick.HOME] = own
    reach = TO_THE_END.get(method if method < 17 else method - 16)
    if reach:
        coupling[reach[0]][tick.HOME] = reach[1]


def home_switch(machine: Machine) -> tuple[float, float]:
    """The range in which the home switch is active (m)."""
    coupling = machine.couplings[0]
    return float(coupling.switch_from[tick.HOME]), float(coupling.switch_to[tick.HOME])


def machine_for(method: int, drive: str = "generic") -> Machine:
    """The axis for a method, with a home switch as the method needs it."""
    machine = linear_axis(drive)
    fit_home_switch(machine, method, SWITCH)
    x = machine.drives["x"]
    x.write("homing_method", method)
    if method in (-1, -2, -17, -18):  # homing on an end stop travels at the slower speed only
        x.write("speed_during_search_for_zero", 50_000)
    return machine


def home(machine: Machine, start: float, name: str = "") -> Run:
    """Home the axis from a carriage position (m); the run may fail."""
    machine.reset(positions={"x": start})
    times: list[float] = []
    positions: list[float] = []

    def note() -> None:
        times.append(machine.time)
        positions.append(float(machine.data.qpos[0]))

    master = Master(MachinePort(machine, note, cycles=10))
    master.enable()
    found, axis = None, machine.drives["x"].axis
    try:
        master.home()
        offset = round(float(axis.home_offset / axis.rad_per_increment))
        counts = int(axis.zero_counts) - offset
        found = counts * float(axis.rad_per_increment) / float(machine.couplings[0].gear)
    except (HomingFailed, Timeout):
        pass
    assert master.state == State.OPERATION_ENABLED
    return Run(name, np.array(times), np.array(positions), found, int(axis.homing_error))


def draw(method: int, machine: Machine, runs: Sequence[Run], path: Path) -> None:
    """Draw one diagram to `path`; the suffix chooses the format."""
    from matplotlib.figure import Figure  # imported here because it is slow to load

    model = machine.drives["x"].model
    figure = Figure((8, 6.4), layout="constrained")
    panel, strip = figure.subplots(2, 1, sharex=True, height_ratios=[4, 1.3])
    for run, colour in zip(runs, COLOURS, strict=False):
        panel.plot(run.position * 1e3, run.time, color=colour, lw=1.5, label=run.start)
        panel.plot(run.position[0] * 1e3, run.time[0], "o", color=colour, ms=5)
        if run.home is not None:
            panel.plot(run.home * 1e3, run.time[-1], "v", color=colour, ms=8)
            strip.axvline(run.home * 1e3, color=colour, lw=1, ls="--")
    panel.invert_yaxis()
    panel.set_ylabel("time (s), downwards")
    panel.legend(fontsize=8, title="start", loc="best")
    panel.grid(alpha=0.3)
    panel.set_title(
        textwrap.fill(homing_words(method, model.own_homing), 108), fontsize=8, loc="left"
    )
    figure.suptitle(f"homing method {method}", fontweight="bold")
    coupling = machine.couplings[0]
    switches = ("negative limit", "positive limit", "home switch")
    places = np.linspace(-25, 525, 2000)
    for row in range(len(switches)):
        active = (places >= coupling.switch_from[row] * 1e3) & (
            places <= coupling.switch_to[row] * 1e3
        )
        strip.fill_between(places, -row, active * 0.7 - row, step="mid", color="#8a8f98", lw=0)
    turn = 2 * math.pi / float(coupling.gear) * 1e3
    pulses = np.arange(math.ceil(-25 / turn), math.floor(525 / turn) + 1) * turn
    strip.vlines(pulses, -3, -2.3, color="#1f5fa8", lw=1.5)
    strip.set_yticks([0.3, -0.7, -1.7, -2.7], [*switches, "index pulse"], fontsize=8)
    strip.set_xlabel("position of the carriage (mm); triangle and dashed line: home")
    strip.set_xlim(-25, 525)
    figure.savefig(path, dpi=110)


def run(
    folder: Path, methods: list[int] | None, suffix: str, console: Console, drive: str = "generic"
) -> int:
    """Draw the gallery; -> exit status."""
    own = load(drive).homing_methods
    chosen = methods or sorted(own)
    for method in chosen:
        if method not in own:
            known = ", ".join(map(str, sorted(own)))
            raise ValueError(f"--method {method} is unknown, choose from {known}")
    folder.mkdir(parents=True, exist_ok=True)
    for method in track(chosen, "homing", console=console):
        machine = machine_for(method, drive)
        runs = [home(machine, start, name) for name, start in STARTS.items()]
        draw(method, machine, runs, folder / f"method_{method:+d}.{suffix}")
    console.print(f"{len(chosen)} diagrams in {folder}")
    return 0
