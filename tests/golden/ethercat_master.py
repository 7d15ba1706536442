"""An EtherCAT master for the script: AL states, sync managers, CoE mailbox, process data."""

import struct

from golden.master import INPUT_MAPPING, OUTPUT_MAPPING, Master

from servogym.drive.ethercat.al import AlState

FRAME = struct.Struct("<HHBBHBHB4s")  # an expedited SDO: mailbox header, CoE header, SDO


class EthercatMaster(Master):
    """A frame every 10 ms from `start` on."""

    PERIOD = 10

    def tick(self, channel, data):
        answer = self.rig.send(channel, data)
        self.rig.step()
        return answer

    def run(self, periods):
        for _ in range(periods):
            end = self.rig.time + self.PERIOD * 1000
            if self.running:
                image = self.rig.send("frame", self.stations[0].outputs)
                self.stations[0].take(image)
            self.rig.until(end)

    def send_outputs(self, station):
        self.run(1)

    def _ask(self, command, index, subindex, data=bytes(4)):
        request = FRAME.pack(10, 0, 0, 3, 2 << 12, command, index, subindex, data)
        answer = FRAME.unpack(self.tick("mailbox", request))
        return answer[5], answer[8]

    def download(self, station, index, subindex, data):
        command = {1: 0x2F, 2: 0x2B, 3: 0x27, 4: 0x23}[len(data)]
        return self._ask(command, index, subindex, data.ljust(4, b"\0"))

    def read(self, station, index, subindex):
        reply, data = self._ask(0x40, index, subindex)
        assert reply & 0xF3 == 0x43, f"{index:04X}h:{subindex:02X}h: {data.hex()}"
        return data[: 4 - (reply >> 2 & 3)]

    def boot(self):
        """INIT to PRE_OPERATIONAL: with a mailbox."""
        self._to(AlState.PRE_OPERATIONAL)

    def _to(self, state):
        rig = self.rig
        sizes = (rig.drive.rpdo_size, rig.drive.tpdo_size)
        words = [*rig.data.mailbox]  # what a master knows from the description file
        for start, size in zip(rig.data.start, sizes, strict=True):
            words += [start, size]
        self.tick("sm", self.rig.SYNC_MANAGERS.pack(*words))
        assert self.tick("al", bytes([state])) == bytes([state, 0, 0])

    def prepare(self, station):
        """Flexible mapping 1600h and 1A00h, and the period of the frames."""
        for assignment, mapping, words in (
            (0x1C12, 0x1600, OUTPUT_MAPPING),
            (0x1C13, 0x1A00, INPUT_MAPPING),
        ):
            self.write(station, assignment, 0, b"\0")
            self.write(station, mapping, 0, b"\0")
            for n, word in enumerate(words):
                self.write(station, mapping, n + 1, struct.pack("<I", word))
            self.write(station, mapping, 0, bytes([len(words)]))
            self.write(station, assignment, 1, struct.pack("<H", mapping))
            self.write(station, assignment, 0, b"\1")
        self.write(station, 0x60C2, 1, bytes([self.PERIOD]))

    def start(self):
        self._to(AlState.SAFE_OPERATIONAL)
        self._to(AlState.OPERATIONAL)
        self.running = True

    def end(self):
        self.running = False
        for state in (AlState.SAFE_OPERATIONAL, AlState.PRE_OPERATIONAL, AlState.INIT):
            self._to(state)

    def cause(self, station, code=None):
        self.tick("cause", b"" if code is None else struct.pack("<H", code))
