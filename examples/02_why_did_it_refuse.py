# %% [markdown]
# # 2 · Why did my drive refuse?
#
# A drive never raises an exception. It answers with a state that does not change, with bit 11 of
# the statusword, with a fault code, or with the abort code of an object access. This lesson
# provokes all four and reads the answers.

# %%
import sys
from pathlib import Path

from servogym.drive import Abort, SdoAbort
from servogym.drive.kernel.words import Limit, Mode
from servogym.drive.master import Master
from servogym.drive.trace import Trace
from servogym.envs import linear_axis
from servogym.envs.masters.port import MachinePort
from servogym.training.pictures.demo import CHANNELS, Phase
from servogym.training.pictures.scope import draw

picture = Path(next((a for a in sys.argv if a.endswith(".png")), "out/02_why_did_it_refuse.png"))
machine = linear_axis("generic", payload=5.0)
machine.reset(positions={"x": 0.12})
x = machine.drives["x"]
trace = Trace(x, CHANNELS)
master = Master(MachinePort(machine, lambda: trace.sample(machine.time)))
phases = []


def begin(name: str) -> None:
    """Begin the next part of the picture."""
    phases.append(Phase(name, len(trace), len(trace)))


# %% [markdown]
# **A refused command.** Enable operation is not obeyed in SWITCH_ON_DISABLED. The state does not
# change, and `why()` names the command, the state and the missing condition.

# %%
begin("not in order")
master.wait(0.03)
x.write("controlword", 0x0F)
master.wait(0.03)
print(x.why())
assert x.why().startswith("ENABLE_OPERATION was refused in SWITCH_ON_DISABLED")

# %% [markdown]
# **A fault whose cause is still present.** Over-voltage trips the drive. A fault reset is a rising
# edge of bit 7, and it is refused as long as the cause is present.

# %%
begin("fault")
master.enable()
master.wait(0.03)
x.inject("overvoltage")
master.wait(0.03)
print(x.state.name, x.fault)
for controlword in (0x00, 0x80):
    master.control(controlword)
master.wait(0.03)
print(x.why())
assert "OVERVOLTAGE" in x.why()
x.clear_injected()
master.reset_fault()

# %% [markdown]
# **An internal limit.** The axis is homed, its upper software limit is 80 mm (607Dh), and the
# target lies beyond it. The drive moves to the limit and sets bit 11; object 2011h names the limit.

# %%
begin("limit")
master.enable()
x.write("home_offset", 0)
master.home(37)  # the present position becomes zero
x.write("max_position_limit", 80_000)
x.write("modes_of_operation", Mode.PROFILE_POSITION)
x.write("target_position", 200_000)
for controlword in (0x0F, 0x1F):
    master.control(controlword)
    master.wait(0.002)
master.wait(0.4)
active = [limit.name for limit in Limit if x.read("active_limits") & limit]
print(x.describe(), "|", *active, "|", x.read("position_actual_value"), "µm")
assert active == ["SOFTWARE_POSITION_MAX"]

# %% [markdown]
# **A following error.** With 15 % of the rated torque the motor cannot follow its own profile. The
# error exceeds its window of 1 mm for longer than 10 ms, and the drive trips.

# %%
begin("following error")
x.write("max_torque", 150)  # per mille of rated torque
x.write("target_position", 0)
for controlword in (0x0F, 0x1F):
    master.control(controlword)
    master.wait(0.002)
master.wait(0.2)
print(x.state.name, x.fault)
fault = x.fault
assert fault.startswith("8611h")

# %% [markdown]
# **An abort code.** Each refused access to an object has the code of CiA 301 that an SDO would
# carry:

# %%
codes = []
for access in (
    lambda: x.write("statusword", 0),
    lambda: x.write("homing_method", 99),
    lambda: x.write("max_torque", 100_000),
    lambda: x.read(0x5FFF),
    lambda: x.read(0x607D, 7),
):
    try:
        access()
    except SdoAbort as abort:
        print(abort)
        codes.append(abort.code)
assert codes[:2] == [Abort.READ_ONLY, Abort.INVALID_VALUE]
assert codes[3:] == [Abort.NO_OBJECT, Abort.NO_SUBINDEX]

# %% [markdown]
# In the picture, the state strip stays grey where the command was refused and turns red at the two
# faults, bit 11 rises with the limits, and at the end the following error crosses its window.

# %%
picture.parent.mkdir(parents=True, exist_ok=True)
print(draw(trace.arrays(), phases, picture, "Four ways to be refused"))
