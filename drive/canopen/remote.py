"""Access of a master to drives on CANopen: objects by SDO, or by PDO where mapped."""

from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

from ..master.errors import BusError, Timeout
from ..master.port import Units
from ..model.model import DriveModel, load
from ..model.pdo import mapping_entry, places
from ..objects.abort import Abort, SdoAbort
from .frame import SYNC, SYNCHRONOUS, Base, Frame
from .node import NmtCommand
from .port import FramePort
from .sdo_client import ATTEMPTS, SdoClient

T = TypeVar("T")
PDOS = 512  # largest number in each direction (CiA 301)
PATIENCE = 0.1  # s, for which the values of a PDO are trusted without a check by SDO
TIMES = 3  # repetitions of an RPDO, after which a difference is a change by the drive
EVIDENT = {"controlword", "modes_of_operation"}  # their arrival shows in the drive's state
LATENCY = 0.02  # s; inferred: until the status bits show the effect of a command


class CanOpenPort:
    """Nodes of one bus.

    Args:
        bus: `NodePort`, or `servogym.drive.wire.bus.CanPort` for a real bus.
        nodes: node-id 1..127 of a drive named ``node``, or several node-ids by drive name.
        model: drive model that names the objects; `generic` names those of the standard.
        sdo_timeout: time-out of one SDO request (s).
        units: units of the drives, if their factors are known.

    Raises:
        ValueError: node-id out of range, unknown model.
    """

    latency = LATENCY

    def __init__(
        self, bus: FramePort, nodes: int | Mapping[str, int] = 1,
        model: str | Path | DriveModel = "generic", *, sdo_timeout: float = 1.0,
        units: Units | None = None,
    ):
        self._bus = bus
        self._units = units or Units()
        known = load(model)
        named = nodes if isinstance(nodes, Mapping) else {"node": nodes}
        self.nodes = {
            axis: RemoteObjects(self, node_id, known, sdo_timeout)
            for axis, node_id in named.items()
        }
        self.models = dict.fromkeys(self.nodes, known)

    def now(self) -> float:
        """Time of the bus (s)."""
        return self._bus.now()

    @property
    def silence(self) -> float:
        """Time (s) spent on SDO transfers that were repeated."""
        return sum(node.sdo.silence for node in self.nodes.values())

    def read(self, axis: str, name: str) -> int | float:
        """Read an object (drive units) from the last PDO that contains it, otherwise by SDO."""
        return self.nodes[axis].read(name)

    def upload(self, axis: str, name: str) -> int | float:
        """Read an object (drive units) by SDO."""
        return self.nodes[axis].upload(name)

    def write(self, axis: str, name: str, value: int | float) -> None:
        """Write an object (drive units) by PDO with the next exchange if mapped, else by SDO."""
        self.nodes[axis].write(name, value)

    def arrived(self, axis: str) -> bool:
        """Whether a drive has received what was sent to it; a lost RPDO is sent again."""
        return self.nodes[axis].arrived()

    def exchange(self, frames: Iterable[Frame] = (), *, sync: bool = True) -> list[Frame]:
        """Send frames, changed RPDOs, and a SYNC if a PDO needs one; -> the frames received.

        Args:
            frames: frames to send first.
            sync: whether a SYNC may be sent.
        """
        out = [*frames, *(frame for node in self.nodes.values() for frame in node.changed())]
        for frame in out:
            for node in self.nodes.values():
                node.answers.sent(frame)
        if sync and any(node.synchronous for node in self.nodes.values()):
            out.append(SYNC)
        received = list(self._bus.exchange(out))
        for frame in received:
            for node in self.nodes.values():
                node.take(frame)
        return received

    def units(self, axis: str) -> Units:
        """Return the units given at construction."""
        return self._units

    def nmt(self, command: NmtCommand) -> None:
        """Send an NMT command to each of the nodes."""
        for node in self.nodes.values():
            node.nmt(command)

    def use_pdos(self) -> None:
        """Read the mapping of the valid PDOs and use them from now on; starts the nodes (NMT)."""
        for node in self.nodes.values():
            node.use_pdos()


@dataclass
class Pdo:
    """A PDO of the drive: its mapping and its data."""

    cob_id: int
    data: bytearray
    places: dict[str, int] = field(default_factory=dict)  # object name -> byte
    heard: bool = False
    synchronous: bool = False
    at: float = 0.0  # s, when it was sent, received or last checked by SDO
    unsure: bool = False  # it was sent, and nothing shows yet that it has arrived
    again: int = 0  # repetitions since its data were last written


