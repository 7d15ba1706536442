"""The script of a frequency inverter: velocities instead of homing and moves, and its parameters.

Source of what is checked: Bonfiglioli ACT, CANopen manual, 7, 8.1.12, 8.2.1, 8.6, 8.7 and 9.2.
"""

import math
import struct

from golden.can_master import MASTER, CanMaster
from golden.master import Station

from servogym.drive.canopen.frame import Frame
from servogym.drive.kernel.words import Controlword as C
from servogym.drive.kernel.words import State, state_of
from servogym.drive.kernel.words import Statusword as S
from servogym.drive.objects.abort import Abort

SHUTDOWN, SWITCH_ON, ENABLE, QUICK_STOP = 0x06, 0x07, 0x0F, 0x02
LOST = 1200  # ms without heartbeat
LOCK = 15_000  # ms from a fault to the earliest reset
OVERVOLTAGE, OVERVOLTAGE_KEY = 0x3210, 0x0700  # F07 00
OTHER, HEARTBEAT_KEY = 0x1000, 0x207F  # F20 nn: the heartbeat of node 127 is missing
SOURCE_OF_CONTROL = 412
PARAMETERS = (  # index, subindex, format, value; data set 0: all four
    (0x2000 + SOURCE_OF_CONTROL, 0, "<H", 1),  # the state machine
    (0x2000 + 424, 0, "<i", 10_000),  # quick stop: 100 Hz/s
    (0x2000 + 425, 0, "<i", 10_000),
    (0x2000 + 638, 0, "<H", 2),  # holding time 0.2 s
    (0x6048, 1, "<I", 1500),  # 1/min in one second: 50 Hz/s
    (0x6049, 1, "<I", 1500),
    (0x6007, 0, "<B", 1),  # a lost connection is a fault
    (0x1016, 1, "<I", MASTER << 16 | LOST),
)
SELECT, ENQUIRE, ACK, NAK = 2, 5, 6, 15  # of the parameter channel 2000h
SIZE = {1: 6, 2: 8, 3: 36}  # its sub-indices: int or uint, long, string


class InverterStation(Station):
    """An inverter: RPDO 2 and TPDO 2 as delivered."""

    IMAGE = struct.Struct("<Hh")  # controlword and target velocity; statusword and velocity

    def __init__(self, axis, node_id):
        super().__init__(axis, node_id)
        self.velocity = 0  # 1/min

    @property
    def outputs(self):
        return self.IMAGE.pack(self.controlword, self.target)

    def take(self, image):
        self.statusword, self.velocity = self.IMAGE.unpack(image)

    @property
    def speed(self):
        """What is true (1/min): a turn moves the carriage by the pitch of its screw."""
        gear = self.axis.model.actuator_gear[0, 0]
        return self.axis.data.qvel[0] * gear * 60 / (2 * math.pi)


