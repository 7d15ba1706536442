"""Machines with hidden parameters, and logs of their buses as a master and a logger make them."""

import struct

import numpy as np
import ruckig

from servogym.drive.canopen.frame import Base, Frame
from servogym.drive.canopen.lockstep import LockStep
from servogym.drive.wire.bus import to_message
from servogym.drive.wire.log import LogFile
from servogym.envs.engine import parameters

NODE = 1
RPDO = (("controlword", 0x6040, 16), ("modes_of_operation", 0x6060, 8),
        ("target_position", 0x607A, 32))
TPDO = (("statusword", 0x6041, 16), ("position_actual_value", 0x6064, 32),
        ("torque_actual_value", 0x6077, 16))


def moves(rng, seconds, period, *, low=0.05, high=0.45, speed=(0.1, 0.8), acceleration=(2, 10),
          jerk=(100, 1000), rest=0.06):
    """Point-to-point moves with rests, one set-point a period (m)."""
    here = 0.5 * (low + high)
    parts, count = [np.full(round(0.05 / period), here)], 0
    while count * period < seconds:
        goal = rng.uniform(low, high)
        if abs(goal - here) < 0.1 * (high - low):
            continue
        wanted, trajectory = ruckig.InputParameter(1), ruckig.Trajectory(1)
        wanted.current_position, wanted.target_position = [here], [goal]
        wanted.max_velocity = [rng.uniform(*speed)]
        wanted.max_acceleration = [rng.uniform(*acceleration)]
        wanted.max_jerk = [rng.uniform(*jerk)]
        ruckig.Ruckig(1).calculate(wanted, trajectory)
        times = np.arange(0, trajectory.duration, period)
        parts += [np.array([trajectory.at_time(t)[0][0] for t in times]),
                  np.full(round(rest / period), goal)]
        here, count = goal, sum(map(len, parts))
    return np.concatenate(parts)[: round(seconds / period)]


class Node:
    """A machine as a node in simulated time, a master that configures it, and a logger."""

    def __init__(self, machine, file, rng, *, period=1e-3, dropped=0.0, jitter=0.0):
        self.machine, self.file = machine, file
        self._log = LogFile(file)
        self._rng, self._dropped, self._jitter = rng, dropped, jitter
        machine.step()
        self.lockstep = LockStep([machine], round(period * 1e6))
        self._link = self.lockstep.bus.join()
        self._cyclic = False

    def write(self, frame, from_node=False):
        if self._cyclic and self._rng.random() < self._dropped:
            return
        message = to_message(frame)
        late = self._rng.uniform(0, self._jitter) if self._cyclic else 0.0
        message.timestamp = 1000.0 + self.lockstep.time * 1e-6 + late + (1e-4 if from_node else 0)
        message.is_rx = from_node
        message.channel = 0
        self._log(message)

    def send(self, identifier, data):
        frame = Frame(identifier, bytes(data))
        self.write(frame)
        self._link.send(frame, self.lockstep.time)

    def turn(self):
        """A SYNC, and what the node answers to it."""
        self.write(Frame(Base.SYNC))
        self.lockstep.sync()
        for frame in self._link.receive(self.lockstep.time):
            if frame.id != Base.SYNC:
                self.write(frame, True)

    def download(self, index, subindex, value, size):
        head = {1: 0x2F, 2: 0x2B, 4: 0x23}[size]
        data = struct.pack("<BHB", head, index, subindex) + (value & (1 << 8 * size) - 1).to_bytes(
            size, "little"
        )
        self.send(0x600 + NODE, data.ljust(8, b"\0"))
        self.turn()

    def configure(self):
        for base, mapping, cob, rows in ((0x1400, 0x1600, 0x200, RPDO), (0x1800, 0x1A00, 0x180,
                                                                          TPDO)):
            self.download(base, 1, 0x80000000 | cob + NODE, 4)
            self.download(mapping, 0, 0, 1)
            for n, (_, index, bits) in enumerate(rows, 1):
                self.download(mapping, n, index << 16 | bits, 4)
            self.download(mapping, 0, len(rows), 1)
            self.download(base, 2, 1, 1)
            self.download(base, 1, cob + NODE, 4)
        self.send(0, bytes([1, NODE]))
        self.turn()

    def command(self, controlword, mode, target):
        self.send(0x200 + NODE, struct.pack("<Hbi", controlword, mode, target))
        self.turn()

    def position(self):
        return int(self.machine.drives["x"].axis.od.position_actual_value)

    def enable(self, mode):
        for word in (6, 7, 15):
            for _ in range(5):
                self.command(word, mode, self.position())
        self._cyclic = True

    def close(self):
        self._log.stop()
        return self.file


def hide(machine, rng, names, spread=1.0, drive=None):
    """Give a drive of a machine other parameters, each by a factor; -> what they are."""
    nominal = parameters.get(machine, names, drive)
    hidden = {name: v * float(np.exp(rng.uniform(-spread, spread))) for name, v in nominal.items()}
    parameters.apply(machine, hidden, drive)
    return hidden


def csp_log(machine, file, rng, *, seconds=4.0, period=1e-3, noise=0.5e-6, home=True, dropped=0.0,
            jitter=0.0, places=None, **shape):
    """Moves in csp with hidden noise, recorded by a logger with clock jitter; -> the file."""
    parameters.apply(machine, {"encoder_noise": noise})
    machine.couplings["noise_state"] = int(rng.integers(1, 2**62))
    if places is None:
        places = moves(rng, seconds, period, **shape)
    set_points = np.round(places * 1e6).astype(int)
    machine.reset({"x": set_points[0] * 1e-6})
    node = Node(machine, file, rng, period=period, dropped=dropped, jitter=jitter)
    drive = machine.drives["x"]
    node.configure()
    if home:  # at its place, as an absolute encoder
        drive.axis.zero_counts = round(
            float(drive.axis.counts)
            - set_points[0] * 1e-6 * machine.joint("x")[0] / float(drive.axis.rad_per_increment)
        )
        drive.axis.homed = 1
        node.turn()
    node.download(0x60C2, 2, -4 if period < 1e-3 else -3, 1)
    node.download(0x60C2, 1, round(period * (1e4 if period < 1e-3 else 1e3)), 1)
    node.download(0x6065, 0, 1_000_000, 4)
    node.enable(8)
    for target in set_points:
        node.command(15, 8, int(target))
    return node.close()
