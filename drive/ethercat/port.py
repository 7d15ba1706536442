"""Access of a master to drives on EtherCAT: objects by SDO, or by process data where mapped."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol

from ..master.port import Units
from ..model.given import whole
from ..model.model import DriveModel, load
from ..model.pdo import mapping_entry, places
from ..objects.hooks.ethercat import mappable
from .al import AlState

LATENCY = 0.01  # s; inferred: until the status bits show the effect of a command
OUTPUTS = ("controlword", "target_position", "modes_of_operation")
INPUTS = ("statusword", "position_actual_value", "modes_of_operation_display")
ASSIGNMENTS = (0x1C12, 0x1C13)
PDO_BYTES = 8


class SlaveSide(Protocol):
    """A slave that a master has found: `master.RemoteSlave` or `wire.soem.SoemSlave`."""

    outputs: bytearray
    inputs: bytes
    mailbox: Any  # upload(index, subindex) and download(index, subindex, data)

    @property
    def state(self) -> AlState:
        """State without the error bit."""

    def read_words(self, word: int) -> bytes:
        """Read 4 or 8 bytes of the EEPROM."""

    def read_sii(self) -> bytes:
        """Read the EEPROM, up to the size it states."""
        image, size = b"", 128
        while len(image) < size:
            image += self.read_words(len(image) // 2)
            if len(image) == 128:
                size = min((int.from_bytes(image[124:126], "little") + 1) * 128, 1 << 16)
        return image[:size]

    def upload(self, index: int, subindex: int = 0) -> int:
        """Read a number by SDO. Raises SdoAbort if the drive refuses."""
        return int.from_bytes(self.mailbox.upload(index, subindex), "little")

    def array(self, index: int) -> list[int]:
        """Read the values of an array by SDO, from sub-index 1 on. Raises SdoAbort."""
        return [self.upload(index, n + 1) for n in range(self.upload(index))]

    def assign(self, rpdos: Iterable[int], tpdos: Iterable[int]) -> None:
        """Assign PDOs to sync managers 2 and 3 (1C12h, 1C13h). Raises SdoAbort, ValueError."""
        for index, pdos in zip(ASSIGNMENTS, ([*rpdos], [*tpdos]), strict=True):
            count = whole("number of PDOs", len(pdos), 0, 254)
            self.mailbox.download(index, 0, b"\0")
            for n, pdo in enumerate(pdos, 1):
                number = whole("PDO", pdo, 0, 0xFFFF)
                self.mailbox.download(index, n, number.to_bytes(2, "little"))
            self.mailbox.download(index, 0, bytes([count]))


class SegmentMaster(Protocol):
    """A master: `master.EtherCatMaster`, or `servogym.drive.wire.soem.SoemMaster`."""

    @property
    def slaves(self) -> Sequence[SlaveSide]:
        """The slaves found by the scan."""

    def scan(self) -> Sequence[SlaveSide]:
        """Find the slaves."""

    def to_preop(self) -> None:
        """Open the mailboxes and bring all slaves to PRE_OPERATIONAL."""

    def to_op(self, prepare: Callable[[], object]) -> None:
        """Bring all slaves to OPERATIONAL; `prepare` fills the outputs before they are sent."""

    def cycle(self) -> bool:
        """Exchange process data once; -> whether every working counter was right."""

    def send_process_data(self) -> None:
        """Send process data; the next call of a method here receives the answer."""

    def look(self) -> bool:
        """Read the inputs only; -> whether all slaves have answered."""

    def recover(self) -> None:
        """Bring slaves back to OPERATIONAL after a watchdog error."""


class EtherCatPort:
    """The slaves of a segment, brought to OPERATIONAL.

    In slaves that are in INIT or PRE_OPERATIONAL, `outputs` and `inputs` are mapped; others keep
    their mapping.

    Args:
        master: master of the segment.
        models: drive models by the names of the slaves, in the order of the slaves; a single model
            is named ``slave``.
        outputs: names of the objects mapped to 1600h, and to the next PDOs once 8 bytes are full.
        inputs: names of the objects mapped to 1A00h and the next PDOs.
        now: returns the time (s); by default that of the bus in memory.
        units: units of the drives, if their factors are known.

    Raises:
        ValueError: slaves and models differ in number, an unknown model or name.
        RuntimeError: a slave refuses a state.
    """

    latency = LATENCY
    cyclic = False  # exchange process data after each SDO too, so that their watchdog is served

    def __init__(
        self,
        master: SegmentMaster,
        models: str | Path | DriveModel | Mapping[str, str | Path | DriveModel],
        *,
        outputs: Sequence[str] = OUTPUTS,
        inputs: Sequence[str] = INPUTS,
        now: Callable[[], float] | None = None,
        units: Units | None = None,
    ):
        named = models if isinstance(models, Mapping) else {"slave": models}
        self.master = master
        self.models = {axis: load(model, "ethercat") for axis, model in named.items()}
        self._units = units or Units()
        self.exchanges = 0  # number of exchanges of process data
        self._now = now or (lambda: master.wire.time * 1e-9)  # type: ignore[attr-defined]
        slaves = master.slaves or master.scan()
        if len(slaves) != len(self.models):
            raise ValueError(f"{len(slaves)} slaves answer, {len(self.models)} models are given: "
                             f"{', '.join(self.models)}; check interface, cable and supply")
        if all(slave.state == AlState.INIT for slave in slaves):
            master.to_preop()
        self.nodes = {
            axis: RemoteObjects(slave, self.models[axis])
            for axis, slave in zip(self.models, slaves, strict=True)
        }
        for node in self.nodes.values():
            if node.slave.state == AlState.PRE_OPERATIONAL:
                node.map(outputs, inputs)
        master.to_op(self._find_places)

    def _find_places(self) -> None:
        for node in self.nodes.values():
            node.find_places()

    def now(self) -> float:
        """Present time (s)."""
        return self._now()

    def read(self, axis: str, name: str) -> int | float:
        """Read an object (drive units) from the process data if mapped, otherwise by SDO."""
        return self.nodes[axis].read(name)

    def upload(self, axis: str, name: str) -> int | float:
        """Read an object (drive units) by SDO."""
        value = self.nodes[axis].upload(name)
        if self.cyclic:
            self.exchange()
        return value

    def write(self, axis: str, name: str, value: int | float) -> None:
        """Set an object (drive units), by SDO, or with the next exchange of process data."""
        if self.nodes[axis].write(name, value) and self.cyclic:
            self.exchange()

    def exchange(self) -> bool:
        """Exchange process data once; -> whether every working counter was right."""
        self.exchanges += 1
        return self.master.cycle()

    def send(self) -> None:
        """Send process data; the next exchange receives the answer."""
        self.exchanges += 1
        self.master.send_process_data()

    def units(self, axis: str) -> Units:
        """Return the units given at construction."""
        return self._units


class RemoteObjects:
    """Reads and writes objects of one slave; arguments and errors as for `EtherCatPort`."""

    def __init__(self, slave: SlaveSide, model: DriveModel):
        self.slave = slave
        self._model = model
        self._outputs: dict[str, int] = {}  # object name -> byte of the process data
        self._inputs: dict[str, int] = {}

    def map(self, outputs: Sequence[str], inputs: Sequence[str]) -> None:
        """Map objects to the first flexible PDOs, as many as needed, and assign these.

        A drive with too few of them keeps its PDOs; `read` and `write` then access the objects that
        are not mapped by SDO.
        """
        shares = [self._shared_out(names) for names in (outputs, inputs)]
        all_pdos, free = (self._model.rpdos, self._model.tpdos), mappable(self._model)
        pdos = [
            [int(pdo.cob_id, 0) for pdo in found[:count]]
            for found, count in zip(all_pdos, free, strict=True)
        ]
        if any(len(wanted) > len(there) for wanted, there in zip(shares, pdos, strict=True)):
            return
        download = self.slave.mailbox.download
        for index in ASSIGNMENTS:
            download(index, 0, b"\0")
        assigned: list[list[int]] = []
        for there, wanted in zip(pdos, shares, strict=True):
            assigned.append(there[: len(wanted)])
            for pdo, words in zip(assigned[-1], wanted, strict=True):
                download(pdo, 0, b"\0")
                for n, word in enumerate(words, 1):
                    download(pdo, n, word.to_bytes(4, "little"))
                download(pdo, 0, bytes([len(words)]))
        self.slave.assign(*assigned)

    def _shared_out(self, names: Sequence[str]) -> list[list[int]]:
        """Distribute the mapping entries of objects over PDOs of 8 bytes."""
        shares: list[list[int]] = [[]]
        free = PDO_BYTES
        for name in names:
            row = self._model.number(name)
            if row.size > free:
                shares.append([])
                free = PDO_BYTES
            shares[-1].append(row.index << 16 | row.subindex << 8 | row.size * 8)
            free -= row.size
        return shares

    def find_places(self) -> None:
        """Read the mapping of the process data; outputs start with the drive's own values."""
        self._outputs, self._inputs = map(self._places, ASSIGNMENTS)
        for name, at in self._outputs.items():
            data = self._model.number(name).pack(self.upload(name))
            self.slave.outputs[at : at + len(data)] = data

    def _places(self, assignment: int) -> dict[str, int]:
        words = [word for pdo in self.slave.array(assignment) for word in self.slave.array(pdo)]
        return places(self._model.objects, map(mapping_entry, words))[0]

    def read(self, name: str) -> int | float:
        """Read an object (drive units) from the process data if mapped, otherwise by SDO."""
        at = self._inputs.get(name)
        if at is None:
            return self.upload(name)
        return self._model.number(name).code.unpack_from(self.slave.inputs, at)[0]

    def upload(self, name: str) -> int | float:
        """Read an object (drive units) by SDO."""
        row = self._model.number(name)
        return row.unpack(self.slave.mailbox.upload(row.index, row.subindex))

    def write(self, name: str, value: int | float) -> bool:
        """Write an object (drive units) to the outputs if mapped, else by SDO; -> whether by SDO.

        Raises:
            ValueError: unknown name, or a value that does not fit the object's type.
            SdoAbort: the drive refuses it.
        """
        row = self._model.number(name)
        data = row.pack(value)
        at = self._outputs.get(name)
        if at is None:
            self.slave.mailbox.download(row.index, row.subindex, data)
        else:
            self.slave.outputs[at : at + len(data)] = data
        return at is None
