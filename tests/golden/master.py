"""Drives as their master sees them, and what a master does on any bus."""

import struct

from servogym.drive.kernel.words import State, state_of

OUTPUTS = struct.Struct("<Hbi")  # controlword, mode, target position
INPUTS = struct.Struct("<Hbi")  # statusword, mode display, position
OUTPUT_MAPPING = (0x6040_0010, 0x6060_0008, 0x607A_0020)
INPUT_MAPPING = (0x6041_0010, 0x6061_0008, 0x6064_0020)


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
    STATION = Station

    def __init__(self, rig):
        self.rig = rig
        self.stations = [self.STATION(axis, n + 1) for n, axis in enumerate(rig.machines)]
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

    def write(self, station, index, subindex, data):
        """Write an object."""
        reply, rest = self.download(station, index, subindex, data)
        assert reply == 0x60, f"{index:04X}h:{subindex:02X}h := {data.hex()}: {rest.hex()}"

    def refused(self, station, index, subindex, data, abort):
        """Try to write what the drive does not take."""
        reply, rest = self.download(station, index, subindex, data)
        assert reply == 0x80
        printed = station.drive.model.abort_codes.get(abort, abort)
        assert int.from_bytes(rest, "little") == printed, (
            f"{index:04X}h:{subindex:02X}h: {rest.hex()}"
        )

    def set(self, stations=None, **outputs):
        """Change outputs of all stations, or of some."""
        for station in stations or self.stations:
            for name, value in outputs.items():
                assert hasattr(station, name)
                setattr(station, name, value)
            self.send_outputs(station)
