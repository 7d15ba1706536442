# %% [markdown]
# # 3 · Tune the cascade
#
# The velocity loop determines the stiffness of an axis. This lesson measures it as on a real drive:
# a step of the velocity, and a Bode diagram from sines with a known amplitude. `python-control`
# computes the margins (`pip install 'servogym[examples]'`).

# %%
import sys
from pathlib import Path

import control
import matplotlib.pyplot as plt
import numpy as np

from servogym.drive.kernel.words import Mode
from servogym.drive.master import Master
from servogym.drive.trace import Trace
from servogym.envs import linear_axis
from servogym.envs.masters.port import MachinePort

picture = Path(next((a for a in sys.argv if a.endswith(".png")), "out/03_tune_the_cascade.png"))
machine = linear_axis("generic", payload=5.0)
machine.reset(positions={"x": 0.05})
x = machine.drives["x"]
master = Master(MachinePort(machine), "x")

# %% [markdown]
# These are the commissioned gains, in the units of the drive and in SI. They follow from the
# symmetrical optimum for the inertia at the shaft and the delays of this drive.

# %%
kp = x.read("velocity_control_gain") * x.axis.velocity_gain_unit  # Nm·s/rad
ti = x.read("velocity_control_time") * 1e-6  # s
print(f"60F9h:01 = {x.read('velocity_control_gain')} µNm·s/rad = {kp:.3f} Nm·s/rad")
print(f"60F9h:02 = {x.read('velocity_control_time')} µs = {ti * 1e3:.2f} ms")
print(f"60FBh:01 = {x.read('position_control_gain')} /1000 s = "
      f"{x.read('position_control_gain') * x.axis.position_gain_unit:.0f} 1/s")

# %% [markdown]
# **How it is measured.** The axis travels at 0.1 m/s in mode csv, so that friction keeps its sign.
# A sine on the torque offset 60B2h, 4 % of the rated torque, adds *d* to the output of the
# controller. The total *u*, the torque command, gives the open loop *L*: u/d = 1/(1 + L). All
# frequencies start from one snapshot taken in motion.

# %%
AMPLITUDE = 40  # per mille of rated torque
FREQUENCIES = np.geomspace(8.0, 500.0, 28)  # Hz
OMEGA = 2 * np.pi * FREQUENCIES
master.enable()
x.write("target_velocity", 100_000)  # µm/s
master.set_mode(Mode.CYCLIC_SYNC_VELOCITY)
machine.step(300)
moving = machine.snapshot()
Ts, T = machine.cycle_time, x.model.cycle_time["velocity"]  # s, position and velocity cycle


def open_loop(frequency: float) -> complex:
    """L at one frequency (Hz), after 0.1 s of settling."""
    settle = int(0.1 / Ts)
    count = round(max(3.0, 0.2 * frequency) / frequency / Ts)
    d, u = [], []
    for n in range(settle + count):
        x.write("torque_offset", round(AMPLITUDE * np.sin(2 * np.pi * frequency * n * Ts)))
        machine.step()
        if n >= settle:
            d.append(x.axis.torque_offset)
            u.append(x.axis.torque_command)
    wave = np.exp(-2j * np.pi * frequency * Ts * np.arange(count)) * np.hanning(count)
    ratio = np.dot(wave, u - np.mean(u)) / np.dot(wave, d)
    # d is held for two velocity cycles; the images of the hold above 1 kHz pass the loop
    held = (1 + np.exp(2j * np.pi * frequency * T)) / 2
    return held / (ratio - 1 + held) - 1


