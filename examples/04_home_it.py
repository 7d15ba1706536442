# %% [markdown]
# # 4 · Home it
#
# An incremental encoder counts from its position at power-on. Homing gives the drive its reference:
# the drive looks for a switch, an index pulse or a mechanical stop, and assigns a position to that
# place. Here the same axis is homed by three methods of 6098h from the same start:
#
# | method | it looks for |
# |---|---|
# | 17 | the edge of the negative limit switch |
# | 7 | the home switch, then the index pulse of the encoder beside it |
# | -17 | the mechanical stop, detected by the torque |

# %%
import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from servogym.drive.master import Master
from servogym.drive.trace import Trace
from servogym.envs import linear_axis
from servogym.envs.engine import tick
from servogym.envs.masters.homing_figures import built_in
from servogym.envs.masters.port import MachinePort

picture = Path(next((a for a in sys.argv if a.endswith(".png")), "out/04_home_it.png"))
METHODS = {17: "negative limit switch", 7: "home switch and index pulse", -17: "mechanical stop"}
START = 0.1  # m
machine = linear_axis("generic", payload=5.0)
x = machine.drives["x"]
x.write("home_offset", 0)  # the home position is zero

# %% [markdown]
# The procedure is always the same: mode 6, the method, and a rising edge of bit 4 of the
# controlword. `Master.home` waits for *homing attained* or *homing error*. The search for the
# switch is fast (6099h:01), the search for the zero is slow (6099h:02). Only the simulation knows
# the true position.

# %%


def home(method: int) -> tuple[dict[str, np.ndarray], np.ndarray, float]:
    """Home from START; -> trace, true positions (m), true position of the drive's zero (m)."""
    machine.reset(positions={"x": START})
    trace, places = Trace(x, ["velocity_actual_value", "axis.torque"]), []

    def look() -> None:
        trace.sample(machine.time)
        places.append(machine.data.qpos[0])

    master = Master(MachinePort(machine, look), "x")
    # a search for a stop uses this speed all the way; at 10 mm/s it would take 12 s
    x.write("speed_during_search_for_zero", 50_000 if method < 0 else 10_000)  # µm/s
    master.enable()
    master.home(method)
    zero = machine.data.qpos[0] - x.read("position_actual_value") * 1e-6
    return trace.arrays(), np.array(places), zero


runs = {method: home(method) for method in METHODS}

# %% [markdown]
# `built_in` runs a method again and measures it: the error against the ideal home, the time, and
# the energy of impacts.

# %%
figures = {}
for method, name in METHODS.items():
    x.write("speed_during_search_for_zero", 50_000 if method < 0 else 10_000)
    figures[method] = built_in(machine, method, START)
    f = figures[method]
    print(f"method {method:>3}, {name:<28} {f.time:5.2f} s, error {f.error * 1e6:+7.1f} µm, "
          f"{f.greatest_torque:4.0%} of the torque, {f.impact_energy * 1e3:.2f} mJ")
assert all(f.attained for f in figures.values())
assert abs(figures[7].error) < abs(figures[-17].error)  # an index pulse beats a stop
assert figures[-17].impact_energy > 0.0 == figures[17].impact_energy  # only the stop is hit

# %% [markdown]
# The diagram is drawn as in a manual: position to the right, time downwards. The triangle marks the
# home of the drive; in the grey areas a switch is active. Index pulses occur once per motor
# revolution, 60 mm.

# %%
figure, panels = plt.subplots(1, 3, figsize=(12, 5.5), layout="constrained", sharex=True)
coupling = machine.couplings[0]
for panel, (method, (data, places, zero)) in zip(panels, runs.items(), strict=True):
    panel.plot(places * 1e3, data["time"], lw=2)
    panel.plot(START * 1e3, 0.0, "o", color="k", label="start")
    panel.plot(zero * 1e3, data["time"][-1], "v", ms=10, color="C3", zorder=3, label="home")
    for switch, shade in ((tick.HOME, "0.85"), (0, "0.75")):
        low, high = coupling.switch_from[switch], coupling.switch_to[switch]
        panel.axvspan(max(low * 1e3, -25), high * 1e3, color=shade, lw=0)
    for pulse in np.arange(0.0, 241.0, 60.0):
        panel.axvline(pulse, color="C0", lw=0.8, ls=":", label="index pulse" if not pulse else None)
    panel.axvline(machine.mechanics["low"][0] * 1e3, color="k", lw=3)
    panel.invert_yaxis()
    panel.set(xlim=(-25, 245), xlabel="position of the carriage (mm)", ylabel="time (s), downwards")
    error = figures[method].error * 1e6
    panel.set_title(f"method {method}: {METHODS[method]}\nerror {error:+.1f} µm", fontsize=10)
    panel.grid(alpha=0.3)
panels[2].legend(fontsize=8, loc="center right")
figure.suptitle("Three ways home; grey: a switch is active, black: the stop")
picture.parent.mkdir(parents=True, exist_ok=True)
figure.savefig(picture, dpi=110)
print(picture)
