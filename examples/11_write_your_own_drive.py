# %% [markdown]
# # 11 · Write your own drive
#
# A drive model is a folder of tables. This one is based on `generic` and only states the
# differences: slower cycles, a slower current loop, fewer modes, and an object of its own. It needs
# no line of Python; every command and `linear_axis` accept the folder.

# %%
import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from servogym.drive.canopen import eds
from servogym.drive.kernel.words import Mode
from servogym.drive.master import Master
from servogym.drive.model.model import load
from servogym.drive.objects.abort import SdoAbort
from servogym.drive.trace import Trace
from servogym.envs import linear_axis
from servogym.envs.masters.port import MachinePort

picture = Path(next((a for a in sys.argv if a.endswith(".png")), "out/11_write_your_own_drive.png"))

# %% [markdown]
# `drive.toml` has identity, cycle times, capabilities and other defaults. The rows of `objects.csv`
# add objects to those of the base, or change them if they exist; empty cells keep the values of the
# base. The last columns give the section of the manual: fill them in, so that facts and guesses can
# be told apart later. Behaviour that differs from the standard is a quirk, also with its source
# (`servogym drives NAME` lists those of a model).

# %%
FILES = {
    "drive.toml": """
based_on = "generic"
title = "Workshop drive"

[cycle_time_us]
current = 125
velocity = 250
position = 1000

[capabilities]
modes = ["pp", "hm", "csp"]
homing_methods = [17, 18, 35, 37]

[motor]
torque_time_constant_us = 1000
""",
    "objects.csv": """\
index,subindex,name,object_type,data_type,access,pdo,unit,min,max,default,storable,section,note,field,when,hook
0x3000,0x00,spindle_pitch,VAR,UNSIGNED32,rw,,µm,1000,100000,60000,yes,manual 4.2,,,,
0x6099,0x01,,,,,,,,500000,400000,,manual 6.7,no faster,,,
""",
    "README.md": """\
# Workshop drive

Made for lesson 11. Cycle times, modes and objects as in its manual; all else inferred from CiA 402.
""",
}
folder = picture.parent / "workshop_drive"
folder.mkdir(parents=True, exist_ok=True)
for name, text in FILES.items():
    (folder / name).write_text(text, encoding="utf-8")
model = load(folder)
print(
    f"{model.title}: {len(model.objects)} objects, {', '.join(mode.name for mode in model.modes)}"
)

# %% [markdown]
# The new object behaves like any other: a value out of range is refused with the abort code of the
# standard, as is a mode that the drive does not have. The EDS for other masters also contains the
# object.

# %%
machines = {"generic": linear_axis("generic"), "workshop drive": linear_axis(folder)}
x = machines["workshop drive"].drives["x"]
x.write("spindle_pitch", 10_000)
refused = []
for name, value in (("spindle_pitch", 10), ("modes_of_operation", Mode.CYCLIC_SYNC_VELOCITY)):
    try:
        x.write(name, value)
    except SdoAbort as error:
        refused.append(error.code)
        print(f"{name} = {int(value)}: {error}")
sheet = folder.with_suffix(".eds")
print(eds.write(model, sheet), "objects in", sheet.name)

# %% [markdown]
# Both drives make the same move on the same axis. Each axis is commissioned for its drive, so the
# slower drive gets lower gains; its larger following error is the cost of its slower cycles.

# %%
figure, (way, error) = plt.subplots(2, 1, figsize=(9, 6), sharex=True, layout="constrained")
peaks = {}
for colour, (name, machine) in zip(("C0", "C1"), machines.items(), strict=True):
    machine.reset(positions={"x": 0.15})
    x = machine.drives["x"]
    trace = Trace(x, ["position_actual_value", "axis.following_error"])
    master = Master(MachinePort(machine, lambda: trace.sample(machine.time)))  # noqa: B023
    master.enable()
    master.home(37)
    master.move_to(0.1)
    data = trace.arrays()
    micrometres = 1e6 * data["axis.following_error"] / float(machine.couplings[0].gear)
    peaks[name] = float(np.abs(micrometres).max())
    way.plot(data["time"], data["position_actual_value"] / 1e3, color=colour, label=name)
    error.plot(data["time"], micrometres, color=colour, label=f"{name}: {peaks[name]:.0f} µm")
    cycle = 1e6 * x.model.cycle_time["position"]
    print(f"{name}: position cycle {cycle:g} µs, following error up to {peaks[name]:.0f} µm")
way.set(ylabel="position (mm)", title="your own drive and the one it is based on")
error.set(xlabel="time (s)", ylabel="following error (µm)")
for panel in (way, error):
    panel.grid(alpha=0.3)
    panel.legend()
figure.savefig(picture, dpi=110)
print(picture)
assert peaks["workshop drive"] > peaks["generic"]
