"""A drive on a shaft behind a slave controller, commanded by single frames, as a master would."""

import struct

from bare_segment import addressed, fprd, fpwr

from conftest import Shaft
from servogym.drive.ethercat.al import AlState
from servogym.drive.ethercat.mailbox import HEADER, Kind
from servogym.drive.ethercat.mailbox import pack as telegram
from servogym.drive.ethercat.segment import Segment
from servogym.drive.ethercat.slave import Slave

I, P, B, S, O = AlState  # noqa: E741
PATH = {I: (), B: (B,), P: (P,), S: (P, S), O: (P, S, O)}


class Wired:
    """One slave; times are ns and stand still unless a test moves them."""

    def __init__(self, model="generic", *, mailbox=None, **arguments):
        self.shaft = Shaft(model, bus="ethercat", **arguments)
        self.drive = self.shaft.drive
        self.data = self.drive.model.ethercat
        self.slave = Slave(self.drive)
        self.segment = addressed(Segment([self.slave]))
        self.now = 0
        self.counter = 0
        out, out_length, in_, in_length = self.data.mailbox
        self.out, self.in_ = out, in_
        self.lengths = mailbox or (out_length, in_length)

    def power_cycle(self):
        """Off and on again; the master gives the station address anew."""
        self.segment.power(0, False)
        self.segment.power(0, True, self.now)
        addressed(self.segment)

    # ------------------------------------------------------------- registers

    def read(self, address, size):
        return fprd(self.segment, 0, address, size, self.now)

    def write(self, address, data):
        return fpwr(self.segment, 0, address, bytes(data), self.now).wkc

    def register(self, address, size=2):
        return int.from_bytes(self.read(address, size).data, "little")

    def sync_manager(self, n, start, length, control, enable=1):
        self.write(0x0806 + 8 * n, [0])
        self.write(0x0800 + 8 * n, struct.pack("<HHBBB", start, length, control, 0, enable))

    def configure(self, *, boot=False):
        """Sync managers as the model wants them."""
        out, out_length, in_, in_length = self.data.bootstrap if boot else self.data.mailbox
        if not boot:
            out_length, in_length = self.lengths
        control = self.data.mailbox_control
        if self.slave.state == I:
            self.sync_manager(0, out, out_length, control[0])
            self.sync_manager(1, in_, in_length, control[1])
        sizes = self.drive.rpdo_size, self.drive.tpdo_size
        if self.slave.state == P:
            for n, (start, size) in enumerate(zip(self.data.start, sizes, strict=True), 2):
                self.sync_manager(n, start, size, self.data.control[n - 2], int(size > 0))

    def request(self, state, flags=0):
        """Write AL Control; -> AL Status and code."""
        assert self.write(0x0120, [state | flags, 0]) == 1
        return self.register(0x0130), self.register(0x0134)

    def to(self, *states):
        """Go there on the way of a master."""
        for state in states:
            self.configure(boot=state == B)
            assert self.request(state) == (state, 0)
        return self

    # --------------------------------------------------------------- mailbox

    def send(self, kind, body, *, counter=None, address=0):
        """Fill SM0."""
        if counter is None:
            self.counter = counter = self.counter % 7 + 1
        data = telegram(kind, body, counter, address)
        return self.write(self.out, data.ljust(self.lengths[0], b"\0"))

    def fetch(self):
        """Empty SM1: type and body, None where there is nothing."""
        answer = self.read(self.in_, self.lengths[1])
        if not answer.wkc:
            return None
        length, _, _, kind = HEADER.unpack_from(answer.data)
        return Kind(kind & 15), answer.data[HEADER.size : HEADER.size + length]

    def ask(self, kind, body):
        """One request and its one answer."""
        assert self.send(kind, body) == 1
        answer = self.fetch()
        assert answer is not None, "silence"
        assert self.fetch() is None, "more than one answer"
        return answer

    # ------------------------------------------------------------------- SDO

    def sdo(self, command, index, subindex=0, data=b""):
        """A SDO request: command, and what follows index and sub-index in the answer."""
        body = struct.pack("<HBHB", 0x2000, command, index, subindex) + data.ljust(4, b"\0")
        kind, answer = self.ask(Kind.COE, body)
        assert kind == Kind.COE
        service, reply, *address = struct.unpack_from("<HBHB", answer)
        assert address == [index, subindex]
        assert service == (0x2000 if reply == 0x80 else 0x3000)
        return reply, answer[6:]

    def segment_request(self, command, data=b"", size=7):
        body = struct.pack("<HB", 0x2000, command) + data.ljust(size, b"\0")
        kind, answer = self.ask(Kind.COE, body)
        assert kind == Kind.COE
        return answer[2], answer[3:]

    def upload(self, index, subindex=0, *, complete=False):
        """The bytes of an object, or the abort code."""
        reply, data = self.sdo(0x50 if complete else 0x40, index, subindex)
        if reply == 0x80:
            return struct.unpack("<I", data)[0]
        if reply & 2:
            return data[: 4 - (reply >> 2 & 3)]
        (total,) = struct.unpack_from("<I", data)
        value, toggle = data[4:], 0
        while len(value) < total:
            reply, part = self.segment_request(0x60 | toggle)
            assert reply & 0xF0 == toggle
            if len(part) == 7:
                part = part[: 7 - (reply >> 1 & 7)]
            value += part
            assert bool(reply & 1) == (len(value) >= total)
            toggle ^= 0x10
        assert len(value) == total
        return value

    def download(self, index, subindex, data, *, complete=False, normal=False):
        """The abort code of a download, 0 where it was accepted."""
        flag = 0x10 if complete else 0
        if len(data) <= 4 and not (complete or normal):
            reply, rest = self.sdo(0x23 | (4 - len(data)) << 2, index, subindex, data)
            return struct.unpack("<I", rest)[0] if reply == 0x80 else 0
        room = self.lengths[0] - 16
        head = struct.pack("<I", len(data))
        reply, rest = self.sdo(0x21 | flag, index, subindex, head + data[:room])
        at, toggle = room, 0
        while reply != 0x80 and at < len(data):
            part = data[at : at + self.lengths[0] - 9]
            at += len(part)
            last = int(at >= len(data))
            unused = max(7 - len(part), 0)
            reply, rest = self.segment_request(toggle | unused << 1 | last, part)
            assert reply == 0x80 or reply == 0x20 | toggle
            toggle ^= 0x10
            if reply == 0x80:
                rest = rest[3:]
        return struct.unpack("<I", rest[:4])[0] if reply == 0x80 else 0

    def write8(self, index, subindex, value):
        return self.download(index, subindex, bytes([value]))

    def write16(self, index, subindex, value):
        return self.download(index, subindex, struct.pack("<H", value))

    def write32(self, index, subindex, value):
        return self.download(index, subindex, struct.pack("<I", value))

    def assign(self, outputs, inputs):
        """PDOs of sync managers 2 and 3."""
        for index, pdos in ((0x1C12, outputs), (0x1C13, inputs)):
            assert self.write8(index, 0, 0) == 0
            for n, pdo in enumerate(pdos, 1):
                assert self.write16(index, n, pdo) == 0
            assert self.write8(index, 0, len(pdos)) == 0

    # ---------------------------------------------------------- process data

    def outputs(self, image):
        return self.write(self.data.start[0], image)

    def inputs(self):
        return self.read(self.data.start[1], self.drive.tpdo_size)

    def cycle(self, image=None, cycles=1):
        """Outputs, drive time, inputs."""
        if image is not None:
            self.outputs(image)
        self.shaft.step(cycles)
        self.segment.publish(self.now)
        return self.inputs().data
