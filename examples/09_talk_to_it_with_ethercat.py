# %% [markdown]
# # 9 · Talk to it with EtherCAT
#
# A master sends frames to a Kollmorgen AKD behind an EtherCAT slave controller: scan, states, SDO
# and process data. Everything happens in memory, so the lesson runs identically each time. On a
# wire, `servogym ethercat -i eth0 --drive kollmorgen_akd` answers any master, such as pysoem or
# SOEM, with the same bytes.

# %%
import sys
from pathlib import Path

import matplotlib.pyplot as plt

from servogym.drive.ethercat.bus import Bus
from servogym.drive.ethercat.frame import BROADCAST, Command, Datagram, pack, unpack
from servogym.drive.ethercat.master import EtherCatMaster
from servogym.drive.ethercat.port import EtherCatPort
from servogym.drive.ethercat.segment import Segment
from servogym.drive.ethercat.slave import Slave
from servogym.drive.kernel.words import state_of
from servogym.drive.master import Master, Units
from servogym.drive.model.model import load
from servogym.drive.objects.abort import SdoAbort
from servogym.envs import linear_axis

picture = Path(
    next((a for a in sys.argv if a.endswith(".png")), "out/09_talk_to_it_with_ethercat.png")
)

# %% [markdown]
# The drive moves a linear axis. A segment is a line of slaves, here with a single one. The bus runs
# the machine: with the clock `frame`, each frame of process data runs one cycle of 60C2h.

# %%
model = load("kollmorgen_akd", "ethercat")
machine = linear_axis(model)
machine.reset(positions={"x": 0.25})
bus = Bus(Segment([Slave(machine.drives["x"])]), [machine], clock="frame")

# %% [markdown]
# The first frame is made by hand: BRD reads the register AL Status (0130h) of all slaves at once.
# The working counter of the reply is the number of slaves; the status 1 means INIT.

# %%
request = pack([Datagram(Command.BRD, 0, 0x0130, bytes(2))])
assert request[:6] == BROADCAST
(reply,) = unpack(bus.exchange(request))
print(f"{reply.wkc} slave, AL Status {reply.data.hex()}")

# %% [markdown]
# A master does the rest. It reads name, mailboxes and PDOs from the EEPROM, and takes the slave to
# PRE_OP, in which the mailbox works. A refusal of the drive is an abort code.

# %%
master = EtherCatMaster(bus)
(slave,) = master.scan()
device = slave.description
print(f"{device.name}: vendor {device.vendor_id:X}h, product {device.product_code:X}h")
for pdo in device.assigned(2) + device.assigned(3):
    print(f"  {pdo.name}: {', '.join(entry.name for entry in pdo.entries)}")
master.to_preop()
print(slave.mailbox.upload(0x1008, 0).decode())
try:
    slave.mailbox.download(0x6041, 0, bytes(2))
except SdoAbort as error:
    refusal = error
    print(f"refused: {error}")

# %% [markdown]
# The master that commands drives on CANopen and in memory also works here. Its port maps
# controlword, target and mode to the outputs and takes the slave through SAFE_OP to OP. From then
# on a frame circulates every millisecond: LRW writes outputs and reads inputs at once.

# %%
port = EtherCatPort(master, {"x": model}, units=Units(1e-6, 1e-6, "m"))
axis = Master(port)
times, places, statuswords = [], [], []
exchange = port.exchange


def recorded() -> bool:
    right = exchange()
    times.append(bus.time * 1e-9)
    places.append(port.read("x", "position_actual_value") * 1e-6)
    statuswords.append(port.read("x", "statusword"))
    return right


port.exchange = recorded
axis.enable()
enabled = len(times)
axis.home(17)
homed = len(times)
for target in (0.3, 0.1):
    axis.move_to(target)
axis.disable()
print(f"{bus.statistics.cycles} frames of process data, {master.wrong} with a wrong counter")
assert abs(places[-1] - 0.1) < 1e-4

# %% [markdown]
# The picture shows the position of the axis from the inputs, and the states of the drive from the
# statusword in the same frames.

# %%
figure, (above, below) = plt.subplots(
    2, 1, figsize=(11, 6), sharex=True, height_ratios=(3, 1), layout="constrained"
)
above.plot(times, places)
for n, text in ((enabled, "enabled"), (homed, "homed")):
    above.axvline(times[n], color="0.6", lw=0.8)
    above.annotate(text, (times[n], max(places)), xytext=(3, 0), textcoords="offset points")
above.set(ylabel="position (m)", title="an AKD on EtherCAT: enable, home by method 17, two moves")
states = [state_of(word) for word in statuswords]
names = [state.name for state in dict.fromkeys(states) if state is not None]
below.plot(times, [names.index(state.name) for state in states], drawstyle="steps-post")
below.set(xlabel="time of the bus (s)")
below.set_yticks(range(len(names)), names)
for panel in (above, below):
    panel.grid(alpha=0.3)
picture.parent.mkdir(parents=True, exist_ok=True)
figure.savefig(picture, dpi=110)
print(picture)
