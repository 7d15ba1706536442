"""`servogym demo`: enables, homes, moves and stops a drive, measures the run and draws it."""

import functools
import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import ruckig
from rich.console import Console
from rich.table import Table

from ...drive.kernel.words import ENABLED, Mode
from ...drive.master import Master
from ...drive.model.model import load
from ...drive.trace import Trace
from ...envs.masters.port import MachinePort
from ...envs.plants.linear_axis import LinearAxisParameters, linear_axis

CHANNELS = (
    "position_demand_value", "position_actual_value", "velocity_demand_value",
    "velocity_actual_value", "following_error_actual_value", "statusword",
    "modes_of_operation_display", "axis.torque_command", "axis.torque",
    "axis.torque_limit_positive", "axis.torque_limit_negative", "following_error_window",
)
NEEDED = (Mode.PROFILE_POSITION, Mode.PROFILE_VELOCITY, Mode.HOMING)
TARGETS = (0.3, 0.06, 0.42)  # m
BUS_CYCLE = 1e-3  # s, the period of the streamed set-points


@dataclass(frozen=True)
class Phase:
    """A named part of the demo, samples `start` to `end` of the trace."""

    name: str
    start: int
    end: int


class Demo:
    """One run: the machine, its master, the trace and the phases of the run."""

    def __init__(self, drive: str, payload: float):
        for mode in NEEDED:
            if mode not in load(drive).modes:
                raise ValueError(
                    f"drive {drive!r} has no mode {mode.name.lower()}, which the demo needs: "
                    "choose another one, see `servogym drives`"
                )
        self.parameters = LinearAxisParameters(payload=payload)
        self.machine = linear_axis(drive, parameters=self.parameters)
        self.machine.reset(positions={"x": 0.12})
        self.drive = self.machine.drives["x"]
        self.trace = Trace(self.drive, CHANNELS)
        self.master = Master(
            MachinePort(self.machine, lambda: self.trace.sample(self.machine.time))
        )
        self.phases: list[Phase] = []

    def run(self) -> None:
        """Run all phases in order."""
        s = self.master
        self._phase("power on", lambda: None, 160)
        self._phase("enable", s.enable, 160)
        self._phase("home (17)", lambda: s.home(17))
        for target in TARGETS:
            self._phase(f"pp {target * 1e3:.0f} mm", functools.partial(s.move_to, target))
        if Mode.CYCLIC_SYNC_POSITION in self.drive.model.modes:
            self._phase("csp, ruckig", self.stream)
        self._phase("quick stop", self.stop_in_motion)

    def _phase(self, name: str, action: Callable[[], None], rest: int = 40) -> None:
        """Run a phase and `rest` position cycles after it."""
        start = len(self.trace)
        action()
        self.master.wait(rest * self.machine.cycle_time)
        self.phases.append(Phase(name, start, len(self.trace)))

    def stream(self) -> None:
        """Stream a jerk-limited trajectory: one target position per bus cycle through the RPDO."""
        x, s, p = self.drive, self.master, self.parameters
        x.write("interpolation_time_period_value", round(BUS_CYCLE * 1e3))
        x.write("interpolation_time_index", -3)
        x.map_pdos([["controlword", "target_position"]], [["statusword", "position_actual_value"]])
        x.exchange(x.pack(target_position=x.read("position_demand_value")))
        s.set_mode(Mode.CYCLIC_SYNC_POSITION)
        generator = ruckig.Ruckig(1, BUS_CYCLE)
        wanted, now = ruckig.InputParameter(1), ruckig.OutputParameter(1)
        wanted.current_position = [x.read("position_demand_value") * 1e-6]
        wanted.target_position = [0.1]
        wanted.max_velocity = [p.max_velocity]
        wanted.max_acceleration = [p.max_acceleration]
        wanted.max_jerk = [p.max_jerk]
        result = ruckig.Result.Working
        while result == ruckig.Result.Working:
            result = generator.update(wanted, now)
            x.exchange(
                x.pack(controlword=ENABLED, target_position=round(now.new_position[0] * 1e6))
            )
            s.wait(BUS_CYCLE)
            now.pass_to_input(wanted)
        if x.model.quirk("sync_monitored"):  # the end of the frames is a fault of an enabled drive
            s.control(0)
            s.enable()

    def stop_in_motion(self) -> None:
        """Run at profile velocity, and quick-stop in the middle of it."""
        self.drive.write("target_velocity", round(0.6 * self.parameters.max_velocity * 1e6))
        self.master.set_mode(Mode.PROFILE_VELOCITY)
        self.master.wait(0.25)
        self.master.quick_stop()

    def table(self) -> Table:
        """Figures of each phase, position units being µm."""
        data = self.trace.arrays()
        table = Table(title=f"{self.drive.model.title}, payload {self.parameters.payload:g} kg")
        table.add_column("phase", no_wrap=True)
        for column in (
            "time\n(ms)", "follow. err.\npeak (µm)", "\nrms (µm)", "torque\npeak (Nm)",
            "settling\n(ms)", "final\n(µm)",
        ):
            table.add_column(column, justify="right", no_wrap=True)
        for phase in self.phases:
            table.add_row(*_figures(phase, data, self.machine.cycle_time, self.drive))
        return table


def _figures(phase: Phase, data: dict[str, np.ndarray], cycle: float, drive) -> list[str]:
    part = slice(phase.start, phase.end)
    error = data["following_error_actual_value"][part].astype(float)
    torque = np.abs(data["axis.torque_command"][part])
    cells = [
        phase.name,
        f"{(phase.end - phase.start) * cycle * 1e3:.0f}",
        f"{np.abs(error).max():.0f}",
        f"{math.sqrt(np.mean(error**2)):.1f}",
        f"{torque.max():.2f}",
        "",
        "",
    ]
    if phase.name.startswith(("pp", "csp")):
        settled, final = _settling(data, part, drive.read("position_window"))
        cells[5:] = [f"{settled * cycle * 1e3:.1f}", f"{final:+.0f}"]
    return cells


def _settling(data: dict[str, np.ndarray], part: slice, window: int) -> tuple[int, int]:
    """Cycles from the end of the demand's motion until the axis stays in the position window."""
    demand = data["position_demand_value"][part]
    actual = data["position_actual_value"][part]
    target = demand[-1]
    moving = np.flatnonzero(demand != target)
    arrived = int(moving[-1]) + 1 if len(moving) else 0
    outside = np.flatnonzero(np.abs(actual - target) > window)
    settled = int(outside[-1]) + 1 if len(outside) else 0
    return max(settled - arrived, 0), int(actual[-1] - target)


def run(drive: str, out: Path, payload: float, console: Console) -> int:
    """Run the demo, print the table, write ``out/scope.png``; -> exit status."""
    demo = Demo(drive, payload)
    began = time.perf_counter()
    with console.status("compiling the control cycle, once per version (up to 30 s) ..."):
        demo.machine.step()
    waited = time.perf_counter() - began
    demo.machine.reset(positions={"x": 0.12})
    if waited > 2:
        console.print(f"compiled in {waited:.0f} s; from now on it is read from the cache")
    demo.run()
    console.print(demo.table())
    if Mode.CYCLIC_SYNC_POSITION not in demo.drive.model.modes:
        console.print("the drive has no csp: the trajectory of ruckig was left out")
    out.mkdir(parents=True, exist_ok=True)
    with console.status("drawing ..."):
        from .scope import draw

        picture = draw(demo.trace.arrays(), demo.phases, out / "scope.png", demo.drive.model.title)
    console.print(f"scope picture: {picture}")
    return 0
