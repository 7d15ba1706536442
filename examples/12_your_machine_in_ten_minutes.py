# %% [markdown]
# # 12 · Your machine in ten minutes
#
# `machines/hidden_axis.py` is a CANopen node in its own process, with soft loops, and with payload
# and friction that this lesson does not know. Three commands make its twin: plan an experiment, log
# it, and fit a machine to the log.

# %%
import csv
import subprocess
import sys
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from servogym.drive.wire.recording import Source
from servogym.envs import linear_axis
from servogym.envs.engine import parameters
from servogym.envs.plants import twins
from servogym.envs.twin.families import GAINS

NODE = Path(__file__).parent / "machines" / "hidden_axis.py"
FOLDER = Path(tempfile.mkdtemp())
picture = Path(
    next((a for a in sys.argv if a.endswith(".png")), "out/12_your_machine_in_ten_minutes.png")
)


def run(*words):
    subprocess.run([sys.executable, *map(str, words)], check=True)


def servogym(*words):
    run("-m", "servogym", *words)


plan, log, folder = FOLDER / "plan.csv", FOLDER / "moves.log", FOLDER / "twin"
servogym("twin", "--plan", plan, "--mechanics", "rigid", "--range", 0.15, 0.35,
         "--velocity", 0.6, "--acceleration", 8)
run(NODE, plan, log)
servogym("twin", log, "--mechanics", "rigid", "-o", folder)

# %% [markdown]
# The twin is a machine like any other. It is compared with the machine of the data sheet, with the
# gains that the node reported by SDO.

# %%
machines = {"data sheet": linear_axis(), "twin": linear_axis(twin=folder)}
stiff = parameters.get(machines["data sheet"], GAINS)
soft = {name: twins.read(folder).values[name] for name in GAINS}
for name, value in twins.read(folder).parameters.items():
    if value.low < value.high:
        print(f"{name}: {value.value:.4g} [{value.low:.4g}, {value.high:.4g}] {value.unit}")

# %% [markdown]
# One call of `replay` plays the set-points of a new move into a machine. With the gains of the node
# it predicts the torque that the node will need.

# %%
RATED, UNIT = 1.27e-3, 1e-6  # Nm a per mille, m a position unit
time = np.arange(0, 0.5, 1e-3)
ramp = np.clip((time - 0.05) / 0.35, 0, 1)
move = 0.15 + 0.2 * (10 * ramp**3 - 15 * ramp**4 + 6 * ramp**5)
targets = np.round(np.concatenate([move, move[::-1]]) / UNIT).astype(int)
still = np.full(100, targets[0])
words = np.concatenate([np.full(20, 6), np.full(20, 7), np.full(len(targets) + 60, 15)])


def play(machine, gains, offsets):
    """Torque and its share for the demanded acceleration (per mille), for each set-point."""
    drive = machine.drives["x"]
    per = round(1e-3 / machine.cycle_time)
    machine.reset({"x": targets[0] * UNIT})
    parameters.apply(machine, gains)
    machine.step()
    here = targets[0] * UNIT * machine.joint("x")[0] / float(drive.axis.rad_per_increment)
    drive.axis.zero_counts, drive.axis.homed = int(drive.axis.counts) - round(here), 1
    columns = {
        "controlword": words,
        "modes_of_operation": np.full(len(words), 8),
        "target_position": np.concatenate([still, targets]),
        "torque_offset": np.round(np.concatenate([0 * still, offsets])).astype(int),
    }
    rows = {name: np.repeat(values, per) for name, values in columns.items()}
    arrives = np.arange(len(words) * per) % per == 0
    found = machine.replay(rows, ("torque", "acceleration_demand"), arrives=arrives)
    inertia = 1e-9 * float(drive.axis.od.acceleration_feed_forward)
    torque, acceleration = (found[name][100 * per :: per] for name in found)
    return torque / RATED, inertia * acceleration / RATED


none = np.zeros(len(targets))
predicted = {name: play(machine, soft, none)[0] for name, machine in machines.items()}

# %% [markdown]
# A controller is trained on each machine by feedback-error learning: the torque that the loops had
# to add in one try is fed forward as torque offset (60B2h) in the next. In a simulation the loops
# may be stiff during training, and the encoder has no noise.


# %%
def smooth(values, width):
    window = np.hanning(width + 2)[1:-1]
    return np.convolve(np.pad(values, width // 2, mode="edge"), window / window.sum(), "valid")


def learn(machine, tries=3):
    """Learn the torque offsets (per mille), one for each set-point."""
    parameters.apply(machine, {"encoder_noise": 0.0})
    offsets = none
    for _ in range(tries):
        torque, share = play(machine, stiff, offsets)
        offsets = smooth(torque - share, 9)
    return offsets


offsets = {"none": none} | {name: learn(machine) for name, machine in machines.items()}

# %% [markdown]
# Back to the node, whose parameters are still unknown: it gets the same set-points, each time with
# the offsets learned on another machine. The result is the deviation of the axis from its
# set-points, apart from a constant delay.

# %%
late = twins.read(folder).lag / 1e-3  # samples from a set-point to its effect
at = np.arange(len(targets))
speed = np.gradient(targets.astype(float))
errors, torques, far = {}, {}, {}
for name, values in offsets.items():
    with plan.open("w", newline="") as file:
        csv.writer(file).writerows([("time (s)", "target"), *enumerate(targets.tolist())])
    table = FOLDER / "torques.csv"
    with table.open("w", newline="") as file:
        rows = enumerate(np.round(values).astype(int).tolist())
        csv.writer(file).writerows([("time (s)", "torque"), *rows])
    run(NODE, plan, FOLDER / "back.log", table)
    source = Source(FOLDER / "back.log", "generic")
    signals = source.signals(source.drive(None, ("position_actual_value",)))
    measured = signals["position_actual_value"].value[-len(targets) :]
    error = np.interp(at - late, at, targets) - measured
    errors[name] = error - (speed @ error) / (speed @ speed) * speed
    far[name] = float(np.sqrt(np.mean(errors[name] ** 2)))
    torques[name] = signals["torque_actual_value"].value[-len(targets) :]
    print(f"{name:10s} {far[name]:6.1f} µm rms off the set-points")

# %% [markdown]
# The prediction of a machine can be compared with the torque of the node in the first run, without
# any offset.

# %%
wrong = {}
for name, torque in predicted.items():
    there = np.interp(at - late + 1, at, torque)
    wrong[name] = float(np.sqrt(np.mean((there - torques["none"]) ** 2)))
    print(f"{name:10s} {wrong[name]:6.1f} per mille rms off the torque of the node")

# %%
figure, axes = plt.subplots(2, 1, figsize=(8, 6), sharex=True, layout="constrained")
for (name, error), color in zip(errors.items(), ("0.5", "#d1721e", "#1f5fa8"), strict=True):
    axes[0].plot(at, error, lw=1, color=color, label=f"learned on: {name}")
    axes[1].plot(at, offsets[name], lw=1, color=color)
axes[0].set_ylabel("off the set-point (µm)")
axes[0].legend(fontsize=8)
axes[1].set_ylabel("torque offset (per mille)")
axes[1].set_xlabel("time (ms)")
for axis in axes:
    axis.grid(alpha=0.3)
picture.parent.mkdir(parents=True, exist_ok=True)
figure.savefig(picture, dpi=110)