class InverterMaster(CanMaster):
    """A heartbeat, no SYNC, and segmented SDO for the parameter channel."""

    STATION = InverterStation
    HEARTBEAT = 500_000  # µs

    def _due(self):
        beats = self.guards and self.ticks % (self.HEARTBEAT // self.rig.cycle) == 0
        return self._error_control() if beats else []

    def _take(self, frame):
        service, station = frame.id & 0x780, self.stations[0]
        if service == 0x280:
            station.take(frame.data)
        elif service == 0x080:
            code, register, key = struct.unpack("<HB3xH", frame.data)
            station.emergencies.append((code, register != 0, key))

    def send_outputs(self, station):
        self.tick(Frame(0x300 + station.node_id, station.outputs))

    def channel(self, station, subindex, command, number, data=b"", data_set=0):
        """Ask the parameter channel 2000h, -> its command byte and value (8.6.1)."""
        word, size = number + 1000 * data_set, SIZE[subindex]
        request = (struct.pack("<HBB", word, command, 0) + data).ljust(size, b"\0")
        head = struct.pack("<HB", 0x2000, subindex)
        answer = self._ask(station, b"\x21" + head + struct.pack("<I", size))
        assert answer == b"\x60" + head + bytes(4)
        for n, start in enumerate(range(0, size, 7)):
            part, toggle = request[start : start + 7], n % 2 << 4
            last = start + 7 >= size
            segment = bytes([toggle | 7 - len(part) << 1 | last]) + part.ljust(7, b"\0")
            assert self._ask(station, segment) == bytes([0x20 | toggle]) + bytes(7)
        answer = self._ask(station, b"\x40" + head + bytes(4))
        assert answer == b"\x41" + head + struct.pack("<I", size)
        result = b""
        for n in range(-(-size // 7)):
            answer = self._ask(station, bytes([0x60 | n % 2 << 4]) + bytes(7))
            assert answer[0] >> 4 == n % 2
            result += answer[1 : 8 - (answer[0] >> 1 & 7)]
        assert len(result) == size
        assert struct.unpack_from("<H", result)[0] == word
        return result[2], result[4:]


def commission(bus):
    """From the first telegram to the last; -> the log."""
    master = InverterMaster(bus)
    (station,) = master.stations
    configure(master, station)
    parameter_channel(master, station)
    master.start()
    enable(master, 600)
    reach(master, station)
    master.set(target=-300)
    reach(master, station)
    quick_stop(master, station)
    enable(master, 600)
    reach(master, station)
    run_down(master, station)
    internal_fault(master, station)
    enable(master, 600)
    lost_heartbeat(master, station)
    master.end()
    return bus.log


def configure(master, station):
    """Identity, parameters, and what the inverter does not take."""
    vendor = int.from_bytes(master.read(station, 0x1018, 1), "little")
    assert vendor == station.drive.read(0x1018, 1)
    for index, subindex, form, value in PARAMETERS:
        master.write(station, index, subindex, struct.pack(form, value))
    for data_set in (1, 2, 3, 4):
        assert master.read(station, 0x2000 + SOURCE_OF_CONTROL, data_set) == b"\1\0\0\0"
    master.write(station, 0x2000 + 420, 2, struct.pack("<i", 600))
    steep = struct.pack("<i", 700)
    master.refused(station, 0x2000 + 420, 0, steep, Abort.INTERNAL_INCOMPATIBLE)  # they differ
    master.refused(station, 0x2000 + SOURCE_OF_CONTROL, 10, b"\1\0", Abort.NO_SUBINDEX)
    master.refused(station, 0x2000 + 999, 0, b"\1\0", Abort.NO_OBJECT)
    master.refused(station, 0x604D, 0, b"\5", Abort.INVALID_VALUE)  # half a pair of poles


def parameter_channel(master, station):
    """Object 2000h: reads, writes, and tells errors in its result, not as an abort."""
    ask = master.channel
    value = b"\1\0"
    assert ask(station, 1, ENQUIRE, SOURCE_OF_CONTROL, data_set=1) == (ACK, value)
    assert ask(station, 1, SELECT, SOURCE_OF_CONTROL, b"\x63\0", data_set=1) == (NAK, b"\1\0")
    assert ask(station, 2, ENQUIRE, 420) == (NAK, b"\x09\0\0\0")  # the data sets differ
    assert ask(station, 2, SELECT, 420, struct.pack("<i", 5000))[0] == ACK  # written all the same
    assert master.read(station, 0x2000 + 420, 0) == struct.pack("<i", 5000)
    command, text = ask(station, 3, ENQUIRE, 14)
    assert (command, text.rstrip(b"\0")) == (ACK, b"ACT 10-1")
    assert ask(station, 1, ENQUIRE, 999) == (NAK, b"\x0b\0")


def control(master, word, state):
    master.set(controlword=word)
    master.wait(lambda s: s.state is state, f"controlword {word:04X}h")


def enable(master, target):
    """By RPDO 2, whose target velocity comes with the controlword."""
    master.set(target=target)
    control(master, SHUTDOWN, State.READY_TO_SWITCH_ON)
    control(master, SWITCH_ON, State.SWITCHED_ON)
    control(master, ENABLE, State.OPERATION_ENABLED)


def reach(master, station):
    master.wait(lambda s: s.statusword & S.TARGET_REACHED, f"target {station.target}")
    master.run(10)
    assert abs(station.velocity - station.target) <= 15
    assert abs(station.speed - station.target) <= 15


def quick_stop(master, station):
    """There is no way back from a quick stop, which ends without power (8.4.3)."""
    control(master, QUICK_STOP, State.SWITCH_ON_DISABLED)
    assert abs(station.speed) < 30


def run_down(master, station):
    """Transition 5 on the ramp, called back on the way, then to its end (9.2.2)."""
    master.set(controlword=SWITCH_ON)
    master.run(10)
    assert station.state is State.OPERATION_ENABLED
    assert 100 < station.speed < 570
    master.set(controlword=ENABLE)
    reach(master, station)
    control(master, SWITCH_ON, State.SWITCHED_ON)
    assert abs(station.speed) < 30
    control(master, ENABLE, State.OPERATION_ENABLED)
    reach(master, station)


def told_by(master, station, code, key):
    """EMCY, error code and parameter 260 agree, and the code is one of the manual's."""
    assert station.emergencies[-1] == (code, True, key)
    assert int.from_bytes(master.read(station, 0x603F, 0), "little") == code
    assert int.from_bytes(master.read(station, 0x2000 + 260, 0), "little") == key
    assert code in {fault.code for fault in station.drive.model.faults}


def reset(master, station):
    """Refused within the lock time, taken after it, and told by an EMCY without data."""
    told = len(station.emergencies)
    for wait in (1_000, LOCK):
        assert station.faulty
        assert len(station.emergencies) == told
        master.run(wait // master.PERIOD)
        master.set(controlword=0)
        master.set(controlword=int(C.FAULT_RESET))
        master.run(4)
    assert station.state is State.SWITCH_ON_DISABLED
    assert station.emergencies[told:] == [(0, False, 0)]


def internal_fault(master, station):
    """DC link voltage: the power goes off at once."""
    master.cause(station, OVERVOLTAGE)
    master.wait(lambda s: s.faulty, "fault", 1.0)
    told_by(master, station, OVERVOLTAGE, OVERVOLTAGE_KEY)
    master.cause(station)
    reset(master, station)


def lost_heartbeat(master, station):
    """The master falls silent: FAULT, and the node leaves OPERATIONAL."""
    master.guards = False
    master.run(100)
    statusword = int.from_bytes(master.read(station, 0x6041, 0), "little")
    assert state_of(statusword) is State.FAULT
    assert station.state is State.OPERATION_ENABLED, "no TPDO since"
    told_by(master, station, OTHER, HEARTBEAT_KEY)
    master.guards = True
    master.start()
    master.run(6)
    reset(master, station)