def measure(gain: float) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Open loop at all frequencies, and a step of 20 mm/s, with `gain` times the velocity gain."""
    points = []
    for frequency in FREQUENCIES:
        machine.restore(moving)
        x.write("velocity_control_gain", round(kp * gain / x.axis.velocity_gain_unit))
        points.append(open_loop(frequency))
    machine.restore(moving)
    x.write("velocity_control_gain", round(kp * gain / x.axis.velocity_gain_unit))
    trace = Trace(x, ["velocity_demand_value", "velocity_actual_value"])
    step = Master(MachinePort(machine, lambda trace=trace: trace.sample(machine.time)))
    step.wait(20 * machine.cycle_time)
    x.write("target_velocity", 120_000)
    step.wait(120 * machine.cycle_time)
    return np.array(points), trace.arrays()


gains = (0.5, 1.0, 4.0)
loops, steps = zip(*[measure(gain) for gain in gains], strict=True)

# %% [markdown]
# **The expected loop.** It consists of PI controller, current loop, inertia and velocity filter,
# each as the drive computes it once per velocity cycle. (The rule for the gains adds up the time
# constants as if they were continuous, 0.9 ms; that leaves 53° by design, and sampled lags are
# shorter.)

# %%
z = np.exp(1j * OMEGA * T)
inertia = x.axis.od.acceleration_feed_forward * 1e-9  # kg·m², 2010h:02
calculated = kp * (1 + T / ti / (z - 1)) * T / (inertia * (z - 1))
for share in (x.axis.torque_filter, x.axis.velocity_filter):  # y += share (x - y)
    calculated *= share / (1 - (1 - share) / z)
names = (*(f"gain × {gain:g}" for gain in gains), "calculated")
margins = []
for name, loop in zip(names, (*loops, calculated), strict=True):
    gm, pm, sm, _, crossover, _ = control.stability_margins(control.frd(loop, OMEGA, smooth=True))
    margins.append((pm, sm, crossover / (2 * np.pi)))
    print(f"{name}: crossover {margins[-1][2]:.0f} Hz, phase margin {pm:.0f}°, "
          f"least distance from -1: {sm:.2f}")
    assert gm == np.inf  # the phase does not reach -180° in what was measured, up to 500 Hz
half, commissioned, fourfold, expected = margins
assert abs(commissioned[0] - expected[0]) < 3.0  # degree
assert half[0] < commissioned[0]
assert fourfold[1] < commissioned[1] - 0.1  # four times the gain comes closer to -1

# %% [markdown]
# With four times the gain the crossover is 3.5 times as high and the margin is still 54°, but the
# loop comes closer to -1: the step overshoots twice as far. Half the gain overshoots least and
# takes longest to return, because the integral part suits a faster loop. At low frequencies the
# fourfold loop leaves so little of the sine in *u* that the increments of the encoder are visible
# in the curve; a larger amplitude is needed there.

# %%
figure, (response, size, angle) = plt.subplots(3, 1, figsize=(8, 10), layout="constrained")
for label, loop, data, margin in zip(names, loops, steps, margins, strict=False):
    time = 1e3 * (data["time"] - data["time"][20])
    (line,) = response.plot(time, data["velocity_actual_value"] / 1e3, label=label)
    size.semilogx(FREQUENCIES, 20 * np.log10(abs(loop)), "o-", ms=3, color=line.get_color())
    angle.semilogx(FREQUENCIES, np.degrees(np.unwrap(np.angle(loop))), "o-", ms=3,
                   color=line.get_color(), label=f"{label}: margin {margin[0]:.0f}°")
    angle.plot([margin[2]] * 2, [-180, margin[0] - 180], color=line.get_color(), lw=3)
response.plot(time, data["velocity_demand_value"] / 1e3, "k--", lw=1, label="demand")
response.set(xlabel="time (ms)", ylabel="velocity (mm/s)", title="step of the velocity demand")
size.semilogx(FREQUENCIES, 20 * np.log10(abs(calculated)), "k:", label="calculated, gain × 1")
size.axhline(0.0, color="grey", lw=1)
size.set(ylabel="open loop (dB)", title="sine of 4 % rated torque, in motion at 0.1 m/s")
angle.semilogx(FREQUENCIES, np.degrees(np.unwrap(np.angle(calculated))), "k:")
angle.axhline(-180.0, color="grey", lw=1)
angle.set(
    xlabel="frequency (Hz)",
    ylabel="phase (degree)",
    title="phase, and its margin at the crossover (thick)",
)
for panel in (response, size, angle):
    panel.grid(alpha=0.3, which="both")
    panel.legend(fontsize=8)
picture.parent.mkdir(parents=True, exist_ok=True)
figure.savefig(picture, dpi=110)
print(picture)
