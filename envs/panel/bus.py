"""Nodes on a bus as a bench, observed by SDO uploads and bus traffic, commanded on request.

The bench sends SDO requests only: no PDO, no SYNC, no NMT command. Another master is not disturbed
as long as it does not use the default SDO channel. A bench that only listens sends nothing at all.
"""

import math
import struct
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

from ...drive.advice import fault_named, remedy_of, unheeded
from ...drive.canopen.frame import Base, Frame
from ...drive.canopen.port import FramePort
from ...drive.canopen.remote import CanOpenPort, Pdo
from ...drive.diagrams import State, Statusword, state_of
from ...drive.master import Refused, ServoError, Timeout, Units
from ...drive.model.model import DriveModel, load
from ...drive.model.rows import Object
from ...drive.objects.abort import TEXT, SdoAbort
from ...drive.objects.mapping import all_objects
from .bench import Bench

RATE = 20.0  # samples/s of the scope
FASTEST = 1000.0
REQUESTS = 200.0  # per second at most, between the samples
PATIENCE = 0.3  # s for an answer
AGAIN = 1.0  # s between two attempts to reach a silent node
FORGOTTEN = 3.0  # s after which an object that no page asks for is no longer read
LISTENS = "the panel was started with --listen: it sends nothing"
WATCHED = (
    "statusword", "controlword", "modes_of_operation_display", "position_actual_value",
    "velocity_actual_value", "torque_actual_value", "following_error_actual_value",
    "target_position", "error_code", "homing_method",
)
ABSENT = {
    "machine": "A picture in 3D needs the model of the machine; a bus reports positions only.",
    "loops": "Loops are measured in every cycle of the controllers, on a copy of the machine. A "
    "bus shows a fraction of the cycles, and a machine on a bus cannot be copied.",
    "experiments": "Faults, disturbances, snapshots and policies act on a simulated machine in "
    "this process; the machine on a bus may be a real one.",
    "lessons": "Exercises begin with a machine in a certain state and observe the inside of the "
    "drive; neither is possible on a bus.",
    "time": "The time of a bus cannot be stopped, slowed down or turned back.",
    "parameters": "The drive itself stores its parameters: write 65766173h to 1010h:01.",
}
FAULTY = (State.FAULT, State.FAULT_REACTION_ACTIVE)
Key = tuple[str, int, int]  # axis, index, sub-index
Where = tuple[str, str, int]  # axis, direction, number of the PDO