class Answers:
    """Counts SDO requests to a node-id and their answers, of which one server sends one each.

    The counts prove nothing once requests of another master have been received.
    """

    def __init__(self, node_id: int):
        self._request, self._response = Base.SDO_REQUEST + node_id, Base.SDO_RESPONSE + node_id
        self._requests = self._answers = 0
        self._shared = False

    def __str__(self) -> str:
        return f"{self._answers} answers to {self._requests} SDO requests"

    def sent(self, frame: Frame) -> None:
        """Count a frame that is sent."""
        if frame.id == self._request:
            self._requests += frame.data[:1] != b"\x80"  # an abort has no answer

    def heard(self, frame: Frame) -> None:
        """Count a frame that was received."""
        self._answers += frame.id == self._response
        self._shared |= frame.id == self._request

    @property
    def twice(self) -> bool:
        """Whether more than one server answers; a single excess answer may be a late one."""
        return not self._shared and self._answers > self._requests + 1


class RemoteObjects:
    """Reads and writes objects of one node; arguments and errors as for `CanOpenPort`."""

    def __init__(self, port: CanOpenPort, node_id: int, model: DriveModel, sdo_timeout: float):
        self.port = port
        self.node_id = node_id
        self.sdo = SdoClient(port, node_id, sdo_timeout)
        self.answers = Answers(node_id)
        self.synchronous = False
        self._model = model
        self._rpdos: list[Pdo] = []
        self._tpdos: list[Pdo] = []
        self._pending: dict[int, Pdo] = {}

    @property
    def tpdos(self) -> tuple[Pdo, ...]:
        """The TPDOs in use."""
        return (*self._tpdos,)

    def nmt(self, command: NmtCommand) -> None:
        """Send an NMT command to the node."""
        for pdo in self._tpdos:
            pdo.heard = False  # its values may be out of date
        self.port.exchange([Frame(Base.NMT, bytes([command, self.node_id]))])

    def changed(self) -> list[Frame]:
        """Return the RPDOs written to since the last call, in that order."""
        now = self.port.now()
        for pdo in self._pending.values():
            pdo.at, pdo.unsure = now, True
        frames = [Frame(pdo.cob_id, bytes(pdo.data)) for pdo in self._pending.values()]
        self._pending.clear()
        return frames

    def take(self, frame: Frame) -> None:
        """Handle a frame of the bus."""
        self.answers.heard(frame)
        for pdo in self._tpdos:
            if frame.id == pdo.cob_id and not frame.remote and len(frame.data) >= len(pdo.data):
                pdo.data[:] = frame.data[: len(pdo.data)]
                pdo.heard, pdo.at = True, self.port.now()

    def read(self, name: str) -> int | float:
        """Read an object (drive units) from the last PDO that contains it, otherwise by SDO.

        PDOs are not acknowledged, so values that may have been lost are verified by SDO: an RPDO is
        verified once and sent again if its values differ, a TPDO is verified whenever it has not
        been received for `PATIENCE`.
        """
        now = self.port.now()
        for pdo in self._rpdos:
            if pdo.unsure and now - pdo.at > PATIENCE:
                self._came(pdo)
        for pdo in self._tpdos:
            if pdo.heard and name in pdo.places:
                if now - pdo.at > PATIENCE:
                    pdo.data[:], pdo.at = self._asked(pdo), self.port.now()
                return self._model.number(name).code.unpack_from(pdo.data, pdo.places[name])[0]
        return self.upload(name)

    def arrived(self) -> bool:
        """Whether the drive has the values of the RPDOs sent; if not, they are sent again."""
        asked = [pdo for pdo in self._rpdos if pdo.unsure and pdo.places.keys() - EVIDENT]
        return all([self._came(pdo) for pdo in asked])

    def _came(self, pdo: Pdo) -> bool:
        """Verify the values of an RPDO by SDO; queue it again if they differ."""
        pdo.unsure = False
        if pdo.again == TIMES or self._asked(pdo) == pdo.data:
            return True
        pdo.again += 1
        self._pending[pdo.cob_id] = pdo
        return False

    def _asked(self, pdo: Pdo) -> bytearray:
        """Read the present content of a PDO by SDO."""
        data = bytearray(pdo.data)
        for name, at in pdo.places.items():
            with suppress(SdoAbort):  # a write-only object
                value = self._model.number(name).pack(self.upload(name))
                data[at : at + len(value)] = value
        return data

    def upload(self, name: str) -> int | float:
        """Read an object (drive units) by SDO."""
        row = self._model.number(name)
        return row.unpack(self._by_sdo(lambda: self.sdo.upload(row.index, row.subindex)))

    def write(self, name: str, value: int | float) -> None:
        """Write an object (drive units) in the first RPDO that contains it, otherwise by SDO.

        Raises:
            ValueError: unknown name, or a value that does not fit the object's type.
            SdoAbort: the drive refuses it.
        """
        row = self._model.number(name)
        data = row.pack(value)
        carriers = [pdo for pdo in self._rpdos if name in pdo.places]
        for pdo in carriers:  # all of them, because a later one must not revert the value
            at = pdo.places[name]
            pdo.data[at : at + len(data)] = data
        if carriers:
            carriers[0].again = 0
            self._pending[carriers[0].cob_id] = carriers[0]
            return
        self._by_sdo(lambda: self.sdo.download(row.index, row.subindex, data))

    def _by_sdo(self, transfer: Callable[[], T]) -> T:
        """Perform a transfer, then check whether two nodes have this node-id.

        Raises BusError for two nodes, whatever either of them answered.
        """
        refused: Exception | None = None
        try:
            result = transfer()
        except (SdoAbort, Timeout) as error:
            refused = error
        if self.answers.twice:
            raise BusError(
                f"node {self.node_id}", f"two nodes answer to this node-id: {self.answers}",
                "switch one of them off, or give it another node-id",
            ) from refused
        if refused is not None:
            raise refused
        return result

    def use_pdos(self) -> None:
        """See `CanOpenPort.use_pdos`."""
        self.synchronous = False
        rpdos, tpdos = self.pdos("rx"), self.pdos("tx")
        for pdo in rpdos:
            for name, at in pdo.places.items():
                data = self._model.number(name).pack(self.upload(name))
                pdo.data[at : at + len(data)] = data
        self._rpdos, self._tpdos = rpdos, tpdos
        self.synchronous = any(pdo.synchronous for pdo in (*rpdos, *tpdos))
        for _ in range(ATTEMPTS):  # it is not acknowledged, and a repetition has no effect
            self.nmt(NmtCommand.START)

    def listen(self) -> None:
        """Read the mapping of the valid TPDOs and receive them from now on; sends no command."""
        self._tpdos = self.pdos("tx")

    def poll(self, names: Iterable[str]) -> dict[str, int | float]:
        """Read values (drive units) from PDOs received since the last poll, otherwise by SDO."""
        values = {name: self.read(name) for name in names}
        for pdo in self._tpdos:
            pdo.heard = False
        return values

    def default_pdos(self, direction: str) -> list[Pdo]:
        """The PDOs of a direction, rx or tx, that are valid in the model at power-on."""
        pdos = []
        for mapping in self._model.rpdos if direction == "rx" else self._model.tpdos:
            base, _, node = mapping.cob_id.partition("+")
            cob_id = int(base, 0) + (self.node_id if node else 0)
            if not cob_id & 0x8000_0000:
                at, size = places(self._model.objects, mapping.entries)
                pdos.append(Pdo(cob_id & 0x7FF, bytearray(size), at))
        return pdos

    def pdos(self, direction: str) -> list[Pdo]:
        """Read the valid PDOs of a direction, rx or tx, from the node by SDO. Raises SdoAbort."""
        communication, mapping = (0x1400, 0x1600) if direction == "rx" else (0x1800, 0x1A00)
        pdos = []
        for number in range(PDOS):
            try:
                cob_id = self._number(communication + number, 1)
            except SdoAbort as refused:
                if refused.code == Abort.NO_OBJECT:
                    break
                raise
            if cob_id & 0x8000_0000:
                continue
            mapped = self._number(mapping + number, 0)
            words = [self._number(mapping + number, n + 1) for n in range(mapped)]
            at, size = places(self._model.objects, map(mapping_entry, words))
            synchronous = self._number(communication + number, 2) in SYNCHRONOUS
            pdos.append(Pdo(cob_id & 0x7FF, bytearray(size), at, synchronous=synchronous))
        return pdos

    def _number(self, index: int, subindex: int) -> int:
        return int.from_bytes(self._by_sdo(lambda: self.sdo.upload(index, subindex)), "little")
