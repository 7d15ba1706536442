"""What an oscilloscope records where the drive is not in this process: a node on a bus, or a log.

Rows are made as values pass: in a log at the time of the frame, of a node at each poll. What has
not been heard yet is nan; a value holds until the next one.
"""

import csv
import math
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from pathlib import Path

import numpy as np

from ..canopen.decode import Decoder
from ..canopen.remote import CanOpenPort
from ..ethercat.decode import EtherCatDecoder
from ..model.files import regular
from ..model.model import DriveModel
from ..model.near import near
from ..model.rows import Object
from ..objects.abort import SdoAbort
from ..trace import Recording
from .bus import to_frame
from .log import messages
from .pcapng import read

CAPTURES = (".pcapng", ".pcap")
TRACES = (".csv", ".npz")  # of `Trace.save`; a .csv may be a log of python-can as well
Heard = Callable[[str, Object, float], None]
Group = dict[str, float]  # values that came together, by the name of the object


class Source:
    """A log whose objects are known: who sent them, and their names.

    Args:
        log: of CAN in a format of python-can, a capture of EtherCAT, or what `Trace.save` wrote.
        model: drive model; of EtherCAT that of the identity, if none is given.

    Raises:
        ValueError: a log that is damaged or has no object in it.
    """

    def __init__(self, log: Path, model: str | Path | DriveModel | None = None):
        self._log = log
        self._model = model
        self.units: dict[str, dict[str, str]] = {}  # who -> object -> unit
        self._addresses: dict[str, dict[tuple[int, int], str]] = {}
        self._count: Counter[tuple[str, str]] = Counter()
        self._columns = _columns(log) if log.suffix in TRACES else []
        if self._columns:
            self.units[log.name] = {name: unit for name, unit, _ in self._columns[1:]}
            return
        for _ in self._frames(self._note):
            pass
        if not self.units:
            raise ValueError(f"{log}: no object of a drive passes in it; look with servogym decode")

    def _note(self, who: str, row: Object, value: float) -> None:
        self.units.setdefault(who, {})[row.name] = row.unit
        self._count[who, row.name] += 1
        self._addresses.setdefault(who, {})[row.index, row.subindex] = row.name

    def _frames(self, heard: Heard) -> Iterator[float]:
        """Time (s) of each frame from the first, after its values were told to `heard`."""
        if self._log.suffix in CAPTURES:
            capture = EtherCatDecoder(self._model, heard)
            begin = None
            for packet in read(self._log):
                begin = packet.time if begin is None else begin
                capture.decode(packet.frame)
                yield (packet.time - begin) * 1e-9
            return
        bus = Decoder(
            self._model or "generic", heard=lambda node, row, value: heard(f"{node}", row, value)
        )
        start = None
        for message in messages(self._log):
            start = message.timestamp if start is None else start
            frame = to_frame(message)
            if frame:
                bus.decode(frame)
            yield message.timestamp - start

    def groups(self, who: str) -> Iterator[tuple[float, Group]]:
        """Time (s) and values of each frame of a drive that has some."""
        if self._columns:
            names = [name for name, _, _ in self._columns]
            for time, *row in zip(*(samples for _, _, samples in self._columns), strict=True):
                yield float(time), dict(zip(names[1:], row, strict=True))
            return
        group: Group = {}

        def hear(name: str, row: Object, value: float) -> None:
            if name == who:
                group[row.name] = value

        for time in self._frames(hear):
            if group:
                yield time, dict(group)
                group.clear()

    def often(self, who: str, most: int) -> list[str]:
        """Objects of a drive that pass most often, at most so many."""
        return sorted(self.units[who], key=lambda name: -self._count[who, name])[:most]

    def name(self, who: str, channel: str) -> str:
        """A channel, by name or address, as it is called in the log. Raises ValueError."""
        address = address_of(channel)
        known = self.units[who]
        name = self._addresses.get(who, {}).get(address, "") if address else channel
        if name in known:
            return name
        raise ValueError(f"{self._log}: no {channel} of drive {who} in it; {near(channel, known)}")

    def drive(self, asked: str | None, channels: Iterable[str]) -> str:
        """The drive that is meant: the one asked for, or the only one that has the channels."""
        if asked is not None:
            for who in self.units:
                if asked.lower().removeprefix("slave ") == who.lower().removeprefix("slave "):
                    return who
            raise ValueError(f"{self._log}: no drive {asked} in it; {near(asked, self.units)}")
        wanted = [*channels]
        having = [who for who in self.units if all(self._has(who, name) for name in wanted)]
        having = having or [*self.units]
        if len(having) > 1:
            raise ValueError(
                f"{self._log}: say which drive is meant, with --axis: {near('', having)}"
            )
        return having[0]

    def _has(self, who: str, channel: str) -> bool:
        address = address_of(channel)
        if address:
            return address in self._addresses.get(who, {})
        return channel in self.units[who]


