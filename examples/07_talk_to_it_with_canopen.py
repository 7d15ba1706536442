# %% [markdown]
# # 7 · Talk to it with `canopen`
#
# The drive is also a CANopen node. Here the library `canopen`, which knows nothing about servogym,
# is the master: its `BaseNode402` enables the drive, homes it and moves it in real time, on a
# virtual bus of python-can. With another interface the same lines command a real drive.

# %%
import sys
import threading
import time
from pathlib import Path

import can
import canopen
import matplotlib.pyplot as plt
from canopen.profiles.p402 import BaseNode402

from servogym.drive.canopen.decode import Decoder
from servogym.drive.canopen.eds import object_dictionary
from servogym.drive.canopen.frame import parse
from servogym.drive.wire.server import Server
from servogym.envs.plants.catalogue import axis_for

picture = Path(
    next((a for a in sys.argv if a.endswith(".png")), "out/07_talk_to_it_with_canopen.png")
)
BUS = {"interface": "virtual", "channel": "servogym-lesson-7"}

# %% [markdown]
# Three members share the bus: the drive as node 5, served by a thread; a listener that only
# records; and the library. In a shell, `servogym node --node-id 5 -i udp_multicast -c
# 239.74.163.2` starts the first one.

# %%
server = Server(can.Bus(**BUS), [axis_for("generic", 5)])
recorder = can.Bus(**BUS)
thread = threading.Thread(target=server.run)
thread.start()
network = canopen.Network()
network.connect(**BUS)
node = BaseNode402(5, object_dictionary("generic", 5))
network.add_node(node)


def until(condition, what: str) -> None:
    """Wait for a condition while the drive moves in real time."""
    end = time.monotonic() + 10.0
    while not condition():
        if time.monotonic() > end:
            raise TimeoutError(what)
        time.sleep(0.005)


# %% [markdown]
# In pre-operational the event timer of TPDO1 is set, so that the statusword is sent every 20 ms.
# The node then becomes operational; the drive is enabled, homed by method 34 (the index pulse), and
# moved by 30 mm in profile position mode.

# %%
try:
    node.nmt.state = "PRE-OPERATIONAL"
    node.sdo[0x1800][5].raw = 20  # ms
    node.setup_402_state_machine()
    node.nmt.state = "OPERATIONAL"
    until(lambda: node.state == "SWITCH ON DISABLED", "switch on disabled")
    node.sdo["homing_method"].raw = 34
    node.sdo[0x6099][2].raw = 50_000  # µm/s, search for zero
    assert node.homing(timeout=30)
    node.controlword = 0x0F
    node.op_mode = "PROFILED POSITION"
    node.state = "OPERATION ENABLED"
    start = node.sdo["position_actual_value"].raw
    target = start + 30_000  # µm
    node.sdo["target_position"].raw = target
    until(lambda: not node.statusword & 0x1000, "set-point acknowledge to fall")
    node.controlword = 0x1F  # new set-point
    until(lambda: node.statusword & 0x1000, "set-point acknowledge")
    node.controlword = 0x0F
    until(lambda: node.check_statusword() & 0x1400 == 0x400, "target reached")
    reached = node.sdo["position_actual_value"].raw
finally:
    network.disconnect()
    server.stop()
    thread.join(5)
    server.close()
print(f"from {start} to {reached} µm, {server.statistics.missed} deadlines missed")
assert abs(reached - target) < 50

# %% [markdown]
# These are the decoded frames of the bus. `servogym decode` does the same with a log; this lesson
# writes one if you give it a name such as `run.log`.

# %%
messages = []
while (message := recorder.recv(timeout=0)) is not None:
    messages.append(message)
recorder.shutdown()
for log in (argument for argument in sys.argv[1:] if argument.endswith(".log")):
    with can.CanutilsLogWriter(log) as writer:
        for message in messages:
            writer(message)
decoder = Decoder("generic", [5])
kinds: dict[str, list[float]] = {}
last = ""
for message in messages:
    text = decoder.decode(parse(f"{message.arbitration_id:03X}#{message.data.hex()}"))
    kinds.setdefault(text.split()[0], []).append(message.timestamp - messages[0].timestamp)
    if "PDO" in text.split()[0] and text != last:  # without repetitions
        print(f"{message.timestamp - messages[0].timestamp:7.3f} s  {text}")
        last = text

# %% [markdown]
# In the picture each frame is a stroke in the row of its service: first configuration by SDO, then
# PDOs, with controlwords from the master and statuswords from the drive.

# %%
figure, panel = plt.subplots(figsize=(11, 4.5), layout="constrained")
for row, times in enumerate(kinds.values()):
    panel.vlines(times, row - 0.35, row + 0.35, color=f"C{row}", lw=1)
panel.set_yticks(range(len(kinds)), [f"{kind} ({len(times)})" for kind, times in kinds.items()])
panel.set(xlabel="time (s)", title="frames of node 5 on the bus: enable, home, move by 30 mm")
panel.invert_yaxis()
panel.grid(axis="x", alpha=0.3)
picture.parent.mkdir(parents=True, exist_ok=True)
figure.savefig(picture, dpi=110)
print(picture)
