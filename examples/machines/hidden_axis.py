"""An unknown machine for lesson 12: a CANopen node in its own process.

    python hidden_axis.py SET_POINTS.csv MOVES.log [TORQUE_OFFSETS.csv]

It reads a table with one csp set-point per millisecond, as `servogym twin --plan` writes it, and
also plays the master: it maps PDOs by SDO, enables the drive and sends a set-point with each SYNC.
The bus is logged in the format of candump. SEED determines payload and friction, and the loops are
as soft as a careful service engineer leaves them.
"""

import csv
import struct
import sys
from pathlib import Path

import numpy as np

from servogym.drive.canopen.frame import Base, Frame
from servogym.drive.canopen.lockstep import LockStep
from servogym.drive.wire.bus import to_message
from servogym.drive.wire.log import LogFile
from servogym.envs import linear_axis
from servogym.envs.engine import parameters

SEED, NODE, NOISE = 12, 1, 0.4e-6  # m, standard deviation of the encoder
SOFT = {"velocity_gain": 0.3, "integral_time": 2.0, "position_gain": 0.4}  # times commissioned
RPDO = ((0x6040, 16), (0x607A, 32), (0x60B2, 16))
TPDO = ((0x6041, 16), (0x6064, 32), (0x6077, 16))
CSP = 8


def column(file, number):
    with open(file, encoding="utf-8") as text:
        return [int(row[number]) for row in list(csv.reader(text))[1:]]


rng = np.random.default_rng(SEED)
machine = linear_axis()
names = ("payload", "coulomb_friction", "viscous_friction")
nominal = parameters.get(machine, names)
hidden = {n: v * float(np.exp(rng.uniform(-0.9, 0.9))) for n, v in nominal.items()}
parameters.apply(machine, hidden)
parameters.apply(machine, {"encoder_noise": NOISE})
commissioned = parameters.get(machine, SOFT)
parameters.apply(machine, {name: share * commissioned[name] for name, share in SOFT.items()})

targets = column(sys.argv[1], 1)
torques = column(sys.argv[3], 1) if len(sys.argv) > 3 else [0] * len(targets)
machine.reset({"x": targets[0] * 1e-6})
machine.step()
bus = LockStep([machine])
link = bus.bus.join()
Path(sys.argv[2]).unlink(missing_ok=True)
log = LogFile(Path(sys.argv[2]))


def write(frame, received):
    message = to_message(frame)
    message.timestamp, message.is_rx = 1e-6 * bus.time + (1e-4 if received else 0.0), received
    message.channel = 0
    log(message)


def send(identifier, data):
    """Send a frame of the master and a SYNC, and log the answers of the node."""
    for frame in (Frame(identifier, data), Frame(Base.SYNC)):
        write(frame, False)
    link.send(Frame(identifier, data), bus.time)
    bus.sync()
    for frame in link.receive(bus.time):
        if frame.id != Base.SYNC:
            write(frame, True)


def download(index, subindex, value, size):
    head = {1: 0x2F, 2: 0x2B, 4: 0x23}[size]
    data = struct.pack("<BHB", head, index, subindex) + value.to_bytes(size, "little")
    send(0x600 + NODE, data.ljust(8, b"\0"))


for base, mapping, cob, rows in ((0x1400, 0x1600, 0x200, RPDO), (0x1800, 0x1A00, 0x180, TPDO)):
    download(base, 1, 0x80000000 | cob + NODE, 4)
    download(mapping, 0, 0, 1)
    for n, (index, bits) in enumerate(rows, 1):
        download(mapping, n, index << 16 | bits, 4)
    download(mapping, 0, len(rows), 1)
    download(base, 2, 1, 1)
    download(base, 1, cob + NODE, 4)
download(0x6060, 0, CSP, 1)
for index, subindex in ((0x60F9, 1), (0x60F9, 2), (0x60FB, 1)):  # upload its gains
    send(0x600 + NODE, struct.pack("<BHB", 0x40, index, subindex).ljust(8, b"\0"))
axis = machine.drives["x"].axis  # with an absolute encoder, which needs no homing
axis.zero_counts = round(
    float(axis.counts) - targets[0] * 1e-6 * machine.joint("x")[0] / float(axis.rad_per_increment)
)
axis.homed = 1
send(0, bytes([1, NODE]))
for word in (6, 7, 15):
    for _ in range(20):
        send(0x200 + NODE, struct.pack("<Hih", word, targets[0], 0))
for target, torque in zip(targets, torques, strict=True):
    send(0x200 + NODE, struct.pack("<Hih", 15, target, torque))
log.stop()
