"""Recordings for the oscilloscope from drives outside this process: a node on a bus, or a log.

A row is added whenever values arrive: at each frame of a log, or at each poll of a node. Values not
yet received are nan; a value holds until the next one.
"""

import csv
import math
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..canopen.decode import Decoder
from ..canopen.remote import CanOpenPort
from ..ethercat.decode import EtherCatDecoder
from ..model import foreign
from ..model.files import regular
from ..model.model import DriveModel
from ..model.names import hint
from ..model.rows import Object
from ..objects.abort import SdoAbort
from ..trace import Recording
from .bus import to_frame
from .log import messages
from .pcapng import read

SCALES = {  # units of a column, and what one of them is in SI
    "s": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "m": 1.0, "mm": 1e-3, "um": 1e-6, "µm": 1e-6,
    "rad": 1.0, "deg": math.pi / 180, "m/s": 1.0, "mm/s": 1e-3, "rad/s": 1.0, "Nm": 1.0,
    "mNm": 1e-3, "A": 1.0, "mA": 1e-3, "1": 1.0,
}
SI = {"s": "s", "ms": "s", "us": "s", "µs": "s", "m": "m", "mm": "m", "um": "m", "µm": "m",
      "rad": "rad", "deg": "rad", "m/s": "m/s", "mm/s": "m/s", "rad/s": "rad/s", "Nm": "Nm",
      "mNm": "Nm", "A": "A", "mA": "A", "1": ""}
SHARES = {"% rated": 10.0}  # units of a scope that are a multiple of the drive's: per mille
HERE = ":"  # between an axis and its object, in a table of several
CAPTURES = (".pcapng", ".pcap")
TRACES = (".csv", ".npz")  # of `Trace.save`; a .csv may be a log of python-can as well
Heard = Callable[[str, Object, float], None]
Group = dict[str, float]  # values that came together, by the name of the object


class Signal(NamedTuple):
    """The recorded times and values of one object, both of shape ``(n,)``."""

    time: np.ndarray  # s, from the first frame of the log
    value: np.ndarray
    unit: str  # SI, or that of the drive


