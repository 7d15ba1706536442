"""A CANopen master for the script: SDO, NMT, SYNC, PDOs, heartbeat or node guarding."""

import struct

from golden.master import INPUT_MAPPING, OUTPUT_MAPPING, Master
from golden.rig import CAUSE

from servogym.drive.canopen.frame import Frame
from servogym.drive.canopen.nmt import NmtCommand

MASTER = 0x7F  # node-id of the master's heartbeat
LOST = 300  # ms without heartbeat or guarding


class CanMaster(Master):
    """SYNC and error control from `start` on, RPDO 1 whenever an output has changed."""

    GUARDED = 5  # SYNCs from one heartbeat or guarding request to the next

    def __init__(self, rig):
        super().__init__(rig)
        self.guards = True
        self.family = rig.model.quirk("identifier_needs_valid_bit")
        self._sync_ticks = round(self.PERIOD * 1000 / rig.cycle)

    def tick(self, *frames):
        """Send frames, let a position cycle pass, -> frames of the drives."""
        for frame in (*frames, *(self._due() if self.running else ())):
            self.rig.send(frame)
        self.ticks += 1
        answers = self.rig.step()
        for frame in answers:
            self._take(frame)
        return answers

    def _due(self):
        """SYNC, and with some of them error control."""
        syncs, rest = divmod(self.ticks, self._sync_ticks)
        if rest:
            return []
        guards = self.guards and syncs % self.GUARDED == 0
        return [Frame(0x080), *(self._error_control() if guards else ())]

    def _error_control(self):
        if not self.family:
            return [Frame(0x700 + MASTER, b"\5")]
        return [Frame(0x700 + s.node_id, remote=True) for s in self.stations]

    def _take(self, frame):
        service, node_id = frame.id & 0x780, frame.id & 0x7F
        if service == 0x180:
            self.stations[node_id - 1].take(frame.data)
        elif service == 0x080 and node_id:
            self.stations[node_id - 1].emergencies.append(int.from_bytes(frame.data[:2], "little"))

    def run(self, periods):
        for _ in range(periods * self._sync_ticks):
            self.tick()

    def send_outputs(self, station):
        self.tick(Frame(0x200 + station.node_id, station.outputs))

    def _ask(self, station, request):
        """One SDO request, -> its answer."""
        answers = self.tick(Frame(0x600 + station.node_id, request))
        for _ in range(10):
            for frame in answers:
                if frame.id == 0x580 + station.node_id:
                    return frame.data
            answers = self.tick()
        raise AssertionError(f"no answer to {request.hex()}")

    def download(self, station, index, subindex, data):
        """Expedited download, -> command specifier and data of the answer."""
        head = struct.pack("<BHB", 0x23 | 4 - len(data) << 2, index, subindex)
        answer = self._ask(station, head + data.ljust(4, b"\0"))
        return answer[0], answer[4:]

    def read(self, station, index, subindex):
        """Expedited upload; an answer without the size has four bytes."""
        answer = self._ask(station, struct.pack("<BHB4x", 0x40, index, subindex))
        assert answer[0] & 0xF2 == 0x42, f"{index:04X}h:{subindex:02X}h: {answer.hex()}"
        return answer[4 : 8 - (answer[0] >> 2 & 3)]

    def nmt(self, command, node_id=0):
        self.tick(Frame(0x000, bytes([command, node_id])))

    def prepare(self, station):
        """PDO 1 of each direction, in the order that the stricter drives want, and error control.

        Identifier off, number of entries 0, entries, number, transmission type, identifier on.
        """
        for communication, mapping, base, words, kind in (
            (0x1400, 0x1600, 0x200, OUTPUT_MAPPING, 254),
            (0x1800, 0x1A00, 0x4000_0180, INPUT_MAPPING, 1),
        ):
            cob_id = base + station.node_id
            self.write(station, communication, 1, struct.pack("<I", 0x8000_0000 | cob_id))
            self.write(station, mapping, 0, b"\0")
            for n, word in enumerate(words):
                self.write(station, mapping, n + 1, struct.pack("<I", word))
            self.write(station, mapping, 0, bytes([len(words)]))
            self.write(station, communication, 2, bytes([kind]))
            self.write(station, communication, 1, struct.pack("<I", cob_id))
        if self.family:
            self.write(station, 0x100C, 0, struct.pack("<H", LOST))
            self.write(station, 0x100D, 0, b"\1")
        else:
            self.write(station, 0x1016, 1, struct.pack("<I", MASTER << 16 | LOST))

    def start(self):
        """OPERATIONAL; again after a loss of the master."""
        self.nmt(NmtCommand.START)
        self.ticks = 0
        self.running = True

    def end(self):
        self.running = False
        self.nmt(NmtCommand.STOP)
        for station in self.stations:
            self.tick(Frame(0x700 + station.node_id, remote=True))
        self.nmt(NmtCommand.RESET_NODE)

    def cause(self, station, code=None):
        data = b"" if code is None else struct.pack("<H", code)
        self.tick(Frame(CAUSE + station.node_id, data, extended=True))
