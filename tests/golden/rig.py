"""A drive model on linear axes and the log of what passes between it and a master.

Each line of a log is ``(seconds) channel frame direction``: T from the master, R from the drives.
What a master cannot send, a fault from inside the drive, is a line too: its error code.
"""

import struct
from itertools import groupby

from servogym.drive.canopen.frame import parse
from servogym.drive.canopen.node import Node
from servogym.drive.ethercat.frame import Command, Datagram, pack, unpack
from servogym.drive.ethercat.segment import Segment
from servogym.drive.ethercat.slave import Slave
from servogym.drive.model.model import load
from servogym.envs.plants.linear_axis import linear_axis

CAUSE = 0x1FFF_FF00  # extended identifier without the node-id: the cause of a fault is there
PLACE = 0.12  # m, where the carriages stand in the beginning
MICRO = 1e6
AXES = {"bonfiglioli_act": {"feed_constant": 1e-3}}  # one without positions needs many turns


def machine(model, node_id):
    """A linear axis whose drive is as delivered; only what has no object is set for the motor."""
    axis = linear_axis(model, **AXES.get(model.name, {}))
    drive = axis.drives["x"]
    drive.node_id = node_id
    drive.reset()
    axis.reset(positions={"x": PLACE})
    return axis


def cause(drive, data):
    """Make the cause of the error code in `data` present, or take it away where there is none."""
    if not data:
        drive.clear_injected()
        return
    code = int.from_bytes(data, "little")
    fault = next(fault for fault in drive.model.faults if fault.code == code)
    drive.inject(fault.name or fault.cause)


class Rig:
    """Machines, their time and their log."""

    def __init__(self, model):
        self.model = load(model)
        self.machines = [machine(self.model, n + 1) for n in range(self.model.axes)]
        self.drives = [axis.drives["x"] for axis in self.machines]
        self.cycle = round(self.machines[0].cycle_time * MICRO)
        self.time = 0  # µs
        self.log = []

    def _write(self, channel, frame, direction):
        self.log.append(f"({self.time / MICRO:.6f}) {channel} {frame} {direction}")

    def step(self):
        """One position cycle."""
        for axis in self.machines:
            axis.step()
        self.time += self.cycle

    def replay(self, lines):
        """Do what the master of a log has done, until the time of its last line; -> own log."""
        entries = [_Entry(line) for line in lines]
        sent = groupby((e for e in entries if e.direction == "T"), key=lambda e: e.time)
        for time, group in [(time, [*group]) for time, group in sent]:
            self.until(time)
            self.send_again(group)
        self.until(entries[-1].time)
        return self.log

    def until(self, time):
        while self.time < time:
            self.step()


class _Entry:
    """A line of a log."""

    def __init__(self, line):
        time, self.channel, self.frame, self.direction = line.split()
        self.time = round(float(time[1:-1]) * MICRO)


class CanRig(Rig):
    """The drives as nodes of a CAN bus; a frame is answered a position cycle later."""

    def __init__(self, model):
        super().__init__(model)
        self.nodes = [Node(drive) for drive in self.drives]
        self.step()

    def step(self):
        """One position cycle, -> what the nodes send after it."""
        super().step()
        answers = []
        for node in self.nodes:
            for frame in node.poll(self.time):
                answers.append(frame)
                self._write("can0", frame, "R")
                for other in self.nodes:
                    if other is not node:
                        other.receive(frame, self.time)
        return answers

    def send(self, frame):
        """A frame of the master."""
        self._write("can0", f"{frame.id:08X}#{frame.data.hex()}" if frame.extended else frame, "T")
        if frame.extended and frame.id & CAUSE == CAUSE:
            cause(self.drives[(frame.id & 0xFF) - 1], frame.data)
        for node in self.nodes:
            node.receive(frame, self.time)

    def send_again(self, entries):
        for entry in entries:
            self.send(parse(entry.frame))


class EthercatRig(Rig):
    """The drive behind a slave controller, a register or a buffer at a time; answered at once.

    A line has what belongs to it and not the rest of a buffer: a telegram ends with its length.
    """

    SYNC_MANAGERS = struct.Struct("<8H")
    AL_CONTROL, AL_STATUS, SYNC_MANAGER = 0x0120, 0x0130, 0x0800
    STATION = 0  # position of the only slave

    def __init__(self, model):
        super().__init__(model)
        self.drive = self.drives[0]
        self.data = self.model.ethercat
        self.segment = Segment([Slave(self.drive)])
        self._take = {
            "al": self._al,  # AL Control -> AL Status, AL Status Code
            "sm": self._sync_managers,  # start and length of each
            "mailbox": self._mailbox,  # a telegram -> the telegrams that wait
            "frame": self._frame,  # outputs -> inputs
            "cause": lambda data: cause(self.drive, data),
        }

    def step(self):
        super().step()
        self.segment.publish(self.time * 1000)

    def send(self, channel, data):
        """Something of the master, -> the last answer."""
        self._write(channel, data.hex() or "-", "T")
        answer = b""
        for answer in self._take[channel](data) or ():
            self._write(channel, answer.hex() or "-", "R")
        return answer

    def send_again(self, entries):
        for entry in entries:
            self.send(entry.channel, bytes.fromhex(entry.frame.strip("-")))

    def _datagram(self, command, address, data):
        frame = pack([Datagram(command, self.STATION, address, bytes(data))])
        return unpack(self.segment.exchange(frame, self.time * 1000))[0]

    def _read(self, address, size):
        return self._datagram(Command.APRD, address, bytes(size))

    def _al(self, data):
        self._datagram(Command.APWR, self.AL_CONTROL, data.ljust(2, b"\0"))
        status = self._read(self.AL_STATUS, 6).data
        return (status[:1] + status[4:],)

    def _sync_managers(self, data):
        words = self.SYNC_MANAGERS.unpack(data)
        controls = (*self.data.mailbox_control, *self.data.control)
        for n, control in enumerate(controls):
            at = self.SYNC_MANAGER + 8 * n
            row = struct.pack("<HHBBB", *words[2 * n : 2 * n + 2], control, 0, 1)
            if self._read(at, 7).data[:5] != row[:5]:
                self._datagram(Command.APWR, at + 6, b"\0")
                self._datagram(Command.APWR, at, row)

    def _mailbox(self, data):
        out, out_length, in_, in_length = self.data.mailbox
        self._datagram(Command.APWR, out, data.ljust(out_length, b"\0"))
        while (answer := self._read(in_, in_length)).wkc:
            yield answer.data[: 6 + int.from_bytes(answer.data[:2], "little")]

    def _frame(self, data):
        self._datagram(Command.APWR, self.data.start[0], data)
        return (self._read(self.data.start[1], self.drive.tpdo_size).data,)


def rig(model):
    """The rig for the bus of a drive model."""
    return {"can": CanRig, "ethercat": EthercatRig}[load(model).bus](model)