class Source:
    """A log whose objects are known: their senders and their names.

    Args:
        log: a CAN log in a format of python-can, an EtherCAT capture, a table written by
            `Trace.save`, or any CSV with `columns`.
        model: drive model; for EtherCAT, the model with the identity of the slave if not given.
        columns: of a CSV, ``time=t:ms,target_position=x:mm``: the object's name, the heading of
            its column, and its unit, one of `SCALES`; without a unit, drive units.

    Raises:
        ValueError: the log is damaged or contains no object.
    """

    def __init__(
        self, log: Path, model: str | Path | DriveModel | None = None, columns: str | None = None
    ):
        self._log = log
        self._model = model
        self.units: dict[str, dict[str, str]] = {}  # sender -> object -> unit
        self._addresses: dict[str, dict[tuple[int, int], str]] = {}
        self._count: Counter[tuple[str, str]] = Counter()
        self._columns = _columns(log) if log.suffix in TRACES and columns is None else []
        if columns is not None:
            self._columns = chosen_columns(log, columns)
        if self._columns:
            for name, unit, _ in self._columns[1:]:
                axis, _, name = name.rpartition(HERE)
                self.units.setdefault(axis or log.name, {})[name] = unit
            return
        for _ in self._frames(self._note):
            pass
        if not self.units:
            raise ValueError(f"{log}: no object of a drive passes in it; look with servogym decode")

    def _note(self, sender: str, row: Object, value: float) -> None:
        self.units.setdefault(sender, {})[row.name] = row.unit
        self._count[sender, row.name] += 1
        self._addresses.setdefault(sender, {})[row.index, row.subindex] = row.name

    def _frames(self, heard: Heard) -> Iterator[float]:
        """Yield the time (s) of each frame since the first, after passing its values to `heard`."""
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

    def groups(self, sender: str) -> Iterator[tuple[float, Group]]:
        """Yield time (s) and values of each frame of a drive that contains values."""
        if self._columns:
            time, samples = self._of(sender)
            for at, *row in zip(time, *samples.values(), strict=True):
                yield float(at), dict(zip(samples, row, strict=True))
            return
        group: Group = {}

        def hear(name: str, row: Object, value: float) -> None:
            if name == sender:
                group[row.name] = value

        for seconds in self._frames(hear):
            if group:
                yield seconds, dict(group)
                group.clear()

    def signals(self, sender: str) -> dict[str, Signal]:
        """Return all signals of a drive, by object."""
        if self._columns:
            time, columns = self._of(sender)
            found = {name: (time, samples) for name, samples in columns.items()}
        else:
            rows: dict[str, tuple[list[float], list[float]]] = {}
            for at, group in self.groups(sender):
                for name, value in group.items():
                    times, values = rows.setdefault(name, ([], []))
                    times.append(at)
                    values.append(value)
            found = {name: (np.array(t), np.array(v)) for name, (t, v) in rows.items()}
        units = self.units[sender]
        return {name: Signal(t, v, units.get(name, "")) for name, (t, v) in found.items()}

    def _of(self, sender: str) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """Time and samples of one axis of a table, by object."""
        axes = {name: name.rpartition(HERE) for name, _, _ in self._columns[1:]}
        return self._columns[0][2], {
            axes[name][2]: samples for name, _, samples in self._columns[1:]
            if (axes[name][0] or self._log.name) == sender
        }

    def often(self, sender: str, most: int) -> list[str]:
        """Return the most frequent objects of a drive, `most` of them."""
        return sorted(self.units[sender], key=lambda name: -self._count[sender, name])[:most]

    def name(self, sender: str, channel: str) -> str:
        """Return the name in the log of a channel given by name or address. Raises ValueError."""
        address = address_of(channel)
        known = self.units[sender]
        name = self._addresses.get(sender, {}).get(address, "") if address else channel
        if name in known:
            return name
        remark = hint(channel, known)
        raise ValueError(f"{self._log}: no {channel} of drive {sender} in it; {remark}")

    def drive(self, asked: str | None, channels: Iterable[str]) -> str:
        """Return the drive asked for, or the only one that has the channels. Raises ValueError."""
        if asked is not None:
            for sender in self.units:
                if asked.lower().removeprefix("slave ") == sender.lower().removeprefix("slave "):
                    return sender
            raise ValueError(f"{self._log}: no drive {asked} in it; {hint(asked, self.units)}")
        wanted = [*channels]
        having = [each for each in self.units if all(self._has(each, name) for name in wanted)]
        having = having or [*self.units]
        if len(having) > 1:
            raise ValueError(
                f"{self._log}: say which drive is meant, with --axis: {hint('', having)}"
            )
        return having[0]

    def _has(self, sender: str, channel: str) -> bool:
        address = address_of(channel)
        if address:
            return address in self._addresses.get(sender, {})
        return channel in self.units[sender]


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
    """Fill a recording until it is complete or the data end; frames of one time form one row."""
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
    """Records a running node without commanding it: TPDOs, and other objects polled by SDO.

    Two masters cannot use one SDO channel at the same time (CiA 301). If another master uses it,
    map the objects of interest, or record the bus with ``--log`` and plot the log.

    Args:
        port: port of the bus with the node.
        rate: of the polls (1/s).
        channels: objects by name or address.
        optional: leave out channels that the node does not have.

    Raises:
        ValueError: the rate is out of range, or model or node does not have an object.
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
        """Also poll this channel; -> name of the object. Raises ValueError for an unknown one."""
        name = channel_of(self._model, channel)
        try:
            self._node.upload(name)
        except (SdoAbort, ValueError) as error:
            raise ValueError(f"channel {channel} of node {self._node.node_id}: {error}") from None
        self.units[name] = self._model.names[name].unit
        return name

    def groups(self, duration: float) -> Iterator[tuple[float, Group]]:
        """Poll for `duration` (s) and yield the time since the start (s) and the values."""
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
    """Return the name in the model of a channel given by name or address. Raises ValueError."""
    if channel.startswith("axis."):
        raise ValueError(f"channel {channel}: a field of the record is seen on a machine alone")
    address = address_of(channel)
    if address is not None and address in model.objects:
        return model.objects[address].name
    if address is not None:
        raise ValueError(f"{channel}: drive {model.name} has no such object")
    if channel not in model.names:
        raise ValueError(f"there is no channel {channel!r}: {hint(channel, model.names)}")
    return channel


def chosen_columns(log: Path, columns: str) -> list[tuple[str, str, np.ndarray]]:
    """Return name, unit and samples (SI) of the chosen columns of a CSV, the time first.

    Args:
        log: the file; its first line contains the headings. Columns are separated by commas, or
            by semicolons or tabs; numbers may then have a decimal comma.
        columns: ``time=t:ms,target_position=x:mm``, see `Source`.

    Raises:
        ValueError: an unknown heading or unit, a cell that is not a number, or no time.
    """
    with log.open(newline="", encoding="utf-8", errors="replace") as file:
        first = file.readline()
        comma = max(",;\t", key=first.count)
        file.seek(0)
        reader = csv.reader(file, delimiter=comma)
        head = [each.strip() for each in next(reader, [])]
        lines = [(n, line) for n, line in enumerate(reader, 2) if any(map(str.strip, line))]
    found = []
    for part in columns.split(","):
        name, equals, rest = (text.strip() for text in part.partition("="))
        heading, _, unit = (text.strip() for text in rest.partition(":"))
        if not equals or not name or not heading:
            raise ValueError(f"--columns {part!r}: use NAME=HEADING:UNIT, as time=t:ms")
        if heading not in head:
            raise ValueError(f"{log}: no column {heading!r}: {hint(heading, head)}")
        if unit and unit not in SCALES:
            raise ValueError(f"--columns {part!r}: unknown unit {unit!r}, use {', '.join(SCALES)}")
        at = head.index(heading)
        samples = np.zeros(len(lines))
        for row, (number, line) in enumerate(lines):
            try:
                text = line[at] if comma == "," else line[at].replace(",", ".")
                samples[row] = float(text)
            except (ValueError, IndexError):
                raise ValueError(f"{log}, line {number}: no number in {heading!r}") from None
        found.append((name, SI.get(unit, ""), samples * SCALES.get(unit or "1", 1.0)))
    found.sort(key=lambda column: column[0] != "time")
    if not found or found[0][0] != "time":
        raise ValueError("--columns: name the time too, as time=t:ms")
    if len(lines) < 2 or not (np.diff(found[0][2]) > 0).all():
        raise ValueError(f"{log}: the time has to rise from line to line")
    return found


def _columns(log: Path) -> list[tuple[str, str, np.ndarray]]:
    """Return name, unit and samples of a file of `Trace.save`; nothing for other files."""
    if log.suffix == ".npz":
        data = foreign.arrays(log)
        return [(name, "", data[name]) for name in data] if "time" in data else []
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
    found = []
    for column, text in zip(table.T, head, strict=True):
        name, _, unit = text.rstrip(")").partition(" (")
        factor = SCALES.get(unit) or SHARES.get(unit, 1.0)
        found.append((name, "" if unit in SHARES else SI.get(unit, unit), column * factor))
    return found
