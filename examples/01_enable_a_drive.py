# %% [markdown]
# # 1 · Enable a drive in ten lines
#
# A target position alone does not move a servo drive. The drive first has to walk through the
# states of CiA 402, one command at a time; its statusword shows the present state:
#
# | controlword | command | state it leads to |
# |---|---|---|
# | 0006h | shutdown | READY_TO_SWITCH_ON: mains present, power stage off |
# | 0007h | switch on | SWITCHED_ON: power stage ready, motor without torque |
# | 000Fh | enable operation | OPERATION_ENABLED: the motor holds its position and obeys |
#
# Run it as `python 01_enable_a_drive.py [picture.png]`, or cell by cell in an editor.

# %%
import sys
from pathlib import Path

from servogym.drive.kernel.words import Mode, State, decode_controlword
from servogym.drive.trace import Trace
from servogym.envs import linear_axis
from servogym.training.pictures.demo import CHANNELS, Phase
from servogym.training.pictures.scope import draw

picture = Path(next((a for a in sys.argv if a.endswith(".png")), "out/01_enable_a_drive.png"))

# %% [markdown]
# These are the ten lines. The machine is a linear axis in MuJoCo with a drive called `x`; a step is
# one cycle of the position controller of the drive, 0.5 ms.

# %%
machine = linear_axis("generic", payload=5.0)
machine.reset(positions={"x": 0.12})  # m; powered, disabled, not referenced
x = machine.drives["x"]
machine.step()
states = [x.state]
for controlword in (0x06, 0x07, 0x0F):
    x.write("controlword", controlword)
    machine.step(2)
    states.append(x.state)
print(x.describe())

# %% [markdown]
# The drive has passed through every state in order:

# %%
assert states == [
    State.SWITCH_ON_DISABLED,
    State.READY_TO_SWITCH_ON,
    State.SWITCHED_ON,
    State.OPERATION_ENABLED,
]

# %% [markdown]
# Now the same is recorded by an oscilloscope, followed by a profile position move and the way back
# to SWITCH_ON_DISABLED. A `Trace` takes one sample per position cycle; a phase is a name on the
# time axis.

# %%
machine.reset(positions={"x": 0.12})
trace = Trace(x, CHANNELS)
phases = []


def control(controlword: int, cycles: int, name: str = "") -> None:
    """Write a controlword, run `cycles`, and print the answer of the drive."""
    start = len(trace)
    x.write("controlword", controlword)
    for _ in range(cycles):
        machine.step()
        trace.sample(machine.time)
    command = " ".join(decode_controlword(controlword, x.mode))
    print(f"{controlword:04X}h {command:<30} -> {x.describe()}")
    phases.append(Phase(name or f"{controlword:04X}h", start, len(trace)))


control(0x00, 100, "power on")
control(0x06, 100)
control(0x07, 100)
control(0x0F, 100)
x.write("modes_of_operation", Mode.PROFILE_POSITION)
x.write("target_position", 50_000)  # µm from where the drive was powered on
control(0x0F, 20, "pp")
control(0x1F, 400, "001Fh: new set-point")
control(0x0F, 60)
control(0x07, 100)
control(0x00, 100)

# %% [markdown]
# The last three controlwords cleared the set-point bit, disabled the operation and switched off the
# voltage. The axis stands at its target, 50 mm away, and the drive reports *target reached*.

# %%
moved = machine.data.qpos[0] - 0.12
print(f"the carriage has moved by {moved * 1e3:.3f} mm")
assert abs(moved - 0.05) < 50e-6
picture.parent.mkdir(parents=True, exist_ok=True)
print(draw(trace.arrays(), phases, picture, "From power-on to a move and back"))