class BusBench(Bench):
    """Nodes on a bus.

    Args:
        bus: port of the bus.
        nodes: node-ids 1..127 by the names of the drives.
        model: the drive model that names the objects.
        rate: sampling rate of the scope (1/s), as far as the nodes answer in time.
        units: units of the drives at the load, if their factors are known.
        listen: send nothing, and show the PDOs that pass with the mapping of the model.
        title: title of the page.

    Raises:
        ValueError: node-id or rate out of range, unknown model.
    """

    real_time = True
    seats_first = False
    sampling = "Sampled over the bus {rate} times a second, less often if the node is slow."
    absent = ABSENT

    def __init__(
        self, bus: FramePort, nodes: Mapping[str, int], model: str | Path | DriveModel = "generic",
        *, rate: float = RATE, units: Units | None = None, listen: bool = False, title: str = "",
    ):
        if not 1.0 <= rate <= FASTEST:
            raise ValueError(f"rate = {rate} samples/s is out of range 1..{FASTEST:g}")
        self.commands = not listen
        self._rows = all_objects(load(model, "can"))
        self._named = {row.name: row for row in self._rows}
        self._places = {(row.index, row.subindex): row for row in self._rows}
        self._known: dict[Key, float | str] = {}
        self._heard: dict[Key, float] = {}  # time of the last PDO with the object (s)
        self._asked: dict[Key, float] = {}  # time of the last request of a page (s)
        self._silent: dict[str, float] = {}  # axis that does not answer: time of the next try (s)
        self._pdos: dict[int, Where] = {}  # by identifier
        self._images: dict[Where, tuple[Pdo, bytes]] = {}  # last data of each PDO
        self._turn = 0
        self.bus = _Tap(bus, nodes, load(model, "can"), sdo_timeout=PATIENCE, units=units)
        self.bus.hear = self._hear
        super().__init__(_Port(self.bus, self), title or ", ".join(f"node {n}" for n in nodes))
        self._watched = [self._named[name] for name in WATCHED if name in self._named]
        self._begun = self._due = self._next = self.bus.now()
        self.asked_rate = rate
        self._marks: list[float] = []  # times of the last samples
        self.scope = self._scope(1 / rate)
        self._unmapped: list[tuple[str, str]] = []
        if self.commands:
            self._map_again(*self.axes)
        for axis, node in self.bus.nodes.items() if listen else ():
            for direction in ("rx", "tx"):
                self._know(axis, direction, node.default_pdos(direction))

    @property
    def rate(self) -> float:
        """The achieved sampling rate of the scope (1/s)."""
        marks = self._marks
        return (len(marks) - 1) / (marks[-1] - marks[0]) if len(marks) > 1 else 0.0

    # ----------------------------------------------------------------- time passes

    def exchange(self) -> None:
        """Request one object or wait for bus traffic, with pacing and recording."""
        self.pace()
        now = self.bus.now()
        due = now >= self._due
        if self.commands and (due or now >= self._next):
            self._next = now + 1 / REQUESTS
            if due:
                for axis, name in dict.fromkeys(map(self.found, self.scope.needed)):
                    self._read(axis, self._named[name], fresh=1 / self.asked_rate)
            else:
                self._read_next()
        else:
            self.bus.exchange()
        self.time = self.bus.now() - self._begun
        if self.beside is not None:
            self.beside.follow()
        self._watch_faults()
        if due:
            self._due = max(self._due + 1 / self.asked_rate, self.bus.now() - 0.5 / self.asked_rate)
            self._marks = [*self._marks[-50:], self.time]
            self.scope.sample(self.time)

    def _read_next(self) -> None:
        """Read the next object, alternately for the header and for the visible page."""
        self._turn += 1
        turn = self._turn // 2
        axis = self.axes[turn % len(self.axes)]
        if self._unmapped and self._turn % len(self._watched) == 0:
            self._learn_pdos(*self._unmapped[0])
            return
        wanted = [key for key, when in self._asked.copy().items() if self.time - when < FORGOTTEN]
        if self._turn % 2 and wanted:
            axis, *place = wanted[turn % len(wanted)]
            self._read(axis, self._places[tuple(place)])  # type: ignore[index]
        else:
            self._read(axis, self._watched[turn // len(self.axes) % len(self._watched)])

    def _read(self, axis: str, row: Object, fresh: float = 0.0) -> None:
        """Read an object by SDO, unless a PDO is newer than `fresh` (s) or the node is silent."""
        key = axis, row.index, row.subindex
        now = self.bus.now()
        if now < self._silent.get(axis, 0.0) or now - self._heard.get(key, -math.inf) < fresh:
            self.bus.exchange()
            return
        try:
            data = self.bus.nodes[axis].sdo.upload(row.index, row.subindex)
            self._known[key] = _decoded(row, data)
        except SdoAbort as error:
            self._known[key] = f"({TEXT.get(error.code, str(error))})"  # type: ignore[call-overload]
        except Timeout as error:
            if axis not in self._silent:
                self.tell("info", f"{axis}: {error}")
            self._silent[axis] = self.bus.now() + AGAIN
            return
        if self._silent.pop(axis, None) is not None:
            self.tell("info", f"{axis} answers again")
            self._map_again(axis)

    def _map_again(self, *axes: str) -> None:
        """Have the PDO mapping of these nodes read between other requests."""
        wanted = [(axis, direction) for axis in axes for direction in ("tx", "rx")]
        self._unmapped = [*dict.fromkeys((*self._unmapped, *wanted))]

    def _learn_pdos(self, axis: str, direction: str) -> None:
        self._unmapped.remove((axis, direction))
        try:
            self._know(axis, direction, self.bus.nodes[axis].pdos(direction))
        except SdoAbort:
            pass  # a node without PDO objects
        except Timeout:  # the mapping is read again when the node answers
            self._silent.setdefault(axis, self.bus.now() + AGAIN)

    # ------------------------------------------------------------------- bus traffic

    def _know(self, axis: str, direction: str, pdos: Iterable[Pdo]) -> None:
        for number, pdo in enumerate(pdos):
            self._pdos[pdo.cob_id] = where = axis, direction, number
            self._images[where] = pdo, b""

    def _hear(self, frame: Frame) -> None:
        """Handle any frame on the bus."""
        where = self._pdos.get(frame.id)
        if where is not None and not frame.remote:
            pdo, _ = self._images[where]
            self._images[where] = pdo, frame.data
            for name, at in pdo.places.items():
                row = self._named[name]
                key = where[0], row.index, row.subindex
                if len(frame.data) >= at + row.size:
                    self._known[key] = value = _decoded(row, frame.data[at : at + row.size])
                    self._heard[key] = self.bus.now()
                    if where[1] == "rx":
                        self.forward(where[0], name, value)
        for axis, node in self.bus.nodes.items():
            if frame.id == Base.EMCY + node.node_id and len(frame.data) == 8:
                code = int.from_bytes(frame.data[:2], "little")
                error = self._named.get("error_code")
                if error is not None:
                    self._known[axis, error.index, error.subindex] = code
                self.tell(
                    "info", f"{axis}: EMCY {fault_named(self.model(axis), code) or 'no error'}"
                )
            elif frame.id == Base.ERROR_CONTROL + node.node_id and frame.data == b"\0":
                self.tell("info", f"{axis}: boot-up")
                if self.commands:
                    self._map_again(axis)

    # ----------------------------------------------------------------------- objects

    def pulse(self) -> str:
        """The requested sampling rate of the scope."""
        return f"{self.rate:.0f} of {self.asked_rate:g} samples/s"

    def rows(self, axis: str) -> list[Object]:
        """Objects of the drive model."""
        return self._rows

    def value(self, axis: str, name: str) -> float | None:
        """Return the value last read, and keep reading the object from now on."""
        if row := self._named.get(name):
            self._asked[axis, row.index, row.subindex] = self.time
        return self.present(axis, name)

    def present(self, axis: str, name: str) -> float | None:
        """Return the value last read."""
        row = self._named.get(name)
        last = self._known.get((axis, row.index, row.subindex)) if row else None
        return None if isinstance(last, str) else last

    def texts(self, axis: str, rows: Iterable[Object]) -> list[str]:
        """Return the values last read as text; an ellipsis where none has arrived yet."""
        texts = []
        for row in rows:
            key = axis, row.index, row.subindex
            if row.access == "wo":
                texts.append("write only")
                continue
            self._asked[key] = self.time
            known = self._known.get(key, "…")
            texts.append(f"{known:g}" if isinstance(known, float) else str(known))
        return texts

    def write(self, axis: str, name: int | str, *arguments: float) -> str:
        """Write an object by SDO and read it back. Returns the reason of a refusal, or nothing."""
        if not self.commands:
            return LISTENS
        try:
            row = self._named[name] if isinstance(name, str) else self._places[
                name, int(arguments[0]) if len(arguments) > 1 else 0
            ]
        except KeyError:
            return f"the model has no object {name!r}"
        try:
            value = arguments[-1] if row.real else int(arguments[-1])
            data = struct.pack("<" + row.format, value)
            self.bus.nodes[axis].sdo.download(row.index, row.subindex, data)
        except struct.error:
            return f"{arguments[-1]:g} does not fit {row.data_type}"
        except (SdoAbort, ServoError, ValueError) as error:
            return str(error)
        self.forward(axis, row.index, row.subindex, value)
        if row.access != "wo":
            self._read(axis, row)
        return ""

    def forward(self, axis: str, *arguments: Any) -> None:
        """Forward a value that a drive has accepted, by object name or index, to its twin."""
        if self.beside is not None and axis == self.beside.axis:
            self.beside.repeat(*arguments)

    def powered(self, axis: str) -> bool:
        """Whether its statusword shows OPERATION_ENABLED."""
        word = self.present(axis, "statusword")
        return word is not None and state_of(int(word)) is State.OPERATION_ENABLED

    def fault_of(self, axis: str) -> tuple[str, str]:
        """Return the fault according to statusword and error code last read."""
        word = self.present(axis, "statusword")
        if word is None or state_of(int(word)) not in FAULTY:
            return "", ""
        model, code = self.model(axis), int(self.present(axis, "error_code") or 0)
        remedy = f"{remedy_of(model, code)}; then reset the fault"
        return fault_named(model, code) or "unknown fault", remedy

    def mapped(self, axis: str, direction: str) -> list[Object]:
        """Return the objects in the PDOs observed so far."""
        return [
            self._named[name] for pdo, _ in self._passed(axis, direction) for name in pdo.places
        ]

    def _passed(self, axis: str, direction: str) -> list[tuple[Pdo, bytes]]:
        return [
            image for where, image in self._images.copy().items()
            if where[:2] == (axis, direction) and image[1]
        ]

    def channel_reader(self, axis: str, name: str) -> Callable[[], float]:
        """Return a reader of an object's last value; NaN where there is none."""
        row = self._named.get(name)
        if row is None or not row.format:
            raise ValueError(f"there is no channel {name!r}: on a bus name an object of the model")

        def read() -> float:
            last = self.present(axis, name)
            return math.nan if last is None or axis in self._silent else float(last)

        return read

    def channel_unit(self, axis: str, name: str) -> str:
        """Return the unit of a channel according to the model."""
        return self._named[name].unit

    def _status(self, axis: str) -> dict[str, Any]:
        """State, and the bytes of the PDOs; a bus does not report the rest."""
        word = self.present(axis, "statusword")
        state = None if word is None else state_of(int(word))
        status, refused = int(word or 0), ""
        if state is not None:
            controlword = int(self.present(axis, "controlword") or 0)
            refused = unheeded(self.model(axis), status, controlword)
        limited = status & Statusword.INTERNAL_LIMIT_ACTIVE
        return {
            "state": -1 if state is None else int(state),
            "answers": axis not in self._silent,
            "homed": None,
            "faults": (),
            "refused": refused,
            "limits": ["internal limit active, statusword bit 11"] if limited else [],
            "injected": 0,
        } | {
            f"{way}pdo": b"".join(data for _, data in self._passed(axis, f"{way}x"))
            for way in ("r", "t")
        }


def _decoded(row: Object, data: bytes) -> float | str:
    """Decode the bytes of an object."""
    if row.format and len(data) == row.size:
        return struct.unpack("<" + row.format, data)[0]
    if row.format:
        return f"({len(data)} bytes, the model has {row.size})"
    return data.decode("latin-1").rstrip("\0")


class _Tap(CanOpenPort):
    """The port of the nodes, which passes all bus traffic to `hear` as well."""

    hear: Callable[[Frame], None] = staticmethod(lambda frame: None)

    def exchange(self, frames: Iterable[Frame] = (), *, sync: bool = True) -> list[Frame]:
        """Exchange process data once and count it."""
        received = super().exchange(frames, sync=sync)
        for frame in received:
            self.hear(frame)
        return received


class _Port:
    """The port through which masters reach the nodes; time passes through the bench."""

    def __init__(self, bus: CanOpenPort, bench: BusBench):
        self._bus, self._bench = bus, bench
        self.models = bus.models
        self.latency = bus.latency
        self.now, self.units, self.arrived = bus.now, bus.units, bus.arrived

    @property
    def silence(self) -> float:
        """Time (s) that passed until lost SDO transfers were repeated."""
        return self._bus.silence

    def upload(self, axis: str, name: str) -> int | float:
        """Read an object by SDO."""
        self._may()
        return self._bus.upload(axis, name)

    read = upload

    def write(self, axis: str, name: str, value: int | float) -> None:
        """Write an object by SDO."""
        self._may()
        self._bus.write(axis, name, value)
        self._bench.forward(axis, name, value)

    def exchange(self) -> None:
        """Advance the bench by a short time."""
        self._bench.exchange()

    def _may(self) -> None:
        if not self._bench.commands:
            raise Refused("command", LISTENS, "start it without --listen")
