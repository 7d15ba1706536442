"""Masters that commission drives by a script: process data, SDO, error control."""

import struct

from golden.rig import CAUSE

from servogym.drive.canopen.frame import Frame
from servogym.drive.canopen.nmt import NmtCommand
from servogym.drive.ethercat import FRAME, AlState
from servogym.drive.words import State, state_of

OUTPUTS = struct.Struct("<Hbi")  # controlword, mode, target position
INPUTS = struct.Struct("<Hbi")  # statusword, mode display, position
OUTPUT_MAPPING = (0x6040_0010, 0x6060_0008, 0x607A_0020)
INPUT_MAPPING = (0x6041_0010, 0x6061_0008, 0x6064_0020)
MASTER = 0x7F  # node-id of the master's heartbeat
LOST = 300  # ms without heartbeat or guarding


class Station:
    """A drive as its master sees it."""

    def __init__(self, axis, node_id):
        self.axis = axis  # the machine, to look at what is true
        self.drive = axis.drives["x"]
        self.node_id = node_id
        self.controlword = self.mode = self.target = 0
        self.statusword = self.mode_display = self.position = 0
        self.emergencies = []  # error codes

    @property
    def outputs(self):
        return OUTPUTS.pack(self.controlword, self.mode, self.target)

    @property
    def state(self):
        return state_of(self.statusword)

    @property
    def faulty(self):
        """In FAULT, which some drives show as FAULT_REACTION_ACTIVE."""
        return self.state in (State.FAULT, State.FAULT_REACTION_ACTIVE)

    def take(self, image):
        self.statusword, self.mode_display, self.position = INPUTS.unpack(image)


class Master:
    """What both buses have in common."""

    PERIOD = 20  # ms of the process data

    def __init__(self, rig):
        self.rig = rig
        self.stations = [Station(axis, n + 1) for n, axis in enumerate(rig.machines)]
        self.running = False  # process data
        self.ticks = 0

    def wait(self, condition, what, seconds=10.0, stations=None):
        """Run until `condition` holds for all stations, but not before they can have reacted."""
        self.run(3)
        for _ in range(round(seconds * 1000 / self.PERIOD)):
            if all(map(condition, stations or self.stations)):
                return
            self.run(1)
        raise AssertionError(
            f"{what}: not within {seconds:g} s; "
            + "; ".join(f"{s.drive.describe()} {s.drive.fault}" for s in self.stations)
        )

    def set(self, stations=None, **outputs):
        """Change outputs of all stations, or of some."""
        for station in stations or self.stations:
            for name, value in outputs.items():
                assert hasattr(station, name)
                setattr(station, name, value)
            self.send_outputs(station)


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
        for frame in frames:
            self.rig.send(frame)
        syncs, rest = divmod(self.ticks, self._sync_ticks)
        if self.running and rest == 0:
            self.rig.send(Frame(0x080))
            if self.guards and syncs % self.GUARDED == 0:
                for frame in self._error_control():
                    self.rig.send(frame)
        self.ticks += 1
        answers = self.rig.step()
        for frame in answers:
            self._take(frame)
        return answers

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

    def write(self, station, index, subindex, data):
        """Expedited download."""
        head = struct.pack("<BHB", 0x23 | 4 - len(data) << 2, index, subindex)
        answer = self._ask(station, head + data.ljust(4, b"\0"))
        assert answer[0] == 0x60, f"{index:04X}h:{subindex:02X}h := {data.hex()}: {answer.hex()}"

    def read(self, station, index, subindex):
        """Expedited upload."""
        answer = self._ask(station, struct.pack("<BHB4x", 0x40, index, subindex))
        assert answer[0] & 0xF3 == 0x43, f"{index:04X}h:{subindex:02X}h: {answer.hex()}"
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

    def write(self, station, index, subindex, data):
        command = {1: 0x2F, 2: 0x2B, 3: 0x27, 4: 0x23}[len(data)]
        reply, rest = self._ask(command, index, subindex, data.ljust(4, b"\0"))
        assert reply == 0x60, f"{index:04X}h:{subindex:02X}h := {data.hex()}: {rest.hex()}"

    def read(self, station, index, subindex):
        reply, data = self._ask(0x40, index, subindex)
        assert reply & 0xF3 == 0x43, f"{index:04X}h:{subindex:02X}h: {data.hex()}"
        return data[: 4 - (reply >> 2 & 3)]

    def boot(self):
        """INIT to PRE_OPERATIONAL: with a mailbox."""
        self._to(AlState.PRE_OPERATIONAL)

    def _to(self, state):
        slave = self.rig.slave
        slave.configure()  # what a master knows from the description file
        words = [word for pair in slave.sync_managers for word in pair]
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
