# %% [markdown]
# # 8 · Put a drive on your own MJCF
#
# Any hinge or slide of a MuJoCo model can get a drive, by its name. Here an arm with two links in
# the vertical plane, written for this lesson, gets two drives of different manufacturers.
# `from_mjcf` also accepts a file.

# %%
import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from servogym.drive.master import Master
from servogym.drive.trace import Trace
from servogym.envs import Machine, commission_joint
from servogym.envs.masters.port import MachinePort

picture = Path(next((a for a in sys.argv if a.endswith(".png")), "out/08_drive_your_own_mjcf.png"))
ARM = """
<mujoco>
  <worldbody>
    <body name="upper" pos="0 0 1">
      <joint name="shoulder" axis="0 1 0" range="-120 120" damping="0.5"/>
      <geom type="capsule" fromto="0 0 0 0 0 -0.4" size="0.03" mass="2"/>
      <body name="lower" pos="0 0 -0.4">
        <joint name="elbow" axis="0 1 0" range="-150 150" damping="0.2"/>
        <geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.02" mass="1"/>
      </body>
    </body>
  </worldbody>
</mujoco>
"""

# %% [markdown]
# `from_mjcf` gives each named joint a motor; `gears` is rad of motor per rad of joint. The physics
# step is shortened until it fits the cycles of both drives. `commission_joint` then derives motor
# size, limits, units (1 µrad) and controller gains from the masses of the model. The remaining
# steps are those of any machine: enable, home (method 37: the present pose is known), move.

# %%
machine = Machine.from_mjcf(
    ARM,
    drives={"shoulder": "kollmorgen_akd", "elbow": "generic"},
    gears={"shoulder": 100, "elbow": 50},
)
CHANNELS = ["position_demand_value", "position_actual_value", "axis.torque"]
port = MachinePort(machine)
masters, traces = {}, {}
for name, x in machine.drives.items():
    commission_joint(machine, name, max_velocity=3.0, max_acceleration=20.0)  # rad/s, rad/s²
    masters[name] = Master(port, name)
    traces[name] = Trace(x, CHANNELS)
    masters[name].enable()
    masters[name].home()
    rated = x.read("motor_rated_torque") / 1e3
    print(f"{name}: {x.model.title}, rated {rated:.2f} Nm, "
          f"60F9h:01 = {x.read('velocity_control_gain')}")
print(f"physics step {machine.model.opt.timestep * 1e6:g} µs")

# %% [markdown]
# Each master waits for its own drive. Meanwhile both drives are traced and hold their positions.

# %%


def look() -> None:
    """Take a sample of both drives."""
    for trace in traces.values():
        trace.sample(machine.time)


port.on_step = look
TARGETS = [("shoulder", 1.2), ("elbow", -0.9), ("shoulder", 0.0), ("elbow", 0.0)]  # rad
for name, target in TARGETS:
    masters[name].move_to(target)
    masters[name].wait(100 * machine.cycle_time)
    joint = machine.data.joint(name).qpos[0]
    print(f"{name} at {joint:+.4f} rad, target {target:+.4f}")
    assert abs(joint - target) < 1e-3

# %% [markdown]
# The torque at rest is that of the weight of the links divided by the gear. It is largest while the
# arm is stretched out; the motion of the shoulder also acts on the elbow.

# %%
figure, (angles, torques) = plt.subplots(2, 1, figsize=(9, 6.5), sharex=True, layout="constrained")
for colour, (name, trace) in zip(("C0", "C1"), traces.items(), strict=True):
    data = trace.arrays()
    angles.plot(data["time"], data["position_actual_value"] / 1e6, color=colour, label=name)
    angles.plot(data["time"], data["position_demand_value"] / 1e6, "k--", lw=0.8)
    torques.plot(data["time"], data["axis.torque"], color=colour, label=name)
torques.axhline(0.0, color="grey", lw=0.8)
angles.set(ylabel="angle (rad)", title="two drives on your own arm; dashed: demand")
torques.set(xlabel="time (s)", ylabel="torque of the motor (Nm)")
for panel in (angles, torques):
    panel.grid(alpha=0.3)
    panel.legend()
picture.parent.mkdir(parents=True, exist_ok=True)
figure.savefig(picture, dpi=110)
print(picture)
peaks = {name: float(np.abs(trace.arrays()["axis.torque"]).max()) for name, trace in traces.items()}
assert peaks["shoulder"] > 0.02
