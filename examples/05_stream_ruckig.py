# %% [markdown]
# # 5 · Stream a trajectory through csp
#
# In cyclic synchronous position mode the master computes the trajectory and sends one target
# position per bus cycle; the drive interpolates and follows. The following error depends on the
# trajectory. Here ruckig plans the same move twice, with and without an effective jerk limit, and
# the drive reports its following error 60F4h.

# %%
import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import ruckig

from servogym.drive.kernel.words import ENABLED, Mode
from servogym.drive.master import Master
from servogym.drive.trace import Trace
from servogym.envs import linear_axis
from servogym.envs.masters.port import MachinePort

picture = Path(next((a for a in sys.argv if a.endswith(".png")), "out/05_stream_ruckig.png"))
BUS_CYCLE = 1e-3  # s
CHANNELS = ["position_demand_value", "velocity_demand_value", "velocity_actual_value",
            "following_error_actual_value", "axis.torque"]
machine = linear_axis("generic", payload=5.0)
machine.reset(positions={"x": 0.1})
x = machine.drives["x"]

# %% [markdown]
# The master writes the bus cycle to 60C2h, so that the drive interpolates over exactly that time,
# and maps controlword and target position into one RPDO.

# %%
x.write("interpolation_time_period_value", 1)
x.write("interpolation_time_index", -3)  # 1 x 10^-3 s
x.map_pdos([["controlword", "target_position"]], [["statusword", "position_actual_value"]])


def stream(jerk: float) -> dict[str, np.ndarray]:
    """Move by 0.3 m at 1 m/s and 10 m/s² with a jerk (m/s³); -> trace."""
    machine.reset(positions={"x": 0.1})
    trace = Trace(x, CHANNELS)
    master = Master(MachinePort(machine, lambda: trace.sample(machine.time)))
    x.exchange(x.pack(target_position=x.read("position_actual_value")))
    master.enable()
    master.set_mode(Mode.CYCLIC_SYNC_POSITION)
    planner = ruckig.Ruckig(1, BUS_CYCLE)
    wanted, now = ruckig.InputParameter(1), ruckig.OutputParameter(1)
    begin = x.read("position_demand_value") * 1e-6
    wanted.current_position, wanted.target_position = [begin], [begin + 0.3]
    wanted.max_velocity, wanted.max_acceleration, wanted.max_jerk = [1.0], [10.0], [jerk]
    start, result = len(trace), ruckig.Result.Working
    while result == ruckig.Result.Working:
        result = planner.update(wanted, now)
        x.exchange(x.pack(controlword=ENABLED, target_position=round(now.new_position[0] * 1e6)))
        master.wait(BUS_CYCLE)
        now.pass_to_input(wanted)
    master.wait(200 * machine.cycle_time)
    return {name: column[start:] for name, column in trace.arrays().items()}


runs = {"acceleration steps": stream(1e6), "jerk 300 m/s³": stream(300.0)}

# %% [markdown]
# The jerk limit costs about 30 ms (acceleration / jerk) and reduces the peak of the following error
# to little more than half.

# %%
window = x.read("following_error_window")  # µm, 6065h
figures = {}
for name, data in runs.items():
    error = data["following_error_actual_value"]
    moving = np.flatnonzero(data["velocity_demand_value"])
    duration = (moving[-1] - moving[0] + 1) * machine.cycle_time
    figures[name] = np.abs(error).max(), np.sqrt(np.mean(error**2.0)), duration
    print(f"{name:<20} {duration * 1e3:4.0f} ms, following error peak {figures[name][0]:4.0f} µm, "
          f"rms {figures[name][1]:5.1f} µm, window {window} µm")
steps, smooth = figures.values()
assert smooth[0] < 0.7 * steps[0]  # the peak
assert steps[0] < window

# %% [markdown]
# Without a trajectory, a target 0.3 m away in a single frame is a set-point that no axis can
# follow: the drive moves at its own maximum velocity, the error exceeds its window, and the drive
# trips with 8611h.

# %%
machine.reset(positions={"x": 0.1})
master = Master(MachinePort(machine), "x")
master.enable()
master.set_mode(Mode.CYCLIC_SYNC_POSITION)
x.exchange(x.pack(controlword=ENABLED, target_position=300_000))
machine.step(200)
print(x.state.name, x.fault)
assert x.fault.startswith("8611h")

# %%
figure, panels = plt.subplots(4, 1, figsize=(9, 10), sharex=True, layout="constrained")
for colour, (name, data) in zip(("C1", "C0"), runs.items(), strict=True):
    time = data["time"] - data["time"][0]
    panels[0].plot(time, data["position_demand_value"] / 1e3, "--", color=colour, label=name)
    panels[1].plot(time, data["velocity_actual_value"] / 1e6, color=colour, label=name)
    panels[2].plot(time, data["axis.torque"], color=colour, label=name)
    panels[3].plot(time, data["following_error_actual_value"], color=colour, label=name)
panels[3].axhspan(-window, window, color="C2", alpha=0.12, lw=0, label="window 6065h")
labels = (
    "position demand (mm)",
    "velocity (m/s)",
    "torque (Nm)",
    "following error (µm),\nlogarithmic from 100",
)
for panel, label in zip(panels, labels, strict=True):
    panel.set_ylabel(label)
    panel.grid(alpha=0.3)
    panel.legend(fontsize=8, loc="upper right" if panel is not panels[0] else "lower right")
panels[3].set_yscale("symlog", linthresh=100)  # linear to 100 µm, so that both are visible
panels[3].set_yticks([-window, -100, -50, 0, 50, 100, window])
panels[3].set_yticklabels([-window, -100, -50, 0, 50, 100, window])
panels[3].set(xlabel="time (s)", ylim=(-2 * window, 2 * window))
figure.suptitle("ruckig through csp, one set-point a millisecond")
picture.parent.mkdir(parents=True, exist_ok=True)
figure.savefig(picture, dpi=110)
print(picture)