def address_of(channel: str) -> tuple[int, int] | None:
    """Index and subindex of ``6064h`` and ``60F9h:01``, None for a name."""
    head, colon, sub = channel.strip().partition(":")
    try:
        if len(head) == 5 and head[-1] in "hH" and (not colon or len(sub) == 2):
            return int(head[:4], 16), int(sub or "0", 16)
    except ValueError:
        pass
    return None


def record(recording: Recording, groups: Iterable[tuple[float, Group]]) -> None:
    """Fill a recording until it is done or nothing more comes; frames of one time are one row."""
    trigger = recording.trigger.channel if recording.trigger else ""
    wanted = {*recording.channels, trigger}
    values = dict.fromkeys(wanted, math.nan)
    last: float | None = None
    for time, group in groups:
        if not wanted & group.keys():
            continue
        if last is not None and time > last:
            recording.add(last, [values[name] for name in recording.channels], values[trigger])
            if recording.done:
                return
        values |= {name: value for name, value in group.items() if name in wanted}
        last = time
    if last is not None:
        recording.add(last, [values[name] for name in recording.channels], values[trigger])


class NodeScope:
    """Polls a running node: TPDOs as they are heard, what is in none by SDO. It commands nothing.

    Two masters cannot use one SDO channel at the same time (CiA 301): where another one does, map
    what is of interest, or record the bus with ``--log`` and look at that.

    Args:
        port: of the bus, with the node.
        rate: of the polls (1/s).
        channels: objects by name or address; of those marked `optional` a node may lack some.

    Raises:
        ValueError: a rate out of range, an object that model or node does not have.
        Timeout: the node does not answer.
    """

    def __init__(
        self, port: CanOpenPort, rate: float, channels: Iterable[str], *, optional: bool = False
    ):
        if not 0 < rate <= 1000:
            raise ValueError(f"rate = {rate:g} polls per second is out of range 0..1000")
        self._port = port
        self._period = 1 / rate
        self._node = next(iter(port.nodes.values()))
        model = next(iter(port.models.values()))
        self.late = 0  # polls that came after their time
        self._node.listen()
        self._model = model
        self.units: dict[str, str] = {}
        for channel in channels:
            if not optional or channel in model.names:
                with suppress(*(SdoAbort, ValueError) if optional else ()):
                    self.watch(channel)

    def watch(self, channel: str) -> str:
        """Poll this channel too; -> name of the object. Raises ValueError for an unknown one."""
        name = channel_of(self._model, channel)
        try:
            self._node.upload(name)
        except (SdoAbort, ValueError) as error:
            raise ValueError(f"channel {channel} of node {self._node.node_id}: {error}") from None
        self.units[name] = self._model.names[name].unit
        return name

    def groups(self, duration: float) -> Iterator[tuple[float, Group]]:
        """Time (s) from now and values of each poll, for `duration` (s)."""
        begin = self._port.now()
        number = 0
        while (due := number * self._period) <= duration:
            while self._port.now() - begin < due:
                self._port.exchange()
            now = self._port.now() - begin
            self.late += now > due + self._period
            yield now, dict(self._node.poll(self.units))
            number = max(number + 1, math.floor((self._port.now() - begin) / self._period))


def channel_of(model: DriveModel, channel: str) -> str:
    """A channel, by name or address, as the model has it. Raises ValueError."""
    if channel.startswith("axis."):
        raise ValueError(f"channel {channel}: a field of the record is seen on a machine alone")
    address = address_of(channel)
    if address is not None and address in model.objects:
        return model.objects[address].name
    if address is not None:
        raise ValueError(f"{channel}: drive {model.name} has no such object")
    if channel not in model.names:
        raise ValueError(f"there is no channel {channel!r}: {near(channel, model.names)}")
    return channel


def _columns(log: Path) -> list[tuple[str, str, np.ndarray]]:
    """Name, unit and samples of a file of `Trace.save`; none where it is another file."""
    if log.suffix == ".npz":
        with np.load(log, allow_pickle=False) as data:
            return [(name, "", data[name]) for name in data.files] if "time" in data else []
    regular(log)
    with log.open(newline="", encoding="utf-8", errors="replace") as file:
        head = next(csv.reader(file), [])
        if head[:1] != ["time (s)"]:
            return []
        try:
            table = np.loadtxt(file, delimiter=",", ndmin=2)
        except ValueError as error:
            raise ValueError(f"{log}: {error}") from None
    if table.shape[0] == 0 or table.shape[1] != len(head):
        raise ValueError(f"{log}: {table.shape[1]} columns of {len(head)}, or no samples")
    named = (text.rstrip(")").partition(" (") for text in head)
    return [(name, unit, table[:, n]) for n, (name, _, unit) in enumerate(named)]
